"""The filter of a freely running coarse garment: the dictionary learned from one without folds at its mesh's limit."""

import numpy as np
from scipy.sparse import csr_matrix, diags

from pbd.bending import hinge_rows
from pbd.engine import ensure_initialized, ti
from pbd.taichi_internals import Launch
from wrinkles.levels import Levels

__all__ = ["CoarseFilter"]

LEAST = 2e-3  # smaller weights are left out: the filter reaches about three rings

Vec4 = ti.types.ndarray(dtype=ti.math.vec4, ndim=1)
Int1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
Float1 = ti.types.ndarray(dtype=ti.f32, ndim=1)


@ti.kernel
def _filter(start: Int1, index: Int1, value: Float1, position: Vec4, filtered: Vec4):
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(filtered.shape[0]):
            x = ti.math.vec4(0.0)
            for q in range(start[i], start[i + 1]):
                x += value[q] * position[index[q]]
            filtered[i] = ti.math.vec4(x[0], x[1], x[2], position[i][3])


class CoarseFilter:
    """The smoothing spline of :meth:`Levels.filter_down`, on the coarse mesh itself and with the same cut-off.

    A fine run filtered down keeps 1/(1 + (cutoff/L)^4) of a fold of wavelength L. A coarse garment that runs freely
    folds at its mesh's limit too; the dictionary would take that for the small rest of a fold that it knows, and
    raise it.

    Args:
        levels: of the garment.

    Attributes:
        matrix: rows sum to one, held vertices stay; shape (n, n).
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
        whole = np.linalg.solve((diags(weight) + stiffness * bending).toarray(), np.diag(weight))
        whole[np.abs(whole) < LEAST] = 0.0
        whole[levels.coarse_held] = np.eye(count)[levels.coarse_held]
        self.matrix = csr_matrix(whole / whole.sum(axis=1, keepdims=True))
        self._start = self.matrix.indptr.astype(np.int32)
        self._index = self.matrix.indices.astype(np.int32)
        self._value = self.matrix.data.astype(np.float32)
        self.position = np.zeros((count, 4), np.float32)
        self._filter = Launch(_filter)

    def __call__(self, position: np.ndarray) -> np.ndarray:
        """Filtered positions [m]: an array of the filter, float32, shape (n, 4)."""
        self._filter(self._start, self._index, self._value, position, self.position)
        return self.position
