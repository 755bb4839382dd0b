"""`gube bench stress`: runs that break cloth engines."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from runtime.cli.arguments import positive

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "run a hanging square through stiff cloth, long frames and bad starts, which break cloth engines"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("names", nargs="*", metavar="NAME", help="names of runs in the table (default: all)")
    parser.add_argument(
        "--solver", metavar="S", default="default", help="name of the solver that is run (default: %(default)s)"
    )
    parser.add_argument(
        "--seconds", type=positive, metavar="S", default=5.0, help="length of a run [s] (default: %(default)g)"
    )


def run(options: argparse.Namespace) -> Report:
    """Run the square and print the verdicts beside those of other engines; any but "ok" fails the command."""
    from precompute.failures.stress import stress_figures, stress_rows, stress_text
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    with Progress(sys.stderr) as progress:
        rows = stress_rows(options.solver, names=options.names, seconds=options.seconds, report=progress)
    say(stress_text(rows))
    return Report(stress_figures(rows), rows, passed=all(row["verdict"] == "ok" for row in rows))
