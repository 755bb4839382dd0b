"""`gube validate`: the solvers held against physics whose result is known."""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_folder, edge_count

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "test the solvers against physics whose result is known"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("names", nargs="*", metavar="NAME", help="names of tests in the table (default: all)")
    parser.add_argument("--solver", metavar="S", help="name of the only solver that is tested (default: all solvers)")
    parser.add_argument(
        "--resolution",
        type=edge_count,
        metavar="N",
        help="number of edges along the length, 4 to 400 [-] (default: both 20 and 40)",
    )
    parser.add_argument(
        "--param",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="a parameter of the test in SI units; may be repeated (default: as in the table)",
    )
    add_output_folder(parser, "out/validate", "a folder for pictures of the curves")


def run(options: argparse.Namespace) -> Report:
    """Run the tests, print the table and draw the curves."""
    from precompute.validation.validation import chosen_rows, result_row, validate_all, validation_text
    from precompute.validation.validation_pictures import draw_results
    from runtime.output.outputs import check_folder
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    check_folder(options.output)
    tests = chosen_rows(options.names, options.param, options.solver)
    with Progress(sys.stderr) as progress:
        results = validate_all(tests, options.solver, options.resolution, os.cpu_count() or 1, progress)
    say(validation_text(results))
    for path in draw_results(options.output, results):
        say(path)
    rows = [result_row(result) for result in results]
    figures = {
        "tests": len(rows),
        "passed_best": sum(row["passed_best"] for row in rows),
        "passed_realtime": sum(row["passed_realtime"] for row in rows),
    }
    return Report(figures, rows, passed=all(row["passed_best"] and row["passed_realtime"] for row in rows))
