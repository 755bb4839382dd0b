"""Girths, lengths and places of a body: what they are, and the record that holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from assets.body_segments import NamedSurface
from assets.facing import StandingFrame

__all__ = ["MEASURES", "BodyMeasures", "Landmarks"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Places on a body, in its own frame [m], shape (3,) each; of pairs the left one (+X), mirrored for the right.

    Places of a part that could not be measured are not numbers.

    Attributes:
        floor: height of the soles [m].
        crotch, waist, hip, underbust, bust: middle of the trunk at that height; the crotch is a point of the surface.
        bust_point: the foremost point of the left breast.
        armpit: the highest point between arm and trunk.
        shoulder: the outer end of the shoulder line, on the surface.
        neck_side, neck_back, neck_front: on the neck's base.
        arm_start, elbow, wrist: middle of the arm, from the armpit's height outwards.
        knee, ankle: middle of the leg.
    """

    floor: float
    crotch: Floats
    waist: Floats
    hip: Floats
    underbust: Floats
    bust: Floats
    bust_point: Floats
    armpit: Floats
    shoulder: Floats
    neck_side: Floats
    neck_back: Floats
    neck_front: Floats
    arm_start: Floats
    elbow: Floats
    wrist: Floats
    knee: Floats
    ankle: Floats


@dataclass(frozen=True, eq=False)
class BodyMeasures:
    """Measures of a body [m].

    Attributes:
        height: from the soles to the crown.
        bust: girth of the trunk at the height of the breasts' points.
        underbust: girth below the breasts, where it no longer changes quickly.
        waist: least girth between hips and breasts; not a number where a body has none.
        hip: greatest girth near the crotch and above it.
        neck: girth of the neck's base.
        shoulder_width: from shoulder point to shoulder point.
        shoulder_length: from the side of the neck to the shoulder point.
        shoulder_slope: of that line against the horizontal [rad].
        armscye_depth: height of the neck's back over the armpits.
        back_width: of the back between the arms, halfway between shoulder and armpit.
        chest_width: the same in front.
        back_length: from the neck's back to the waist, along the spine.
        back_waist_length: from the side of the neck down the back to the waist.
        front_waist_length: from the side of the neck over the breast to the waist.
        bust_point_distance: between the breasts' points.
        bust_depth: from the side of the neck to the breast's point.
        arm_length: from the shoulder point over the elbow to the wrist.
        upper_arm, wrist: girths of the arm.
        waist_to_hip: difference of height.
        rise: height of the waist over the crotch.
        inseam: height of the crotch over the soles.
        waist_to_floor: height of the waist over the soles.
        thigh, knee, ankle: girths of the leg.
        front_share: shares of bust, waist and hip girth that lie in front of the sides [-], shape (3,).
        landmarks: places on the body, in its frame.
        surface: the body that was measured, in the world.
        frame: of the body in the world.
        arm_vertices: whether a vertex belongs to an arm, shape (n,).
        doubts: why a measure is not a number, by its name.
    """

    height: float
    bust: float
    underbust: float
    waist: float
    hip: float
    neck: float
    shoulder_width: float
    shoulder_length: float
    shoulder_slope: float
    armscye_depth: float
    back_width: float
    chest_width: float
    back_length: float
    back_waist_length: float
    front_waist_length: float
    bust_point_distance: float
    bust_depth: float
    arm_length: float
    upper_arm: float
    wrist: float
    waist_to_hip: float
    rise: float
    inseam: float
    waist_to_floor: float
    thigh: float
    knee: float
    ankle: float
    front_share: Floats
    landmarks: Landmarks
    surface: NamedSurface
    frame: StandingFrame
    arm_vertices: NDArray[np.bool_]
    doubts: Mapping[str, str] = field(default_factory=dict)

    def values(self) -> dict[str, float]:
        """All girths and lengths by name [m], and the slope of the shoulder [rad]."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.type == "float"}


MEASURES = tuple(field.name for field in fields(BodyMeasures) if field.type == "float")
"""Names of all measures."""
