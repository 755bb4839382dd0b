"""The banded Cholesky factorisation against dense algebra."""

import numpy as np
import pytest
from scipy.sparse import eye as identity

from pbd.models.linear import Cholesky, FreeOrder, NotPositiveDefinite
from pbd.models.springs import triangle_springs
from tests.pbd.models.sheets import sheet


def test_it_solves_for_the_free_vertices() -> None:
    model = sheet()
    springs = triangle_springs(model.mesh, model.fabric)
    free = np.array([0, 3, 4, 5, 7, 11, 12, 19])
    matrix = springs.hessian(model.mesh.vertices) + 3.0 * identity(60)
    right = np.random.default_rng(0).normal(size=(20, 3))
    solution = Cholesky(matrix, FreeOrder([springs], free)).solve(right)
    rows = (3 * free[:, None] + np.arange(3)).ravel()
    assert solution.ravel()[rows] == pytest.approx(
        np.linalg.solve(matrix.toarray()[np.ix_(rows, rows)], right.ravel()[rows])
    )
    assert not solution[np.setdiff1d(np.arange(20), free)].any()


@pytest.mark.parametrize("shift", [-1.0, np.nan])
def test_what_cannot_be_factorised_is_told(shift: float) -> None:
    model = sheet()
    springs = triangle_springs(model.mesh, model.fabric)
    matrix = springs.hessian(model.mesh.vertices) + shift * identity(60)
    with pytest.raises(NotPositiveDefinite):
        Cholesky(matrix, FreeOrder([springs], np.arange(20)))
