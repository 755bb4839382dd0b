"""A circle skirt: two halves of a ring whose inner edge is the waist."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from assets.measures import BodyMeasures
from assets.patterns.drafts.drawing import Outline, arc, bands, check_at_least, line, number, require, same_names
from assets.patterns.drafts.placing import Surroundings, facing, nearest_placement, points_of
from assets.patterns.pattern import Pattern, Placement
from pbd.errors import InputError

__all__ = ["CircleSkirt", "circle_skirt"]

_HEM, _WAISTBAND = 0.02, 0.03  # [m]
_WAISTBAND_LAYERS = 3.0
_ROLLS = (0.45, 0.5, 0.55, 0.6, 0.7, 0.8, 1.0)  # radii of the roll over the panel's half width [-]


@dataclass(frozen=True)
class CircleSkirt:
    """Parameters of a circle skirt; None is derived from the body."""

    ease: float = number(0.0, "m", "added to the girth of the waist")
    length: float | None = number(None, "m", "from waist to hem; default: to the knee")
    circle: float = number(1.0, "-", "part of a whole circle, 0.25 to 1")


def circle_skirt(measures: BodyMeasures, parameters: CircleSkirt) -> Pattern:
    """Draft a circle skirt: the waist is an arc of radius girth / (2 pi circle).

    Raises:
        InputError: the body lacks a measure, or a parameter cannot be.
    """
    m, p, name = measures, parameters, "circle_skirt"
    require(m, name, "waist")
    check_at_least(name, "ease", p.ease, 0.0, "so that the skirt is not smaller than the waist")
    if not 0.25 <= p.circle <= 1.0:
        raise InputError("no part of a circle", key=f"draft {name}, circle", received=p.circle, expected="0.25 to 1")
    knee = float(m.landmarks.waist[1] - m.landmarks.knee[1])
    length = p.length if p.length is not None else knee
    check_at_least(name, "length", length, 0.15, "so that something covers the hips")
    if length > m.waist_to_floor:
        floor = f"at most {m.waist_to_floor:.3f} m, the height of the waist"
        raise InputError(
            "the skirt would lie on the floor", key=f"draft {name}, length", received=length, expected=floor
        )
    radius = (m.waist + p.ease) / (2.0 * math.pi * p.circle)
    if 2.0 * math.pi * p.circle * (radius + m.waist_to_hip) < m.hip:
        raise InputError(
            "the skirt is smaller than the hips",
            key=f"draft {name}, circle",
            received=p.circle,
            expected=f"more than {(m.hip - m.waist) / (2.0 * math.pi * m.waist_to_hip):.2f}",
        )
    half = 0.5 * math.pi * p.circle  # angle on both sides of the middle
    front = _half_ring("front", radius, length, half, "left", "right")
    back = _half_ring("back", radius, length, half, "right", "left")
    around = Surroundings(m)
    reach = float(points_of(front)[:, 0].max())
    before = _place(front, m, around, radius, 1, [reach * share for share in _ROLLS])
    behind = _place(back, m, around, radius, -1, [before.bend_radius])  # so that the sides hang side by side
    panels = (front.panel(before), back.panel(behind))
    strips = [band for outline in (front, back) for band in bands(outline, ["hem"], _HEM, 2.0)]
    for outline in (front, back):
        strips += bands(outline, ["waist"], _WAISTBAND, _WAISTBAND_LAYERS, m.waist / (m.waist + p.ease))
    seams = same_names(front, back, "side_left", "side_right")
    return Pattern(name, panels, tuple(seams), tuple(strips), f"draft:{name}")


def _half_ring(name: str, radius: float, length: float, half: float, plus: str, minus: str) -> Outline:
    """Edges hem, side (plus), waist, side (minus); the waist's circle is around the origin, the hem below."""
    down = -0.5 * math.pi
    waist, hem = arc(radius, down + half, down - half), arc(radius + length, down - half, down + half)
    return Outline(
        name,
        {"hem": hem, f"side_{plus}": line(hem[-1], waist[0]), "waist": waist, f"side_{minus}": line(waist[-1], hem[0])},
    )


def _place(
    outline: Outline,
    measures: BodyMeasures,
    around: Surroundings,
    radius: float,
    side: int,
    rolls: Sequence[float | None],
) -> Placement:
    """A half that lies like a saddle cloth before (side 1) or behind (-1) the waist: its sides hang down.

    The axis of its roll is level and leads away from the body, so that both halves have their side seams together
    whatever the radius of the roll is.
    """
    waist = measures.landmarks.waist
    rotation = facing((0.0, 1.0, 0.0), (0.0, 0.0, -side))
    points = points_of(outline)

    def placed(distance: float, roll: float | None) -> Placement:
        return Placement(rotation, np.array([0.0, waist[1] + 0.03, waist[2] + side * (distance - 0.5 * radius)]), roll)

    return nearest_placement(
        outline.name,
        points,
        [partial(placed, roll=roll) for roll in rolls],
        around,
        lambda placement: abs(float(placement.translation[2] - waist[2])),
        lambda placed: bool((side * (placed[:, 2] - waist[2]) > 0.005).all()),
    )
