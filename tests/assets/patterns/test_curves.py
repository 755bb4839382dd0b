"""Arcs and Bezier curves of outlines, and the tests of outlines, against geometry that is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from assets.patterns.curves import arc, bezier, contains, crossings, signed_area
from assets.patterns.pattern import edge_length

SQUARE = np.array([(0.0, 0.0), (0.2, 0.0), (0.2, 0.2), (0.0, 0.2)])


@pytest.mark.parametrize(
    ("large", "counter_clockwise", "middle", "length"),
    [
        (False, False, (0.1, 0.2 - 0.1 * math.sqrt(3.0)), 0.2 * math.pi / 3.0),
        (False, True, (0.1, -0.2 + 0.1 * math.sqrt(3.0)), 0.2 * math.pi / 3.0),
        (True, False, (0.1, 0.2 + 0.1 * math.sqrt(3.0)), 0.2 * math.pi * 5.0 / 3.0),
        (True, True, (0.1, -0.2 - 0.1 * math.sqrt(3.0)), 0.2 * math.pi * 5.0 / 3.0),
    ],
)
def test_an_arc_takes_the_side_and_the_length_of_its_flags(
    large: bool, counter_clockwise: bool, middle: tuple[float, float], length: float
) -> None:
    """An arc of 60 degrees from (0, 0) to (0.2, 0), radius 0.2, and the 300 degrees that it leaves."""
    points = arc(np.array([0.0, 0.0]), np.array([0.2, 0.0]), 0.2, large, counter_clockwise)
    assert points[0].tolist() == [0.0, 0.0] and points[-1].tolist() == [0.2, 0.0]
    assert edge_length(points) == pytest.approx(length, rel=1e-4)
    assert np.linalg.norm(points - middle, axis=1).min() < 0.002


def test_an_arc_that_does_not_reach_is_refused() -> None:
    with pytest.raises(ValueError, match="radius below half"):
        arc(np.array([0.0, 0.0]), np.array([0.2, 0.0]), 0.09, False, True)


def test_a_bezier_curve_keeps_its_ends_tangents_and_middle() -> None:
    control = np.array([(0.0, 0.0), (0.0, 0.2), (0.2, 0.2), (0.3, 0.0)])
    points = bezier(control)
    assert (points[[0, -1]] == control[[0, -1]]).all()
    middle = (control[0] + 3.0 * control[1] + 3.0 * control[2] + control[3]) / 8.0
    assert np.linalg.norm(points - middle, axis=1).min() < 0.002
    first = points[1] - points[0]
    assert first[0] / first[1] < 0.02
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() < 0.01


def test_area_is_positive_counter_clockwise() -> None:
    assert signed_area(SQUARE) == pytest.approx(0.04)
    assert signed_area(SQUARE[::-1]) == pytest.approx(-0.04)


def test_points_inside_an_outline_with_a_notch() -> None:
    notched = np.array([(0.0, 0.0), (0.2, 0.0), (0.2, 0.2), (0.1, 0.05), (0.0, 0.2)])
    points = np.array([(0.1, 0.02), (0.1, 0.1), (0.01, 0.15), (0.3, 0.1), (-0.1, 0.0)])
    assert contains(notched, points).tolist() == [True, False, True, False, False]


@pytest.mark.parametrize(
    ("outline", "pairs"),
    [
        (SQUARE, []),
        (SQUARE[[0, 2, 1, 3]], [[0, 2]]),  # a bow
        (np.array([(0.0, 0.0), (0.2, 0.0), (0.2, 0.2), (0.1, 0.0), (0.0, 0.2)]), [[0, 2], [0, 3]]),  # touches
        (np.array([(0.0, 0.0), (0.2, 0.0), (0.3, 0.0), (0.2, 0.0), (0.2, 0.2)]), [[1, 2]]),  # turns back
    ],
)
def test_an_outline_that_crosses_or_touches_itself(outline: np.ndarray, pairs: list[list[int]]) -> None:
    found = crossings(outline, outline).tolist()
    assert all(pair in found for pair in pairs) and bool(found) == bool(pairs)


def test_crossings_agree_with_every_pair_by_itself() -> None:
    """Random outlines of more segments than are compared at once."""
    rng = np.random.default_rng(3)
    one, two = rng.random((300, 2)), rng.random((40, 2))
    expected = []
    for i in range(len(one)):
        for j in range(len(two)):
            a, b, c, d = one[i], one[(i + 1) % 300], two[j], two[(j + 1) % 40]
            matrix = np.stack([b - a, c - d], axis=1)
            s, t = np.linalg.solve(matrix, c - a)
            if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
                expected.append([i, j])
    assert sorted(crossings(one, two).tolist()) == expected
