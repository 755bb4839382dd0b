"""Figures that compare two sequences of a cloth mesh: normals, positions, edges, bending.

Sequences are arrays of vertex positions [m], shape (f, n, 3), on one fixed mesh; a single frame of shape (n, 3) is
accepted too. A figure in the project's list of figures has the same name here, as a function or as a key.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix

from pbd.errors import InputError
from pbd.mesh import ClothMesh, edges_of
from wrinkles.mesh_measures import as_frames, bending_energy, edge_lengths, frame_parts, vertex_normals

__all__ = [
    "bending_energy_ratio",
    "given_coarse_figures",
    "normal_correlation",
    "normal_error_deg",
    "patch_normal_errors",
    "rmse_mm",
    "skill",
    "sted",
    "worse_than_smooth_percent",
]

_NOISE_DEG = 0.01  # angle by which rounding to float32 can turn a normal, on a mesh of a few millimetres [deg]

_STED_FRAME_LENGTH = 0.01  # of the duration of one frame in a temporal edge, in diagonals of the bounding box
_STED_WINDOW = 5  # temporal edges in the window of the temporal deviation


def normal_error_deg(test: np.ndarray, truth: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mean angle between the vertex normals of two sequences, per frame [deg], shape (f,).

    The mean runs over the vertices that have a face. A normal that has collapsed to zero on one side counts 90 deg.

    Args:
        test: positions [m], shape (f, n, 3).
        truth: positions [m], shape (f, n, 3).
        faces: int, shape (m, 3).

    Raises:
        InputError: sequences of different shape.
    """
    test, truth = _same_frames(test=test, truth=truth)
    return _normal_angles(vertex_normals(test, faces), vertex_normals(truth, faces))[:, np.unique(faces)].mean(axis=1)


def patch_normal_errors(test: np.ndarray, truth: np.ndarray, faces: np.ndarray, patches: np.ndarray) -> np.ndarray:
    """Mean angle between the vertex normals of two sequences, per frame and patch [deg], shape (f, patches).

    Args:
        test: positions [m], shape (f, n, 3).
        truth: positions [m], shape (f, n, 3).
        faces: int, shape (m, 3).
        patches: patch of each vertex, int >= 0, shape (n,); those that occur count, in ascending order.

    Raises:
        InputError: sequences of different shape, or patches that do not fit them.
    """
    test, truth = _same_frames(test=test, truth=truth)
    return _patch_means(_normal_angles(vertex_normals(test, faces), vertex_normals(truth, faces)), patches)


def skill(error: float, error_smooth: float) -> float:
    """Share of smooth upsampling's error that a method removes, 1 - error / error_smooth [-]; nan if smooth has none.

    Args:
        error, error_smooth: of the method and of smooth upsampling, in the same unit.
    """
    return 1.0 - error / error_smooth if error_smooth > 0 else float("nan")


def normal_correlation(test: np.ndarray, truth: np.ndarray, smooth: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Correlation of the wrinkles' normals, per frame [-], shape (f,).

    This is the cosine between two long vectors: the stacked deviations n - n_smooth of the test and of the truth. 1
    means the same wrinkles, up to a common amplitude; 0 means unrelated wrinkles, or none in the test. It is nan where
    the truth itself is smooth.

    Args:
        test: positions [m], shape (f, n, 3).
        truth: positions [m], shape (f, n, 3).
        smooth: the smooth upsampling of the same coarse states [m], shape (f, n, 3).
        faces: int, shape (m, 3).

    Raises:
        InputError: sequences of different shape.
    """
    test, truth, smooth = _same_frames(test=test, truth=truth, smooth=smooth)
    return _deviation_cosine(*(vertex_normals(frames, faces) for frames in (test, truth, smooth)))


def rmse_mm(test: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Root mean square distance of the vertices, per frame [mm], shape (f,).

    Args:
        test: positions [m], shape (f, n, 3).
        truth: positions [m], shape (f, n, 3).

    Raises:
        InputError: sequences of different shape.
    """
    test, truth = _same_frames(test=test, truth=truth)
    out = [((test[part] - truth[part]) ** 2).sum(axis=2).mean(axis=1) for part in frame_parts(len(test))]
    return 1e3 * np.sqrt(np.concatenate(out))


def sted(test: np.ndarray, truth: np.ndarray, faces: np.ndarray) -> float:
    """Spatio-temporal edge difference [-], after Vasa and Skala 2011, in a simplified form.

    "A perception correlated comparison method for dynamic meshes". The spatial part takes the relative length
    differences (l_test - l_truth) / l_truth of the edges around a vertex and their standard deviation (weights
    l_truth), averaged over vertices and frames. The temporal part does the same for the edges that join a vertex to
    itself in the next frame, of length sqrt(|dx|^2 / d^2 + 0.01^2) with the diagonal d of the truth's first bounding
    box, over windows of five frames. The result is the root of the sum of both squares. Three things are simplified:
    the neighbourhood is one ring, the differences keep their sign, and both parts have the same weight. As in the
    original, a rigid offset does not change the figure.

    Args:
        test: positions [m], shape (f, n, 3).
        truth: positions [m], shape (f, n, 3).
        faces: int, shape (m, 3).

    Raises:
        InputError: sequences of different shape.
    """
    test, truth = _same_frames(test=test, truth=truth)
    edges, _ = edges_of(np.asarray(faces))
    used = np.unique(edges)
    ends = edges.ravel()
    around = csr_matrix(
        (np.ones(ends.size), (ends, np.repeat(np.arange(len(edges)), 2))), shape=(test.shape[1], len(edges))
    )[used]
    spatial = 0.0
    for part in frame_parts(len(test)):
        length = edge_lengths(truth[part], edges).T
        difference = (edge_lengths(test[part], edges).T - length) / length
        spatial += _deviation(lambda values: around @ values, length, difference).sum()
    spatial /= len(used) * len(test)
    if len(test) < 2:
        return float(spatial)

    diagonal = np.linalg.norm(np.ptp(truth[0][used], axis=0))
    length, other = (
        np.hypot(np.linalg.norm(np.diff(frames[:, used], axis=0), axis=2) / diagonal, _STED_FRAME_LENGTH)
        for frames in (truth, test)
    )
    window = min(_STED_WINDOW, len(length))

    def window_sum(values: np.ndarray) -> np.ndarray:
        total = np.cumsum(np.concatenate([np.zeros_like(values[:1]), values]), axis=0)
        return total[window:] - total[:-window]

    temporal = _deviation(window_sum, length, (other - length) / length).mean()
    return float(np.hypot(spatial, temporal))


def worse_than_smooth_percent(
    test: np.ndarray, truth: np.ndarray, smooth: np.ndarray, faces: np.ndarray, patches: np.ndarray
) -> float:
    """Share of patches and frames whose mean normal error exceeds that of smooth upsampling [%].

    An excess below 0.01 deg may be rounding of float32 positions and does not count.

    Args:
        test: positions [m], shape (f, n, 3).
        truth: positions [m], shape (f, n, 3).
        smooth: the smooth upsampling of the same coarse states [m], shape (f, n, 3).
        faces: int, shape (m, 3).
        patches: patch of each vertex (for instance its nearest coarse vertex), int >= 0, shape (n,).

    Raises:
        InputError: sequences of different shape, or patches that do not fit them.
    """
    test, truth, smooth = _same_frames(test=test, truth=truth, smooth=smooth)
    normals = [vertex_normals(frames, faces) for frames in (test, truth, smooth)]
    return _worse_percent(_normal_angles(normals[0], normals[1]), _normal_angles(normals[2], normals[1]), patches)


def given_coarse_figures(
    test: np.ndarray, truth: np.ndarray, smooth: np.ndarray, faces: np.ndarray, patches: np.ndarray
) -> dict[str, float]:
    """The figures of this module that assume a given coarse state, by name.

    Angles are means over the frames, `rmse_*` is the root mean square over all frames, `normal_correlation_p50` and
    `_p90` are percentiles over the frames.

    Args:
        test: positions [m], shape (f, n, 3).
        truth: positions [m], shape (f, n, 3).
        smooth: the smooth upsampling of the same coarse states [m], shape (f, n, 3).
        faces: int, shape (m, 3).
        patches: patch of each vertex, int >= 0, shape (n,).

    Raises:
        InputError: sequences of different shape, or patches that do not fit them.
    """
    test, truth, smooth = _same_frames(test=test, truth=truth, smooth=smooth)
    normal_test, normal_truth, normal_smooth = (vertex_normals(frames, faces) for frames in (test, truth, smooth))
    angles, angles_smooth = _normal_angles(normal_test, normal_truth), _normal_angles(normal_smooth, normal_truth)
    used = np.unique(faces)
    error, error_smooth = float(angles[:, used].mean()), float(angles_smooth[:, used].mean())
    rmse, rmse_smooth = (float(np.sqrt((rmse_mm(frames, truth) ** 2).mean())) for frames in (test, smooth))
    correlation = _deviation_cosine(normal_test, normal_truth, normal_smooth)
    correlation = correlation[np.isfinite(correlation)]
    median, upper = np.percentile(correlation, [50, 90]) if correlation.size else (np.nan, np.nan)
    return {
        "normal_error_deg": error,
        "normal_error_smooth_deg": error_smooth,
        "normal_skill": skill(error, error_smooth),
        "normal_correlation_p50": float(median),
        "normal_correlation_p90": float(upper),
        "rmse_mm": rmse,
        "rmse_smooth_mm": rmse_smooth,
        "rmse_skill": skill(rmse, rmse_smooth),
        "sted": sted(test, truth, faces),
        "worse_than_smooth_percent": _worse_percent(angles, angles_smooth, patches),
    }


def bending_energy_ratio(test: np.ndarray, truth: np.ndarray, mesh: ClothMesh) -> float:
    """Mean bending energy of the test over that of the truth [-]. The sequences may differ in length.

    Args:
        test: positions [m], shape (f, n, 3).
        truth: positions [m], shape (g, n, 3).
        mesh: the cloth, whose flat faces set the metric.
    """
    energies = (bending_energy(frames, mesh).mean() for frames in (test, truth))
    return float(next(energies) / next(energies))


def _same_frames(**sequences: np.ndarray) -> list[np.ndarray]:
    """The sequences as float64, shape (f, n, 3); an InputError if their shapes differ."""
    frames = [as_frames(array, key) for key, array in sequences.items()]
    shapes = {key: array.shape for key, array in zip(sequences, frames, strict=True)}
    if len(set(shapes.values())) > 1:
        raise InputError("sequences of different shape", received=shapes, expected="one shape (f, n, 3)")
    return frames


def _normal_angles(normals: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Angles between unit vectors [deg], shape (f, n).

    2 atan2(|a - b|, |a + b|) (Kahan) is accurate for all angles, and gives 90 deg if one is zero, 0 if both are.
    """
    angles = np.zeros(normals.shape[:-1])
    for part in frame_parts(len(normals)):
        difference, total = normals[part] - others[part], normals[part] + others[part]
        lengths = (np.sqrt(np.einsum("fni,fni->fn", v, v)) for v in (difference, total))
        angles[part] = np.degrees(2.0 * np.arctan2(*lengths))
    return angles


def _deviation_cosine(test: np.ndarray, truth: np.ndarray, smooth: np.ndarray) -> np.ndarray:
    """Cosine between the stacked deviations of test and truth normals from the smooth ones, shape (f,)."""
    cosines = np.full(len(test), np.nan)
    for frame in range(len(test)):
        a, b = (test[frame] - smooth[frame]).ravel(), (truth[frame] - smooth[frame]).ravel()
        norm_a, norm_b = np.linalg.norm(a), np.linalg.norm(b)
        if norm_b > 0:
            cosines[frame] = a @ b / (norm_a * norm_b) if norm_a > 0 else 0.0
    return cosines


def _worse_percent(angles: np.ndarray, angles_smooth: np.ndarray, patches: np.ndarray) -> float:
    """The figure of :func:`worse_than_smooth_percent`, from the angles of both [deg], shape (f, n)."""
    return float(100.0 * (_patch_means(angles - angles_smooth, patches) > _NOISE_DEG).mean())


def _patch_means(angles: np.ndarray, patches: np.ndarray) -> np.ndarray:
    """Means over the vertices of each patch, shape (f, n) to (f, patches)."""
    patches = np.asarray(patches)
    if patches.shape != angles.shape[1:] or patches.min(initial=0) < 0:
        raise InputError(
            "bad patches", key="patches", received=patches.shape, expected=f"labels >= 0, shape {angles.shape[1:]}"
        )
    _, label, size = np.unique(patches, return_inverse=True, return_counts=True)
    mean_of = csr_matrix((1.0 / size[label], (label, np.arange(len(label)))))
    return (mean_of @ angles.T).T


def _deviation(total: Callable[[np.ndarray], np.ndarray], weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Weighted standard deviation of values within the neighbourhoods that `total` sums over."""
    weight = total(weights)
    mean = total(weights * values) / weight
    return np.sqrt(np.maximum(total(weights * values**2) / weight - mean**2, 0.0))
