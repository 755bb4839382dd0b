"""A low-pass filter for a coarse garment that is simulated on its own, before its wrinkles are predicted.

The dictionary was trained on filtered coarse states, which have no folds of the shortest wavelengths.
"""

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, hstack
from scipy.sparse.linalg import splu

from pbd.bending import hinge_rows
from pbd.engine import ensure_initialized, ti
from pbd.taichi_internals import Launch
from wrinkles.levels import Levels

__all__ = ["CoarseFilter"]

COLUMNS = 256  # that are solved for at once
MIN_WEIGHT = 2e-3  # smaller weights are left out: the filter then reaches about three rings of vertices

Vec4 = ti.types.ndarray(dtype=ti.math.vec4, ndim=1)
Int1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
Float1 = ti.types.ndarray(dtype=ti.f32, ndim=1)


@ti.kernel
def _filter(start: Int1, index: Int1, value: Float1, position: Vec4, filtered: Vec4):
    """Multiply positions by a sparse matrix; the fourth column is copied."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(filtered.shape[0]):
            x = ti.math.vec4(0.0)
            for q in range(start[i], start[i + 1]):
                x += value[q] * position[index[q]]
            filtered[i] = ti.math.vec4(x[0], x[1], x[2], position[i][3])


class CoarseFilter:
    """The smoothing spline of :meth:`Levels.filter_down`, on the coarse mesh itself and with the same cut-off.

    A filtered fine run keeps the share 1/(1 + (cutoff/L)^4) of a fold of wavelength L. A coarse garment that is
    simulated on its own also has folds at the limit of its mesh. Without the filter the dictionary would take such a
    fold for the faint remainder of a fine fold, and amplify it.

    Args:
        levels: of the garment.

    Attributes:
        matrix: filters coarse positions; rows sum to one, held vertices stay; shape (n, n).
        position: filtered positions of the last call [m], float32, shape (n, 4).
    """

    def __init__(self, levels: Levels) -> None:
        ensure_initialized()
        mesh, count = levels.coarse, levels.subdivision.coarse_count
        hinges, rows, areas, _ = hinge_rows(mesh)
        columns = (np.repeat(np.arange(len(hinges)), 4), hinges.ravel())
        curl = csr_matrix((rows.ravel(), columns), (len(hinges), count))
        bending = curl.T @ curl.multiply((1.0 / areas)[:, None])
        weight = mesh.vertex_areas.copy()
        weight[levels.coarse_held] *= 1.0e3
        stiffness = (levels.cutoff / (2.0 * np.pi)) ** 4
        factor = splu((diags(weight) + stiffness * bending).tocsc())
        parts = []
        for first in range(0, count, COLUMNS):  # the whole matrix would need count^2 numbers
            last = min(first + COLUMNS, count)
            some = np.zeros((count, last - first))
            some[np.arange(first, last), np.arange(last - first)] = weight[first:last]
            some = factor.solve(some)
            some[np.abs(some) < MIN_WEIGHT] = 0.0
            parts.append(csc_matrix(some))
        matrix = hstack(parts).tolil()
        matrix[levels.coarse_held] = 0.0
        matrix[levels.coarse_held, levels.coarse_held] = 1.0
        matrix = matrix.tocsr()
        self.matrix = (diags(1.0 / np.asarray(matrix.sum(axis=1)).ravel()) @ matrix).tocsr()
        self.matrix.sort_indices()
        self._start = self.matrix.indptr.astype(np.int32)
        self._index = self.matrix.indices.astype(np.int32)
        self._value = self.matrix.data.astype(np.float32)
        self.position = np.zeros((count, 4), np.float32)
        self._filter = Launch(_filter)

    def __call__(self, position: np.ndarray) -> np.ndarray:
        """Filter positions [m], float32, shape (n, 4).

        Returns:
            :attr:`position`, which the next call overwrites. The fourth column is copied.
        """
        self._filter(self._start, self._index, self._value, position, self.position)
        return self.position
