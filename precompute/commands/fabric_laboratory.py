"""`gube fabric`: a fabric in the instruments of a textile laboratory."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_folder

if TYPE_CHECKING:
    from pbd import Fabric
    from precompute.validation.trial import TrialSetting
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "measure a fabric in the instruments of a textile laboratory, or fit it to measured curves"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "fabric", metavar="NAME|FILE.json", help="name of a preset, or a file with a fabric measured for ARCSim"
    )
    parser.add_argument(
        "--fit",
        type=Path,
        metavar="CURVES.csv",
        help="a file of measured curves; change the fabric so that it follows them (default: measure it as it is)",
    )
    parser.add_argument(
        "--solver",
        metavar="S",
        default="fem-corotational/quasi-static",
        help="name of the solver that moves the cloth (default: %(default)s)",
    )
    add_output_folder(parser, "out/fabric", "a folder for curves and their picture")


def run(options: argparse.Namespace) -> Report:
    """Measure the fabric or fit it; print the figures and draw the curves."""
    from assets.fabrics import load_fabric
    from precompute.validation.trial import TrialSetting
    from runtime.output.outputs import check_folder

    check_folder(options.output)
    fabric, setting = load_fabric(options.fabric), TrialSetting(solver=options.solver)
    options.output.mkdir(parents=True, exist_ok=True)
    if options.fit is not None:
        return _fit(fabric, setting, options.fit, options.output)
    return _measure(fabric, setting, options.output)


def _fit(fabric: Fabric, setting: TrialSetting, curves: Path, output: Path) -> Report:
    from dataclasses import asdict

    from precompute.fabric_lab.fabric_fit import draw_fit, fit_fabric, read_curves
    from precompute.fabric_lab.fabric_report import fabric_text
    from runtime.output.report import Report
    from runtime.output.terminal import say

    fitted, found = fit_fabric(read_curves(curves), fabric, setting)
    draw_fit(output / "fit.png", found)
    say(fabric_text(fitted))
    for curve in found:
        say(f"# {curve.instrument} {curve.direction}: {100.0 * curve.error:.2g} % off")
    say(f"# {output / 'fit.png'}")
    rows = [{"instrument": c.instrument, "direction": c.direction, "error": c.error} for c in found]
    return Report(asdict(fitted), rows)


def _measure(fabric: Fabric, setting: TrialSetting, output: Path) -> Report:
    from precompute.fabric_lab.fabric_report import curve_rows, curves_text, draw_curves, measure_fabric, write_curves
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    with Progress(sys.stderr) as progress:
        curves, figures = measure_fabric(fabric, setting, progress)
    say(curves_text(curves, figures))
    write_curves(output / "curves.csv", curves)
    draw_curves(output / "curves.png", curves)
    say(f"\n{output / 'curves.png'}")
    return Report(figures, curve_rows(curves))
