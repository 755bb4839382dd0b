"""Linear systems: a banded Cholesky factorisation, kept for as long as the matrix stays."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from functools import cache

import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.sparse import coo_matrix, csr_matrix, spmatrix
from scipy.sparse.csgraph import reverse_cuthill_mckee
from threadpoolctl import ThreadpoolController

from pbd.models.elements import ElementEnergy

__all__ = ["Cholesky", "FreeOrder", "NotPositiveDefinite"]


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()  # looks through all loaded libraries, which takes milliseconds


def _one_thread() -> AbstractContextManager:
    """BLAS on one thread: of a narrow band, two wait for one another longest, on a busy machine 50 times as long."""
    return _libraries().limit(limits=1, user_api="blas")


class NotPositiveDefinite(ArithmeticError):
    """The matrix has an eigenvalue that is not positive, or an entry that is not finite."""


class FreeOrder:
    """Order of the free unknowns that keeps a cloth's matrices in a narrow band (reverse Cuthill-McKee).

    Args:
        parts: energies whose elements say which vertices meet.
        free: vertices that move, int, shape (f,).
    """

    def __init__(self, parts: Sequence[ElementEnergy], free: np.ndarray) -> None:
        count = parts[0].vertex_count
        place = np.full(count, -1)
        place[free] = np.arange(len(free))
        rows, columns = [np.arange(len(free))], [np.arange(len(free))]
        for part in parts:
            local = place[part.elements]
            pairs = np.stack(np.broadcast_arrays(local[:, :, None], local[:, None]), axis=-1).reshape(-1, 2)
            pairs = pairs[(pairs >= 0).all(axis=1)]
            rows.append(pairs[:, 0])
            columns.append(pairs[:, 1])
        row, column = np.concatenate(rows), np.concatenate(columns)
        graph = coo_matrix((np.ones(len(row)), (row, column)), (len(free), len(free))).tocsr()
        order = free[reverse_cuthill_mckee(graph, symmetric_mode=True)]
        self.unknowns = (3 * order[:, None] + np.arange(3)).ravel()
        self.position = np.full(3 * count, -1)
        self.position[self.unknowns] = np.arange(len(self.unknowns))


class Cholesky:
    """Factorised matrix of the free unknowns.

    Args:
        matrix: symmetric, shape (3 n, 3 n); rows and columns of held vertices are left out.
        order: see :class:`FreeOrder`.

    Raises:
        NotPositiveDefinite: it cannot be factorised.
    """

    def __init__(self, matrix: csr_matrix | spmatrix, order: FreeOrder) -> None:
        self.order = order
        entries = coo_matrix(matrix)
        row, column = order.position[entries.row], order.position[entries.col]
        lower = (row >= column) & (column >= 0)
        row, column, values = row[lower], column[lower], entries.data[lower]
        if not np.isfinite(values).all():
            raise NotPositiveDefinite("a matrix that is not finite")
        band = np.zeros((int((row - column).max(initial=0)) + 1, len(order.unknowns)))
        band[row - column, column] = values
        try:
            with _one_thread():
                self.band = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
        except LinAlgError as error:
            raise NotPositiveDefinite(str(error)) from error

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution for a right side, shape (n, 3); zero at held vertices."""
        solution = np.zeros(right.size)
        unknowns = self.order.unknowns
        with _one_thread():
            solution[unknowns] = cho_solve_banded((self.band, True), right.ravel()[unknowns], check_finite=False)
        return solution.reshape(-1, 3)
