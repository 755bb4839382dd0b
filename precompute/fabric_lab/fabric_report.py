"""`gube fabric`: one fabric in all instruments of the laboratory, or fitted to measured curves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pbd import Fabric
from pbd.storage import replacing
from precompute.fabric_lab.laboratory import (
    DIRECTIONS,
    LoadCurve,
    bending_curve,
    compression_curve,
    friction_coefficient,
    shear_curve,
    tension_curve,
)
from precompute.reporting.tables import write_table
from precompute.validation.drape_rows import cusick_drape
from precompute.validation.trial import TrialSetting

__all__ = ["curve_rows", "curves_text", "draw_curves", "fabric_text", "measure_fabric", "write_curves"]

STRAINS = (0.005, 0.01, 0.02)
FAR_STRAINS = (*STRAINS, 0.05, 0.10, 0.17)  # of a fabric that stiffens
SHEARS = (0.01, 0.04)  # [rad]
CURVATURES = (50.0, 100.0)  # [1/m]
PRESSURES = (50.0, 500.0, 2000.0, 5000.0)  # [Pa]
LABELS = {
    "tension": ("strain", "tension [N/m]"),
    "shear": ("shear [rad]", "shear force [N/m]"),
    "bending": ("curvature [1/m]", "moment per width [N]"),
    "compression": ("thickness [m]", "pressure [Pa]"),
}


def measure_fabric(
    fabric: Fabric, setting: TrialSetting, report: Callable[[str], None] = lambda line: None
) -> tuple[dict[tuple[str, str], LoadCurve], dict[str, float]]:
    """Curves of a fabric by instrument and direction, and single figures.

    Args:
        fabric: SI values.
        setting: solver and resolution of the samples. What finds equilibria alone gives way to the default solver where
            cloth slides or lies on a plate.
        report: called with a line of progress.
    """
    moving = TrialSetting(edges=setting.edges) if setting.solver.endswith("quasi-static") else setting
    strains = FAR_STRAINS if fabric.stiffening().any() else STRAINS
    curves = {}
    for direction, angle in DIRECTIONS.items():
        report(f"tension, shear and bending along the {direction}")
        curves["tension", direction] = tension_curve(setting, fabric, angle, strains)
        curves["shear", direction] = shear_curve(setting, fabric, angle, SHEARS)
        curves["bending", direction] = bending_curve(setting, fabric, angle, CURVATURES)
    report("compression, friction, drape")
    curves["compression", "normal"] = compression_curve(moving, fabric, PRESSURES)
    figures = {
        "friction": friction_coefficient(moving, fabric)[0],
        "gravity_length_m": fabric.gravity_length,
        "cusick_drape_coefficient": cusick_drape(moving, fabric.gravity_length)[0],
    }
    return curves, figures


def curve_rows(curves: Mapping[tuple[str, str], LoadCurve]) -> list[dict[str, float | str]]:
    """One row per point: what :func:`precompute.fabric_lab.fabric_fit.read_curves` reads."""
    return [
        {"instrument": instrument, "direction": direction, "deformation": float(x), "load": float(y)}
        for (instrument, direction), curve in curves.items()
        for x, y in zip(curve.deformation, curve.load, strict=True)
    ]


def write_curves(path: Path, curves: Mapping[tuple[str, str], LoadCurve]) -> None:
    """The points as CSV."""
    write_table(path, curve_rows(curves))


def draw_curves(path: Path, curves: Mapping[tuple[str, str], LoadCurve]) -> None:
    """One panel per instrument, as PNG."""
    figure = Figure(figsize=(16.0, 3.8), layout="constrained")
    for panel, (instrument, labels) in zip(figure.subplots(1, len(LABELS)), LABELS.items(), strict=True):
        for (name, direction), curve in curves.items():
            if name == instrument:
                panel.plot(curve.deformation, curve.load, "o-", label=direction)
        panel.set_xlabel(labels[0])
        panel.set_ylabel(labels[1])
        panel.set_title(instrument)
        panel.set_xlim(
            0.0, 1.1 * max((c.deformation.max() for (name, _), c in curves.items() if name == instrument), default=1.0)
        )
        panel.set_ylim(bottom=0.0)
        if panel.lines:
            panel.legend(fontsize=8)
    with replacing(path) as beside, open(beside, "wb") as file:
        FigureCanvasAgg(figure).print_png(file)


def fabric_text(fabric: Fabric) -> str:
    """The values as they stand in a scene file."""
    return "\n".join(f"{name} = {value:.6g}" for name, value in asdict(fabric).items())


def curves_text(curves: Mapping[tuple[str, str], LoadCurve], figures: Mapping[str, float]) -> str:
    """A line through each curve and the single figures."""
    lines = []
    for (instrument, direction), curve in curves.items():
        if instrument == "compression":
            thickness = ", ".join(
                f"{1e3 * x:.3g} mm at {y:g} Pa" for x, y in zip(curve.deformation, curve.load, strict=True)
            )
            lines.append(f"compression          {thickness}")
            continue
        slope = float(curve.deformation @ curve.load / (curve.deformation @ curve.deformation))
        unit = "N m" if instrument == "bending" else "N/m"
        lines.append(f"{instrument:<10} {direction:<9} {slope:.5g} {unit}")
    return "\n".join([*lines, *(f"{name:<25} {value:.4g}" for name, value in figures.items() if not math.isnan(value))])
