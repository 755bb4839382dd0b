"""Where a cloth goes through itself, exactly enough to be trusted as a measure: in float64, edge against face."""

import numpy as np

from pbd.mesh import edges_of

__all__ = ["cross", "crossings"]

_PAIRS = 1_000_000  # of an edge and a face that are looked at together


def cross(start: np.ndarray, end: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether segments go through triangles: the ends lie on both sides of the plane, the line runs inside the sides.

    A segment that only touches a side or lies in the plane does not.

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
    """Edges that go through faces with which they share no vertex.

    Args:
        vertices: [m], float64, shape (n, 3).
        faces: int, shape (m, 3).

    Returns:
        Rows (end, end, face), int64, shape (k, 3), sorted.
    """
    edges, _ = edges_of(faces)
    vertices = np.asarray(vertices, float)
    ends, corners = vertices[edges], vertices[faces]
    edge_low, edge_high = ends.min(axis=1), ends.max(axis=1)
    face_low, face_high = corners.min(axis=1), corners.max(axis=1)
    # Along the longest axis of all, sorted; each edge looks at the faces that may begin before it ends.
    axis = int(np.argmax(np.ptp(vertices, axis=0)))
    order = np.argsort(face_low[:, axis], kind="stable")
    width = (face_high - face_low)[:, axis].max()
    first = np.searchsorted(face_low[order, axis], edge_low[:, axis] - width)
    last = np.searchsorted(face_low[order, axis], edge_high[:, axis], side="right")
    # Pairs of an edge and a face whose boxes meet, so many edges at a time that memory is bounded.
    counts = np.maximum(last - first, 0)
    ends_of_runs = np.cumsum(counts)
    found = [np.zeros((0, 3), np.int64)]
    begin = 0
    while begin < len(edges):
        before = ends_of_runs[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(ends_of_runs, before + _PAIRS, side="right")))
        many = counts[begin:end]
        edge = np.repeat(np.arange(begin, end), many)
        place = np.arange(len(edge)) - np.repeat(np.cumsum(many) - many, many)
        face = order[first[edge] + place]
        meets = (face_low[face] <= edge_high[edge]).all(axis=1) & (face_high[face] >= edge_low[edge]).all(axis=1)
        edge, face = edge[meets], face[meets]
        apart = (faces[face][:, :, None] != edges[edge][:, None, :]).all(axis=(1, 2))
        edge, face = edge[apart], face[apart]
        through = cross(ends[edge, 0], ends[edge, 1], corners[face])
        found.append(np.column_stack([edges[edge[through]], face[through]]).astype(np.int64))
        begin = end
    rows = np.concatenate(found)
    return rows[np.lexsort(rows.T[::-1])]
