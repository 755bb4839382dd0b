"""What patches leave of each fine vertex's displacement on average, in a frame that turns with the cloth.

Hems, seams, gathers and pleats hardly change and differ from vertex to vertex; pleats that are sewn down lie in layers
over one place of the coarse mesh, so that no patch that all layers read can tell them. The mean of what decoding lacks
is drawn as it is, and not before lengths are brought back, so that it takes back what these do wrong on average.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix

__all__ = ["fit_vertex_mean", "mean_from_sums", "turned", "vertex_mean_sums"]

STEP = 2.0**-15  # means are rounded to this [m], so that a file of them is small
LEAST = 1e-3  # of a frame's square, so that one that is turned to nothing is no division by zero


def fit_vertex_mean(turning: csr_matrix, frames: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """The displacements d that are nearest to residuals r in all frames: least sum of |r - M^T d|^2 over them.

    Args:
        turning: weights of the coarse vertices' frames in M, see :class:`wrinkles.patches.Patches`, shape (N, n).
        frames: of the coarse vertices, shape (f, n, 9).
        residual: [m], shape (f, N, 3).

    Returns:
        [m], float32, shape (N, 3).
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
    left = sum(one[0] for one in sums) + LEAST * np.eye(3)
    right = sum(one[1] for one in sums)
    mean = np.linalg.solve(left, right[..., None])[..., 0]
    return (np.round(mean / STEP) * STEP).astype(np.float32)


def turned(turning: csr_matrix, frames: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """The means turned from the frames of one state into space [m], shape (N, 3); frames have shape (n, 9)."""
    return np.einsum("nax,na->nx", (turning @ frames).reshape(-1, 3, 3), mean)
