"""The mean displacement that patches do not represent, of each fine vertex, in a frame that turns with the cloth.

Hems, seams, gathers and pleats hardly change in time but differ from vertex to vertex. The layers of a sewn-down pleat
read the same patches, so that patches cannot displace them differently. The mean residual of decoding is added to each
vertex. It is added after the correction of edge lengths, so that it also removes the mean error of this correction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix

__all__ = ["fit_vertex_mean", "mean_from_sums", "turned", "vertex_mean_sums"]

MEAN_STEP = 2.0**-15  # means are rounded to this [m], so that they compress well
REGULARISATION = 1e-3  # added to the summed squares of a frame, which may cancel to zero [-]


def fit_vertex_mean(turning: csr_matrix, frames: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Fit to each fine vertex the displacement d that minimises the sum of |r - M^T d|^2 over some frames.

    M is the frame of the fine vertex, and r its residual.

    Args:
        turning: weights of the coarse vertices' frames in M, see :class:`wrinkles.patches.Patches`, shape (N, n).
        frames: of the coarse vertices, shape (f, n, 9).
        residual: in space [m], shape (f, N, 3).

    Returns:
        d [m], float32, shape (N, 3).
    """
    return mean_from_sums([vertex_mean_sums(turning, frames, residual)])


def vertex_mean_sums(turning: csr_matrix, frames: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of :func:`fit_vertex_mean`, summed over some frames: shapes (N, 3, 3), (N, 3)."""
    left, right = np.zeros((turning.shape[0], 3, 3)), np.zeros((turning.shape[0], 3))
    for at, found in zip(frames, residual, strict=True):
        basis = (turning @ at).reshape(-1, 3, 3)
        left += basis @ basis.transpose(0, 2, 1)
        right += np.einsum("nax,nx->na", basis, found)
    return left, right


def mean_from_sums(sums: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """The means that solve :func:`vertex_mean_sums` of all frames together [m], float32, shape (N, 3)."""
    left = sum(one[0] for one in sums) + REGULARISATION * np.eye(3)
    right = sum(one[1] for one in sums)
    mean = np.linalg.solve(left, right[..., None])[..., 0]
    return (np.round(mean / MEAN_STEP) * MEAN_STEP).astype(np.float32)


def turned(turning: csr_matrix, frames: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """The means of one state, turned into space [m], shape (N, 3).

    Args:
        turning: as for :func:`fit_vertex_mean`.
        frames: of the coarse vertices in that state, shape (n, 9).
        mean: of :func:`fit_vertex_mean` [m], shape (N, 3).
    """
    return np.einsum("nax,na->nx", (turning @ frames).reshape(-1, 3, 3), mean)
