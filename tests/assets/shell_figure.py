"""A figure of overlapping closed shells whose girths are known: trunk, head, arms, legs and feet apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from assets.sewing.body import StandingBody

__all__ = ["WAIST", "WAIST_AT", "ellipse_girth", "moved", "shell_figure"]

Floats = NDArray[np.float64]

AROUND = 32  # vertices of a ring
WAIST, WAIST_AT = (0.125, 0.095), 1.06  # half width and half depth [m], and the height [m]
# Height, half width, half depth, and how far ahead the middle is [m].
TRUNK = (
    (0.77, 0.06, 0.06, 0.0),
    (0.80, 0.15, 0.10, 0.0),
    (0.88, 0.172, 0.125, -0.01),
    (0.97, 0.155, 0.11, 0.0),
    (WAIST_AT, *WAIST, 0.0),
    (1.15, 0.14, 0.10, 0.0),
    (1.25, 0.155, 0.125, 0.01),
    (1.33, 0.155, 0.105, 0.0),
    (1.40, 0.16, 0.08, -0.01),
    (1.44, 0.11, 0.065, -0.015),
    (1.47, 0.06, 0.06, -0.015),
)
HEAD = (
    (1.44, 0.052, 0.055, -0.01),
    (1.53, 0.052, 0.055, 0.0),
    (1.58, 0.075, 0.09, 0.01),
    (1.66, 0.078, 0.1, 0.01),
    (1.72, 0.05, 0.06, 0.01),
)


def ellipse_girth(half_width: float, half_depth: float) -> float:
    """Girth of an ellipse [m], by a fine polygon."""
    angle = np.linspace(0.0, 2.0 * np.pi, 2000)
    return float(
        np.linalg.norm(np.diff([half_width * np.cos(angle), half_depth * np.sin(angle)], axis=1), axis=0).sum()
    )


def moved(body: StandingBody, by: tuple[float, float, float], degrees: float) -> StandingBody:
    """The body somewhere else, turned about the vertical to its left."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return StandingBody(body.name, body.vertices @ turn.T + by, body.faces)


def shell_figure(arms: float = 0.0) -> StandingBody:
    """A figure that is 1.72 m high and looks along +Z.

    Args:
        arms: how far they hang down: 0 for a T-pose [deg].
    """
    shells = [_upright(TRUNK), _upright(HEAD)]
    down = np.array([np.cos(np.radians(arms)), -np.sin(np.radians(arms)), 0.0])
    for side in (1.0, -1.0):
        flip = np.array([side, 1.0, 1.0])
        shoulder = np.array([0.10, 1.385, -0.01])
        reach = (0.0, 0.10, 0.30, 0.34, 0.52, 0.58, 0.70)
        radii = (0.045, 0.05, 0.042, 0.04, 0.026, 0.035, 0.012)
        shells.append(_tube([(shoulder + along * down) * flip for along in reach], radii))
        hip, knee, ankle = np.array([0.085, 0.84, 0.0]), np.array([0.095, 0.48, 0.01]), np.array([0.1, 0.06, -0.02])
        leg = [
            hip * flip,
            (hip + [0.0, -0.1, 0.0]) * flip,
            knee * flip,
            (knee - [0.0, 0.12, 0.02]) * flip,
            ankle * flip,
        ]
        shells.append(_tube(leg, (0.078, 0.075, 0.05, 0.055, 0.034)))
        toes = [np.array([0.1, 0.04, z]) * flip for z in (-0.06, -0.02, 0.1, 0.17)]
        shells.append(_tube(toes, (0.03, 0.04, 0.035, 0.025)))
    vertices, faces = [], []
    for points, triangles in shells:
        faces.append(triangles + sum(len(part) for part in vertices))
        vertices.append(points)
    return StandingBody("shells", np.concatenate(vertices), np.concatenate(faces).astype(np.int32))


def _upright(rows: tuple[tuple[float, float, float, float], ...]) -> tuple[Floats, NDArray[np.int32]]:
    fine = _finer(np.array(rows))
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    rings = [
        np.stack([width * np.sin(angle), np.full(AROUND, y), z + depth * np.cos(angle)], axis=1)
        for y, width, depth, z in fine
    ]
    return _closed(rings)


def _tube(path: list[Floats], radii: tuple[float, ...]) -> tuple[Floats, NDArray[np.int32]]:
    rows = _finer(np.column_stack([np.array(path), radii]))
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    along = rows[-1, :3] - rows[0, :3]
    first = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.5 * np.linalg.norm(along) else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(along / np.linalg.norm(along), first)
    turned = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    return _closed([row[:3] + row[3] * turned for row in rows])


def _finer(rows: Floats) -> Floats:
    """Four rows for each step."""
    at = np.linspace(0.0, len(rows) - 1.0, 4 * (len(rows) - 1) + 1)
    return np.stack([np.interp(at, np.arange(len(rows)), rows[:, k]) for k in range(rows.shape[1])], axis=1)


def _closed(rings: list[Floats]) -> tuple[Floats, NDArray[np.int32]]:
    """A tube through rings, counter-clockwise around its direction, closed at both ends by a point."""
    points = np.concatenate([*rings, rings[0].mean(axis=0)[None], rings[-1].mean(axis=0)[None]])
    here = np.arange(AROUND)
    after, last, faces = (here + 1) % AROUND, AROUND * (len(rings) - 1), []
    for row in range(len(rings) - 1):
        low, high = AROUND * row, AROUND * (row + 1)
        faces += [
            np.stack([low + here, low + after, high + after], 1),
            np.stack([low + here, high + after, high + here], 1),
        ]
    bottom, top = np.full(AROUND, len(points) - 2), np.full(AROUND, len(points) - 1)
    faces += [np.stack([after, here, bottom], 1), np.stack([last + here, last + after, top], 1)]
    return points, np.concatenate(faces).astype(np.int32)
