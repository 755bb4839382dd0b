"""Girths and lengths of a body, as a tape measures them, found by the body's geometry alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from assets.body_segments import UP, BodySegments, Missing, NamedSurface, unit
from assets.cross_sections import cross_section, hull_length, hull_loop, tape_length
from assets.measures import MEASURES, BodyMeasures, Landmarks
from assets.plausible import check_given, doubtful
from pbd.errors import InputError

__all__ = ["measure"]

Floats = NDArray[np.float64]

_STEP = 0.005  # [m] between two heights at which the trunk is cut
_KNEE_HEIGHT = 0.285  # of the stature [-]; Drillis and Contini (1966)
_NECK_SLOPE = 0.8  # of the outline seen from the front, where shoulder becomes neck [-]
_NECK_TILT = np.radians(20.0)  # of the plane of the neck's base, down to the front
_WAIST_LESS = 0.97  # girth of a waist over those below and above it, at most [-]
_WAIST_HEIGHT = (
    0.64  # of the stature, where a waist of given girth is, if none shows [-]; five bodies have 0.63 to 0.66
)
_WAIST_BELOW_ARMPIT = 0.05  # of the stature, at least, where a waist is given by hand [-]


def measure(body: NamedSurface, by_hand: Mapping[str, float] | None = None) -> BodyMeasures:
    """Measure a body that stands upright with its arms away from its trunk.

    A measure that the body does not show, or that no body of its height has, is not a number, and ``doubts`` says why;
    a draft that needs it says so. All girths are those of convex hulls, for a tape bridges hollows. Names and places
    follow ISO 8559-1 where the shape of the surface shows the place; bones that a tailor feels with the finger are
    found by proportions and said so.

    Args:
        body: anywhere, turned about the vertical in any way.
        by_hand: measures that were taken by hand, which count instead of those of the surface [m]. A waist of such a
            girth lies where the body shows one, else at a usual height; with ``waist_to_floor`` it lies there.

    Raises:
        InputError: the surface is no figure with two arms and two legs that are apart, or a given measure is unknown or
            of no body.
    """
    by_hand = dict(by_hand or {})
    unknown = sorted(set(by_hand) - set(MEASURES))
    if unknown:
        raise InputError("no such measure", received=unknown[0], expected="one of " + ", ".join(MEASURES))
    figure = BodySegments(body)
    for name, value in by_hand.items():
        check_given(name, value, figure.height)
    doubts: dict[str, str] = {}
    values, places = _trunk(figure, by_hand)
    for part, names in ((_neck_and_shoulder, _NECK), (_arm, _ARM), (_leg, _LEG)):
        found = _taken(figure, part, by_hand, doubts, names)
        values |= found.values
        places |= found.places
    landmarks = Landmarks(floor=figure.floor, crotch=figure.crotch, armpit=figure.armpit, **places)
    values |= _taken(figure, partial(_trunk_lengths, places=landmarks), by_hand, doubts, _TRUNK_LENGTHS).values
    waist, hip, crotch = landmarks.waist[1], landmarks.hip[1], figure.crotch[1]
    values |= {"height": figure.height, "inseam": crotch - figure.floor}
    values |= {"waist_to_floor": waist - figure.floor, "rise": waist - crotch, "waist_to_hip": waist - hip}
    values = {name: float(value) for name, value in values.items()} | by_hand
    doubts |= {name: _NO_WAIST for name, value in values.items() if np.isnan(value) and name not in doubts}
    impossible = doubtful({name: value for name, value in values.items() if not np.isnan(value)}, set(by_hand))
    for name, reason in impossible.items():
        place = getattr(landmarks, name, None)
        doubts[name] = reason if place is None else f"{place[1] - figure.floor:.2f} m above the floor, {reason}"
    return BodyMeasures(
        **{name: np.nan if name in impossible else value for name, value in values.items()},
        front_share=_front_share(figure, landmarks),
        landmarks=landmarks,
        surface=body,
        frame=figure.frame,
        arm_vertices=figure.is_arm,
        doubts=doubts,
    )


class _Part(NamedTuple):
    """Measures of a part of the body [m], and places on it."""

    values: dict[str, float]
    places: dict[str, Floats]


_NO_WAIST = f"no girth between hips and bust is {100.0 * (1.0 - _WAIST_LESS):.0f} % less than those below and above it"
_Names = tuple[tuple[str, ...], tuple[str, ...]]  # of the measures of a part, and of its places
_NECK: _Names = (
    ("neck", "shoulder_width", "shoulder_length", "shoulder_slope", "armscye_depth", "back_width", "chest_width"),
    ("shoulder", "neck_side", "neck_back", "neck_front"),
)
_ARM: _Names = (("arm_length", "upper_arm", "wrist"), ("arm_start", "elbow", "wrist"))
_LEG: _Names = (("thigh", "knee", "ankle"), ("knee", "ankle"))
_TRUNK_LENGTHS: _Names = (("back_length", "back_waist_length", "front_waist_length", "bust_depth"), ())


def _taken(
    figure: BodySegments,
    part: Callable[[BodySegments], _Part],
    by_hand: Mapping[str, float],
    doubts: dict[str, str],
    names: _Names,
) -> _Part:
    """Measures of a part; not numbers, with the reason in ``doubts``, where the body does not have it.

    Args:
        figure: to measure.
        part: takes the measures.
        by_hand: measures by hand.
        doubts: reasons by measure; the missing ones are added.
        names: of the part's measures and of its places.

    Raises:
        InputError: a measure of a missing part was given: there is no place for it.
    """
    try:
        return part(figure)
    except Missing as missing:
        lost = sorted(set(by_hand) & set(names[0]))
        if lost:
            raise figure.problem(f"{lost[0].replace('_', ' ')} by hand has no place: {missing}") from None
        doubts |= {name: str(missing) for name in names[0]}
        return _Part(dict.fromkeys(names[0], np.nan), {name: np.full(3, np.nan) for name in names[1]})


def _trunk(figure: BodySegments, by_hand: Mapping[str, float]) -> _Part:
    """Girths of the trunk; a waist that does not show lies where measures by hand want it.

    Raises:
        InputError: there is no trunk at some height between crotch and armpits, or a waist by hand is not there.
    """
    low, high = figure.crotch[1], figure.armpit[1]
    heights = np.arange(low, high, _STEP)
    try:
        girths = np.array([hull_length(figure.level(y), UP) for y in heights])
    except Missing as missing:
        raise figure.problem(str(missing)) from None
    hip = int(girths[heights < low + 0.12 * figure.height].argmax())
    waist = hip + int(girths[hip:].argmin())
    around = [girths[hip : waist + 1].max(), girths[waist:].max()]  # below the waist, and above it
    has_waist = girths[waist] < _WAIST_LESS * min(around)
    if "waist_to_floor" in by_hand or "waist" in by_hand and not has_waist:
        above_floor = by_hand.get("waist_to_floor", _WAIST_HEIGHT * figure.height)
        least, most = heights[hip] - figure.floor, high - figure.floor - _WAIST_BELOW_ARMPIT * figure.height
        if not least < above_floor < most:
            expected = f"{least:.3f} to {most:.3f} m, between hips and armpits"
            raise InputError("no height of a waist", key="waist_to_floor", received=above_floor, expected=expected)
        waist, has_waist = int(np.abs(heights - figure.floor - above_floor).argmin()), True
    # The foremost point of the upper half between waist and armpits; where there is no waist, of the upper third.
    middle = 0.5 * (heights[waist] + high) if has_waist else (low + 2.0 * high) / 3.0
    upper = np.flatnonzero(heights > middle)
    breasts = [_breast(figure.level(heights[k])) for k in upper]
    best = int(np.argmax([point[2] for point in breasts]))
    bust, bust_point = int(upper[best]), breasts[best]
    slopes = np.diff(girths[: bust + 1]) / _STEP
    underbust = bust - 1
    while underbust > waist and slopes[underbust] < 1.0:  # the breast's top is flat, its underside steep
        underbust -= 1
    while underbust > waist and slopes[underbust] >= 1.0:
        underbust -= 1
    levels = {"bust": bust, "underbust": underbust, "waist": waist, "hip": hip}
    values = {name: girths[k] for name, k in levels.items()}
    places = {name: _middle(figure.level(heights[k])) for name, k in levels.items()}
    if not has_waist:
        values |= {"waist": np.nan, "underbust": np.nan}
        places |= {"waist": np.full(3, np.nan), "underbust": np.full(3, np.nan)}
    width = 2.0 * bust_point[0]
    return _Part(values | {"bust_point_distance": width}, places | {"bust_point": bust_point})


def _breast(points: Floats) -> Floats:
    """The foremost point of the left half of a level, not at its very middle nor at its side."""
    half = points[:, 0].max()
    between = points[(points[:, 0] > 0.25 * half) & (points[:, 0] < 0.75 * half)]
    points = between if len(between) else points
    return points[points[:, 2].argmax()]


def _middle(points: Floats) -> Floats:
    """Middle of the box around points."""
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def _neck_and_shoulder(figure: BodySegments) -> _Part:
    """The shoulder line and the neck's base."""
    cut = figure.cut(figure.faces, figure.armpit, figure.shoulder_normal, "shoulder")
    shoulder = cut[cut[:, 1].argmax()]
    limit = shoulder[1] + 0.07 * figure.height  # on the neck, below the head
    tops = np.array([_top(figure, x, limit) for x in np.arange(0.02, shoulder[0], _STEP)])
    neckless = Missing(f"no neck rises above the shoulders, {shoulder[1] - figure.floor:.2f} m above the floor")
    if not len(tops) or tops[0, 1] < limit - 0.02:
        raise neckless
    outside = np.flatnonzero(tops[:-1, 1] < limit - 0.02)  # of the neck's column
    slopes = -np.diff(tops[:, 1]) / _STEP
    flat = outside[slopes[outside] < _NECK_SLOPE]
    if not len(flat):
        raise neckless
    side = tops[flat[0]]
    line = shoulder - side
    normal = np.array([0.0, np.cos(_NECK_TILT), np.sin(_NECK_TILT)])
    base = figure.cut(figure.trunk, side, normal, "neck")
    base = base[np.abs(base[:, 0]) < 1.2 * side[0]]
    spine = base[np.abs(base[:, 0]) < 0.3 * side[0]]
    if not len(spine):
        raise Missing(f"nothing of the neck is {side[1] - figure.floor:.2f} m above the floor")
    back, front = (spine[spine[:, 2].argmin()] * (0, 1, 1), spine[spine[:, 2].argmax()] * (0, 1, 1))
    half = figure.level(0.5 * (shoulder[1] + figure.armpit[1]))
    values = {
        "neck": hull_length(base, normal),
        "shoulder_width": 2.0 * shoulder[0],
        "shoulder_length": np.linalg.norm(line),
        "shoulder_slope": np.arctan2(-line[1], line[0]),
        "armscye_depth": back[1] - figure.armpit[1],
        "back_width": _width(half, -1.0),
        "chest_width": _width(half, 1.0),
    }
    return _Part(values, {"shoulder": shoulder, "neck_side": side, "neck_back": back, "neck_front": front})


def _top(figure: BodySegments, x: float, limit: float) -> Floats:
    """The highest point of the trunk below a limit, at a certain x [m], shape (3,)."""
    points = cross_section(figure.vertices, figure.trunk, np.array([x, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    points = points[points[:, 1] < limit]
    if not len(points):
        raise Missing(f"nothing of the trunk is {100.0 * x:.0f} cm beside its middle")
    return points[points[:, 1].argmax()]


def _width(points: Floats, side: float) -> float:
    """Length of a tape over the front (side 1) or the back (side -1) of a level, from side to side [m]."""
    loop = points[side * (points[:, 2] - _middle(points)[2]) >= 0.0][:, [0, 2]] * (1.0, side)
    ends = loop[[loop[:, 0].argmin(), loop[:, 0].argmax()]]
    return tape_length(loop, ends[0], ends[1])


def _arm(figure: BodySegments) -> _Part:
    """Girths and length of the left arm."""
    used = np.unique(figure.arm)
    if not len(used):
        raise Missing("no arm begins at the left armpit")

    def cut(point: Floats, direction: Floats) -> Floats:
        return figure.cut(figure.arm, point, direction, "arm")

    start = figure.armpit
    direction = figure.arm_direction
    for _ in range(2):
        # The hand's end along the arm, the wrist as the thinnest place before the hand, and again along that line.
        reach = float(((figure.vertices[used] - start) @ direction).max())
        places = np.arange(0.45, 0.82, 0.01) * reach
        cuts = [cut(start + t * direction, direction) for t in places]
        wrist = _middle(cuts[int(np.argmin([hull_length(points, direction) for points in cuts]))])
        start = _middle(cut(figure.armpit + 0.005 * direction, direction))
        direction = unit(wrist - start)
    elbow = _middle(cut(0.5 * (start + wrist), direction))
    upper, lower = unit(elbow - start), unit(wrist - elbow)
    length = np.linalg.norm(elbow - start)
    girths = [hull_length(cut(start + t * length * upper, upper), upper) for t in np.arange(0.1, 0.5, 0.05)]
    shoulder = figure.cut(figure.faces, figure.armpit, figure.shoulder_normal, "shoulder")
    shoulder = shoulder[shoulder[:, 1].argmax()]
    over_elbow = np.linalg.norm(elbow - shoulder) + np.linalg.norm(wrist - elbow)
    near = [cut(wrist + t * lower, lower) for t in np.arange(-0.02, 0.021, 0.005)]
    thinnest = min(hull_length(points, lower) for points in near)
    values = {"arm_length": over_elbow, "upper_arm": max(girths), "wrist": thinnest}
    return _Part(values, {"arm_start": start, "elbow": elbow, "wrist": wrist})


def _leg(figure: BodySegments) -> _Part:
    """Girths of the left leg."""
    v, low, height = figure.vertices, figure.floor, figure.height

    def cut(y: float) -> Floats:
        return figure.cut(figure.leg, np.array([0.0, y, 0.0]), UP, "leg")

    ankles = [cut(y) for y in np.arange(low + 0.03 * height, low + 0.12 * height, _STEP)]
    ankle = _middle(min(ankles, key=lambda points: hull_length(points, UP)))
    knee = _middle(cut(low + _KNEE_HEIGHT * height))
    top = _middle(cut(figure.crotch[1] - 2.0 * _STEP))
    thigh, shin = unit(top - knee), unit(knee - ankle)
    side = v[:, 0] > -0.005
    faces = figure.trunk[side[figure.trunk].all(axis=1)]
    around = figure.cut(faces, figure.crotch - (0.0, 2.0 * _STEP, 0.0), thigh, "leg")
    near = [figure.cut(figure.leg, ankle + t * shin, shin, "leg") for t in np.arange(-0.02, 0.021, 0.005)]
    values = {
        "thigh": hull_length(around, thigh),
        "knee": hull_length(figure.cut(figure.leg, knee, unit(thigh + shin), "leg"), unit(thigh + shin)),
        "ankle": min(hull_length(points, shin) for points in near),
    }
    return _Part(values, {"knee": knee, "ankle": ankle})


def _trunk_lengths(figure: BodySegments, places: Landmarks) -> _Part:
    """Lengths along back and front, as a tape runs over hollows."""
    waist = places.waist[1]
    if np.isnan(waist):
        raise Missing(_NO_WAIST)
    if np.isnan(places.neck_side).any():
        raise Missing("the neck's side, where the tape begins, was not found")

    def tape(start: Floats, end: Floats, outward: Floats) -> float:
        """Length along the surface between two points of it, in the plane that holds the outward direction."""
        along = unit(end - start)
        cut = cross_section(figure.vertices, figure.trunk, start, np.cross(along, outward))
        cut = cut[(cut[:, 1] < start[1]) & (cut[:, 1] > end[1])]  # without the face
        plane = np.stack([along, unit(outward - (outward @ along) * along)], axis=1)
        return tape_length((cut - start) @ plane, np.zeros(2), (end - start) @ plane)

    def surface(x: float, side: float) -> Floats:
        """The point of the surface at the waist, at a certain x, on the front (side 1) or the back (side -1)."""
        points = figure.level(waist)
        points = points[side * (points[:, 2] - places.waist[2]) > 0.0]
        if not len(points):
            raise Missing(f"nothing of the trunk is {waist - figure.floor:.2f} m above the floor")
        return points[np.abs(points[:, 0] - x).argmin()]

    front = np.array([0.0, 0.0, 1.0])
    depth = tape(places.neck_side, places.bust_point, front)
    lengths = {
        "back_length": tape(places.neck_back, surface(0.0, -1.0), -front),
        "back_waist_length": tape(places.neck_side, surface(places.neck_side[0], -1.0), -front),
        "front_waist_length": depth + tape(places.bust_point, surface(places.bust_point[0], 1.0), front),
        "bust_depth": depth,
    }
    return _Part(lengths, {})


def _front_share(figure: BodySegments, places: Landmarks) -> Floats:
    """Shares of the girths of bust, waist and hip in front of one upright plane through the sides [-], shape (3,)."""
    levels = (places.bust, places.waist, places.hip)
    side = float(np.nanmean([place[2] for place in levels]))
    shares = []
    for place in levels:
        if np.isnan(place).any():
            shares.append(np.nan)
            continue
        loop = hull_loop(figure.level(place[1])[:, [0, 2]])
        ends = np.roll(loop, -1, axis=0)
        fine = (loop[:, None] + (ends - loop)[:, None] * np.linspace(0.0, 1.0, 50)[None, :, None]).reshape(-1, 2)
        steps = np.linalg.norm(np.roll(fine, -1, axis=0) - fine, axis=1)
        shares.append(steps[fine[:, 1] > side].sum() / steps.sum())
    return np.array(shares)
