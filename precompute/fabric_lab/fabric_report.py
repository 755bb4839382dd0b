"""`gube fabric`: one fabric in all instruments of the laboratory, or fitted to measured curves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pbd import Fabric
from pbd.models.newton import StepError
from precompute.reporting.cost_charts import write_png
from precompute.reporting.tables import write_table
from precompute.validation.drape_rows import cusick_drape
from precompute.validation.laboratory import (
    DIRECTIONS,
    LoadCurve,
    bending_curve,
    compression_curve,
    friction_coefficient,
    shear_curve,
    tension_curve,
)
from precompute.validation.loops import LOOP_SOLVER, LOOPS, bending_loop, read_loop, shear_loop
from precompute.validation.trial import TrialSetting

__all__ = [
    "PULLED",
    "curve_rows",
    "curves_text",
    "draw_curves",
    "fabric_text",
    "loop_figures",
    "measure_fabric",
    "pull",
    "write_curves",
]

STRAINS = (0.005, 0.01, 0.02)
FAR_STRAINS = (*STRAINS, 0.05, 0.10, 0.17)  # of a fabric that stiffens
SHEARS = (0.01, 0.04)  # [rad]
CURVATURES = (50.0, 100.0)  # [1/m]
PULLED = TrialSetting(substeps=1536)  # of strips that are pulled by the default solver
PRESSURES = (50.0, 500.0, 2000.0, 5000.0)  # [Pa]
ROUNDING = 1e-4  # width of a loop without friction, over the range of its loads [-]
LABELS = {
    "tension": ("strain", "tension [N/m]"),
    "shear": ("shear [rad]", "shear force [N/m]"),
    "bending": ("curvature [1/m]", "moment per width [N]"),
    "compression": ("thickness [m]", "pressure [Pa]"),
    "bending_loop": ("curvature [1/m]", "moment per width [N]"),
    "shear_loop": ("shear [rad]", "shear force [N/m]"),
}


def measure_fabric(
    fabric: Fabric, setting: TrialSetting, report: Callable[[str], None] = lambda line: None
) -> tuple[dict[tuple[str, str], LoadCurve], dict[str, float]]:
    """Curves of a fabric by instrument and direction, and single figures.

    Loops of bending and shear are measured with the finite elements for every solver of a setting: a load cell reads
    nothing but the membrane of the default one. Their figures are named as Kawabata names them
    (:func:`precompute.validation.loops.read_loop`).

    Args:
        fabric: SI values.
        setting: solver and resolution of the samples. A solver that only finds equilibria is replaced by the default
            one where cloth slides or lies on a plate.
        report: called with a line of progress.
    """
    moving = TrialSetting(edges=setting.edges) if setting.solver.endswith("quasi-static") else setting
    strains = FAR_STRAINS if fabric.stiffening().any() else STRAINS
    curves = {}
    for direction, angle in DIRECTIONS.items():
        report(f"tension, shear and bending along the {direction}")
        curves["tension", direction] = pull(setting, fabric, angle, strains)
        curves["shear", direction] = shear_curve(setting, fabric, angle, SHEARS)
        curves["bending", direction] = bending_curve(setting, fabric, angle, CURVATURES)
    sample = TrialSetting(LOOP_SOLVER, edges=setting.edges)
    for direction in ("warp", "weft"):
        report(f"loop of bending along the {direction}")
        angle, path = DIRECTIONS[direction], LOOPS["bending_loop"].path
        curves["bending_loop", direction] = bending_loop(sample, fabric, angle, path)
    report("loop of shear")
    curves["shear_loop", "warp"] = shear_loop(sample, fabric, DIRECTIONS["warp"], LOOPS["shear_loop"].path)
    report("compression, friction, drape")
    curves["compression", "normal"] = compression_curve(moving, fabric, PRESSURES)
    figures = loop_figures(curves) | {
        "friction": friction_coefficient(moving, fabric)[0],
        "gravity_length_m": fabric.gravity_length,
        "cusick_drape_coefficient": cusick_drape(moving, fabric.gravity_length)[0],
    }
    return curves, figures


def pull(setting: TrialSetting, fabric: Fabric, angle: float, strains: Sequence[float]) -> LoadCurve:
    """Tension; arguments as for :func:`precompute.validation.laboratory.tension_curve`.

    Newton's method does not find every equilibrium of cloth that stiffens, and ends: the default solver takes over, in
    steps that are small enough.
    """
    try:
        return tension_curve(setting, fabric, angle, strains)
    except StepError:
        return tension_curve(PULLED, fabric, angle, strains)


def loop_figures(curves: Mapping[tuple[str, str], LoadCurve]) -> dict[str, float]:
    """What is read off the loops among the curves: B [N m], 2HB [N], G, 2HG and 2HG5 [N/m]."""
    found: dict[str, float] = {}
    for (instrument, direction), curve in curves.items():
        if instrument not in LOOPS:
            continue
        reading = read_loop(curve, instrument, direction)
        if instrument == "bending_loop":
            found |= {f"B_{direction}": reading.stiffness, f"2HB_{direction}": reading.widths[0]}
        else:
            found |= {"G": reading.stiffness, "2HG": reading.widths[0], "2HG5": reading.widths[1]}
    return found


def curve_rows(curves: Mapping[tuple[str, str], LoadCurve]) -> list[dict[str, float | str]]:
    """One row per point: what :func:`precompute.fabric_lab.fabric_fit.read_curves` reads.

    Loops without width are left out: they hold nothing that the curves of bending and shear do not.
    """
    return [
        {"instrument": instrument, "direction": direction, "deformation": float(x), "load": float(y)}
        for (instrument, direction), curve in curves.items()
        for x, y in zip(curve.deformation, curve.load, strict=True)
        if instrument not in LOOPS or _has_width(curve, instrument, direction)
    ]


def _has_width(curve: LoadCurve, instrument: str, direction: str) -> bool:
    widths = read_loop(curve, instrument, direction).widths
    return min(widths) > ROUNDING * float(np.ptp(curve.load))


def write_curves(path: Path, curves: Mapping[tuple[str, str], LoadCurve]) -> None:
    """The points as CSV."""
    write_table(path, curve_rows(curves))


def draw_curves(path: Path, curves: Mapping[tuple[str, str], LoadCurve]) -> None:
    """One panel per instrument, as PNG."""
    figure = Figure(figsize=(13.0, 7.4), layout="constrained")
    for panel, (instrument, labels) in zip(figure.subplots(2, 3).ravel(), LABELS.items(), strict=True):
        for (name, direction), curve in curves.items():
            if name == instrument:
                panel.plot(curve.deformation, curve.load, ".-" if instrument in LOOPS else "o-", label=direction)
        panel.set_xlabel(labels[0])
        panel.set_ylabel(labels[1])
        panel.set_title(instrument.replace("_", " "))
        if instrument in LOOPS:
            panel.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)
            panel.axvline(0.0, color="0.8", linewidth=0.8, zorder=0)
        else:
            reach = max((c.deformation.max() for (name, _), c in curves.items() if name == instrument), default=1.0)
            panel.set_xlim(0.0, 1.1 * reach)
            panel.set_ylim(bottom=0.0)
        if panel.get_legend_handles_labels()[0]:
            panel.legend(fontsize=8)
    write_png(path, figure)


def fabric_text(fabric: Fabric) -> str:
    """The values as they stand in a scene file."""
    return "\n".join(f"{name} = {value:.6g}" for name, value in asdict(fabric).items())


def curves_text(curves: Mapping[tuple[str, str], LoadCurve], figures: Mapping[str, float]) -> str:
    """A line through each curve, and the single figures, among them those of the loops."""
    lines = []
    for (instrument, direction), curve in curves.items():
        if instrument == "compression":
            thickness = ", ".join(
                f"{1e3 * x:.3g} mm at {y:g} Pa" for x, y in zip(curve.deformation, curve.load, strict=True)
            )
            lines.append(f"compression          {thickness}")
            continue
        if instrument in LOOPS:
            continue
        slope = float(curve.deformation @ curve.load / (curve.deformation @ curve.deformation))
        unit = "N m" if instrument == "bending" else "N/m"
        lines.append(f"{instrument:<10} {direction:<9} {slope:.5g} {unit}")
    return "\n".join([*lines, *(f"{name:<25} {value:.4g}" for name, value in figures.items() if not math.isnan(value))])
