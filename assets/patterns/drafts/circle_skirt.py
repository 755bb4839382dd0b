"""A circle skirt: four sectors of a ring whose inner edge is the waist."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from assets.measures import BodyMeasures
from assets.patterns.drafts.drawing import Outline, arc, bands, check_above_floor, check_at_least, line, number, require
from assets.patterns.drafts.placing import Surroundings, facing, nearest_placement, points_of
from assets.patterns.pattern import Pattern, Placement, Seam
from pbd.errors import InputError

__all__ = ["CircleSkirt", "circle_skirt"]

Floats = NDArray[np.float64]

_HEM, _WAISTBAND = 0.02, 0.03  # [m]
_WAISTBAND_LAYERS = 3.0
_MOST_EASE = 0.25  # of the waist, over what the hip measures more [-]
_PANELS = ("front", "left", "back", "right")
_ROLLS = (0.5, 0.55, 0.6, 0.65, 0.7, 0.8, 0.9, 1.0, 1.3, 2.0)  # radii of the roll over the panel's half width [-]
_DEPTH_LESS = 0.03  # [m] by which the waist's half depth is less than its half width


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
    require(m, name, "waist", "hip", "waist_to_hip", "knee")
    check_at_least(name, "ease", p.ease, 0.0, "so that the skirt is not smaller than the waist")
    if p.ease > _MOST_EASE * (m.hip - m.waist):
        raise InputError(
            "nothing holds so wide a waist above the hips",
            key=f"draft {name}, ease",
            received=p.ease,
            expected=f"at most {_MOST_EASE * (m.hip - m.waist):.3f} m",
        )
    if not 0.25 <= p.circle <= 1.0:
        raise InputError("no part of a circle", key=f"draft {name}, circle", received=p.circle, expected="0.25 to 1")
    knee = float(m.landmarks.waist[1] - m.landmarks.knee[1])
    length = p.length if p.length is not None else knee
    check_at_least(name, "length", length, 0.15, "so that something covers the hips")
    check_above_floor(name, length, m)
    radius = (m.waist + p.ease) / (2.0 * math.pi * p.circle)
    if 2.0 * math.pi * p.circle * (radius + m.waist_to_hip) < m.hip:
        raise InputError(
            "the skirt is smaller than the hips",
            key=f"draft {name}, circle",
            received=p.circle,
            expected=f"more than {(m.hip - m.waist) / (2.0 * math.pi * m.waist_to_hip):.2f}",
        )
    outlines = [_sector(panel, radius, length, 0.25 * math.pi * p.circle) for panel in _PANELS]
    around = Surroundings(m)
    panels = tuple(outline.panel(_place(outline, m, around, number)) for number, outline in enumerate(outlines))
    strips, seams = [], []
    for outline, neighbour in zip(outlines, outlines[1:] + outlines[:1], strict=True):
        seams.append(Seam(outline.edge("next"), neighbour.edge("previous")))
        strips += bands(outline, ["hem"], _HEM, 2.0)
        strips += bands(outline, ["waist"], _WAISTBAND, _WAISTBAND_LAYERS, m.waist / (m.waist + p.ease))
    return Pattern(name, panels, tuple(seams), tuple(strips), f"draft:{name}")


def _sector(name: str, radius: float, length: float, half: float) -> Outline:
    """Edges hem, next (towards the next panel), waist, previous; the waist's circle is around the origin."""
    down = -0.5 * math.pi
    waist, hem = arc(radius, down + half, down - half), arc(radius + length, down - half, down + half)
    # y = 0 at the waist's middle, so that the panel is placed by it.
    waist, hem = (edge + (0.0, radius) for edge in (waist, hem))
    return Outline(
        name, {"hem": hem, "next": line(hem[-1], waist[0]), "waist": waist, "previous": line(waist[-1], hem[0])}
    )


def _place(outline: Outline, measures: BodyMeasures, around: Surroundings, number: int) -> Placement:
    """A panel that hangs before, beside or behind the waist, its sides rolled outwards to those of its neighbours."""
    places = measures.landmarks
    turn = 0.5 * math.pi * number  # front, left, back, right
    outward = np.array([math.sin(turn), 0.0, math.cos(turn)])
    lateral = np.array([math.cos(turn), 0.0, -math.sin(turn)])
    rotation = facing(outward, (0.0, 1.0, 0.0))
    centre = np.array([0.0, places.waist[1] + 0.01, 0.5 * (places.waist[2] + places.hip[2])])
    points = points_of(outline)
    reach = float(points[:, 0].max())
    # The seams lie in planes at 45 degrees; the trunk is wider than deep, so that they do not meet on its axis.
    wider = _DEPTH_LESS if number % 2 == 0 else -_DEPTH_LESS

    def beyond(placed: Floats) -> Floats:
        """Distance of points from the nearer of both planes, inside of the panel's own quarter [m]."""
        local = placed - centre
        return (local @ outward + wider - np.abs(local @ lateral)) / math.sqrt(2.0)

    def placed(distance: float, roll: float | None) -> Placement:
        return Placement(rotation, centre + distance * outward, roll)

    return nearest_placement(
        outline.name,
        points,
        [partial(placed, roll=-reach * share) for share in _ROLLS],
        around,
        lambda placement: float(np.abs(beyond(placement.apply(outline.edges["next"]))).mean()),
        lambda points: bool((beyond(points) > 0.005).all()),
    )
