"""`gube bench frame`: the parts of a frame beside their limits on this machine."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_database, positive

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "time the parts of a frame of a database and of plain cloth beside this machine's limits"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_database(parser)
    parser.add_argument(
        "--seconds", type=positive, metavar="S", default=3.0, help="motion that is played [s] (default: %(default)g)"
    )
    parser.add_argument(
        "--against",
        type=Path,
        metavar="CHECKOUT",
        help="also play it in turns with the code in another folder and print only the times of both (default: none)",
    )
    parser.add_argument(
        "--against-database",
        type=Path,
        metavar="DB.h5",
        help="the database that the code in the other folder plays: one of its own (default: the same)",
    )


def run(options: argparse.Namespace) -> Report:
    """Play the database and plain cloth, and print the tables."""
    from pbd import InputError
    from precompute.benchmarks.frame import bench_frame, frame_text
    from precompute.benchmarks.frame_turns import compare_frames
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    if options.against_database is not None and options.against is None:
        received = str(options.against_database)
        raise InputError("nothing plays it", key="--against-database", received=received, expected="--against as well")
    if options.against is not None:
        with Progress(sys.stderr) as progress:
            comparison = compare_frames(
                options.database, options.against, options.seconds, progress, other_path=options.against_database
            )
        say(comparison.text())
        return Report(comparison.figures())
    with Progress(sys.stderr) as progress:
        bench = bench_frame(options.database, options.seconds, progress)
    say(frame_text(bench))
    return Report(bench.figures(), bench.rows())
