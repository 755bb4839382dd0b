"""Loops of the laboratory: cloth bent and sheared to and fro, and what Kawabata's instruments read off (KES-FB1, FB2).

The loop's width is what the cloth's internal friction takes: see :class:`pbd.Fabric`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pbd import Fabric, InputError
from precompute.experiment.sheets import level
from precompute.validation.laboratory import FLAT, LoadCurve
from precompute.validation.trial import Specimen, Trial, TrialSetting, strip

__all__ = [
    "LOOPS", "LOOP_SOLVER", "Gauge", "Reading", "bending_loop", "check_loop", "loop_area", "read_loop", "shear_loop",
]  # fmt: skip

LOOP_SOLVER = "fem-stvk/quasi-static"  # its shear strain is that of a trellis, whose yarns keep their lengths
SLOPE_POINTS = 21  # through which a line gives the slope
CLOSED = 0.05  # by so much of its range the load of a loop may differ where it meets itself [-]
RETURNED = 0.02  # and by so much of its range the deformation may end before it began, or go back on its way [-]


@dataclass(frozen=True)
class Gauge:
    """Where an instrument reads a loop off.

    Attributes:
        far: deformation at which it turns back [1/m] or [rad].
        slope: between which deformations it reads the slope.
        widths: at which deformations it reads the width.
        path: deformations to which the sample is brought, from 0 to ``far``, ``-far`` and ``far``, shape (k,).
    """

    far: float
    slope: tuple[float, float]
    widths: tuple[float, ...]
    path: np.ndarray


@dataclass(frozen=True)
class Reading:
    """What was read off a loop.

    Attributes:
        stiffness: mean slope, B [N m] or G [N/m].
        widths: 2HB [N], or 2HG and 2HG5 [N/m], in the order of :attr:`Gauge.widths`.
    """

    stiffness: float
    widths: tuple[float, ...]


def _path(start: list[float], back: list[float]) -> np.ndarray:
    """From 0 by ``start`` to the far end, by ``back`` to the other one, and back again the same way."""
    return np.array([0.0, *start, *back, *(-at for at in back)])


_BACK_BENT = [237.5, 225.0, 212.5, 200.0, 150.0, 100.0, 50.0, -50.0, -100.0, -150.0, -200.0, -250.0]
_BACK_SHEARED = [7.75, 7.5, 7.0, 6.0, 5.0, 2.5, 0.5, -0.5, -2.5, -5.0, -8.0]
# Closer together where the cloth has just turned back: there its friction sticks.
LOOPS = {
    "bending_loop": Gauge(250.0, (50.0, 150.0), (100.0,), _path([50.0, 100.0, 150.0, 200.0, 250.0], _BACK_BENT)),
    "shear_loop": Gauge(
        math.radians(8.0),
        (math.radians(0.5), math.radians(2.5)),
        (math.radians(0.5), math.radians(5.0)),
        np.radians(_path([2.5, 5.0, 8.0], _BACK_SHEARED)),
    ),
}


def bending_loop(setting: TrialSetting, fabric: Fabric, angle: float, path: np.ndarray) -> LoadCurve:
    """A strip between clamps 1 cm apart that lie on one arc after the other: pure bending, as Kawabata's KES-FB2.

    Args:
        setting: solver and resolution; a solver without time, for each point is an equilibrium.
        fabric: SI values.
        angle: of the strip to the warp [rad].
        path: curvatures one after the other [1/m], shape (k,).

    Returns:
        Moment per width [N] in the middle of the strip at each of them, in that order.
    """
    length, width = 0.01, 0.004
    specimen = strip(length, width, setting.edges, clamp=1)
    x = specimen.flat[:, 0]
    far = x > length - 1.5 * specimen.edge
    free = length - _area(specimen, far) / width  # the border of the faces in the clamp is no straight line
    trial = _sample(specimen, fabric, (x < 1e-9) | far, setting, angle)
    loads = []
    for curvature in path:
        trial.lay(_on_arc(specimen, free, curvature))
        force, moment = trial.pull(np.flatnonzero(far))
        middle = trial.world()[np.abs(x - 0.5 * free) < specimen.edge].mean(axis=0)
        loads.append(float((moment - np.cross(middle, force))[2] / width))
    return LoadCurve(np.array(path), np.array(loads), trial.cost_ms)


def _area(specimen: Specimen, clamped: np.ndarray) -> float:
    """Of the faces that a clamp holds [m2]."""
    first, second, third = np.moveaxis(specimen.flat[specimen.faces[clamped[specimen.faces].all(axis=1)]], 1, 0)
    one, two = second - first, third - first
    return 0.5 * float(np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum())


def _on_arc(specimen: Specimen, free: float, curvature: float) -> np.ndarray:
    """Places of a strip whose first ``free`` metres lie on an arc and whose clamped faces are flat [m]."""
    x, y = specimen.flat.T
    s = np.clip(x, 0.0, free)
    turn, beyond = curvature * s, x - s
    half = np.sinc(0.5 * turn / math.pi)
    along = s * np.sinc(turn / math.pi) + beyond * np.cos(turn)
    down = 0.5 * s * turn * half**2 + beyond * np.sin(turn)
    return np.stack([along, -down, -y], axis=1)


def shear_loop(setting: TrialSetting, fabric: Fabric, angle: float, path: np.ndarray) -> LoadCurve:
    """Cloth 5 cm high between two clamps, one led along an arc about the other: simple shear, as Kawabata's KES-FB1.

    On the arc yarns from clamp to clamp keep their lengths, as they do under the instrument's constant tension. The
    force is that along the arc. Two widths are measured, so that free sides cancel.

    Args:
        setting: ``edges`` lie along the height of two samples; see :func:`bending_loop`.
        fabric: SI values.
        angle: of the height to the warp [rad].
        path: angles of shear one after the other [rad], shape (k,).

    Returns:
        Shear force per width [N/m] at each of them, in that order.
    """
    height, widths = 0.05, (0.05, 0.1)
    # Cloth that stays flat, as its tension keeps it in the instrument, has no friction of bending to measure.
    flat = replace(fabric, bend_warp=FLAT, bend_weft=FLAT, bend_hysteresis_warp=0.0, bend_hysteresis_weft=0.0)
    loads, costs = np.zeros((2, len(path))), []
    for row, width in enumerate(widths):
        specimen = strip(height, width, max(4, setting.edges // 2), clamp=0)
        x, start = specimen.flat[:, 0], level(specimen.flat)
        far = x > height - 1e-9
        trial = _sample(specimen, flat, (x < 1e-9) | far, setting, angle)
        for column, shear in enumerate(path):
            places = start.copy()
            places[:, 0], places[:, 2] = math.cos(shear) * x, start[:, 2] + math.sin(shear) * x
            trial.lay(places)
            force = -trial.pull(np.flatnonzero(far))[0]
            loads[row, column] = force @ [-math.sin(shear), 0.0, math.cos(shear)]
        costs.append(trial.cost_ms)
    found = (loads[1] - loads[0]) / (widths[1] - widths[0])
    return LoadCurve(np.array(path), found, float(np.median(costs)))


def _sample(specimen: Specimen, fabric: Fabric, clamps: np.ndarray, setting: TrialSetting, angle: float) -> Trial:
    setting = replace(setting, substeps=1)  # clamps that went straight from one point to the next would bend it more
    return Trial(specimen, level(specimen.flat), fabric, clamps, setting, (0.0, 0.0, 0.0), warp=angle)


def read_loop(curve: LoadCurve, instrument: str, direction: str) -> Reading:
    """What an instrument reads off a loop; each figure is the mean of both sides.

    The slope is that of the loading cloth: of the rising branch on the positive side, of the falling one on the other.
    The width is the load of the rising branch less that of the falling one.

    Args:
        curve: points in the order in which they were measured.
        instrument: ``bending_loop`` or ``shear_loop``.
        direction: of the sample, for messages.

    Raises:
        InputError: no loop: it does not go as far to both sides as the instrument reads, does not come back to where it
            began, or does not meet itself there; or its load falls as the deformation rises.
    """
    gauge, key = LOOPS[instrument], f"{instrument} {direction}"
    rising, falling = branches(curve, instrument, direction)
    value = lambda branch, at: np.interp(at, branch[0], branch[1])  # noqa: E731
    places = np.linspace(*gauge.slope, SLOPE_POINTS)
    design = places - places.mean()
    slopes = [design @ value(rising, places), -design @ value(falling, -places)] / (design @ design)
    stiffness = float(np.mean(slopes))
    if not stiffness > 0.0:
        expected = f"load that rises with the deformation between {gauge.slope[0]:.4g} and {gauge.slope[1]:.4g}"
        raise InputError("load falls as the deformation rises", key=key, received=stiffness, expected=expected)
    widths = [float(np.mean([value(rising, at) - value(falling, at) for at in (side, -side)])) for side in gauge.widths]
    return Reading(stiffness, tuple(widths))


def check_loop(curve: LoadCurve, instrument: str, direction: str) -> Reading:
    """The reading of a measured loop.

    Raises:
        InputError: as :func:`read_loop`; or no width, or a loop run the wrong way round, whose width is negative.
    """
    reading = read_loop(curve, instrument, direction)
    if not min(reading.widths) > 0.0:
        expected = "a width above 0, rows in the order of measuring; a fabric without hysteresis has no rows of a loop"
        problem = "loop without width or run the wrong way round"
        received, key = min(reading.widths), f"{instrument} {direction}"
        raise InputError(problem, key=key, received=received, expected=expected)
    return reading


def branches(curve: LoadCurve, instrument: str, direction: str) -> tuple[np.ndarray, np.ndarray]:
    """Deformation and load of the branch on which the deformation rises, and of that on which it falls, shape (2, k).

    A loop starts anywhere, turns at its largest deformation and at its smallest one, in either order, and comes back at
    least to where it began; values after another turn do not count. Of a piece that is measured
    twice the later one counts, for at first friction had not slipped yet.

    Raises:
        InputError: see :func:`read_loop`.
    """
    gauge, x, load, key = LOOPS[instrument], curve.deformation, curve.load, f"{instrument} {direction}"
    reach = max(*gauge.slope, *gauge.widths)
    span = float(np.ptp(x))
    if len(x) < 8 or x.max() < reach or x.min() > -reach:
        received = f"{len(x)} points from {x.min():.4g} to {x.max():.4g}"
        expected = f"8 points or more, to {reach:.4g} and to {-reach:.4g} or further"
        raise InputError("no loop", key=key, received=received, expected=expected)
    turn = sorted((int(np.argmax(x)), int(np.argmin(x))))
    sign = 1.0 if x[turn[0]] > x[turn[1]] else -1.0
    end = turn[1] + int(np.argmax(sign * x[turn[1] :])) + 1
    pieces = [slice(0, turn[0] + 1), slice(turn[0], turn[1] + 1), slice(turn[1], end)]
    steps = [sign * way * np.diff(x[piece]) for piece, way in zip(pieces, (1.0, -1.0, 1.0), strict=True)]
    if min(step.min(initial=0.0) for step in steps) < -RETURNED * span:
        expected = "deformation that turns at its largest and at its smallest value alone"
        raise InputError("no loop", key=key, received="one that turns in between", expected=expected)
    if sign * (x[end - 1] - x[0]) < -RETURNED * span:
        expected = f"a last deformation of {x[0]:.4g}, where it began, or beyond"
        raise InputError("loop does not close", key=key, received=float(x[end - 1]), expected=expected)
    back = np.stack([x[pieces[1]], load[pieces[1]]])
    again, first = (np.stack([x[piece], load[piece]]) for piece in (pieces[2], pieces[0]))
    virgin = first[:, sign * first[0] > sign * again[0, -1]]
    if virgin.shape[1] == 0:  # it has come back to where it turned first
        gap = abs(float(again[1, -1] - back[1, 0]))
        if gap > CLOSED * float(np.ptp(load)):
            expected = f"the load {back[1, 0]:.4g} that it had there at first, within {100 * CLOSED:g} % of its range"
            raise InputError("loop does not close", key=key, received=float(again[1, -1]), expected=expected)
    on = np.concatenate([again, virgin], axis=1)
    branch = [part[:, np.argsort(part[0], kind="stable")] for part in (on, back)]
    return (branch[0], branch[1]) if sign > 0.0 else (branch[1], branch[0])


def loop_area(curve: LoadCurve, instrument: str, direction: str) -> float:
    """Work that friction takes in a loop, over the cloth's area [J/m2]."""
    rising, falling = branches(curve, instrument, direction)
    return float(np.trapezoid(rising[1], rising[0]) - np.trapezoid(falling[1], falling[0]))
