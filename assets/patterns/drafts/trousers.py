"""Trousers: front and back of both legs, with darts at the waist.

The rules are those of a block for trousers with a straight leg (Aldrich, Metric Pattern Cutting for Women's Wear):
forks of a twentieth and a tenth of the hip, a centre back that leans and rises so that the seat has room to sit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from assets.measures import BodyMeasures
from assets.patterns.drafts.drawing import (
    Outline,
    bands,
    check_above_floor,
    check_at_least,
    curve,
    line,
    number,
    require,
)
from assets.patterns.drafts.placing import Surroundings, facing, nearest_placement, points_of
from assets.patterns.drafts.waist import dart_seams, share_surplus, waist_line
from assets.patterns.pattern import Pattern, Placement, Seam, edge_length

__all__ = ["Trousers", "trousers"]

Floats = NDArray[np.float64]

_HEM, _WAISTBAND = 0.02, 0.035  # [m]
_WAISTBAND_LAYERS = 3.0


@dataclass(frozen=True)
class _Half:
    """How front and back differ.

    Attributes:
        fork: width of the fork over the hip's girth [-].
        lean: of the centre at the waist towards the side [m].
        centre_rise: of the waist line at the centre over that at the side [m].
        leg: width of the leg over half its girth, minus 1, in metres [m].
        dart_depth: over the height between waist and hip [-].
    """

    fork: float
    lean: float
    centre_rise: float
    leg: float
    dart_depth: float


_FRONT = _Half(0.05, 0.01, -0.008, -0.01, 0.45)
_BACK = _Half(0.105, 0.03, 0.022, 0.01, 0.6)


@dataclass(frozen=True)
class Trousers:
    """Parameters of trousers [m]; None is derived from the body."""

    ease: float = number(0.06, "m", "added to the girth of the hip")
    length: float | None = number(None, "m", "from waist to hem; default: to 5 cm above the floor")
    leg_width: float | None = number(None, "m", "girth of the hem; default: that of the knee and 8 cm")
    rise_ease: float = number(0.015, "m", "of the crotch below the body's")


def trousers(measures: BodyMeasures, parameters: Trousers) -> Pattern:
    """Draft trousers.

    Raises:
        InputError: the body lacks a measure, or a parameter makes the trousers smaller than the body.
    """
    m, p, name = measures, parameters, "trousers"
    require(m, name, "waist", "hip", "waist_to_hip", "rise", "knee", "thigh", "ankle")
    check_at_least(name, "ease", p.ease, 0.01, "so that the trousers go around the hip")
    check_at_least(name, "rise_ease", p.rise_ease, 0.0, "so that the crotch is not above the body's")
    length = p.length if p.length is not None else m.waist_to_floor - 0.05
    check_at_least(name, "length", length, m.rise + p.rise_ease + 0.08, "8 cm below the crotch")
    check_above_floor(name, length, m)
    leg_width = p.leg_width if p.leg_width is not None else m.knee + 0.08
    least, where = _girth_at(m, length)
    check_at_least(name, "leg_width", leg_width, least + 0.02, f"2 cm more than the {where}")
    around_thigh = 0.5 * (m.hip + p.ease) + (_FRONT.fork + _BACK.fork) * m.hip
    check_at_least(name, "ease", p.ease + around_thigh - m.thigh, p.ease + 0.02, "so that the thigh has room")
    share = np.clip(m.front_share, 0.47, 0.51)
    front = _panel("left_front", m, p, _FRONT, length, leg_width, share[1], share[2], m.rise + p.rise_ease)
    inseam = front.length("inseam")

    def back_with(depth: float) -> Outline:
        return _panel("right_back", m, p, _BACK, length, leg_width, 1.0 - share[1], 1.0 - share[2], depth)

    depth = m.rise + p.rise_ease  # the back's fork hangs lower until both inseams are of one length
    depth = brentq(lambda y: back_with(y).length("inseam") - inseam, depth - 0.03, depth + 0.06)
    right_back = back_with(depth)
    outlines = {
        "left_front": front,
        "right_front": front.mirrored("right_front"),
        "left_back": right_back.mirrored("left_back"),
        "right_back": right_back,
    }
    around = Surroundings(m)
    panels = tuple(
        outline.panel(
            _place(outline, m, around, 1 if key.startswith("left") else -1, 1 if key.endswith("front") else -1)
        )
        for key, outline in outlines.items()
    )
    strips = []
    for outline in outlines.values():
        waist = [edge for edge in outline.edges if edge.startswith("waist_")]
        strips += bands(outline, waist, _WAISTBAND, _WAISTBAND_LAYERS) + bands(outline, ["hem"], _HEM, 2.0)
    return Pattern(name, panels, tuple(_seams(outlines)), tuple(strips), f"draft:{name}")


def _girth_at(m: BodyMeasures, length: float) -> tuple[float, str]:
    """Girth of the leg where trousers of a length end [m], and the place's name."""
    above_floor = m.waist_to_floor - length
    heights = [m.landmarks.ankle[1] - m.landmarks.floor, m.landmarks.knee[1] - m.landmarks.floor, m.inseam]
    girth = float(np.interp(above_floor, heights, [m.ankle, m.knee, m.thigh]))
    return girth, ("ankle", "knee", "thigh")[int(np.argmin(np.abs(np.array(heights) - above_floor)))]


def _seams(outlines: dict[str, Outline]) -> list[Seam]:
    seams = []
    for side in ("left", "right"):
        front, back = outlines[f"{side}_front"], outlines[f"{side}_back"]
        seams += [Seam(front.edge(edge), back.edge(edge)) for edge in ("side", "inseam")]
    for half in ("front", "back"):
        seams.append(Seam(outlines[f"left_{half}"].edge("centre"), outlines[f"right_{half}"].edge("centre")))
    return seams + [seam for outline in outlines.values() for seam in dart_seams(outline)]


def _panel(
    name: str,
    m: BodyMeasures,
    p: Trousers,
    half: _Half,
    length: float,
    leg_width: float,
    waist_share: float,
    hip_share: float,
    depth: float,
) -> Outline:
    """A left front or a right back: edges hem, side, waist line with darts, centre, inseam; x = 0 is the crease.

    y = 0 is the waist at the side; x grows towards the side.

    Args:
        name: of the panel.
        m: of the body.
        p: parameters.
        half: front or back.
        length: from waist to hem [m].
        leg_width: girth of the hem [m].
        waist_share: part of the waist's girth in both panels of this half [-].
        hip_share: the same of the hip's.
        depth: of the fork below the waist [m].
    """
    hip = 0.5 * hip_share * (m.hip + p.ease)
    waist = 0.5 * waist_share * m.waist
    fork = half.fork * m.hip
    width = hip + fork
    side, centre = 0.5 * width, fork - 0.5 * width  # x at the hip
    hip_depth = min(m.waist_to_hip, 0.72 * (m.rise + p.rise_ease))
    knee_depth = float(m.landmarks.waist[1] - m.landmarks.knee[1])
    taken, darts = share_surplus(hip - half.lean - waist, 0.35, 0.03, 0.03)
    top_side, top_centre = (side - taken, 0.0), (centre + half.lean, half.centre_rise)
    hem = 0.25 * leg_width + 0.5 * half.leg
    knee = 0.25 * max(leg_width, m.knee + 0.06) + 0.5 * half.leg
    crotch = (-0.5 * width, -depth)
    hip_point = (side, -hip_depth)
    if length > knee_depth + 0.03:
        outside, inner = _long_leg((hem, -length), (knee, -knee_depth), hip_point, crotch)
    else:  # short trousers: straight from the fork to the hem
        rise = (0.0, 0.3 * (length - hip_depth))
        outside = curve((hem, -length), rise, hip_point, rise)
        inner = line(crotch, (-hem, -length))
    upper = curve(hip_point, (0.0, 0.4 * hip_depth), top_side, (-0.3 * taken, 0.35 * hip_depth))
    # The centre runs straight to the hip's height and then curves into the fork.
    low = (centre, -hip_depth)
    straight = line(top_centre, low)
    down = (straight[1] - straight[0]) / edge_length(straight)
    drop = depth - hip_depth
    bend = curve(low, 0.65 * drop * down, crotch, 0.75 * fork * np.array([-1.0, 0.0]))
    edges = {"hem": line((-hem, -length), (hem, -length)), "side": _joined(outside, upper)}
    edges |= waist_line(top_side, top_centre, darts, half.dart_depth * m.waist_to_hip)
    return Outline(name, edges | {"centre": _joined(straight, bend), "inseam": inner})


def _long_leg(
    hem: tuple[float, float], knee: tuple[float, float], hip: tuple[float, float], crotch: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Outer side from hem to hip, and inner side from fork to hem."""
    leg = line(hem, knee)
    thigh = np.array(hip) - knee
    outside = _joined(leg, curve(knee, 0.35 * _slope(leg, thigh), hip, (0.0, 0.4 * thigh[1])))
    inside = _joined(_inner_thigh(crotch, (-knee[0], knee[1])), line((-knee[0], knee[1]), (-hem[0], hem[1])))
    return outside, inside


def _slope(leg: Floats, thigh: Floats) -> Floats:
    """Direction at the knee between shin and thigh, as long as the thigh."""
    low, high = leg[-1] - leg[0], thigh
    return np.linalg.norm(high) * (low / np.linalg.norm(low) + 0.3 * high / np.linalg.norm(high)) / 1.3


def _inner_thigh(crotch: tuple[float, float], knee: tuple[float, float]) -> Floats:
    """From the fork to the knee: hollow, for the fork is wider than the thigh."""
    reach = np.array(knee) - crotch
    return curve(crotch, (0.55 * reach[0], 0.25 * reach[1]), knee, (0.05 * reach[0], 0.4 * reach[1]))


def _joined(first: Floats, second: Floats) -> Floats:
    return np.concatenate([first, second[1:]])


def _place(outline: Outline, m: BodyMeasures, around: Surroundings, side: int, half: int) -> Placement:
    """A panel rolled around its leg, before (half 1) or behind (-1) it, on its own side of the body's middle."""
    rotation = facing((0.0, 0.0, half), (0.0, 1.0, 0.0))
    points = points_of(outline)
    places = m.landmarks
    middle = 0.5 * float(places.crotch[2] + places.knee[2])
    height = float(places.waist[1])
    widest = 0.5 * float(np.ptp(points[:, 0]))

    def placed(distance: float, radius: float) -> Placement:
        at = Placement(rotation, np.array([0.0, height, middle + half * distance]), radius)
        x = side * float((side * at.apply(points)[:, 0]).min())
        return Placement(rotation, at.translation - (x - side * 0.006, 0.0, 0.0), radius)

    return nearest_placement(
        outline.name,
        points,
        [partial(placed, radius=widest * k) for k in (0.7, 0.75, 0.8, 0.9, 1.0, 1.2, 1.5, 2.0, 3.0)],
        around,
        lambda placement: float(
            np.abs(placement.apply(outline.edges["side"])[:, 2] - middle).mean()
            + np.abs(placement.apply(outline.edges["centre"])[:, 0]).mean()
        ),
        lambda p: bool((half * (p[:, 2] - middle) > 0.005).all()),
    )
