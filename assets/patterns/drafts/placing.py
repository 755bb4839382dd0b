"""Where the panels of a draft stand around the body that it was drafted for.

A panel is rolled to a part of a cylinder and moved away from the body until it is clear of it. Several radii are tried;
the one whose seams stay nearest to each other is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from assets.measures import BodyMeasures
from assets.patterns.drafts.drawing import Outline, Point
from assets.patterns.pattern import Placement
from pbd.errors import InputError

__all__ = ["CLEARANCE", "Surroundings", "facing", "nearest_placement", "place_on_trunk", "points_of"]

Floats = NDArray[np.float64]

CLEARANCE = 0.02  # [m] of a panel from the body
_PANEL_CLEARANCE = 0.008  # [m] of a panel from another one
_SPACING = 0.02  # [m] between points of a panel that are held against the body
_STEP = 0.01  # [m] between two places that are tried
_REACH = 0.45  # [m] from the first place to the last


class Surroundings:
    """The body, and the panels that stand already, in the body's frame.

    Args:
        measures: of the body.
    """

    def __init__(self, measures: BodyMeasures) -> None:
        vertices = measures.frame.local(np.asarray(measures.surface.vertices, float))
        a, b, c = (vertices[measures.surface.faces[:, k]] for k in range(3))
        normals = np.zeros_like(vertices)
        for k in range(3):
            np.add.at(normals, measures.surface.faces[:, k], np.cross(b - a, c - a))
        self._vertices, self._normals = vertices, normals
        self._body = cKDTree(vertices)
        self._panels: list[Floats] = []
        self._panel_tree: cKDTree | None = None

    def add(self, points: Floats) -> None:
        """Points of a panel that stands [m], shape (n, 3)."""
        self._panels.append(points)
        self._panel_tree = cKDTree(np.concatenate(self._panels))

    def clear(self, points: Floats, clearance: float) -> bool:
        """Whether points [m], shape (n, 3), are outside the body and apart from the panels."""
        if self._panel_tree is not None:
            near = self._panel_tree.query(points, distance_upper_bound=_PANEL_CLEARANCE)[0]
            if np.isfinite(near).any():
                return False
        return self.room(points[::7]) >= clearance and self.room(points) >= clearance  # a few points say no quickly

    def room(self, points: Floats) -> float:
        """Distance of the nearest of points from the body [m], negative inside."""
        distance, nearest = self._body.query(points)
        outside = np.einsum("na,na->n", points - self._vertices[nearest], self._normals[nearest]) > 0.0
        return float(np.where(outside, distance, -distance).min())


def points_of(outline: Outline) -> Floats:
    """Points all over a panel, its outline among them [m], shape (n, 2)."""
    border = []
    for edge in outline.edges.values():
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(edge, axis=0), axis=1))])
        at = np.linspace(0.0, length[-1], max(2, int(length[-1] / _SPACING) + 1))[:-1]
        border.append(np.stack([np.interp(at, length, edge[:, k]) for k in (0, 1)], axis=1))
    loop = np.concatenate(border)
    low, high = loop.min(axis=0), loop.max(axis=0)
    x, y = np.meshgrid(*(np.arange(low[k] + 0.5 * _SPACING, high[k], _SPACING) for k in (0, 1)))
    grid = np.stack([x.ravel(), y.ravel()], axis=1)
    return np.concatenate([loop, grid[_inside(grid, loop)]])


def facing(outward: Point, up: Point) -> Floats:
    """The rotation of a panel whose outer side looks along one direction and whose y axis lies along another."""
    z = np.asarray(outward, float) / np.linalg.norm(outward)
    y = np.asarray(up, float) - (np.asarray(up, float) @ z) * z
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z], axis=1)


def nearest_placement(
    name: str,
    points: Floats,
    candidates: Iterable[Callable[[float], Placement]],
    surroundings: Surroundings,
    cost: Callable[[Placement], float],
    allowed: Callable[[Floats], bool] = lambda _: True,
    *,
    clearance: float = CLEARANCE,
) -> Placement:
    """The placement with the least cost that is clear of the body and of the panels that stand.

    Args:
        name: of the panel, for messages.
        points: of the panel [m], shape (n, 2).
        candidates: rolls to try: each gives the placement for a distance by which the panel is moved away [m].
        surroundings: the body and the other panels; the panel is added to them.
        cost: of a placement, such as the width of the seams that are still open [m].
        allowed: whether the points may be there at all.
        clearance: of the panel from the body [m].

    Raises:
        InputError: no place is clear.
    """
    best: tuple[float, Placement] | None = None
    for candidate in candidates:
        for distance in np.arange(0.0, _REACH, _STEP):
            placement = candidate(float(distance))
            placed = placement.apply(points)
            if allowed(placed) and surroundings.clear(placed, clearance):
                if best is None or cost(placement) < best[0]:
                    best = cost(placement), placement
                break
    if best is None:
        raise InputError(f"no place around the body is free for the panel {name}")
    surroundings.add(best[1].apply(points))
    return best[1]


def place_on_trunk(outline: Outline, height: float, middle: float, side: int, around: Surroundings) -> Placement:
    """A panel that stands upright before (side 1) or behind (side -1) the trunk.

    Args:
        outline: of the panel; x = 0 is its middle.
        height: of the panel's y = 0 [m].
        middle: z of the upright plane through both sides of the body [m]; the panel stays on its own side of it.
        side: 1 or -1.
        around: the body.
    """
    rotation = facing((0.0, 0.0, side), (0.0, 1.0, 0.0))
    points = points_of(outline)
    half = float(points[:, 0].max())
    sides = points[np.abs(points[:, 0]) > 0.85 * half]

    def placed(distance: float, radius: float) -> Placement:
        return Placement(rotation, np.array([0.0, height, middle + side * distance]), radius)

    return nearest_placement(
        outline.name,
        points,
        [partial(placed, radius=half * k) for k in (0.62, 0.66, 0.7, 0.75, 0.8, 0.9, 1.0, 1.2, 1.5, 2.0, 3.0, 6.0)],
        around,
        lambda placement: float(np.abs(placement.apply(sides)[:, 2] - middle).mean()),
        lambda placed: bool((side * (placed[:, 2] - middle) > 0.005).all()),
    )


def _inside(points: Floats, loop: Floats) -> NDArray[np.bool_]:
    """Whether points lie inside a closed polyline (even-odd rule)."""
    x, y = points[:, :1], points[:, 1:]
    (x0, y0), (x1, y1) = loop.T, np.roll(loop, -1, axis=0).T
    crossing = (y0 > y) != (y1 > y)
    at = x0 + (y - y0) * (x1 - x0) / np.where(y1 == y0, 1.0, y1 - y0)
    return (crossing & (x < at)).sum(axis=1) % 2 == 1
