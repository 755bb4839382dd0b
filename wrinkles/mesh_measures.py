"""Measures of a sequence of a cloth mesh: normals, stretch, bending, folds, and motion on a screen.

Sequences are arrays of vertex positions [m], shape (f, n, 3), on one fixed mesh; a single frame of shape (n, 3) is
accepted too. A figure in the project's list of figures has the same name here.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_matrix

from pbd.bending import hinge_rows
from pbd.errors import InputError
from pbd.mesh import ClothMesh

__all__ = [
    "PIXELS_PER_METRE",
    "Stretch",
    "as_frames",
    "bending_energy",
    "edge_lengths",
    "edge_stretch",
    "fold_count",
    "frame_parts",
    "jitter_px",
    "pixel_distance",
    "vertex_normals",
]

PIXELS_PER_METRE = 1080 / (2 * 3.0 * np.tan(np.radians(20.0)))
"""Of the standard camera [px/m]: 1080 lines, vertical field of view 40 deg, 3 m away."""

_CHUNK_FRAMES = 32  # frames that are processed at once: bounds the memory, large enough for the sparse products


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
    for part in frame_parts(len(frames)):
        points = np.ascontiguousarray(frames[part].transpose(1, 0, 2), float)  # (n, f, 3)
        corner = points[faces[:, 0]]
        twice_area = _cross(points[faces[:, 1]] - corner, points[faces[:, 2]] - corner)
        total = (around @ twice_area.reshape(face_count, -1)).reshape(points.shape)
        length = np.sqrt(np.einsum("...i,...i->...", total, total))[..., None]
        normals[part] = np.divide(total, length, out=np.zeros_like(total), where=length > 0).transpose(1, 0, 2)
    return normals.reshape(vertices.shape)


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
    frames = as_frames(vertices, "vertices")
    stretch = np.concatenate([edge_lengths(frames[part], edges) for part in frame_parts(len(frames))])
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
    frames = as_frames(vertices, "vertices")
    hinges, rows, areas, _ = hinge_rows(mesh)
    rows = rows / np.sqrt(areas)[:, None]  # sqrt(2 c 3/2 / (A0 + A1)) with c = 1/3
    index = np.repeat(np.arange(len(hinges)), 4)
    factor = csr_matrix((rows.ravel(), (index, hinges.ravel())), shape=(len(hinges), frames.shape[1]))
    energy = np.zeros(len(frames))
    for part in frame_parts(len(frames)):
        points = frames[part].transpose(1, 0, 2)
        bent = (factor @ points.reshape(len(points), -1)).reshape(len(hinges), -1, 3)
        of_hinge = 0.5 * np.einsum("hfi,hfi->fh", bent, bent)
        if where is not None:
            of_hinge = of_hinge * (where[part][:, hinges[:, 0]] & where[part][:, hinges[:, 1]])
        energy[part] = of_hinge.sum(axis=1)
    return energy


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
    return np.array([_fold_count(points, np.radians(min_turn_deg), blur) for points in as_frames(loop, "loop")])


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
    frames = as_frames(vertices, "vertices")
    if len(frames) < 3:
        raise InputError("too few frames for jitter", key="vertices", received=len(frames), expected="at least 3")
    return float(0.5 * np.percentile(pixel_distance(frames[2:] + frames[:-2], 2.0 * frames[1:-1]), 95))


def as_frames(array: np.ndarray, key: str) -> np.ndarray:
    """The sequence as float64, shape (f, n, 3).

    Args:
        array: positions [m], shape (f, n, 3) or, of a single frame, (n, 3).
        key: its name, for the message of an error.

    Raises:
        InputError: an array of another shape.
    """
    array = np.asarray(array, float)
    if array.ndim not in (2, 3) or array.shape[-1] != 3:
        raise InputError("not a sequence of positions", key=key, received=array.shape, expected="shape (f, n, 3)")
    return array if array.ndim == 3 else array[None]


def frame_parts(count: int) -> Iterator[slice]:
    """Slices of ``count`` frames that are processed at once."""
    return (slice(start, min(start + _CHUNK_FRAMES, count)) for start in range(0, count, _CHUNK_FRAMES))


def edge_lengths(frames: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Lengths of the edges in each frame [m], shape (f, e).

    Args:
        frames: positions [m], shape (f, n, 3).
        edges: int, shape (e, 2).
    """
    side = frames[:, edges[:, 1]] - frames[:, edges[:, 0]]
    return np.sqrt(np.einsum("fei,fei->fe", side, side))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product along the last axis; several times faster than numpy's on long arrays."""
    out = np.zeros_like(a)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


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
