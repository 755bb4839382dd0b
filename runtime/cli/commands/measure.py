"""`gube measure`: girths and lengths of a body."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "measure girths and lengths of a body as a tape does"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "body",
        metavar="BODY",
        help="a character (glTF, USD) in its bind pose, builtin:mannequin, a vertex sequence (.npz, .mdd, USD) or a "
        "surface (.obj)",
    )


def run(options: argparse.Namespace) -> Report:
    """Measure a body and print every measure."""
    from assets.anthropometry import measure
    from assets.loading import load_standing_body
    from runtime.output.report import Report
    from runtime.output.terminal import say

    measures = measure(load_standing_body(options.body))
    figures = {}
    for name, value in measures.values().items():
        unit, words = ("deg", math.degrees(value)) if name == "shoulder_slope" else ("m", value)
        shown = (
            f"could not be measured: {measures.doubts.get(name, '')}"
            if math.isnan(value)
            else f"{words:8.1f} deg"
            if unit == "deg"
            else f"{words:8.3f} m"
        )
        say(f"{name.replace('_', ' '):22}{shown}")
        figures[f"{name}_{unit}"] = words
    return Report(figures)
