"""Predicts wrinkles at run time: from the state of the coarse garment to the smooth surface and grids of displacements.

All arrays are allocated once, so that a frame allocates none.
"""

from collections.abc import Sequence

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

    A layer max(W x + b, 0) is computed as max(W x, -b), the sum with b being left to the biases of the next layer: of
    arrays as large as one another NumPy takes the larger in one fast pass.

    Args:
        stencil: reads features and frames from the coarse garment.
        mapping: gives coefficients for features.
        atoms: give grids for coefficients.
        novelty: fades wrinkles where the coarse state is unlike the training data.

    Attributes:
        amplitude: share of the wrinkles that was drawn at each coarse vertex, float32, shape (n,).
        score: log of the error that is expected there, see :meth:`NoveltyScore.score` [log deg], float32, shape (n,).
        frames: of the last state, see :meth:`Stencil.read`.
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
        count, width = len(stencil.corners), mapping.weights_2.shape[2]
        self.amplitude = np.ones(count, np.float32)
        self.score = np.zeros(count, np.float32)
        self.frames = np.zeros((count, 9), np.float32)
        # The network runs region by region, over rows that lie together and stay in the processor's cache.
        order = np.argsort(mapping.region, kind="stable")
        self._row, region = np.argsort(order).astype(np.int32), mapping.region[order]
        ends = np.searchsorted(region, np.arange(len(mapping.weights_2) + 1))
        self._spans = [slice(*ends[r : r + 2]) for r in range(len(mapping.weights_2))]
        # Beside the second layer of each region, the units of the novelty score.
        heads = np.broadcast_to(novelty.weights_1, (len(mapping.weights_2), *novelty.weights_1.shape))
        self._weights_2 = np.concatenate([mapping.weights_2, heads], axis=2)
        self._blas = ThreadpoolController()
        with self._blas.limit(limits=1, user_api="blas"):
            bias_1 = mapping.place_bias[order].astype(float)
            bias_2 = _through(bias_1, self._spans, self._weights_2)
            bias_2[:, :width] += mapping.bias_2[region]
            bias_2[:, width:] += novelty.bias_1
            bias_3 = np.zeros((count, 1 + len(atoms.shapes)))
            bias_3[:, 1:] = _through(bias_2[:, :width], self._spans, mapping.weights_3) + mapping.bias_3[region]
            bias_score = bias_2[:, width:] @ novelty.weights_2 + novelty.bias_2
        self._floor_1, self._floor_2, self._bias_3, self._bias_score = (
            np.ascontiguousarray(bias, np.float32) for bias in (-bias_1, -bias_2, bias_3, bias_score)
        )
        self._features = np.zeros((count, DYNAMIC_COUNT), np.float32)
        largest = int(np.bincount(region).max())
        self._hidden_1, self._hidden_2 = (np.zeros_like(floor[:largest]) for floor in (self._floor_1, self._floor_2))
        self._score = np.zeros(count, np.float32)
        self._output, self._coefficients = np.zeros_like(self._bias_3), np.zeros_like(self._bias_3)
        self._shapes = np.concatenate([atoms.mean[None], atoms.shapes])  # the mean patch is one more atom
        self.grids = np.zeros((count, len(atoms.mean)), np.float32)

    def read(self, position: np.ndarray, contact: np.ndarray) -> None:
        """Set ``frames`` to those of a coarse state.

        Args:
            position, contact: of the coarse garment, as in :class:`pbd.State`.
        """
        m = self.mapping
        self.stencil.read(
            position, contact, self.frames, self._features, m.center, scale=m.scale, limit=CLIP, row=self._row
        )

    def predict(self, position: np.ndarray, contact: np.ndarray, atoms: int | None = None) -> None:
        """Set ``grids`` to those of a coarse state, and all other attributes.

        Args:
            position, contact: as for :meth:`read`.
            atoms: number of atoms used, the most important ones first; None takes all.
        """
        self.read(position, contact)
        count = len(self._shapes) - 1
        # Matrices this small are slower on several threads, much slower beside other work, and their bits would depend
        # on the number of threads.
        with self._blas.limit(limits=1, user_api="blas"):
            self._mix(count if atoms is None else min(atoms, count))

    def _mix(self, atoms: int) -> None:
        """Run the network: features to grids, with the first ``atoms`` atoms."""
        width = self.mapping.weights_2.shape[2]
        for r, rows in enumerate(self._spans):
            first, second = (hidden[: rows.stop - rows.start] for hidden in (self._hidden_1, self._hidden_2))
            np.matmul(self._features[rows], self.mapping.weights_1, out=first)
            np.maximum(first, self._floor_1[rows], out=first)
            np.matmul(first, self._weights_2[r], out=second)
            np.maximum(second, self._floor_2[rows], out=second)
            weights_3 = self.mapping.weights_3[r, :, :atoms]
            np.matmul(second[:, :width], weights_3, out=self._output[rows, 1 : 1 + atoms])
            np.matmul(second[:, width:], self.novelty.weights_2, out=self._score[rows])
        self._score += self._bias_score
        amplitude = self.novelty.amplitude(self._score)
        output = self._output[:, : 1 + atoms]
        output += self._bias_3[:, : 1 + atoms]
        output *= amplitude[:, None]
        np.take(self._score, self._row, out=self.score, mode="clip")  # the default mode makes a copy
        np.take(amplitude, self._row, out=self.amplitude, mode="clip")
        np.take(self._output, self._row, axis=0, out=self._coefficients, mode="clip")
        self._coefficients[:, 0] = 1.0
        np.matmul(self._coefficients[:, : 1 + atoms], self._shapes[: 1 + atoms], out=self.grids)


def _through(rows: np.ndarray, spans: Sequence[slice], weights: np.ndarray) -> np.ndarray:
    """Rows, shape (n, p), times the weights of their regions, shape (r, p, q): shape (n, q)."""
    return np.concatenate([rows[span] @ w for span, w in zip(spans, weights, strict=True)])
