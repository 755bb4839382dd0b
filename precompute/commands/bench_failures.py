"""`gube bench failures`: scenes in which cloth engines are known to fail."""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_file, add_scheduler

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "run the scenes in which cloth engines are known to fail"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "--solver", metavar="S", help="name of the only solver that is run (default: default and the classic ones)"
    )
    add_scheduler(parser)
    add_output_file(parser, "OUT.csv", "a file for the table of all runs", "out/bench/failures.csv")


def run(options: argparse.Namespace) -> Report:
    """Run the scenes and print the class of error in which each method ends."""
    from precompute.cluster import workers_of
    from precompute.failures.failures import CLASSIC, all_failure_rows, failure_table, write_failures
    from runtime.output.outputs import check_file
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    check_file(options.output, ".csv")
    solvers = (options.solver,) if options.solver else ("default", *CLASSIC)
    with Progress(sys.stderr) as progress, workers_of(options.scheduler, os.cpu_count() or 1) as workers:
        rows = all_failure_rows(solvers, workers, progress)
    write_failures(options.output, rows)
    say(f"{failure_table(rows)}\n\n{options.output}")
    ours = [row for row in rows if row["solver"] == "default"]
    catastrophic = [row for row in rows if row["class"] == "catastrophic"]
    figures = {
        "failure_scenes": float(len(rows)),
        "catastrophic_scenes": float(len(catastrophic)),
        "catastrophic_scenes_default": float(sum(row in catastrophic for row in ours)),
        "late_scenes_default": float(sum(row["recovered_s"] > 1.0 for row in ours)),
    }
    late = figures["catastrophic_scenes_default"] + figures["late_scenes_default"]
    return Report(figures, rows, passed=late == 0.0)
