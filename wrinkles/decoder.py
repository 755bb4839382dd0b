"""Predicts wrinkles at run time: from the state of the coarse garment to the smooth surface and grids of displacements.

All arrays are allocated once, so that a frame allocates none.
"""

import numpy as np
from threadpoolctl import ThreadpoolController

from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Int1, Vec3, Vec4, xyz
from pbd.taichi_internals import Launch
from wrinkles.dictionary import CLIP, Atoms, CoefficientNetwork
from wrinkles.features import DYNAMIC_COUNT, Stencil
from wrinkles.fine_surface import sparse_row
from wrinkles.novelty import NoveltyScore
from wrinkles.surface import Subdivision, csr_arrays

__all__ = ["Decoder", "Upsampler"]


@ti.kernel
def _to_middle(start: Int1, index: Int1, value: Float1, coarse: Vec4, middle: Vec4):
    """Middle vertices of coarse ones, by :attr:`wrinkles.surface.Subdivision.to_middle`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(middle.shape[0]):
            middle[i] = sparse_row(start, index, value, coarse, i)


@ti.kernel
def _to_fine(start: Int1, index: Int1, value: Float1, middle: Vec4, fine: Vec3):
    """Fine vertices of middle ones, by :attr:`wrinkles.surface.Subdivision.from_middle`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(fine.shape[0]):
            fine[i] = xyz(sparse_row(start, index, value, middle, i))


class Upsampler:
    """Computes the smooth fine surface of a coarse state, with two sparse matrices.

    Args:
        subdivision: from the coarse to the fine mesh.

    Attributes:
        middle: vertices of the coarse mesh cut once, the result of the first matrix [m], float32, shape (q, 4); the
            last column is not used.
    """

    def __init__(self, subdivision: Subdivision) -> None:
        ensure_initialized()
        self._first, self._second = csr_arrays(subdivision.to_middle), csr_arrays(subdivision.from_middle)
        self.middle = np.zeros((subdivision.middle.fine_count, 4), np.float32)
        self._to_middle, self._to_fine = Launch(_to_middle), Launch(_to_fine)

    def __call__(self, position: np.ndarray, fine: np.ndarray) -> None:
        """Write smooth fine positions (float32, shape (N, 3)) of coarse ones (float32, shape (n, 4)) [m]."""
        self.to_middle(position)
        self._to_fine(*self._second, self.middle, fine)

    def to_middle(self, position: np.ndarray) -> None:
        """Write :attr:`middle` alone."""
        self._to_middle(*self._first, position, self.middle)


class Decoder:
    """Predicts the dictionary's displacements: a grid of them around each coarse vertex.

    Args:
        stencil: reads features and frames from the coarse garment.
        mapping: gives coefficients for features.
        atoms: give grids for coefficients.
        novelty: fades wrinkles where the coarse state is unlike the training data.

    Attributes:
        amplitude: share of the wrinkles that was drawn at each coarse vertex, float32, shape (n,).
        score: log of the error that is expected there, see :meth:`NoveltyScore.score` [log deg], float32, shape (n,).
        frames, features: of the last state, see :meth:`Stencil.read`.
        grids: displacements in the patches' frames [m], float32, shape (n, 3 nodes).
    """

    def __init__(
        self,
        stencil: Stencil,
        mapping: CoefficientNetwork,
        atoms: Atoms,
        novelty: NoveltyScore,
    ) -> None:
        self.stencil, self.mapping, self.novelty = stencil, mapping, novelty
        self.amplitude = np.ones(len(stencil.corners), np.float32)
        self.score = np.zeros(len(stencil.corners), np.float32)
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
        self.grids = np.zeros((count, len(atoms.mean)), np.float32)
        self._shapes = np.ascontiguousarray(atoms.shapes)
        self._mean = atoms.mean
        self._blas = ThreadpoolController()

    def read(self, position: np.ndarray, contact: np.ndarray) -> None:
        """Set ``frames`` and ``features`` to those of a coarse state.

        Args:
            position, contact: of the coarse garment, as in :class:`pbd.State`.
        """
        m = self.mapping
        self.stencil.read(position, contact, self.frames, self.features, m.center, m.scale, CLIP)

    def predict(self, position: np.ndarray, contact: np.ndarray, atoms: int | None = None) -> None:
        """Set ``grids`` to those of a coarse state, and all that :meth:`read` sets.

        Args:
            position, contact: as for :meth:`read`.
            atoms: number of atoms used, the most important ones first; None takes all.
        """
        self.read(position, contact)
        # Matrices this small are slower on several threads, much slower beside other work, and their bits would depend
        # on the number of threads.
        with self._blas.limit(limits=1, user_api="blas"):
            self._mix(len(self._shapes) if atoms is None else min(atoms, len(self._shapes)))

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
        score = self.novelty.score(self._hidden_1)
        amplitude = self.novelty.amplitude(score)
        output *= amplitude[:, None]
        self.score[self._order], self.amplitude[self._order], coefficients[self._order] = score, amplitude, output
        np.matmul(coefficients, self._shapes[:atoms], out=self.grids)
        self.grids += self._mean
