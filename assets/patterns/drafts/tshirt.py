"""A T-shirt: front, back and two short sleeves, without darts."""

from __future__ import annotations

from dataclasses import dataclass

from assets.measures import BodyMeasures
from assets.patterns.drafts.bodice import (
    BodiceLines,
    bodice_panel,
    bodice_seams,
    place_sleeve,
    sleeve_panel,
    sleeve_seams,
)
from assets.patterns.drafts.drawing import bands, check_at_least, number, require
from assets.patterns.drafts.placing import Surroundings, place_on_trunk
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
    neck_side, crotch = m.landmarks.neck_side, m.landmarks.crotch
    length = p.length if p.length is not None else float(neck_side[1] - crotch[1]) - 0.05
    sleeve_length = p.sleeve_length if p.sleeve_length is not None else 0.4 * m.arm_length
    sleeve_ease = p.sleeve_ease if p.sleeve_ease is not None else 0.03 + 0.5 * max(p.ease, 0.0)
    check_at_least(name, "ease", p.ease, 0.0, "so that the shirt is not smaller than the bust")
    check_at_least(name, "sleeve_ease", sleeve_ease, 0.01, "so that the sleeve is not smaller than the arm")
    check_at_least(name, "neck_depth", p.neck_depth, 0.04, "below the neck")
    front, back = _lines(m, p, length)
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
    right = left.mirrored("right_sleeve")
    around = Surroundings(m)
    neck, middle = float(neck_side[1]) + 0.02, 0.5 * float(m.landmarks.bust[2] + m.landmarks.hip[2])
    panels = (
        front_panel.panel(place_on_trunk(front_panel, neck, middle, 1, around)),
        back_panel.panel(place_on_trunk(back_panel, neck, middle, -1, around)),
        left.panel(place_sleeve(left, m, around, 1)),
        right.panel(place_sleeve(right, m, around, -1)),
    )
    seams = bodice_seams(front_panel, back_panel)
    seams += sleeve_seams(front_panel, back_panel, left, "left")
    seams += sleeve_seams(front_panel, back_panel, right, "right")
    strips = [band for outline in (front_panel, back_panel, left, right) for band in bands(outline, ["hem"], _HEM, 2.0)]
    strips += [
        band for outline in (front_panel, back_panel) for band in bands(outline, ["neck"], _RIB, 2.0, _RIB_LENGTH)
    ]
    return Pattern(name, panels, tuple(seams), tuple(strips), f"draft:{name}")


def _lines(m: BodyMeasures, p: Tshirt, length: float) -> tuple[BodiceLines, BodiceLines]:
    """Front and back."""
    places = m.landmarks
    chest = (m.bust + p.ease) / 4.0
    neck = float(places.neck_side[0]) + 0.015
    shoulder = 0.5 * m.shoulder_width + 0.01 + 0.05 * p.ease
    drop = 0.9 * float(places.neck_side[1] - places.shoulder[1])
    body_depth = float(places.neck_side[1] - places.armpit[1])
    # Mueller & Sohn: a tenth of the bust and 10.5 cm, and the more ease, the deeper; at least clear of the armpit.
    depth = max(0.1 * m.bust + 0.105, body_depth + 0.02) + 0.2 * p.ease
    hem = max(chest, (m.hip + 0.6 * p.ease) / 4.0) if length > neck_to_waist(m) else chest
    common = dict(hem=hem, neck=neck, shoulder=shoulder, shoulder_drop=drop, armhole_depth=depth, length=length)
    front = BodiceLines(
        chest=chest,
        neck_depth=p.neck_depth,
        narrowest=min(0.5 * m.chest_width, shoulder - 0.01, chest - 0.02),
        **common,
    )
    back = BodiceLines(
        chest=chest,
        neck_depth=0.02,
        narrowest=min(0.5 * m.back_width + 0.005, shoulder - 0.005, chest - 0.02),
        **common,
    )
    return front, back


def neck_to_waist(m: BodyMeasures) -> float:
    """Height of the neck's side over the waist [m]."""
    return float(m.landmarks.neck_side[1] - m.landmarks.waist[1])
