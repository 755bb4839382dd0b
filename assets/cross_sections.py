"""Cross-sections of a triangle mesh: where a plane cuts it, and the girth that a tape would read there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

__all__ = ["cross_section", "hull_length", "hull_loop", "tape_length"]

Floats = NDArray[np.float64]


def cross_section(vertices: Floats, faces: NDArray[np.int32], point: Floats, normal: Floats) -> Floats:
    """Points where a plane cuts the edges of a mesh [m], shape (k, 3); every edge of a cut face comes once a face.

    Args:
        vertices: [m], shape (n, 3).
        faces: shape (m, 3).
        point: of the plane [m], shape (3,).
        normal: of the plane, shape (3,).
    """
    distance = (vertices - point) @ normal
    above = distance[faces] > 0.0
    faces = faces[above.any(axis=1) & ~above.all(axis=1)]
    starts, ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    crossed = (distance[starts] > 0.0) != (distance[ends] > 0.0)
    starts, ends = starts[crossed], ends[crossed]
    share = distance[starts] / (distance[starts] - distance[ends])
    return vertices[starts] + share[:, None] * (vertices[ends] - vertices[starts])


def hull_loop(points: Floats) -> Floats:
    """The convex hull of points in a plane [m], shape (k, 2), counter-clockwise; shape (0, 2) where there is none.

    Args:
        points: [m], shape (n, 2).
    """
    if len(points) < 3:
        return np.zeros((0, 2))
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # all on one line
        return np.zeros((0, 2))


def hull_length(points: Floats, normal: Floats) -> float:
    """Girth of points of a plane [m]: the length of their convex hull, for a tape bridges hollows.

    Args:
        points: [m], shape (n, 3).
        normal: of the plane, shape (3,).
    """
    first = np.asarray(np.cross(normal, np.eye(3)[np.abs(normal).argmin()]), float)
    first /= np.linalg.norm(first)
    second = np.asarray(np.cross(normal, first), float) / np.linalg.norm(normal)
    loop = hull_loop(points @ np.stack([first, second], axis=1))
    return float(np.linalg.norm(loop - np.roll(loop, 1, axis=0), axis=1).sum())


def tape_length(points: Floats, start: Floats, end: Floats) -> float:
    """Length of a tape that is pulled tight over points of a plane, from one point of it to another [m].

    Args:
        points: [m], shape (n, 2); the tape lies on the side of greater second coordinate.
        start: where it begins [m], shape (2,).
        end: where it ends [m], shape (2,), at a greater first coordinate than the start.
    """
    between = points[(points[:, 0] > start[0]) & (points[:, 0] < end[0])]
    chain: list[Floats] = []
    for point in [start, *between[between[:, 0].argsort()], end]:  # Andrew's monotone chain, upper half
        while len(chain) > 1 and _turn(chain[-2], chain[-1], point) >= 0.0:
            chain.pop()
        chain.append(point)
    return float(np.linalg.norm(np.diff(chain, axis=0), axis=1).sum())


def _turn(a: Floats, b: Floats, c: Floats) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
