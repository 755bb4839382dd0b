"""Figures that compare two sequences of a cloth mesh: normals, positions, edges, bending, folds, pixels.

Sequences are arrays of vertex positions [m], shape (f, n, 3), on one fixed mesh; a single frame of shape (n, 3) is
accepted too. A figure in the project's list of figures has the same name here, as a function or as a key.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_matrix

from pbd.bending import hinge_rows
from pbd.errors import InputError
from pbd.mesh import ClothMesh, edges_of

__all__ = [
    "PIXELS_PER_METRE",
    "Stretch",
    "bending_energy",
    "bending_energy_ratio",
    "edge_stretch",
    "fold_count",
    "given_coarse_figures",
    "jitter_px",
    "normal_correlation",
    "normal_error_deg",
    "patch_normal_errors",
    "pixel_distance",
    "rmse_mm",
    "skill",
    "sted",
    "vertex_normals",
    "worse_than_smooth_percent",
]

PIXELS_PER_METRE = 1080 / (2 * 3.0 * np.tan(np.radians(20.0)))
"""Of the standard camera [px/m]: 1080 lines, vertical field of view 40 deg, 3 m away."""

_CHUNK_FRAMES = 32  # frames that are processed at once: bounds the memory, large enough for the sparse products
_NOISE_DEG = 0.01  # angle by which rounding to float32 can turn a normal, on a mesh of a few millimetres [deg]

_STED_FRAME_LENGTH = 0.01  # of the duration of one frame in a temporal edge, in diagonals of the bounding box
_STED_WINDOW = 5  # temporal edges in the window of the temporal deviation


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit vertex normals, each the mean of its faces' normals weighted by area.

    Args:
        vertices: [m], shape (..., n, 3).
        faces: int, shape (m, 3).

    Returns:
        Shape (..., n, 3), float64. Zero where a vertex has no face or its faces cancel.
    """
    vertices = np.asarray(vertices)
    frames = vertices.reshape(-1, *vertices.shape[-2:])
    vertex_count, face_count = frames.shape[1], len(faces)
    rows = np.asarray(faces).ravel()
    around = csr_matrix(
        (np.ones(rows.size), (rows, np.repeat(np.arange(face_count), 3))), shape=(vertex_count, face_count)
    )
    normals = np.zeros(frames.shape)
    for part in _parts(len(frames)):
        points = np.ascontiguousarray(frames[part].transpose(1, 0, 2), float)  # (n, f, 3)
        corner = points[faces[:, 0]]
        twice_area = _cross(points[faces[:, 1]] - corner, points[faces[:, 2]] - corner)
        total = (around @ twice_area.reshape(face_count, -1)).reshape(points.shape)
        length = np.sqrt(np.einsum("...i,...i->...", total, total))[..., None]
        normals[part] = np.divide(total, length, out=np.zeros_like(total), where=length > 0).transpose(1, 0, 2)
    return normals.reshape(vertices.shape)


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
    out = [((test[part] - truth[part]) ** 2).sum(axis=2).mean(axis=1) for part in _parts(len(test))]
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
    for part in _parts(len(test)):
        length = _edge_lengths(truth[part], edges).T
        difference = (_edge_lengths(test[part], edges).T - length) / length
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


class Stretch(NamedTuple):
    """Stretch of edges, length over rest length minus 1 [-]; shortened edges count as 0."""

    mean: float
    p99: float
    max: float


def edge_stretch(vertices: np.ndarray, edges: np.ndarray, rest_lengths: np.ndarray) -> Stretch:
    """Stretch of the edges over all frames.

    Shortening does not count, because an edge that spans a fold is shorter than the cloth without any error.

    Args:
        vertices: positions [m], shape (f, n, 3).
        edges: int, shape (e, 2).
        rest_lengths: [m], shape (e,).
    """
    frames = _frames(vertices, "vertices")
    stretch = np.concatenate([_edge_lengths(frames[part], edges) for part in _parts(len(frames))])
    stretch = np.maximum(stretch / rest_lengths - 1.0, 0.0)
    return Stretch(float(stretch.mean()), float(np.percentile(stretch, 99)), float(stretch.max()))


def bending_energy(vertices: np.ndarray, mesh: ClothMesh, where: np.ndarray | None = None) -> np.ndarray:
    """Bending energy per unit of bending stiffness, per frame [-], shape (f,).

    Quadratic hinges, E = 1/2 x^T Q x = sum of c (3/2) |K x|^2 / (A0 + A1) (Bergou et al. 2006, "A quadratic
    bending model for inextensible surfaces") with c = 1/3. This approximates 1/2 the integral of the squared curvature;
    its error depends on the mesh, so compare energies on one mesh only. Rest angles are zero.

    Args:
        vertices: positions [m], shape (f, n, 3).
        mesh: the cloth, whose flat faces set the metric.
        where: bool, shape (f, n); only hinges with both ends of their edge marked are counted, for instance vertices
            in contact. None counts all.
    """
    frames = _frames(vertices, "vertices")
    hinges, rows, areas, _ = hinge_rows(mesh)
    rows = rows / np.sqrt(areas)[:, None]  # sqrt(2 c 3/2 / (A0 + A1)) with c = 1/3
    index = np.repeat(np.arange(len(hinges)), 4)
    factor = csr_matrix((rows.ravel(), (index, hinges.ravel())), shape=(len(hinges), frames.shape[1]))
    energy = np.zeros(len(frames))
    for part in _parts(len(frames)):
        points = frames[part].transpose(1, 0, 2)
        bent = (factor @ points.reshape(len(points), -1)).reshape(len(hinges), -1, 3)
        of_hinge = 0.5 * np.einsum("hfi,hfi->fh", bent, bent)
        if where is not None:
            of_hinge = of_hinge * (where[part][:, hinges[:, 0]] & where[part][:, hinges[:, 1]])
        energy[part] = of_hinge.sum(axis=1)
    return energy


def bending_energy_ratio(test: np.ndarray, truth: np.ndarray, mesh: ClothMesh) -> float:
    """Mean bending energy of the test over that of the truth [-]. The sequences may differ in length.

    Args:
        test: positions [m], shape (f, n, 3).
        truth: positions [m], shape (g, n, 3).
        mesh: the cloth, whose flat faces set the metric.
    """
    energies = (bending_energy(frames, mesh).mean() for frames in (test, truth))
    return float(next(energies) / next(energies))


def fold_count(loop: np.ndarray, min_turn_deg: float = 15.0, *, blur: float = 0.01) -> np.ndarray:
    """Number of folds along a closed loop, such as a hem, per frame: int, shape (f,).

    The loop is projected along its area vector and blurred. Its tangent turns by 360 deg on the whole. A fold is one
    swing of the tangent about an even turn, that is, two sign changes of the curvature minus the loop's mean
    curvature. Swings smaller than the threshold do not count, so that noise and the loop's own roundness add nothing.

    Args:
        loop: vertex positions in order, the last joined to the first [m], shape (f, k, 3) or (k, 3).
        min_turn_deg: threshold, from one extreme of the tangent to the next [deg]; a wave of amplitude a and length w
            swings by 2 atan(2 pi a / w).
        blur: standard deviation of the blur along the loop [m].
    """
    return np.array([_fold_count(points, np.radians(min_turn_deg), blur) for points in _frames(loop, "loop")])


def pixel_distance(test: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distance of the vertices on the standard camera's screen [px], shape (..., n).

    The whole distance counts as perpendicular to the line of sight, so that it is an upper bound for every view.

    Args:
        test: positions [m], shape (..., n, 3).
        truth: positions [m], shape (..., n, 3).
    """
    return PIXELS_PER_METRE * np.linalg.norm(np.asarray(test, float) - np.asarray(truth, float), axis=-1)


def jitter_px(vertices: np.ndarray) -> float:
    """Jitter on the standard camera's screen: the 95th percentile over vertices and frames [px a frame].

    It is half the second difference over three frames. For a vertex that jumps back and forth this is the length of
    the jump; for one that moves evenly it is 0. True acceleration counts too (free fall at 60 Hz: 0.7 px), so measure
    cloth at rest, or compare with the truth's own figure.

    Args:
        vertices: positions [m], shape (f, n, 3), at least three frames.

    Raises:
        InputError: fewer than three frames.
    """
    frames = _frames(vertices, "vertices")
    if len(frames) < 3:
        raise InputError("too few frames for jitter", key="vertices", received=len(frames), expected="at least 3")
    return float(0.5 * np.percentile(pixel_distance(frames[2:] + frames[:-2], 2.0 * frames[1:-1]), 95))


def _parts(count: int) -> Iterator[slice]:
    """Slices of ``count`` frames that are processed at once."""
    return (slice(start, min(start + _CHUNK_FRAMES, count)) for start in range(0, count, _CHUNK_FRAMES))


def _frames(array: np.ndarray, key: str) -> np.ndarray:
    """The sequence as float64, shape (f, n, 3)."""
    array = np.asarray(array, float)
    if array.ndim not in (2, 3) or array.shape[-1] != 3:
        raise InputError("not a sequence of positions", key=key, received=array.shape, expected="shape (f, n, 3)")
    return array if array.ndim == 3 else array[None]


def _same_frames(**sequences: np.ndarray) -> list[np.ndarray]:
    """The sequences as float64, shape (f, n, 3); an InputError if their shapes differ."""
    frames = [_frames(array, key) for key, array in sequences.items()]
    shapes = {key: array.shape for key, array in zip(sequences, frames, strict=True)}
    if len(set(shapes.values())) > 1:
        raise InputError("sequences of different shape", received=shapes, expected="one shape (f, n, 3)")
    return frames


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product along the last axis; several times faster than numpy's on long arrays."""
    out = np.zeros_like(a)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def _edge_lengths(frames: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Lengths of the edges [m], shape (f, e)."""
    side = frames[:, edges[:, 1]] - frames[:, edges[:, 0]]
    return np.sqrt(np.einsum("fei,fei->fe", side, side))


def _normal_angles(normals: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Angles between unit vectors [deg], shape (f, n).

    2 atan2(|a - b|, |a + b|) (Kahan) is accurate for all angles, and gives 90 deg if one is zero, 0 if both are.
    """
    angles = np.zeros(normals.shape[:-1])
    for part in _parts(len(normals)):
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


def _fold_count(points: np.ndarray, min_turn: float, blur: float) -> int:
    """Number of folds along one closed loop, shape (k, 3); ``min_turn`` in radians."""
    from scipy.signal import find_peaks  # takes longer to import than all other parts of SciPy that playing needs

    # The loop is projected along its area vector and resampled in even steps of a fifth of the blur.
    points = points - points.mean(axis=0)
    area = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    flat = points @ np.linalg.svd(area[None])[2][1:].T
    closed = np.concatenate([flat, flat[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    count = max(int(np.ceil(5.0 * arc[-1] / blur)), 8)
    step = arc[-1] / count
    even = np.stack([np.interp(np.arange(count) * step, arc, column) for column in closed.T], axis=1)
    even = gaussian_filter1d(even, blur / step, axis=0, mode="wrap")
    # The tangent's angle minus an even turn is periodic along the loop. The sequence begins at its highest point.
    side = np.diff(np.concatenate([even, even[:2]]), axis=0)
    angle = np.unwrap(np.arctan2(side[:, 1], side[:, 0]))
    angle -= np.linspace(0.0, angle[-1] - angle[0], count + 1) + angle[0]
    swing = np.roll(angle[:-1], -int(np.argmax(angle[:-1])))
    if np.ptp(swing) < min_turn:
        return 0
    peaks, _ = find_peaks(np.append(swing, swing[0]), prominence=min_turn)
    return 1 + len(peaks)
