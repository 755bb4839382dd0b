"""A T-shirt: front, back and two short sleeves, without darts."""

from __future__ import annotations

from dataclasses import dataclass

from assets.measures import BodyMeasures
from assets.patterns.drafts.bodice import bodice_lines, bodice_panel, sewn_top, sleeve_panel
from assets.patterns.drafts.drawing import bands, check_at_least, number, require
from assets.patterns.pattern import Pattern

__all__ = ["Tshirt", "tshirt"]

_CAP_SHARE = 0.27  # height of the cap over the armhole [-]; a shirt for work has less, a jacket a third
_HEM, _RIB = 0.02, 0.02  # [m]
_RIB_LENGTH = 0.92  # of the neck's rib over the neckline [-]


@dataclass(frozen=True)
class Tshirt:
    """Parameters of a T-shirt [m]; None is derived from the body."""

    ease: float = number(0.10, "m", "added to the girth of the bust")
    length: float | None = number(
        None, "m", "from the neck's side to the hem; default: to 5 cm above the crotch's height"
    )
    sleeve_length: float | None = number(None, "m", "from the shoulder to the hem; default: 0.4 of the arm")
    sleeve_ease: float | None = number(None, "m", "added to the girth of the upper arm; default: 3 cm and half of ease")
    neck_depth: float = number(0.085, "m", "of the neckline below the neck's side in front")


def tshirt(measures: BodyMeasures, parameters: Tshirt) -> Pattern:
    """Draft a T-shirt.

    Raises:
        InputError: the body lacks a measure, or a parameter makes the shirt smaller than the body.
    """
    m, p, name = measures, parameters, "tshirt"
    require(m, name, "bust", "hip", "upper_arm", "shoulder_width", "arm_length", "armscye_depth", "shoulder_length")
    require(m, name, "chest_width", "back_width", "bust_point_distance", "wrist")
    neck_side, crotch = m.landmarks.neck_side, m.landmarks.crotch
    length = p.length if p.length is not None else float(neck_side[1] - crotch[1]) - 0.05
    sleeve_length = p.sleeve_length if p.sleeve_length is not None else 0.4 * m.arm_length
    sleeve_ease = p.sleeve_ease if p.sleeve_ease is not None else 0.03 + 0.5 * max(p.ease, 0.0)
    check_at_least(name, "ease", p.ease, 0.0, "so that the shirt is not smaller than the bust")
    check_at_least(name, "sleeve_ease", sleeve_ease, 0.01, "so that the sleeve is not smaller than the arm")
    check_at_least(name, "neck_depth", p.neck_depth, 0.04, "below the neck")
    hem = (m.hip + 0.6 * p.ease) / 4.0 if length > float(neck_side[1] - m.landmarks.waist[1]) else 0.0
    front, back = bodice_lines(m, p.ease, length, hem, p.neck_depth, (0.015, 0.01))
    check_at_least(name, "length", length, front.armhole_depth + 0.05, "5 cm below the armhole")
    front_panel = bodice_panel("front", front, "left", "right")
    back_panel = bodice_panel("back", back, "right", "left")
    girth = m.upper_arm + sleeve_ease
    left = sleeve_panel(
        "left_sleeve",
        back_panel.length("armhole_left"),
        front_panel.length("armhole_left"),
        _CAP_SHARE,
        girth,
        sleeve_length,
        0.92 * girth,
    )
    panels, seams, right = sewn_top(m, front_panel, back_panel, left)
    strips = [band for outline in (front_panel, back_panel, left, right) for band in bands(outline, ["hem"], _HEM, 2.0)]
    strips += [
        band for outline in (front_panel, back_panel) for band in bands(outline, ["neck"], _RIB, 2.0, _RIB_LENGTH)
    ]
    return Pattern(name, tuple(panels), tuple(seams), tuple(strips), f"draft:{name}")
