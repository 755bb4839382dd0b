"""Curves of outlines as polylines, and the tests of outlines that need no triangles."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["arc", "bezier", "contains", "crossings", "signed_area"]

Floats = NDArray[np.float64]

_LONGEST_PIECE = 0.003  # [m]; of a circle of 10 cm such a chord lies 0.01 mm off
_FEWEST_PIECES, _MOST_PIECES = 16, 512  # a file in another unit than it says must not take long
_ROWS = 256  # segments of one outline that are compared with all of the other at once


def bezier(control: Floats) -> Floats:
    """Points of a Bezier curve [m], shape (k, 2), from control points, shape (degree + 1, 2): de Casteljau's steps."""
    pieces = _pieces(float(np.linalg.norm(np.diff(control, axis=0), axis=1).sum()))
    share = np.linspace(0.0, 1.0, pieces + 1)[:, None]
    points = [np.broadcast_to(point, (pieces + 1, 2)) for point in control]
    while len(points) > 1:
        points = [(1.0 - share) * one + share * two for one, two in zip(points, points[1:], strict=False)]
    return points[0].copy()


def arc(start: Floats, end: Floats, radius: float, large: bool, counter_clockwise: bool) -> Floats:
    """Points of an arc of a circle [m], shape (k, 2).

    Args:
        start, end: the ends [m], shape (2,).
        radius: of the circle [m].
        large: whether the arc is longer than half of the circle.
        counter_clockwise: whether it runs so from start to end.

    Raises:
        ValueError: no circle of this radius joins the ends.
    """
    chord = end - start
    half = float(np.linalg.norm(chord)) / 2.0
    if not half > 0.0 or not radius >= half * (1.0 - 1e-6):
        raise ValueError("a radius below half of the distance between the ends")
    radius = max(radius, half)
    angle = 2.0 * math.asin(half / radius)
    angle = (2.0 * math.pi - angle if large else angle) * (1.0 if counter_clockwise else -1.0)
    left = np.array([-chord[1], chord[0]]) / (2.0 * half)
    away = math.sqrt(radius**2 - half**2) * (1.0 if counter_clockwise != large else -1.0)
    centre = (start + end) / 2.0 + away * left
    first = math.atan2(*(start - centre)[::-1])
    angles = first + angle * np.linspace(0.0, 1.0, _pieces(radius * abs(angle)) + 1)
    points = centre + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points[0], points[-1] = start, end
    return points


def _pieces(length: float) -> int:
    return int(np.clip(length / _LONGEST_PIECE + 1.0, _FEWEST_PIECES, _MOST_PIECES))


def signed_area(outline: Floats) -> float:
    """Area of a closed outline [m^2], shape (n, 2); positive if it runs counter-clockwise."""
    (x, y), (x1, y1) = (outline - outline[0]).T, np.roll(outline - outline[0], -1, axis=0).T
    return float((x * y1 - x1 * y).sum()) / 2.0


def contains(outline: Floats, points: Floats) -> NDArray[np.bool_]:
    """Whether points lie in a closed outline, shape (k,): a ray to the right crosses it an odd number of times."""
    inside = np.zeros(len(points), bool)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if y0 != y1:
            crosses = (y0 > points[:, 1]) != (y1 > points[:, 1])
            inside ^= crosses & (points[:, 0] < x0 + (points[:, 1] - y0) * (x1 - x0) / (y1 - y0))
    return inside


def crossings(one: Floats, two: Floats) -> NDArray[np.int64]:
    """Pairs of segments of two closed outlines that cross or touch, by the number of their first points, shape (p, 2).

    Of one outline with itself (``two is one``) neighbours count only where the outline turns back on itself.
    """
    low, high = np.minimum(two, np.roll(two, -1, axis=0)), np.maximum(two, np.roll(two, -1, axis=0))
    found = [np.zeros((2, 0), np.int64)]
    for start in range(0, len(one), _ROWS):
        # Boxes that overlap, and the ends of each segment not on one side of the other.
        a, b = one[start : start + _ROWS, None], np.roll(one, -1, axis=0)[start : start + _ROWS, None]
        overlap = ((np.minimum(a, b) <= high) & (low <= np.maximum(a, b))).all(axis=2)
        found.append(np.stack(np.nonzero(overlap)) + [[start], [0]])
    first, second = np.concatenate(found, axis=1)
    if two is one:
        apart = (second - first) % len(one)
        keep = (first < second) & (apart != 1) & (apart != len(one) - 1)
        first, second = first[keep], second[keep]
    a, b, c, d = one[first], one[(first + 1) % len(one)], two[second], two[(second + 1) % len(two)]
    meet = (_turn(a, b, c) * _turn(a, b, d) <= 0.0) & (_turn(c, d, a) * _turn(c, d, b) <= 0.0)
    pairs = np.stack([first[meet], second[meet]], axis=1)
    if two is not one:
        return pairs
    ahead = np.roll(one, -1, axis=0) - one
    following = np.roll(ahead, -1, axis=0)
    sine = ahead[:, 0] * following[:, 1] - ahead[:, 1] * following[:, 0]
    cosine = (ahead * following).sum(axis=1)
    back = np.flatnonzero((np.abs(sine) <= 1e-9 * np.abs(cosine)) & (cosine < 0.0))
    return np.concatenate([pairs, np.stack([back, (back + 1) % len(one)], axis=1)])


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Twice the areas of triangles."""
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
