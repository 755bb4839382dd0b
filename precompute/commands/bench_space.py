"""`gube bench space`: how fine the mesh of a garment must be."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.arguments import add_output_file, positive

if TYPE_CHECKING:
    from runtime.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "refine the mesh of a garment until its folds stop changing"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("scene", type=Path, metavar="SCENE", help="a scene file with one garment on one body")
    parser.add_argument(
        "--fabric", action="append", default=[], metavar="NAME", help="a preset; may be repeated (default: the scene's)"
    )
    parser.add_argument(
        "--subdivisions", type=int, choices=(2, 3, 4), default=3, help="of the finest mesh [-] (default: %(default)s)"
    )
    parser.add_argument(
        "--seconds", type=positive, default=2.0, metavar="S", help="of the motion, over 1 [s] (default: %(default)s)"
    )
    add_output_file(parser, "OUT.csv", "a file for the table", "out/bench/space.csv")


def run(options: argparse.Namespace) -> Report:
    """Simulate every fabric on every mesh, write the table and print it."""
    from assets.fabrics import PRESETS
    from assets.io.scene import load_scene
    from pbd.errors import InputError
    from precompute.benchmarks.space import SKIPPED, converged_mesh, measure_meshes, space_rows, space_text
    from precompute.reporting.tables import write_table
    from runtime.outputs import check_file
    from runtime.report import Progress, Report
    from runtime.terminal import say

    check_file(options.output, ".csv")
    for name in options.fabric:
        if name not in PRESETS:
            raise InputError("no such fabric", key="--fabric", received=name, expected="one of " + ", ".join(PRESETS))
    if options.seconds <= SKIPPED + 0.2:
        expected = f"over {SKIPPED + 0.2:g}: the first {SKIPPED:g} s only lead to the clip"
        raise InputError("too short a motion", key="--seconds", received=options.seconds, expected=expected)
    scene = load_scene(options.scene)
    with Progress(sys.stderr) as progress:
        workers = os.cpu_count() or 1
        found = measure_meshes(scene, options.fabric, options.subdivisions, options.seconds, workers, progress)
    rows = space_rows(found)
    write_table(options.output, rows, machine=True)
    say(space_text(found))
    say(options.output)
    figures: dict[str, float | str] = {}
    for fabric in dict.fromkeys(one.fabric for one in found):
        mesh = converged_mesh([one for one in found if one.fabric == fabric])
        figures[f"{fabric}_converged_subdivisions"] = float("nan") if mesh is None else mesh.subdivisions
    return Report(figures, rows)
