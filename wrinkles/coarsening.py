"""Makes the coarse mesh of a fine mesh that comes with a garment, by decimation, and binds the fine mesh to it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, identity
from scipy.sparse.csgraph import dijkstra
from scipy.sparse.linalg import splu

from assets.remesh import decimated
from assets.seams import Seams, sew, without_pleats
from pbd.attachment import closest_weights
from pbd.mesh import edges_of
from wrinkles.binding import Binding
from wrinkles.surface import Subdivision

__all__ = ["bind", "faces_around", "label_of", "nearest_places"]

FIT_ROUNDS = 4  # alternations of binding the fine vertices and fitting the coarse ones
STAY_WEIGHT = 0.02  # of a coarse vertex's last position in that fit, for vertices that carry almost nothing
PLACE_STEP = 2.0**-12  # barycentric weights are rounded to this (some micrometres), so that a file holds them exactly
FLAT_STEP = 2.0**-18  # pattern coordinates are rounded to this [m], for the same reason
MAX_OVERHANG = 1.0  # how far outside a border face a vertex may be bound, in barycentric weight


def bind(
    vertices: np.ndarray, faces: np.ndarray, flat: np.ndarray, seams: Seams | None, count: int, levels: int
) -> tuple[np.ndarray, Subdivision]:
    """Make the coarse mesh of a fine one, and the subdivision that binds the fine mesh to it.

    The panels are closed at their seams and decimated. Then two steps alternate: each fine vertex is bound to the
    nearest point of the coarse mesh's smooth surface, among the faces near it along the cloth; and the coarse vertices
    move to where their smooth surface fits the fine vertices best (least squares). Beyond the border a vertex is bound
    in the plane of the last face.

    Args:
        vertices: of the fine mesh [m], shape (N, 3).
        faces: int, shape (M, 3).
        flat: position of each vertex in the pattern [m], shape (N, 2).
        seams: stitches between the panels, None without any.
        count: coarse vertices to start from, see :func:`assets.remesh.decimated`.
        levels: number of times that each coarse face is cut in four.

    Returns:
        coarse vertices [m], shape (n, 3), and the subdivision.

    Raises:
        InputError: seams that close to no surface, see :func:`assets.seams.without_pleats`.
    """
    flat = np.round(flat / FLAT_STEP) * FLAT_STEP
    seams = seams or Seams(np.zeros((0, 3), np.int32), np.zeros(0))
    sewn = sew(faces, flat, seams)
    whole, shrunk = without_pleats(sewn.faces)
    used, whole = np.unique(whole, return_inverse=True)
    whole = whole.reshape(-1, 3).astype(np.int32)
    number = np.searchsorted(used, shrunk[sewn.one])  # of each fine vertex in the closed surface
    chosen, coarse_faces = decimated(vertices[used], whole, count)
    plain = Subdivision.of(coarse_faces, len(chosen), levels)
    near = faces_around(coarse_faces, label_of(vertices[used], whole, chosen)[number])
    coarse = vertices[used][chosen]
    for _ in range(FIT_ROUNDS):
        face, place = nearest_places(plain, plain.upsample(coarse), coarse, vertices, near)
        near = faces_around(coarse_faces, coarse_faces[face // 4**levels])
        binding = Binding(face, place, faces, flat, seams.vertices, seams.weights)
        bound = Subdivision.of(coarse_faces, len(chosen), levels, binding)
        left = bound.matrix.T @ bound.matrix + STAY_WEIGHT * identity(len(coarse))
        coarse = splu(left.tocsc()).solve(bound.matrix.T @ vertices + STAY_WEIGHT * coarse)
    return coarse, bound


def label_of(vertices: np.ndarray, faces: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Index into ``chosen`` of the chosen vertex that is nearest to each vertex along the edges: int, shape (n,).

    Args:
        vertices: [m], shape (n, 3).
        faces: int, shape (m, 3).
        chosen: vertices, int, shape (k,).
    """
    edges = edges_of(faces)[0]
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    graph = csr_matrix((lengths, tuple(edges.T)), (len(vertices),) * 2)
    _, _, source = dijkstra(graph, directed=False, indices=chosen, min_only=True, return_predecessors=True)
    order = np.argsort(chosen)
    return order[np.searchsorted(chosen[order], source)]


def faces_around(faces: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Faces around the vertices of each row, padded with the row's first face: int, shape (p, k).

    Args:
        faces: int, shape (m, 3).
        corners: vertices, int, shape (p,) or (p, c).
    """
    count = faces.max() + 1
    at = csr_matrix((np.ones(faces.size), (faces.ravel(), np.repeat(np.arange(len(faces)), 3))), (count, len(faces)))
    corners = corners.reshape(len(corners), -1)
    rows = np.repeat(np.arange(len(corners)), corners.shape[1])
    found = (csr_matrix((np.ones(rows.size), (rows, corners.ravel())), (len(corners), count)) @ at).tocsr()
    found.sort_indices()
    sizes = np.diff(found.indptr)
    slot = np.arange(sizes.max())
    return found.indices[found.indptr[:-1, None] + np.where(slot < sizes[:, None], slot, 0)]


def nearest_places(
    plain: Subdivision, smooth: np.ndarray, coarse: np.ndarray, points: np.ndarray, near: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest points of a smooth surface: its face, int32, shape (p,), and barycentric weights, shape (p, 3).

    Args:
        plain: subdivision of the coarse mesh.
        smooth: vertices of the subdivided mesh [m], shape (q, 3).
        coarse: coarse vertices [m], shape (n, 3).
        points: [m], shape (p, 3).
        near: candidate coarse faces of each point, int, shape (p, k).
    """
    rows = np.arange(len(points))[:, None]
    cut = 4 ** len(plain.steps)
    away = _distance(points[:, None], coarse[plain.coarse_faces[near]])[0]
    best = near[rows, np.argsort(away, axis=1, kind="stable")[:, :4]]
    candidates = (cut * best[:, :, None] + np.arange(cut)).reshape(len(points), -1)
    away, weights = _distance(points[:, None], smooth[plain.faces[candidates]])
    first = away.argmin(axis=1)[:, None]
    face, weights = candidates[rows, first][:, 0], weights[rows, first][:, 0]
    # A point beyond the border has its nearest point on it. It is bound in the face's plane instead, so that it keeps
    # its distance from the border.
    edges, side_edge = edges_of(plain.faces)
    rim = (np.bincount(side_edge.ravel(), minlength=len(edges)) == 1)[side_edge]
    opposite = np.roll(weights, 1, axis=1) < 1e-9  # of side s the corner s - 1 has no weight
    beyond = (rim[face] & opposite).any(axis=1)
    weights[beyond] = _in_plane(points[beyond], smooth[plain.faces[face[beyond]]])
    weights = np.clip(weights, -MAX_OVERHANG, 1.0 + MAX_OVERHANG)
    place = np.round(weights[:, 1:] / PLACE_STEP) * PLACE_STEP
    return face.astype(np.int32), np.concatenate([1.0 - place.sum(axis=1, keepdims=True), place], axis=1)


def _distance(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances of points from triangles [m], shape (p, k), and weights of the closest points, shape (p, k, 3)."""
    weights = closest_weights(points, corners[..., 0, :], corners[..., 1, :], corners[..., 2, :])
    return np.linalg.norm(np.einsum("pkc,pkci->pki", weights, corners) - points, axis=2), weights


def _in_plane(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric weights of points projected into the planes of triangles, shape (p, 3)."""
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    inner = np.einsum("pai,pi->pa", np.linalg.pinv(sides), points - corners[:, 0])
    return np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
