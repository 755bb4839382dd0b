"""`gube bench clips`: real garments on real clips."""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_file, add_scheduler

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "simulate real garments on real clips: contact with the body, layers, speed and time"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("names", nargs="*", metavar="NAME", help="names of clips in the table (default: all)")
    add_scheduler(parser)
    add_output_file(parser, "OUT.csv", "a file for the table; the pictures come beside it", "out/bench/clips.csv")


def run(options: argparse.Namespace) -> Report:
    """Simulate the clips, write the table and print it."""
    from precompute.benchmarks.clips import MAX_OVER_LIMBS, clip_rows, write_clips
    from precompute.cluster import workers_of
    from runtime.output.outputs import check_file
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    check_file(options.output, ".csv")
    count = 1 if options.scheduler is None else os.cpu_count() or 1
    with Progress(sys.stderr) as progress, workers_of(options.scheduler, count) as workers:
        rows = clip_rows(options.names, report=progress, pictures=options.output.parent, workers=workers)
    write_clips(options.output, rows)
    for row in rows:
        say(row["clip"])
        say("\n".join(f"    {name} {value:.4g}" for name, value in row.items() if name != "clip"))
    say(options.output)
    figures = {f"{row['clip']}_{name}": value for row in rows for name, value in row.items() if name != "clip"}
    well = all(
        row["finite"] == 1.0
        and row["inside_s"] <= 0.5
        and row["crossings_layers"] == 0.0
        and row["catastrophic_frames"] == 0.0
        and row["speed_over_limb"] < MAX_OVER_LIMBS
        for row in rows
    )
    return Report(figures, rows, passed=well)
