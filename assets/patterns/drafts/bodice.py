"""Upper parts with set-in sleeves: what T-shirt and shirt have in common.

Rules of flat pattern cutting (Aldrich, Metric Pattern Cutting for Women's Wear; Mueller & Sohn), with lengths taken
from the body where it shows them. y = 0 is the height of the neck's side.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from assets.measures import BodyMeasures
from assets.patterns.drafts.drawing import Outline, curve, line, same_names, symmetric
from assets.patterns.drafts.placing import (
    CLEARANCE,
    Surroundings,
    facing,
    nearest_placement,
    place_on_trunk,
    points_of,
)
from assets.patterns.pattern import Panel, Placement, Seam, edge_length
from pbd.errors import InputError

__all__ = ["BodiceLines", "bodice_lines", "bodice_panel", "sewn_top", "sleeve_panel"]

Floats = NDArray[np.float64]

_LEAST_CAP = 0.05  # height of a sleeve's cap over its armhole [-]
_LEAST_UNDERARM = 0.03  # length of a sleeve's own seam [m]
_MOST_SQUEEZE = 0.3  # of a sleeve along the arm before it is sewn [-]
_BOW_STEPS = 6  # until a place on the arm finds its line of the sleeve; each one leaves at most that share of the error
_SIDE_DART_DEPTH = 0.045  # of the dart's upper end below the armhole [m]


@dataclass(frozen=True)
class BodiceLines:
    """Half of a front or a back.

    Attributes:
        chest: half width at the armhole's lower end [m].
        hem: half width at the hem [m].
        neck: half width of the neckline [m].
        neck_depth: of the neckline's middle below the neck's side [m].
        shoulder: half width between the shoulder points [m].
        shoulder_drop: of the shoulder point below the neck's side [m].
        narrowest: half width between the arms, halfway up the armhole [m].
        armhole_depth: of the armhole's lower end below the neck's side [m].
        length: of the hem below the neck's side, with the dart closed [m].
        dart: how much the dart in the side takes in [m]; 0 for none.
        dart_point: half width at which the dart ends [m].
    """

    chest: float
    hem: float
    neck: float
    neck_depth: float
    shoulder: float
    shoulder_drop: float
    narrowest: float
    armhole_depth: float
    length: float
    dart: float = 0.0
    dart_point: float = 0.0


def bodice_lines(
    m: BodyMeasures,
    ease: float,
    length: float,
    hem: float,
    neck_depth: float,
    looseness: tuple[float, float],
    dart: float = 0.0,
) -> tuple[BodiceLines, BodiceLines]:
    """Front and back.

    Args:
        m: measures of the body.
        ease: added to the girth of the bust [m].
        length: from the neck's side to the hem [m].
        hem: half width of each at the hem [m], at least that of the chest is taken.
        neck_depth: of the neckline in front [m].
        looseness: how much further than the body's the neck's side and the shoulder point are from the middle [m].
        dart: what the dart in the front's side takes in [m].
    """
    places = m.landmarks
    chest = (m.bust + ease) / 4.0
    shoulder = 0.5 * m.shoulder_width + looseness[1] + 0.05 * ease
    body_depth = float(places.neck_side[1] - places.armpit[1])
    common = dict(
        chest=chest,
        hem=max(chest, hem),
        neck=float(places.neck_side[0]) + looseness[0],
        shoulder=shoulder,
        shoulder_drop=0.9 * float(places.neck_side[1] - places.shoulder[1]),
        # Mueller & Sohn: a tenth of the bust and 10.5 cm, and the more ease, the deeper; at least clear of the armpit.
        armhole_depth=max(0.1 * m.bust + 0.105, body_depth + 0.02) + 0.2 * ease,
        length=length,
    )
    front = BodiceLines(
        neck_depth=neck_depth,
        narrowest=min(0.5 * m.chest_width, shoulder - 0.01, chest - 0.02),
        dart=dart,
        dart_point=min(0.5 * m.bust_point_distance + 0.025, chest - 0.05),
        **common,
    )
    back = BodiceLines(
        neck_depth=0.02, narrowest=min(0.5 * m.back_width + 0.005, shoulder - 0.005, chest - 0.02), **common
    )
    return front, back


def sewn_top(m: BodyMeasures, front: Outline, back: Outline, left: Outline) -> tuple[list[Panel], list[Seam], Outline]:
    """Front, back and both sleeves where they stand, their seams, and the right sleeve.

    Args:
        m: measures of the body.
        front, back: of the bodice.
        left: the left sleeve; the right one is its mirror image.

    Raises:
        InputError: there is no room for a panel around the body.
    """
    right, around, places = left.mirrored("right_sleeve"), Surroundings(m), m.landmarks
    neck, middle = float(places.neck_side[1]) + 0.02, 0.5 * float(places.bust[2] + places.hip[2])
    panels = [
        outline.panel(place_on_trunk(outline, neck, middle, side, around)) for outline, side in ((front, 1), (back, -1))
    ]
    panels += [outline.panel(place_sleeve(outline, m, around, side)) for outline, side in ((left, 1), (right, -1))]
    seams = bodice_seams(front, back)
    seams += sleeve_seams(front, back, left, "left") + sleeve_seams(front, back, right, "right")
    return panels, seams, right


def bodice_panel(name: str, lines: BodiceLines, plus: str, minus: str) -> Outline:
    """Front or back with edges hem, low_side, high_side, armhole, shoulder (all but hem with plus and minus) and neck.

    With a dart, its edges low_dart and high_dart lie between those of the side.

    Args:
        name: "front" or "back".
        lines: of the half.
        plus: ending of edge names at x > 0: "left" for a front, "right" for a back.
        minus: the other one.
    """
    b = lines
    under, tip, neck = (b.chest, -b.armhole_depth), (b.shoulder, -b.shoulder_drop), (b.neck, 0.0)
    rise = b.armhole_depth - b.shoulder_drop
    # From the side the armhole runs level, turns upwards at the narrowest width and meets the shoulder squarely.
    turn = (b.narrowest, -b.armhole_depth + 0.42 * rise)
    slope = np.arctan2(b.shoulder_drop, b.shoulder - b.neck)
    arriving = 0.22 * rise * np.array([np.sin(slope), np.cos(slope)])
    low = curve(under, (-0.75 * (b.chest - b.narrowest), 0.0), turn, (0.0, 0.24 * rise))
    high = curve(turn, (0.0, 0.2 * rise), tip, arriving)
    half = {
        "hem": line((0.0, -b.length - b.dart), (b.hem, -b.length - b.dart)),
        **_side(b),
        "armhole": np.concatenate([low, high[1:]]),
        "shoulder": line(tip, neck),
        "neck": _neckline(b.neck, b.neck_depth),
    }
    return symmetric(name, half, plus, minus)


def _side(b: BodiceLines) -> dict[str, Floats]:
    """The side from the hem to the armhole, with its dart."""
    hem, under = np.array([b.hem, -b.length - b.dart]), np.array([b.chest, -b.armhole_depth])
    up = (under - hem) / np.linalg.norm(under - hem)
    high = under - _SIDE_DART_DEPTH * up
    low = high - b.dart * up
    if b.dart == 0.0:
        return {"low_side": line(hem, low), "high_side": line(high, under)}
    # The dart's point is as far from both of its ends, so that its legs are of one length.
    middle = 0.5 * (low + high)
    point = (b.dart_point, middle[1] - (b.dart_point - middle[0]) * up[0] / up[1])
    return {
        "low_side": line(hem, low),
        "low_dart": line(low, point),
        "high_dart": line(point, high),
        "high_side": line(high, under),
    }


def bodice_seams(front: Outline, back: Outline) -> list[Seam]:
    """Sides, shoulders and darts."""
    seams = []
    for side in ("left", "right"):
        seams += same_names(front, back, *(f"{edge}_{side}" for edge in ("low_side", "high_side", "shoulder")))
        if f"low_dart_{side}" in front.edges:
            seams.append(Seam(front.edge(f"low_dart_{side}"), front.edge(f"high_dart_{side}")))
    return seams


def _neckline(width: float, depth: float) -> Floats:
    """Half a neckline from the neck's side to the middle, level in the middle: nearly a quarter of an ellipse."""
    return curve((width, 0.0), (-0.1 * width, -0.6 * depth), (0.0, -depth), (-0.6 * width, 0.0))


def sleeve_panel(
    name: str, armhole_back: float, armhole_front: float, cap_share: float, girth: float, length: float, hem: float
) -> Outline:
    """The left sleeve: edges hem, underarm_back, cap_back, cap_front, underarm_front; its back is at x > 0.

    y = 0 is the cap's lower end.
    The cap's height is given; its two halves become as wide as they must be for their curves to have the lengths of the
    armhole. If the sleeve is then narrower than it must be, or shorter than its cap, the cap is made flatter.

    Args:
        name: of the panel.
        armhole_back: length of the cap's back half [m].
        armhole_front: length of the cap's front half [m].
        cap_share: height of the cap over the whole armhole [-].
        girth: least girth of the sleeve at the upper arm [m].
        length: from the cap's top to the hem [m].
        hem: girth at the hem [m]; at most that at the upper arm is used.

    Raises:
        InputError: even a flat cap is too narrow for the arm.
    """
    whole = armhole_back + armhole_front
    height = min(cap_share * whole, length - _LEAST_UNDERARM)
    while height > _LEAST_CAP * whole:
        back, front = (_cap_width(half, height, side) for half, side in ((armhole_back, 1), (armhole_front, -1)))
        if back + front >= girth:
            break
        height *= 0.97
    else:
        raise InputError(
            "the armhole is too small for the arm, or the sleeve too short",
            key=name,
            received=f"{whole:.3f} m around, {length:.3f} m long",
            expected=f"more than {girth:.3f} m around, more than {_LEAST_CAP * whole + _LEAST_UNDERARM:.3f} m long",
        )
    drop = length - height
    half_hem = 0.5 * min(hem, back + front)
    middle = 0.5 * (back - front)
    cap_back, cap_front = _cap(back, height, 1), _cap(front, height, -1)
    return Outline(
        name,
        {
            "hem": line((middle - half_hem, -drop), (middle + half_hem, -drop)),
            "underarm_back": line((middle + half_hem, -drop), (back, 0.0)),
            "cap_back": cap_back,
            "cap_front": cap_front[::-1],
            "underarm_front": line((-front, 0.0), (middle - half_hem, -drop)),
        },
    )


def _cap(width: float, height: float, side: int) -> Floats:
    """Half a sleeve cap from the underarm at (side width, 0) to its top at (0, height): an S, fuller at the back."""
    hollow = 0.30 if side > 0 else 0.38
    points = curve((width, 0.0), (-hollow * width, 0.0), (0.0, height), (-0.42 * width, 0.0))
    return points * (side, 1.0)


def _cap_width(length: float, height: float, side: int) -> float:
    """Width of half a cap whose curve has a certain length [m]."""
    return brentq(lambda width: edge_length(_cap(width, height, side)) - length, 1e-3, length)


def sleeve_seams(front: Outline, back: Outline, sleeve: Outline, side: str) -> list[Seam]:
    """Seams of a sleeve: its own, and those to both armholes."""
    return [
        Seam(sleeve.edge("underarm_back"), sleeve.edge("underarm_front")),
        Seam(sleeve.edge("cap_front"), front.edge(f"armhole_{side}")),
        Seam(sleeve.edge("cap_back"), back.edge(f"armhole_{side}")),
    ]


def place_sleeve(outline: Outline, measures: BodyMeasures, around: Surroundings, side: int) -> Placement:
    """A sleeve around the left (side 1) or right (side -1) arm, its cap outside the shoulder point."""
    places = measures.landmarks
    flip = np.array([side, 1.0, 1.0])
    start, shoulder = places.arm_start * flip, places.shoulder * flip
    points = points_of(outline)
    # A short sleeve follows the upper arm, a long one the line to the wrist.
    reaches_elbow = float(np.ptp(points[:, 1])) > 0.6 * measures.arm_length
    along = (places.wrist if reaches_elbow else places.elbow) * flip - start
    along /= np.linalg.norm(along)
    rotation = facing(_across((0.5 * side, 1.0, 0.0), along), -along)
    # The arm from beyond the wrist upwards: how far it is along that line, and beside it.
    arm = np.array([2.0 * places.wrist - places.elbow, places.wrist, places.elbow, places.arm_start]) * flip
    stations = (arm - start) @ along
    beside = arm - start - stations[:, None] * along
    width, top = float(np.ptp(points[:, 0])), float(points[:, 1].max())
    crest = np.array([[0.0, top]])
    crown = float((shoulder - start) @ along)
    reach = float(stations[1])

    def placed(distance: float, radius: float, apart: float, below: float) -> Placement:
        # The sleeve's outer line lies along the arm, which becomes thinner, so that the hem goes around the wrist.
        first = radius - measures.upper_arm / (2.0 * np.pi) - apart
        last = radius - measures.wrist / (2.0 * np.pi) - below
        axis = _unit(along - rotation[:, 2] * (last - first) / reach)
        turned = facing(_across(rotation[:, 2], axis), -axis)
        origin = start - first * rotation[:, 2] + (crown + top + distance) * axis
        # Away from the shoulder it is pushed together along the arm: a hem over the hand would catch the fingers.
        squeeze = min(distance / reach, _MOST_SQUEEZE)
        before = stations / (1.0 - squeeze)
        bow = np.column_stack([crown + top + distance - before, beside - squeeze * before[:, None] * axis])
        return Placement(turned, origin + radius * turned[:, 2], radius, bow)

    middles = np.concatenate([np.linspace(arm[k], arm[k + 1], 8) for k in (1, 2)])

    def cost(placement: Placement) -> float:
        far = float(np.linalg.norm(placement.apply(crest) - shoulder))
        return far + _open(placement, outline) + 10.0 * max(0.03 - _held(placement, outline, middles), 0.0)

    return nearest_placement(
        outline.name,
        points,
        [
            partial(placed, radius=width / (2.0 * np.pi) * k, apart=apart, below=below)
            for k in (1.03, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5)
            for apart in (0.015, 0.03, 0.05)
            for below in (0.015, 0.03, 0.05)
        ],
        around,
        cost,
        clearance=0.7 * CLEARANCE,  # a narrow sleeve leaves little room
    )


def _open(placement: Placement, outline: Outline) -> float:
    """How wide the sleeve's own seam is open on average [m]."""
    back, front = (placement.apply(outline.edges[f"underarm_{half}"]) for half in ("back", "front"))
    return float(np.linalg.norm(back - front[::-1], axis=1).mean())


def _held(placement: Placement, outline: Outline, places: Floats) -> float:
    """How far places of the arm are inside of the sleeve, if its seam closed by the shortest way [m], at least."""
    radius = placement.bend_radius or np.inf
    local = (places - placement.translation) @ placement.rotation
    flat = local
    for _ in range(_BOW_STEPS):
        flat = local - placement.moves(flat[:, 1]) @ placement.rotation
    local = flat
    ends = []
    for name in ("underarm_back", "underarm_front"):
        edge = outline.edges[name]
        edge = edge[np.argsort(edge[:, 1])]  # upwards, in a mirrored panel too
        x = np.interp(local[:, 1], edge[:, 1], edge[:, 0])
        ends.append(np.stack([radius * np.sin(x / radius), radius * np.cos(x / radius) - radius], axis=1))
    along = ends[1] - ends[0]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    across *= np.sign(-(ends[0] * across).sum(axis=1))[:, None]  # towards the sleeve's outer line
    return float(((local[:, [0, 2]] - ends[0]) * across).sum(axis=1).min())


def _unit(vector: Floats) -> Floats:
    return vector / np.linalg.norm(vector)


def _across(vector: Floats | tuple[float, float, float], along: Floats) -> Floats:
    """The part of a vector that stands across a direction."""
    return np.asarray(vector) - (np.asarray(vector) @ along) * along
