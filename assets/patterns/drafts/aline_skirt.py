"""An A-line skirt: front and back with darts at the waist."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

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
    same_names,
)
from assets.patterns.drafts.placing import Surroundings, place_on_trunk
from assets.patterns.drafts.waist import dart_seams, share_surplus, waist_line
from assets.patterns.pattern import Pattern
from pbd.errors import InputError

__all__ = ["AlineSkirt", "aline_skirt"]

_HEM, _WAISTBAND = 0.02, 0.03  # [m]
_WAISTBAND_LAYERS = 3.0
_SIDE_RISE = 0.012  # [m] of the waist line at the side
_SHAPING = {"front": (0.6, 0.045, 0.022), "back": (0.4, 0.035, 0.035)}  # by the side and by darts; the belly needs less
_DART_DEPTHS = {"front": 0.4, "back": 0.65}  # over the height between waist and hip [-]


@dataclass(frozen=True)
class AlineSkirt:
    """Parameters of an A-line skirt [m]; None is derived from the body."""

    ease: float = number(0.05, "m", "added to the girth of the hip")
    length: float | None = number(None, "m", "from waist to hem; default: to the knee")
    flare: float = number(0.36, "m", "girth of the hem minus that of the skirt's hip")


def aline_skirt(measures: BodyMeasures, parameters: AlineSkirt) -> Pattern:
    """Draft an A-line skirt.

    Raises:
        InputError: the body lacks a measure, or a parameter cannot be.
    """
    m, p, name = measures, parameters, "aline_skirt"
    require(m, name, "waist", "hip", "waist_to_hip", "knee")
    check_at_least(name, "ease", p.ease, 0.0, "so that the skirt is not smaller than the hip")
    check_at_least(name, "flare", p.flare, 0.0, "so that the skirt does not become narrower")
    length = p.length if p.length is not None else float(m.landmarks.waist[1] - m.landmarks.knee[1])
    check_at_least(name, "length", length, m.waist_to_hip + 0.05, "5 cm below the hip")
    check_above_floor(name, length, m)
    share = np.clip(m.front_share, 0.46, 0.54)
    front = _panel("front", m, p, length, share[1], share[2])
    back = _panel("back", m, p, length, 1.0 - share[1], 1.0 - share[2])
    around = Surroundings(m)
    middle = 0.5 * float(m.landmarks.waist[2] + m.landmarks.hip[2])
    height = float(m.landmarks.waist[1])
    panels = tuple(
        outline.panel(place_on_trunk(outline, height, middle, side, around))
        for outline, side in ((front, 1), (back, -1))
    )
    seams = same_names(front, back, "side_left", "side_right") + dart_seams(front) + dart_seams(back)
    strips = []
    for outline in (front, back):
        waist = [edge for edge in outline.edges if edge.startswith("waist_")]
        strips += bands(outline, waist, _WAISTBAND, _WAISTBAND_LAYERS) + bands(outline, ["hem"], _HEM, 2.0)
    return Pattern(name, panels, tuple(seams), tuple(strips), f"draft:{name}")


def _panel(name: str, m: BodyMeasures, p: AlineSkirt, length: float, waist_share: float, hip_share: float) -> Outline:
    """Front or back: edges hem, side and waist line with darts; x > 0 is left in front, right behind."""
    waist = 0.5 * waist_share * m.waist
    hip = 0.5 * hip_share * (m.hip + p.ease)
    flare = 0.5 * hip_share * p.flare
    taken, darts = share_surplus(hip - waist, *_SHAPING[name])
    top = (hip - taken, _SIDE_RISE)
    below = length - m.waist_to_hip
    if flare >= below:
        raise InputError(
            "the flare is too wide for so short a skirt",
            key="draft aline_skirt, flare",
            received=p.flare,
            expected=f"less than {2.0 * below / hip_share:.3f} m",
        )
    # Below the hip the panel spreads like a fan, so that all its threads are as long as the middle: the hem is level.
    spread = math.asin(flare / below) * np.linspace(0.0, 1.0, 33)
    hem = np.stack(
        [np.linspace(0.0, hip, 33) + below * np.sin(spread), -m.waist_to_hip - below * np.cos(spread)], axis=1
    )
    hip_point, corner = np.array([hip, -m.waist_to_hip]), hem[-1]
    out = (corner - hip_point) / below
    upper = curve(hip_point, -0.35 * m.waist_to_hip * out, top, 0.3 * m.waist_to_hip * np.array([-0.25, 1.0]))
    line_half = waist_line(top, (0.0, 0.0), darts, _DART_DEPTHS[name] * m.waist_to_hip)
    plus, minus = ("left", "right") if name == "front" else ("right", "left")
    edges = {
        "hem": np.concatenate([(hem * (-1.0, 1.0))[::-1], hem[1:]]),
        f"side_{plus}": np.concatenate([line(corner, hip_point), upper[1:]]),
    }
    flipped = {key: (edge * (-1.0, 1.0))[::-1] for key, edge in line_half.items()}
    last = f"waist_{len(darts)}"
    edges |= {f"{key}_{plus}": edge for key, edge in line_half.items() if key != last}
    edges["waist_middle"] = np.concatenate([line_half[last], flipped[last][1:]])
    for key in reversed(list(flipped)):
        if key != last:
            other = key.replace("_in", "_OUT").replace("_out", "_in").replace("_OUT", "_out")
            edges[f"{other}_{minus}"] = flipped[key]
    edges[f"side_{minus}"] = (edges[f"side_{plus}"] * (-1.0, 1.0))[::-1]
    return Outline(name, edges)
