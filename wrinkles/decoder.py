"""Draws wrinkles at run time: from the state of the coarse garment to the vertices of the fine mesh.

All arrays are allocated once, so that a frame allocates none.
"""

import numpy as np
from threadpoolctl import ThreadpoolController

from pbd.engine import ensure_initialized, ti
from pbd.geometry import (
    Float1,
    Float2,
    Int1,
    Int3,
    Vec3,
    Vec4,
    vec3,
)
from pbd.taichi_internals import Launch
from wrinkles.dictionary import CLIP, Atoms, CoefficientNetwork
from wrinkles.features import DYNAMIC_COUNT, Stencil
from wrinkles.novelty import NoveltyScore
from wrinkles.patches import NODES, SIDE, Patches
from wrinkles.surface import Subdivision, csr_arrays

__all__ = ["Decoder", "MeanWriter", "PatchWriter", "Upsampler", "add_patches"]


@ti.func
def _sparse_row(start: ti.template(), index: ti.template(), value: ti.template(), source: ti.template(), i: ti.i32):
    """Row i of a sparse matrix times the vectors of ``source``."""
    total = vec3(0.0)
    for q in range(start[i], start[i + 1]):
        p = source[index[q]]
        total += value[q] * vec3(p[0], p[1], p[2])
    return total


@ti.kernel
def _to_middle(start: Int1, index: Int1, value: Float1, coarse: Vec4, middle: Vec3):
    """Middle vertices of coarse ones, by :attr:`wrinkles.surface.Subdivision.to_middle`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(middle.shape[0]):
            middle[i] = _sparse_row(start, index, value, coarse, i)


@ti.kernel
def _to_fine(start: Int1, index: Int1, value: Float1, middle: Vec3, fine: Vec3):
    """Fine vertices of middle ones, by :attr:`wrinkles.surface.Subdivision.from_middle`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(fine.shape[0]):
            fine[i] = _sparse_row(start, index, value, middle, i)


@ti.kernel
def add_patches(grids: Float2, frames: Float2, corners: Int3, blend: Vec3, cell: Int3, within: Float2, fine: Vec3):
    """Add to each fine vertex the blended displacements of the three patches around it.

    Each patch is read with bilinear interpolation and turned from its own frame into space. Arguments as in
    :class:`wrinkles.patches.Patches`; ``grids`` float32, shape (n, 3 NODES), ``frames`` float32, shape (n, 9).
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(fine.shape[0]):
            total = vec3(0.0)
            for c in ti.static(range(3)):
                weight = blend[i][c]
                if weight > 1e-4:
                    j = corners[i][c]
                    u, v = within[i, 2 * c], within[i, 2 * c + 1]
                    k = 3 * cell[i][c]
                    d = vec3(0.0)
                    for a in ti.static(range(3)):
                        d[a] = (1.0 - u) * ((1.0 - v) * grids[j, k + a] + v * grids[j, k + 3 + a]) + u * (
                            (1.0 - v) * grids[j, k + 3 * SIDE + a] + v * grids[j, k + 3 * SIDE + 3 + a]
                        )
                    for a in ti.static(range(3)):
                        total[a] += weight * (d[0] * frames[j, a] + d[1] * frames[j, 3 + a] + d[2] * frames[j, 6 + a])
            fine[i] += total


@ti.kernel
def _add_smoothed(start: Int1, index: Int1, value: Float1, displacement: Vec3, fine: Vec3):
    """Add displacements to fine vertices after smoothing them with a sparse matrix."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(fine.shape[0]):
            fine[i] += _sparse_row(start, index, value, displacement, i)


@ti.kernel
def _add_turned(start: Int1, index: Int1, value: Float1, frames: Float2, mean: Vec3, fine: Vec3):
    """Turn each fine vertex's mean by the weighted sum of coarse frames, and add it."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(fine.shape[0]):
            d, total = mean[i], vec3(0.0)
            for q in range(start[i], start[i + 1]):
                j = index[q]
                for a in ti.static(range(3)):
                    total[a] += value[q] * (d[0] * frames[j, a] + d[1] * frames[j, 3 + a] + d[2] * frames[j, 6 + a])
            fine[i] += total


class PatchWriter:
    """Adds the displacements of grids to the vertices of a mesh.

    On a delivered mesh they are smoothed where its bound points crowd.

    Args:
        patches: where each vertex reads the grids.
    """

    def __init__(self, patches: Patches) -> None:
        self._patches = patches
        self._add_patches = Launch(add_patches)
        if patches.smoothing is not None:
            self._smoothing = csr_arrays(patches.smoothing)
            self._displacement = np.zeros((len(patches.corners), 3), np.float32)
            self._add_smoothed = Launch(_add_smoothed)

    def __call__(self, grids: np.ndarray, frames: np.ndarray, vertices: np.ndarray) -> None:
        """Add the displacements to ``vertices`` in place.

        Args:
            grids: displacements in the patches' frames [m], float32, shape (n, 3 NODES).
            frames: of the coarse vertices, float32, shape (n, 9).
            vertices: [m], float32, shape (N, 3).
        """
        p = self._patches
        if p.smoothing is None:
            self._add_patches(grids, frames, p.corners, p.blend, p.cell, p.within, vertices)
            return
        self._displacement[:] = 0.0
        self._add_patches(grids, frames, p.corners, p.blend, p.cell, p.within, self._displacement)
        self._add_smoothed(*self._smoothing, self._displacement, vertices)


class MeanWriter:
    """Adds the mean displacement of each vertex, turned into space, see :mod:`wrinkles.vertex_mean`.

    Args:
        patches: holds the weights of the coarse vertices' frames.
        mean: displacement in the vertex's frame [m], float32, shape (N, 3).
    """

    def __init__(self, patches: Patches, mean: np.ndarray) -> None:
        self._turning, self._mean = csr_arrays(patches.turning), mean
        self._add_turned = Launch(_add_turned)

    def __call__(self, frames: np.ndarray, vertices: np.ndarray) -> None:
        """Add the mean to ``vertices`` in place; arguments as for :class:`PatchWriter`."""
        self._add_turned(*self._turning, frames, self._mean, vertices)


class Upsampler:
    """Computes the smooth fine surface of a coarse state, with two sparse matrices.

    Args:
        subdivision: from the coarse to the fine mesh.

    Attributes:
        middle: vertices of the coarse mesh cut once, the result of the first matrix [m], float32, shape (q, 3).
    """

    def __init__(self, subdivision: Subdivision) -> None:
        ensure_initialized()
        self._first, self._second = csr_arrays(subdivision.to_middle), csr_arrays(subdivision.from_middle)
        self.middle = np.zeros((subdivision.middle.fine_count, 3), np.float32)
        self._to_middle, self._to_fine = Launch(_to_middle), Launch(_to_fine)

    def __call__(self, position: np.ndarray, fine: np.ndarray) -> None:
        """Write smooth fine positions (float32, shape (N, 3)) of coarse ones (float32, shape (n, 4)) [m]."""
        self._to_middle(*self._first, position, self.middle)
        self._to_fine(*self._second, self.middle, fine)


class Decoder:
    """Adds the dictionary's displacements to the smooth surface.

    Args:
        stencil: reads features and frames from the coarse garment.
        patches, middle_patches: where the vertices of the fine and of the middle mesh read the grids.
        mapping: gives coefficients for features.
        atoms: give grids for coefficients.
        unfamiliarity: fades wrinkles where the coarse state is unlike the training data.

    Attributes:
        amplitude: share of the wrinkles that was drawn at each coarse vertex, float32, shape (n,).
        frames, features: of the last state, see :meth:`Stencil.read`.
    """

    def __init__(
        self,
        stencil: Stencil,
        patches: Patches,
        middle_patches: Patches,
        mapping: CoefficientNetwork,
        atoms: Atoms,
        novelty: NoveltyScore,
    ) -> None:
        self.stencil, self.mapping, self.novelty = stencil, mapping, novelty
        self.amplitude = np.ones(len(stencil.corners), np.float32)
        count, (regions, width_1, width_2) = len(stencil.corners), mapping.weights_2.shape
        self.frames = np.zeros((count, 9), np.float32)
        self.features = np.zeros((count, DYNAMIC_COUNT), np.float32)
        # The network runs region by region, over rows that lie together.
        self._order = np.argsort(mapping.region, kind="stable")
        ends = np.searchsorted(mapping.region[self._order], np.arange(regions + 1))
        self._spans = [slice(*ends[r : r + 2]) for r in range(regions)]
        self._place_bias = np.ascontiguousarray(mapping.place_bias[self._order])
        self._features = np.zeros_like(self.features)
        self._hidden_1 = np.zeros((count, width_1), np.float32)
        self._hidden_2 = np.zeros((count, width_2), np.float32)
        self._output, self._coefficients = (np.zeros((count, len(atoms.shapes)), np.float32) for _ in range(2))
        self._grids = np.zeros((count, 3 * NODES), np.float32)
        self._shapes = np.ascontiguousarray(atoms.shapes)
        self._mean = atoms.mean
        self._add_to_fine, self._add_to_middle = PatchWriter(patches), PatchWriter(middle_patches)
        self._add_mean = MeanWriter(patches, atoms.vertex_mean)
        self._blas = ThreadpoolController()

    def read(self, position: np.ndarray, contact: np.ndarray) -> None:
        """Set ``frames`` and ``features`` to those of a coarse state; arguments as for :meth:`add`."""
        m = self.mapping
        self.stencil.read(position, contact, self.frames, self.features, m.center, m.scale, CLIP)

    def add(
        self,
        position: np.ndarray,
        contact: np.ndarray,
        fine: np.ndarray,
        middle: np.ndarray,
        atoms: int | None = None,
    ) -> None:
        """Add wrinkles to fine and middle vertices for a coarse state.

        Args:
            position, contact: of the coarse garment, as in :class:`pbd.State`.
            fine, middle: [m], float32, shapes (N, 3), (q, 3); changed in place.
            atoms: number of atoms used, the most important ones first; None takes all.
        """
        self.read(position, contact)
        # Matrices this small are slower on several threads, much slower beside other work, and their bits would depend
        # on the number of threads.
        with self._blas.limit(limits=1, user_api="blas"):
            self._mix(len(self._shapes) if atoms is None else min(atoms, len(self._shapes)))
        self._add_to_fine(self._grids, self.frames, fine)
        self._add_mean(self.frames, fine)
        self._add_to_middle(self._grids, self.frames, middle)  # lengths are brought back without the mean

    def _mix(self, atoms: int) -> None:
        """Run the network: features to grids, with the first ``atoms`` atoms."""
        m, output, coefficients = self.mapping, self._output[:, :atoms], self._coefficients[:, :atoms]
        np.take(self.features, self._order, axis=0, out=self._features, mode="clip")  # the default mode makes a copy
        np.matmul(self._features, m.weights_1, out=self._hidden_1)
        self._hidden_1 += self._place_bias
        np.maximum(self._hidden_1, 0.0, out=self._hidden_1)
        for r, rows in enumerate(self._spans):
            second = self._hidden_2[rows]
            np.matmul(self._hidden_1[rows], m.weights_2[r], out=second)
            second += m.bias_2[r]
            np.maximum(second, 0.0, out=second)
            np.matmul(second, m.weights_3[r, :, :atoms], out=output[rows])
            output[rows] += m.bias_3[r, :atoms]
        amplitude = self.novelty.amplitude(self.novelty.score(self._hidden_1))
        output *= amplitude[:, None]
        self.amplitude[self._order], coefficients[self._order] = amplitude, output
        np.matmul(coefficients, self._shapes[:atoms], out=self._grids)
        self._grids += self._mean
