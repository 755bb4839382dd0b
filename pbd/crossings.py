"""Self-intersections of a cloth: which edges go through which faces, tested in float64.

This is a measuring tool; the solver has its own, faster search for contact.
"""

import numpy as np
from scipy.spatial import cKDTree

from pbd.mesh import edges_of

__all__ = ["cross", "crossings"]

_MAX_PAIRS = 50_000_000  # of an edge and a face that may be tested at once: bounds the memory


def cross(start: np.ndarray, end: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether segment k goes through triangle k: bool, shape (k,).

    It does if its ends lie on different sides of the triangle's plane and its line passes inside the three sides. A
    segment that only touches a side, or lies in the plane, does not count.

    Args:
        start, end: of the segments [m], float64, shape (k, 3).
        corners: of the triangles [m], float64, shape (k, 3, 3).
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    volume = lambda p, q, r, s: np.einsum("ki,ki->k", np.cross(q - p, r - p), s - p)  # noqa: E731
    sides = volume(a, b, c, start) * volume(a, b, c, end) < 0
    around = np.stack([volume(start, end, p, q) for p, q in ((a, b), (b, c), (c, a))])
    return sides & ((around > 0).all(axis=0) | (around < 0).all(axis=0))


def crossings(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Find the edges that go through faces with which they share no vertex.

    Args:
        vertices: [m], float64, shape (n, 3).
        faces: int, shape (m, 3).

    Returns:
        Sorted rows of the two ends of an edge and the face that it goes through, int64, shape (k, 3).
    """
    edges, _ = edges_of(faces)
    vertices = np.asarray(vertices, float)
    ends, corners = vertices[edges], vertices[faces]
    edge_low, edge_high = ends.min(axis=1), ends.max(axis=1)
    face_low, face_high = corners.min(axis=1), corners.max(axis=1)
    # Where an edge goes through a face, their boxes' middles are no further apart than both half diagonals.
    face_reach = 0.5 * np.linalg.norm(face_high - face_low, axis=1).max(initial=0.0)
    reach = 0.5 * np.linalg.norm(edge_high - edge_low, axis=1) + face_reach
    tree, middles = cKDTree(0.5 * (face_low + face_high)), 0.5 * (edge_low + edge_high)
    # Edges are taken in groups, which bounds the memory; pairs whose boxes do not overlap are dropped first.
    found = [np.zeros((0, 3), np.int64)]
    group = max(1, _MAX_PAIRS // max(len(faces), 1))
    for begin in range(0, len(edges), group):
        end = min(begin + group, len(edges))
        near = tree.query_ball_point(middles[begin:end], reach[begin:end])
        edge = np.repeat(np.arange(begin, end), [len(faces_near) for faces_near in near])
        face = np.concatenate([np.asarray(faces_near, np.int64) for faces_near in near])
        overlap = (face_low[face] <= edge_high[edge]).all(axis=1) & (face_high[face] >= edge_low[edge]).all(axis=1)
        edge, face = edge[overlap], face[overlap]
        apart = (faces[face][:, :, None] != edges[edge][:, None, :]).all(axis=(1, 2))
        edge, face = edge[apart], face[apart]
        through = cross(ends[edge, 0], ends[edge, 1], corners[face])
        found.append(np.column_stack([edges[edge[through]], face[through]]).astype(np.int64))
    rows = np.concatenate(found)
    return rows[np.lexsort(rows.T[::-1])]
