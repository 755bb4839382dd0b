"""`gube bench plan`: the planner at work for minutes, beside full detail."""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING

from runtime.arguments import add_database, positive

if TYPE_CHECKING:
    from runtime.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "play a database under the planner and measure the error on screen against full detail"
BUDGET_MS = 16.0
WELL = 99.0  # of the ticks must be within the target [%]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_database(parser)
    parser.add_argument("names", nargs="*", metavar="NAME", help="camera scenes: flight, cuts, pair (default: all)")
    parser.add_argument(
        "--garments",
        type=int,
        metavar="N",
        help="play N of them, each before a camera of its own, and count ticks over the budget [-] (default: one)",
    )
    parser.add_argument(
        "--budget-ms",
        type=positive,
        metavar="MS",
        help=f"only with --garments: time of all of one process in a tick [ms] (default: {BUDGET_MS:g})",
    )
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="only with --garments: processes that share them out [-] (default: one for each core, here "
        f"{os.cpu_count() or 1})",
    )
    parser.add_argument(
        "--seconds", type=positive, metavar="S", default=300.0, help="length of a scene [s] (default: %(default)g)"
    )


def run(options: argparse.Namespace) -> Report:
    """Play the scenes and print a row for each; one that fails or misses the target fails the command.

    With several garments it fails where one burst or more than one tick in a hundred is over the budget.
    """
    from pbd.errors import InputError
    from precompute.planning.group_trial import group_figures
    from precompute.planning.plan_trial import trial_rows, trial_text
    from runtime.report import Progress, Report
    from runtime.terminal import say

    if options.garments is not None:
        if options.names:
            expected = "none beside --garments: each has its own flight"
            raise InputError("scenes of a group", key="NAME", received=options.names, expected=expected)
        workers = (os.cpu_count() or 1) if options.workers is None else options.workers
        budget_ms = BUDGET_MS if options.budget_ms is None else options.budget_ms
        with Progress(sys.stderr) as progress:
            found = group_figures(options.database, options.garments, workers, budget_ms, options.seconds, progress)
        return Report(found, passed=not found["catastrophic"] and found["over_budget_percent"] <= 1.0)
    for key, value in (("--budget-ms", options.budget_ms), ("--workers", options.workers)):
        if value is not None:
            raise InputError("an option of a group", key=key, received=value, expected="--garments N beside it")
    with Progress(sys.stderr) as progress:
        rows = trial_rows(options.database, options.names, options.seconds, progress)
    say(trial_text(rows))
    figures = {f"{row['scene']}_{name}": value for row in rows for name, value in row.items() if name != "scene"}
    well = all(row["catastrophic"] == 0 and row["within_target_percent"] >= WELL for row in rows)
    return Report(figures, rows, passed=well)
