from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import block_diag, csc_matrix, diags

from pbd import ClothMesh
from tests.wrinkles.meshes import flat_sheet
from wrinkles.nested_dissection import BlockSolver, Dissection
from wrinkles.spectrum import cotangent_laplacian


def turned_system(side: int) -> csc_matrix:
    """Mass and stiffness of a sheet, as a filter's pole joins them: complex symmetric."""
    stiffness, mass = cotangent_laplacian(ClothMesh.from_surface(*flat_sheet(side, 1.0, jitter=0.25)))
    return csc_matrix(diags(mass) - (0.05**2 / np.exp(0.25j * np.pi)) * stiffness)


@pytest.mark.parametrize("side", [3, 40])
def test_solves_what_a_dense_solver_solves(side: int) -> None:
    matrix = turned_system(side)
    right = np.random.default_rng(0).normal(size=(matrix.shape[0], 5))
    exact = np.linalg.solve(matrix.toarray(), right)
    for dtype, tolerance in ((np.complex128, 1e-11), (np.complex64, 1e-5)):
        solver = BlockSolver(matrix, Dissection(matrix), dtype)
        found = solver.solve(right)
        assert found.dtype == dtype
        assert np.abs(found - exact).max() < tolerance * np.abs(exact).max()
        assert np.allclose(solver.quadratic(right), (right * exact).sum(axis=0), rtol=tolerance)


def test_cloth_in_several_pieces() -> None:
    matrix = csc_matrix(block_diag([turned_system(15), turned_system(12), turned_system(2)]))
    right = np.random.default_rng(1).normal(size=(matrix.shape[0], 3))
    found = BlockSolver(matrix, Dissection(matrix), np.complex128).solve(right)
    assert np.allclose(matrix @ found, right, atol=1e-12)


def test_parts_cover_all_unknowns_once_and_are_small() -> None:
    matrix = turned_system(60)
    dissection = Dissection(matrix)
    assert np.array_equal(np.sort(dissection.order), np.arange(3600))
    ends = [0, *(block.end for block in dissection.blocks)]
    assert [block.start for block in dissection.blocks] == ends[:-1] and ends[-1] == 3600
    # A separator of a square sheet is about a side or a diagonal long; without dissection one block would hold all.
    assert max(np.diff(ends)) < 3 * 60
    assert all((block.after >= block.end).all() for block in dissection.blocks)
