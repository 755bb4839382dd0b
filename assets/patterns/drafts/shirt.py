"""A jumper with long sleeves, darts at the bust and cuffs: neither collar nor placket, pulled over the head."""

from __future__ import annotations

from dataclasses import dataclass

from assets.measures import BodyMeasures
from assets.patterns.drafts.bodice import bodice_lines, bodice_panel, sewn_top, sleeve_panel
from assets.patterns.drafts.drawing import bands, check_at_least, number, require
from assets.patterns.pattern import Pattern
from pbd.errors import InputError

__all__ = ["Shirt", "shirt"]

_CAP_SHARE = 0.24  # height of the cap over the armhole [-]
_HEM, _NECK_BAND, _CUFF = 0.02, 0.025, 0.05  # [m]
_LEAST_DART = 0.01  # [m] a smaller one is left out


@dataclass(frozen=True)
class Shirt:
    """Parameters of a jumper [m]; None is derived from the body."""

    ease: float = number(0.12, "m", "added to the girth of the bust")
    length: float | None = number(None, "m", "from the neck's side to the hem; default: to the crotch's height")
    sleeve_length: float | None = number(None, "m", "from the shoulder to the cuff's end; default: to the wrist")
    sleeve_ease: float | None = number(None, "m", "added to the girth of the upper arm; default: 3 cm and half of ease")
    cuff_ease: float = number(0.05, "m", "added to the girth of the wrist")
    dart: float | None = number(
        None, "m", "taken in by each dart at the bust; default: the front's surplus over the back"
    )
    neck_depth: float = number(0.075, "m", "of the neckline below the neck's side in front")


def shirt(measures: BodyMeasures, parameters: Shirt) -> Pattern:
    """Draft a jumper.

    Raises:
        InputError: the body lacks a measure, or a parameter makes the shirt smaller than the body.
    """
    m, p, name = measures, parameters, "shirt"
    require(m, name, "bust", "waist", "hip", "upper_arm", "wrist", "shoulder_width", "arm_length", "armscye_depth")
    require(m, name, "front_waist_length", "back_waist_length", "chest_width", "back_width", "bust_point_distance")
    places = m.landmarks
    length = p.length if p.length is not None else float(places.neck_side[1] - places.crotch[1])
    sleeve_length = p.sleeve_length if p.sleeve_length is not None else m.arm_length
    sleeve_ease = p.sleeve_ease if p.sleeve_ease is not None else 0.03 + 0.5 * max(p.ease, 0.0)
    check_at_least(name, "ease", p.ease, 0.02, "so that woven cloth goes around the bust")
    check_at_least(name, "sleeve_ease", sleeve_ease, 0.02, "so that the sleeve is not smaller than the arm")
    check_at_least(name, "cuff_ease", p.cuff_ease, 0.0, "so that the cuff is not smaller than the wrist")
    check_at_least(name, "neck_depth", p.neck_depth, 0.04, "below the neck")
    if sleeve_length > 1.15 * m.arm_length:
        longest = f"at most {1.15 * m.arm_length:.3f} m"
        raise InputError(
            "the sleeve is longer than the arm", key=f"draft {name}", received=sleeve_length, expected=longest
        )
    dart = p.dart if p.dart is not None else min(0.8 * (m.front_waist_length - m.back_waist_length), 0.06)
    dart = 0.0 if dart < _LEAST_DART else dart
    hem = (m.hip + 0.6 * p.ease) / 4.0
    front, back = bodice_lines(m, p.ease, length, hem, p.neck_depth, (0.01, 0.015), dart)
    check_at_least(name, "length", length, front.armhole_depth + 0.1, "10 cm below the armhole")
    front_panel = bodice_panel("front", front, "left", "right")
    back_panel = bodice_panel("back", back, "right", "left")
    cuff = m.wrist + p.cuff_ease
    opening = cuff + 0.1  # gathered into the cuff
    armholes = (back_panel.length("armhole_left"), front_panel.length("armhole_left"))
    left = sleeve_panel("left_sleeve", *armholes, _CAP_SHARE, m.upper_arm + sleeve_ease, sleeve_length, opening)
    panels, seams, right = sewn_top(m, front_panel, back_panel, left)
    strips = []
    for outline in (front_panel, back_panel):
        strips += bands(outline, ["hem"], _HEM, 2.0) + bands(outline, ["neck"], _NECK_BAND, 3.0)
    for outline in (left, right):
        strips += bands(outline, ["hem"], _CUFF, 3.0, cuff / opening)
    return Pattern(name, tuple(panels), tuple(seams), tuple(strips), f"draft:{name}")
