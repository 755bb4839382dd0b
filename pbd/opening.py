"""Cloth that starts through itself, opened before it is simulated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags

from pbd.attachment import push_outside
from pbd.crossings import SelfCrossings
from pbd.mesh import ClothMesh, edges_of, vertex_rings

__all__ = ["CLEARANCE", "neighbour_means", "smoothed_apart"]

Floats = NDArray[np.float64]

SMOOTHINGS = 4  # of the cloth around a crossing, one after the other
MAX_RINGS = 6  # of vertices around it that are smoothed
MAX_ROUNDS = 16
CLEARANCE = 0.003  # of what is moved from the body [m]


def neighbour_means(faces: NDArray[np.int32], count: int) -> tuple[csr_matrix, csr_matrix]:
    """Means over the neighbours of each vertex, itself where it has none, and 1 for each neighbour: shape (n, n)."""
    starts, ring = vertex_rings(faces, count)
    around = csr_matrix((np.ones(len(ring)), ring, starts), (count, count))
    counts = np.diff(starts)
    return diags(1.0 / np.maximum(counts, 1)) @ around + diags((counts == 0).astype(float)), around


def _means_along_borders(mesh: ClothMesh) -> tuple[csr_matrix, csr_matrix]:
    """As :func:`neighbour_means`, but on a border that is no seam the mean along it: a hem stays a hem."""
    count = len(mesh.vertices)
    mean, around = neighbour_means(mesh.faces, count)
    edges, side_edge = edges_of(mesh.faces)
    a, b = edges[np.bincount(side_edge.ravel()) == 1].T
    along = csr_matrix((np.ones(2 * len(a)), (np.concatenate([a, b]), np.concatenate([b, a]))), (count, count))
    beside = np.bincount(np.concatenate([a, b]), minlength=count)
    beside[mesh.stitches.ravel()] = 0
    inner = diags((beside == 0).astype(float))
    return (inner @ mean + diags((beside > 0) / np.maximum(beside, 1)) @ along).tocsr(), around


def smoothed_apart(
    mesh: ClothMesh, held: np.ndarray, layer: np.ndarray | None, body_vertices: Floats, body_faces: np.ndarray
) -> Floats:
    """Where the cloth lies once it is smoothed around the places where a garment goes through itself.

    Contact brings sheets back that are through one another. A crease that is folded into itself, as gathers and pleats
    are, has no right side; the smooth surface over it has one. Patches of one ring of vertices are tried first, then
    larger ones where that does not help. It is no state of rest: the cloth folds anew when it is simulated.

    Args:
        mesh: the cloth.
        held: vertices that stay where they are, int, shape (p,).
        layer: number of the garment of each vertex, shape (n,); None for one garment. Crossings of two are left.
        body_vertices, body_faces: what the cloth stays outside of [m], shapes (b, 3) and (k, 3).

    Returns:
        positions with the fewest crossing faces that were found [m], shape (n, 3).
    """
    crossings, vertices = SelfCrossings(mesh), np.array(mesh.vertices, float)
    mean, around = _means_along_borders(mesh)
    (v, a, b), weight = mesh.stitches.T, 1.0 - mesh.stitch_weights[:, None]
    best, fewest, last, rings = vertices, len(mesh.faces) + 1, len(mesh.faces) + 1, 1
    for _ in range(MAX_ROUNDS):
        rows = crossings.find(vertices)
        if layer is not None:
            rows = rows[layer[rows[:, 0]] == layer[mesh.faces[rows[:, 2], 0]]]
        count = len(crossings.faces_of(rows))
        if count < fewest:
            best, fewest = vertices, count
        if count == 0 or rings > MAX_RINGS:
            break
        rings, last = rings + int(count >= last), count
        patch = np.zeros(len(vertices))
        patch[rows[:, :2].ravel()] = patch[mesh.faces[rows[:, 2]].ravel()] = 1.0
        for _ in range(rings):
            patch = np.maximum(patch, around @ patch > 0.0)
        patch[held] = 0.0
        moved, vertices = np.flatnonzero(patch), vertices.copy()
        for _ in range(SMOOTHINGS):
            vertices[moved] = mean[moved] @ vertices
        if len(body_faces):
            vertices[moved] = push_outside(vertices[moved], body_vertices, body_faces, CLEARANCE)
        vertices[v] = weight * vertices[a] + (1.0 - weight) * vertices[b]
    return best
