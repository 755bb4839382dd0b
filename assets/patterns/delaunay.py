"""Delaunay triangles inside a closed outline, whose segments are all sides of them."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay

from assets.patterns.curves import signed_area

__all__ = ["triangles_inside"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Side = tuple[int, int]

_MAX_AREA_ERROR = 1e-6  # of the triangles against the outline [-]


def triangles_inside(points: Floats, outline_count: int) -> NDArray[np.int32]:
    """Counter-clockwise triangles inside an outline, shape (m, 3).

    Args:
        points: the outline counter-clockwise, then others [m], shape (n, 2); no face has those that lie outside.
        outline_count: number of points of the outline.

    Raises:
        ValueError: the outline crosses itself.
    """
    fixed = outline_count
    scaled = (points - points[:fixed].mean(axis=0)) / np.ptp(points[:fixed], axis=0).max()
    # Qhull winds all faces alike, also those without area on a straight side of the hull: their areas do not say how.
    faces = Delaunay(scaled).simplices.astype(np.int64)
    start = np.arange(fixed)
    segments = np.stack([start, (start + 1) % fixed], axis=1)
    row = np.array([len(points), 1])
    missing = ~np.isin(np.sort(segments, axis=1) @ row, np.sort(_sides(faces), axis=1) @ row)
    if missing.any():
        faces = _with_segments(scaled, faces, segments, segments[missing])
    # Faces that share a side which is no segment lie on the same side of the outline.
    sides = _sides(faces)
    key = np.sort(sides, axis=1) @ row
    order = np.argsort(key, kind="stable")
    shared = np.flatnonzero(np.diff(key[order]) == 0)
    shared = shared[~np.isin(key[order][shared], np.sort(segments, axis=1) @ row)]
    links = csr_matrix((np.ones(len(shared)), (order[shared] // 3, order[shared + 1] // 3)), (len(faces),) * 2)
    _, part = connected_components(links, directed=False)
    left_of_segments = np.flatnonzero(np.isin(sides @ row, segments @ row)) // 3
    faces = faces[np.isin(part, part[left_of_segments])]
    a, b, c = (scaled[corner] for corner in faces.T)
    covered = ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])).sum() / 2.0
    if abs(covered - signed_area(scaled[:fixed])) > _MAX_AREA_ERROR:
        raise ValueError("an outline that crosses itself")
    return faces.astype(np.int32)


def _sides(faces: Ints) -> Ints:
    """The sides of faces, three after another for each: shape (3 m, 2)."""
    return np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)


def _with_segments(points: Floats, faces: Ints, segments: Ints, missing: Ints) -> Ints:
    """Triangles that have the missing segments as sides, by flips of the sides that cross them.

    Sloan, "A fast algorithm for generating constrained Delaunay triangulations", 1993.

    Raises:
        ValueError: segments that cross each other.
    """
    flips = _Flips(points, faces)
    walls = {tuple(sorted(segment)) for segment in segments.tolist()}
    for a, b in missing.tolist():
        waiting = deque(side for side in flips.opposite if side[0] < side[1] and flips.cross((a, b), side))
        made: list[Side] = []
        tries = 10 * (len(waiting) + 5) ** 2
        while waiting and tries and not walls.intersection(waiting):
            tries -= 1
            side = waiting.popleft()
            new = flips.flip(side)
            if new is None or flips.cross((a, b), new):
                waiting.append(new or side)
            else:
                made.append(new)
        if (a, b) not in flips.opposite and (b, a) not in flips.opposite:
            raise ValueError("segments that cross each other")
        for _ in range(len(made)):
            bad = [k for k, side in enumerate(made) if side not in walls and flips.is_illegal(side)]
            if not bad:
                break
            made[bad[0]] = flips.flip(made[bad[0]]) or made[bad[0]]
    return np.array([(a, b, c) for (a, b), c in flips.opposite.items() if a < b and a < c])


class _Flips:
    """Triangles by their sides: the corner opposite to each."""

    def __init__(self, points: Floats, faces: Ints) -> None:
        self.place = points.tolist()
        self.opposite: dict[Side, int] = {}
        for a, b, c in faces.tolist():
            self.opposite[a, b], self.opposite[b, c], self.opposite[c, a] = c, a, b

    def turn(self, a: int, b: int, c: int) -> float:
        """Twice the area of a triangle, positive if it runs counter-clockwise."""
        (ax, ay), (bx, by), (cx, cy) = self.place[a], self.place[b], self.place[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    def cross(self, one: Side, two: Side) -> bool:
        """Whether two sides cross between their ends."""
        (a, b), (c, d) = one, two
        if a in two or b in two or self.turn(a, b, c) * self.turn(a, b, d) >= 0.0:
            return False
        return self.turn(c, d, a) * self.turn(c, d, b) < 0.0

    def flip(self, side: Side) -> Side | None:
        """Replace a side by the other diagonal of its quadrilateral; None if that lies outside."""
        a, b = side
        if (a, b) not in self.opposite or (b, a) not in self.opposite:
            return None
        c, d = self.opposite[a, b], self.opposite[b, a]
        if self.turn(a, d, c) <= 0.0 or self.turn(d, b, c) <= 0.0:
            return None
        del self.opposite[a, b], self.opposite[b, a]
        for one, two, three in ((a, d, c), (d, b, c)):
            self.opposite[one, two], self.opposite[two, three], self.opposite[three, one] = three, one, two
        return min(c, d), max(c, d)

    def is_illegal(self, side: Side) -> bool:
        """Whether both angles opposite to a side sum up to more than 180 degrees: Delaunay's test."""
        a, b = side
        if (a, b) not in self.opposite or (b, a) not in self.opposite:
            return False
        cosine = sine = 0.0
        angles = []
        for corner in (self.opposite[a, b], self.opposite[b, a]):
            p, q = (np.subtract(self.place[end], self.place[corner]) for end in (a, b))
            cosine, sine = float(p @ q), abs(float(p[0] * q[1] - p[1] * q[0]))
            angles.append(np.arctan2(sine, cosine))
        return sum(angles) > np.pi + 1e-9
