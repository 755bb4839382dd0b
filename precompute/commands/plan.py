"""`gube plan`: the cheapest detail of a garment that a scene's camera does not tell from the full one."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_folder, angle, positive

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "choose the cheapest level of detail whose error on screen is small enough"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "source", type=Path, metavar="DB.h5|SCENE.toml", help="a wrinkle database, or a scene to learn one from"
    )
    parser.add_argument(
        "--budget-ms",
        type=positive,
        metavar="MS",
        default=2.0,
        help="time of all garments in a frame [ms] (default: %(default)g)",
    )
    parser.add_argument(
        "--target",
        choices=("imperceptible", "accepted"),
        default="imperceptible",
        help="name of the largest error on screen: imperceptible is 1 px, accepted is 10 px (default: %(default)s)",
    )
    parser.add_argument(
        "--distance", type=positive, metavar="M", help="from the camera to the garment [m] (default: as in the scene)"
    )
    parser.add_argument(
        "--fov", type=angle, metavar="DEG", help="vertical field of view [deg] (default: as in the scene)"
    )
    parser.add_argument(
        "--garments",
        type=int,
        metavar="N",
        default=1,
        help="number of equal garments that share the budget [-] (default: %(default)s)",
    )
    add_output_folder(parser, "out/plan", "a folder for the database that is learned from a scene")


def run(options: argparse.Namespace) -> Report:
    """Plan for the camera of a scene and print the choice with its reason."""
    from precompute.planning.planning import plan_file, plan_rows, plan_text
    from runtime.detail.planner import TARGETS
    from runtime.output.outputs import check_folder
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    check_folder(options.output)
    with Progress(sys.stderr) as progress:
        found = plan_file(
            options.source,
            options.output,
            target_px=TARGETS[options.target],
            budget_ms=options.budget_ms,
            distance=options.distance,
            field_of_view_deg=options.fov,
            garments=options.garments,
            report=progress,
        )
    say(plan_text(found))
    return Report(found.figures, plan_rows(found))
