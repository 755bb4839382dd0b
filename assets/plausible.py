"""What bodies have: measures that no body of its height has, and measures that do not go together."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from pbd.errors import InputError

__all__ = ["check_given", "doubtful"]

# Usual shares of the stature, men and women together, rounded [-]: Gordon et al. 2014, "2012 Anthropometric Survey of
# U.S. Army Personnel", NATICK/TR-15/007. Names there: chest, waist (omphalion), buttock, neck circumference base,
# biacromial breadth, shoulder length, cervicale minus axilla height, waist back, sleeve outseam, biceps, wrist, crotch
# height, waist height, thigh, lower thigh and ankle circumference.
_SHARES = {
    "bust": 0.59,
    "waist": 0.53,
    "hip": 0.60,
    "neck": 0.24,
    "shoulder_width": 0.23,
    "shoulder_length": 0.083,
    "armscye_depth": 0.106,
    "back_length": 0.28,
    "arm_length": 0.335,
    "upper_arm": 0.20,
    "wrist": 0.098,
    "inseam": 0.475,
    "waist_to_floor": 0.60,
    "thigh": 0.36,
    "knee": 0.22,
    "ankle": 0.128,
}
# Figures of games are thinner, stouter and of other proportions than soldiers: so far from the mean they may be [-].
_GIRTHS = {"bust", "waist", "hip", "neck", "upper_arm", "wrist", "thigh", "knee", "ankle"}
_GIRTH_RANGE, _LENGTH_RANGE = (0.4, 2.2), (0.35, 2.0)
# A measure over another one, at least and at most [-]; of a pair that does not go together, the one that is further
# from its mean is doubted, the first one where the survey has no mean.
_RATIOS = {
    ("underbust", "bust"): (0.6, 1.3),
    ("waist", "bust"): (0.45, 1.6),
    ("waist", "hip"): (0.4, 1.6),
    ("thigh", "hip"): (0.3, 0.85),
    ("knee", "thigh"): (0.3, 1.0),
    ("ankle", "knee"): (0.3, 1.05),
    ("wrist", "upper_arm"): (0.25, 1.05),
    ("upper_arm", "bust"): (0.12, 0.6),
    ("neck", "bust"): (0.2, 0.85),
    ("chest_width", "back_width"): (0.5, 2.0),
    ("back_waist_length", "back_length"): (0.75, 1.5),
    ("front_waist_length", "back_waist_length"): (0.6, 1.8),
    ("bust_depth", "front_waist_length"): (0.2, 1.0),
    ("bust_point_distance", "bust"): (0.04, 0.4),
}


def _range(name: str) -> tuple[float, float] | None:
    """Least and greatest share of the height that a body has [-]; None for a measure that the survey lacks."""
    if name not in _SHARES:
        return None
    low, high = _GIRTH_RANGE if name in _GIRTHS else _LENGTH_RANGE
    return low * _SHARES[name], high * _SHARES[name]


def doubtful(values: Mapping[str, float], trusted: Collection[str] = ()) -> dict[str, str]:
    """Measures that no body has, each with the reason.

    Args:
        values: measures by name [m], ``height`` among them.
        trusted: names of those that were taken by hand: nothing is concluded from them.
    """
    height, found = values["height"], {}
    for name, value in values.items():
        limits = _range(name)
        if name not in trusted and limits is not None and not limits[0] <= value / height <= limits[1]:
            has = f"bodies have {limits[0]:.3f} to {limits[1]:.3f}"
            found[name] = f"{value:.3f} m would be {value / height:.3f} of the height: {has}"
    for (one, other), (low, high) in _RATIOS.items():
        if not values.keys() >= {one, other} or {*found, *trusted} & {one, other}:
            continue
        ratio = values[one] / values[other]
        if not low <= ratio <= high:
            name = max((one, other), key=lambda name: _strangeness(name, values))
            words = f"{one.replace('_', ' ')} over {other.replace('_', ' ')} would be {ratio:.2f}"
            found[name] = f"{values[name]:.3f} m cannot be: {words}, bodies have {low:g} to {high:g}"
    return found


def _strangeness(name: str, values: Mapping[str, float]) -> float:
    """How far a measure is from its mean, as the logarithm of their ratio [-]."""
    if name not in _SHARES:
        return math.inf
    return abs(math.log(max(values[name], 1e-9) / (_SHARES[name] * values["height"])))


def check_given(name: str, value: float, height: float) -> None:
    """Refuse a measure taken by hand that no body has: its unit may be another one.

    Args:
        name: of the measure.
        value: [m].
        height: of the body [m].

    Raises:
        InputError: the value is not a number above 0, or outside of what bodies of that height have.
    """
    share = _range(name) or (0.0, 2.5)
    low, high = share[0] * height, share[1] * height
    if not (value > 0.0 and low <= value <= high):
        expected = f"{low:.3f} to {high:.3f} m for a body that is {height:.2f} m high"
        raise InputError("a measure that no body has", key=name, received=value, expected=expected)
