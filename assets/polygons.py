"""Polygons cut into triangles."""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray

__all__ = ["triangulate"]

Floats = NDArray[np.float64]

_MIN_TURN = 1e-5  # height of a triangle over its length, below which it is a line at the precision of a file


def triangulate(corners: Floats) -> list[tuple[int, int, int]]:
    """Cut a simple polygon, also one that is not convex, into triangles; the shortest cuts come first.

    A corner that lies in the triangle of another one blocks its cut, which then waits until the first is cut off. The
    time grows with the square of the number of corners: 600 take a tenth of a second.

    Args:
        corners: [m], shape (k, 3), nearly in one plane.

    Returns:
        k - 2 triangles of corner numbers, wound as the polygon is.
    """
    count = len(corners)
    flat, left = _flattened(corners), np.ones(count, bool)
    before, after = [(k - 1) % count for k in range(count)], [(k + 1) % count for k in range(count)]
    cut = lambda tip: float(np.linalg.norm(corners[after[tip]] - corners[before[tip]]))  # noqa: E731
    ears = [(cut(tip), tip, before[tip], after[tip]) for tip in range(count)]
    heapify(ears)
    blocked: dict[int, list[tuple[float, int, int, int]]] = {}
    triangles: list[tuple[int, int, int]] = []
    while len(triangles) < count - 3:
        while ears:
            ear = heappop(ears)
            _, tip, start, end = ear
            if not left[tip] or (before[tip], after[tip]) != (start, end) or not _is_convex(flat[[start, tip, end]]):
                continue
            blocker = _corner_inside(flat, (start, tip, end), np.flatnonzero(left))
            if blocker is None:
                break
            blocked.setdefault(blocker, []).append(ear)
        else:  # the polygon crosses itself
            tip = int(left.argmax())
            start, end = before[tip], after[tip]
        triangles.append((start, tip, end))
        left[tip], after[start], before[end] = False, end, start
        for ear in [*blocked.pop(tip, []), *((cut(side), side, before[side], after[side]) for side in (start, end))]:
            heappush(ears, ear)
    first, second, third = np.flatnonzero(left).tolist()
    return [*triangles, (first, second, third)]


def _flattened(corners: Floats) -> Floats:
    """Corners in the plane of a polygon, which runs counter-clockwise there: shape (k, 2); zeros without an area."""
    normal = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)  # Newell's: twice the area vector
    length = np.linalg.norm(normal)
    if length == 0.0:
        return np.zeros((len(corners), 2))
    normal /= length
    across = np.eye(3)[np.abs(normal).argmin()]
    across = across - (across @ normal) * normal
    across /= np.linalg.norm(across)
    return corners @ np.stack([across, np.cross(normal, across)], axis=1)


def _is_convex(corners: Floats) -> bool:
    """Whether three corners turn to the left by more than rounding makes three corners of a straight side turn."""
    (ax, ay), (bx, by), (cx, cy) = corners.tolist()
    turn = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    return turn > _MIN_TURN * max((bx - ax) ** 2 + (by - ay) ** 2, (cx - ax) ** 2 + (cy - ay) ** 2)


def _corner_inside(flat: Floats, ear: tuple[int, int, int], corners: NDArray[np.intp]) -> int | None:
    """One of the corners that lies in a triangle or on its sides and is none of its own; None if all lie outside."""
    places = flat[corners]
    inside = np.ones(len(corners), bool)
    for start, end in zip(ear, (*ear[1:], ear[0]), strict=True):
        (x, y), (dx, dy) = flat[start], flat[end] - flat[start]
        inside &= dx * (places[:, 1] - y) - dy * (places[:, 0] - x) >= 0.0
    found = [corner for corner in corners[inside].tolist() if corner not in ear]
    return found[0] if found else None
