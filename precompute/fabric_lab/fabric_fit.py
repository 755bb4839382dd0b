"""Fabrics fitted to measured curves: a CSV file of load against deformation in, a fabric and a picture of both out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path

import numpy as np

from assets.fabrics import fitted_tension
from assets.text import read_words
from pbd import Fabric
from pbd.errors import InputError
from pbd.fabric import stiffening_stress
from precompute.reporting.cost_charts import panels, write_png
from precompute.validation.laboratory import (
    DIRECTIONS,
    LoadCurve,
    bending_curve,
    compression_curve,
    shear_curve,
    tension_curve,
)
from precompute.validation.loops import (
    LOOP_SOLVER,
    LOOPS,
    bending_loop,
    branches,
    check_loop,
    shear_loop,
)
from precompute.validation.trial import TrialSetting

__all__ = ["FittedCurve", "draw_fit", "fit_fabric", "read_curves"]

# Columns of a row, in the units of :class:`precompute.validation.laboratory.LoadCurve`.
COLUMNS = ("instrument", "direction", "deformation", "load")
INSTRUMENTS = {"tension": tension_curve, "shear": shear_curve, "bending": bending_curve}
LOOP_INSTRUMENTS = {"bending_loop": bending_loop, "shear_loop": shear_loop}
PRESSED = ("compression", "normal")
# A curve of tension that goes this far [-], and has so many points, says how the fabric stiffens.
FAR_STRAIN, FAR_POINTS = 0.05, 3


@dataclass(frozen=True)
class FittedCurve:
    """One measured curve and what the fitted fabric gives in the same instrument.

    Attributes:
        instrument, direction: what was measured, and along what.
        measured, fitted: the curves.
        error: root mean squared difference of the loads over that of the measured ones [-].
    """

    instrument: str
    direction: str
    measured: LoadCurve
    fitted: LoadCurve
    error: float


def read_curves(path: Path) -> dict[tuple[str, str], LoadCurve]:
    """Curves of a CSV file with the columns instrument, direction, deformation, load, by instrument and direction.

    Instruments are tension (strain, N/m), shear (rad, N/m) and bending (1/m, N); directions warp, weft and bias. And
    compression (thickness in m, Pa) in the direction normal. A bending_loop or shear_loop, in the units of bending and
    shear, has its rows in the order in which it was measured and goes to both sides
    (:func:`precompute.validation.loops.branches`).

    Raises:
        InputError: no such file, another header, an unknown word, a number that is not finite or, but for a loop, not
            above 0, or rows that form no loop (:func:`precompute.validation.loops.check_loop`).
    """
    rows = read_words(path, COLUMNS)
    points: dict[tuple[str, str], list[tuple[float, float]]] = {}
    errors = []
    for number, words in rows:
        row = dict(zip_longest(COLUMNS, words))
        pressed, looped = (row["instrument"], row["direction"]) == PRESSED, row["instrument"] in LOOP_INSTRUMENTS
        for name, allowed in (("instrument", INSTRUMENTS | LOOP_INSTRUMENTS), ("direction", DIRECTIONS)):
            if row[name] not in allowed and not pressed:
                expected = " or ".join(allowed) + ", or compression with normal"
                errors.append(
                    InputError("unknown word", file=path, key=f"line {number}", received=row[name], expected=expected)
                )
        try:
            point = (float(row["deformation"]), float(row["load"]))
        except (TypeError, ValueError):
            point = (math.nan, math.nan)
        if not all((-math.inf if looped else 0.0) < value < math.inf for value in point):
            received = (row["deformation"], row["load"])
            expected = "two finite numbers" if looped else "two numbers above 0"
            errors.append(
                InputError("bad point", file=path, key=f"line {number}", received=received, expected=expected)
            )
        points.setdefault((row["instrument"], row["direction"]), []).append(point)
    if not rows:
        errors.append(InputError("no curve", file=path, received=0, expected="at least one row"))
    if errors:
        raise InputError.join(errors)
    ordered = {key: np.array(found if key[0] in LOOPS else sorted(found)) for key, found in points.items()}
    curves = {key: LoadCurve(curve[:, 0], curve[:, 1], math.nan) for key, curve in ordered.items()}
    for (instrument, direction), curve in curves.items():
        if instrument in LOOPS:
            try:
                check_loop(curve, instrument, direction)
            except InputError as error:
                errors.append(error.in_file(path))
    if errors:
        raise InputError.join(errors)
    return curves


def fit_fabric(
    curves: dict[tuple[str, str], LoadCurve], fabric: Fabric, setting: TrialSetting
) -> tuple[Fabric, list[FittedCurve]]:
    """The fabric that is nearest to the curves, and what it gives in the same instruments.

    A fabric has one stiffness for each instrument and axis: a line through the origin is fitted by least squares of the
    loads. Tension along warp or weft that is measured up to 5 % strain or further also gives the stiffening
    (:func:`assets.fabrics.fitted_tension`). Tension at the bias gives the shear stiffness where shear itself was not
    measured. Van Wyk's law is a line in 1/T^3. A loop gives stiffness and hysteresis as Kawabata reads them, the
    stiffness rather than a curve of the same kind; shear that was measured along warp and weft gives the mean of both.

    Args:
        curves: as :func:`read_curves` gives them.
        fabric: for what was not measured.
        setting: of the solver that stands in the instruments.
    """
    line = {
        key: float(c.deformation @ c.load / (c.deformation @ c.deformation))
        for key, c in curves.items()
        if key != PRESSED and key[0] not in LOOPS
    }
    names = {
        ("tension", "warp"): "stretch_warp",
        ("tension", "weft"): "stretch_weft",
        ("shear", "warp"): "shear",
        ("bending", "warp"): "bend_warp",
        ("bending", "weft"): "bend_weft",
    }
    fitted = replace(fabric, **{names[key]: value for key, value in line.items() if key in names})
    for axis in ("warp", "weft"):
        if ("tension", axis) in curves:
            fitted = _pulled(curves["tension", axis], axis, fitted)
    fitted = _rubbed(curves, fitted)
    bias = line.get(("tension", "bias"))
    shear = ("shear", "warp") in line or any(("shear_loop", axis) in curves for axis in ("warp", "weft"))
    if bias is not None and not shear:
        fitted = replace(fitted, shear=_shear_of_bias(bias, fitted))
    found = []
    if PRESSED in curves:
        fitted = _pressed(curves[PRESSED], fitted)
    for (instrument, direction), measured in curves.items():
        if (instrument, direction) == PRESSED:
            drawn = compression_curve(TrialSetting(edges=setting.edges), fitted, tuple(measured.load))
            error = float(np.sqrt(((drawn.deformation / measured.deformation - 1.0) ** 2).mean()))
            found.append(FittedCurve(instrument, direction, measured, drawn, error))
            continue
        if instrument in LOOPS:
            found.append(_loop_beside(instrument, direction, measured, fitted, setting))
            continue
        drawn = INSTRUMENTS[instrument](setting, fitted, DIRECTIONS[direction], tuple(measured.deformation))
        # The strain in the middle of a strip is a little less than that given at its ends.
        far, near = (_straightened(fitted, instrument, direction, c.deformation) for c in (measured, drawn))
        difference = drawn.load * far / near - measured.load
        error = float(np.sqrt((difference**2).mean() / (measured.load**2).mean()))
        found.append(FittedCurve(instrument, direction, measured, drawn, error))
    return fitted, found


def _shear_of_bias(bias: float, fabric: Fabric) -> float:
    """Shear stiffness by tension at the bias, 4/E45 = 1/E1 + 1/E2 + 1/G - 2 nu12/E1."""
    rest = 1.0 / fabric.stretch_warp + 1.0 / fabric.stretch_weft - 2.0 * fabric.poisson / fabric.stretch_warp
    softness = 4.0 / bias - rest
    if softness <= 0.0:
        expected = f"below {4 / rest:.4g}"
        raise InputError("no fabric is so stiff at the bias", key="tension bias", received=bias, expected=expected)
    return 1.0 / softness


def _rubbed(curves: dict[tuple[str, str], LoadCurve], fabric: Fabric) -> Fabric:
    """With the stiffness and the hysteresis of loops; those at the bias say nothing that warp and weft do not."""
    for axis in ("warp", "weft"):
        if ("bending_loop", axis) in curves:
            reading = check_loop(curves["bending_loop", axis], "bending_loop", axis)
            changes = {f"bend_{axis}": reading.stiffness, f"bend_hysteresis_{axis}": reading.widths[0]}
            fabric = replace(fabric, **changes)
    sheared = [
        check_loop(curves[key], *key) for key in (("shear_loop", "warp"), ("shear_loop", "weft")) if key in curves
    ]
    if sheared:
        # The fabric has one width for all shears: the mean of 2HG and 2HG5.
        width = float(np.mean([reading.widths for reading in sheared]))
        fabric = replace(fabric, shear=float(np.mean([r.stiffness for r in sheared])), shear_hysteresis=width)
    return fabric


def _loop_beside(
    instrument: str, direction: str, measured: LoadCurve, fabric: Fabric, setting: TrialSetting
) -> FittedCurve:
    """The loop of the fitted fabric, as far to both sides as the measured one; its error is that of both branches."""
    x = measured.deformation
    path = np.clip(LOOPS[instrument].path, x.min(), x.max())
    sample = TrialSetting(LOOP_SOLVER, edges=setting.edges)
    drawn = LOOP_INSTRUMENTS[instrument](sample, fabric, DIRECTIONS[direction], path)
    ours, theirs = branches(drawn, instrument, direction), branches(measured, instrument, direction)
    off, size = [], []
    for own, (at, load) in zip(ours, theirs, strict=True):
        within = (at >= path.min()) & (at <= path.max())
        off.append((np.interp(at, *own) - load)[within])
        size.append(load[within])
    error = float(np.sqrt((np.concatenate(off) ** 2).mean() / (np.concatenate(size) ** 2).mean()))
    return FittedCurve(instrument, direction, measured, drawn, error)


def _pulled(curve: LoadCurve, axis: str, fabric: Fabric) -> Fabric:
    """With the stretch stiffness and the stiffening of a curve of tension that goes far enough."""
    if len(curve.deformation) < FAR_POINTS or curve.deformation.max() < FAR_STRAIN:
        return replace(fabric, **{f"stiffening_{axis}_10": 1.0, f"stiffening_{axis}_20": 1.0})
    try:
        stretch, ten, twenty = fitted_tension(curve.deformation, curve.load)
    except InputError as error:
        raise InputError(f"no curve of tension: {error}", key=f"tension {axis}") from error
    changes = {f"stretch_{axis}": stretch, f"stiffening_{axis}_10": ten, f"stiffening_{axis}_20": twenty}
    return replace(fabric, **changes)


def _straightened(fabric: Fabric, instrument: str, direction: str, deformation: np.ndarray) -> np.ndarray:
    """Deformation at which a fabric that does not stiffen would bear the same load, shape (k,)."""
    if instrument != "tension" or direction == "bias":
        return deformation
    law = fabric.stiffening()[("warp", "weft").index(direction)]
    return deformation + stiffening_stress(deformation, law)[1]


def _pressed(curve: LoadCurve, fabric: Fabric) -> Fabric:
    """With the thickness and the p_c of the line P = p_c T0^3 / T^3 - p_c."""
    inverse = curve.deformation**-3.0
    if np.ptp(inverse) <= 1e-6 * inverse.max():  # it does not give
        return replace(fabric, thickness=float(curve.deformation.mean()), compression=0.0)
    slope, level = np.polyfit(inverse / inverse.max(), curve.load, 1)
    if level >= 0.0 or slope <= 0.0:
        expected = "thickness that falls with pressure, less and less"
        raise InputError("no law of van Wyk's", key="compression normal", received=curve.load, expected=expected)
    return replace(fabric, thickness=float((slope / inverse.max() / -level) ** (1.0 / 3.0)), compression=float(-level))


def draw_fit(path: Path, found: Sequence[FittedCurve]) -> None:
    """Draw measured and fitted curves side by side, one panel each, as PNG."""
    labels = {"tension": ("strain", "N/m"), "shear": ("shear [rad]", "N/m"), "bending": ("curvature [1/m]", "N")}
    labels |= {"compression": ("thickness [m]", "Pa"), "bending_loop": labels["bending"], "shear_loop": labels["shear"]}
    figure, places = panels(len(found))
    for panel, curve in zip(places, found, strict=True):
        looped = curve.instrument in LOOPS
        through_zero = curve.instrument != "compression" and not looped
        line = np.pad(np.stack([curve.fitted.deformation, curve.fitted.load]), ((0, 0), (int(through_zero), 0)))
        panel.plot(*line, color="tab:red", label="fitted")
        panel.plot(curve.measured.deformation, curve.measured.load, "o", color="0.4", label="measured")
        x_label, y_label = labels[curve.instrument]
        if not looped:
            panel.set_xlim(0.0, 1.1 * curve.measured.deformation.max())
            panel.set_ylim(0.0, 1.1 * curve.measured.load.max())
        panel.set_xlabel(x_label)
        panel.set_ylabel(y_label)
        panel.set_title(
            f"{curve.instrument.replace('_', ' ')}, {curve.direction}: {100.0 * curve.error:.2g} % off", fontsize=9
        )
        panel.legend(fontsize=8)
    write_png(path, figure)
