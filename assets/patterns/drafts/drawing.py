"""How drafts draw: curves, outlines of named edges, and parameters with unit and meaning."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.measures import BodyMeasures
from assets.patterns.pattern import Band, EdgeName, Panel, Placement, Seam, edge_length
from pbd.errors import InputError

__all__ = [
    "Outline",
    "Point",
    "arc",
    "bands",
    "check_above_floor",
    "check_at_least",
    "curve",
    "line",
    "number",
    "require",
    "same_names",
    "symmetric",
]

Floats = NDArray[np.float64]
Point = Sequence[float] | NDArray[np.float64]

_CURVE_POINTS = 33


def number(default: float | None, unit: str, meaning: str) -> Any:
    """A parameter of a draft: a field of a dataclass.

    Args:
        default: None for a value that the draft derives from the body.
        unit: "m" or "-".
        meaning: in words, for the command line.
    """
    return field(default=default, metadata={"unit": unit, "meaning": meaning})


def require(measures: BodyMeasures, draft: str, *names: str) -> None:
    """Refuse a body on which a measure could not be taken.

    Raises:
        InputError: a measure that the draft needs is not a number.
    """
    values = measures.values()
    missing = [name for name in names if not math.isfinite(values[name])]
    if missing:
        words = ", ".join(name.replace("_", " ") for name in missing)
        reasons = dict.fromkeys(measures.doubts[name] for name in missing if name in measures.doubts)
        raise InputError(
            f"a body without a {words}",
            key=f"draft {draft}, body {measures.surface.name}",
            received="; ".join(reasons) or None,
            expected=f"a body that shows it, or the measure by hand [m]: --param {missing[0]}=METRES",
        )


def check_at_least(draft: str, name: str, value: float, least: float, reason: str) -> None:
    """Refuse a length that cannot be.

    Args:
        draft: its name.
        name: of the parameter or of the length that follows from it.
        value: [m].
        least: [m].
        reason: the least value in words.

    Raises:
        InputError: the value is less, or not a number.
    """
    if not value >= least:
        raise InputError(
            f"{name.replace('_', ' ')} is too small",
            key=f"draft {draft}, {name}",
            received=round(float(value), 4),
            expected=f"at least {least:.3f} m, {reason}",
        )


def check_above_floor(draft: str, length: float, measures: BodyMeasures) -> None:
    """Refuse what hangs from the waist and would lie on the floor.

    Args:
        draft: its name.
        length: from the waist down [m].
        measures: of the body.

    Raises:
        InputError: the waist is not as high.
    """
    if length > measures.waist_to_floor:
        expected = f"at most {measures.waist_to_floor:.3f} m, the height of the waist"
        raise InputError(
            "the hem would lie on the floor", key=f"draft {draft}, length", received=length, expected=expected
        )


def line(*points: Point) -> Floats:
    """A polyline through points [m]."""
    return np.array(points, float)


def curve(start: Point, towards: Point, end: Point, arriving: Point) -> Floats:
    """A cubic Bezier curve as a polyline [m], shape (k, 2).

    Args:
        start: first point [m].
        towards: second control point minus the first [m].
        end: last point [m].
        arriving: last point minus the third control point [m].
    """
    a, d = np.asarray(start, float), np.asarray(end, float)
    b, c = a + np.asarray(towards, float), d - np.asarray(arriving, float)
    t = np.linspace(0.0, 1.0, _CURVE_POINTS)[:, None]
    return (1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * b + 3 * (1 - t) * t**2 * c + t**3 * d


def arc(radius: float, first: float, last: float) -> Floats:
    """Part of a circle around the origin as a polyline [m], from one angle to another [rad]."""
    angles = np.linspace(first, last, 2 * _CURVE_POINTS - 1)
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


@dataclass(frozen=True, eq=False)
class Outline:
    """A panel whose edges have names.

    Attributes:
        name: of the panel.
        edges: polylines [m] by name, counter-clockwise seen from the outer side, each from the end of the one before.
    """

    name: str
    edges: Mapping[str, Floats]

    def edge(self, name: str) -> EdgeName:
        """The edge of a name as seams and bands name it."""
        return EdgeName(self.name, list(self.edges).index(name))

    def length(self, *names: str) -> float:
        """Length of edges together [m]."""
        return sum(edge_length(self.edges[name]) for name in names)

    def mirrored(self, name: str) -> Outline:
        """The panel for the other side of the body; its edges keep their names.

        Args:
            name: of the new panel.
        """
        return Outline(name, {key: edge[::-1] * (-1.0, 1.0) for key, edge in reversed(list(self.edges.items()))})

    def panel(self, placement: Placement | None) -> Panel:
        """The panel; its warp runs along its y axis."""
        return Panel(self.name, tuple(self.edges.values()), np.array([0.0, 1.0]), placement)


def symmetric(name: str, half: Mapping[str, Floats], plus: str, minus: str) -> Outline:
    """A panel that is its own mirror image.

    Args:
        name: of the panel.
        half: edges of the half x >= 0, from the line x = 0 at the bottom to the same line at the top. The first and the
            last become one edge with their mirror images.
        plus: ending of the names of the others at x > 0, such as "left".
        minus: the same at x < 0.
    """
    names = list(half)
    first, last = half[names[0]], half[names[-1]]
    flip = np.array([-1.0, 1.0])
    edges = {names[0]: np.concatenate([(first * flip)[::-1], first[1:]])}
    edges |= {f"{key}_{plus}": half[key] for key in names[1:-1]}
    edges[names[-1]] = np.concatenate([last, (last * flip)[::-1][1:]])
    edges |= {f"{key}_{minus}": (half[key] * flip)[::-1] for key in reversed(names[1:-1])}
    return Outline(name, edges)


def same_names(first: Outline, second: Outline, *names: str) -> list[Seam]:
    """Seams between edges that have one name in both panels."""
    return [Seam(first.edge(name), second.edge(name)) for name in names]


def bands(outline: Outline, names: Sequence[str], width: float, layers: float, length_ratio: float = 1.0) -> list[Band]:
    """Strips along several edges of a panel."""
    return [Band(outline.edge(name), width, layers, length_ratio) for name in names]
