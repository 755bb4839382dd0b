"""`gube bench cluster`: what a scheduler adds to the time of many databases."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from typing import TYPE_CHECKING

from runtime.arguments import add_database

if TYPE_CHECKING:
    from runtime.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "simulate clusters that learn many databases and tell what their scheduler adds"
WORKERS = (10, 100, 1000)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_database(parser)
    parser.add_argument(
        "--databases",
        type=int,
        default=1000,
        metavar="N",
        help="number of databases to learn [-] (default: %(default)s)",
    )


def run(options: argparse.Namespace) -> Report:
    """Let workers sleep for as long as the database took, and print what came of it."""
    from pbd.errors import InputError
    from precompute.benchmarks.cluster import cluster_row, durations
    from precompute.workers import Workers
    from runtime.report import Progress, Report
    from runtime.terminal import say
    from wrinkles.database import read_database

    if options.databases < 1:
        raise InputError("nothing to learn", key="--databases", received=options.databases, expected="at least 1")
    minutes = read_database(options.database).training_minutes
    rows, size = [], options.database.stat().st_size
    with Progress(sys.stderr) as progress:
        for workers in WORKERS:
            progress(f"{workers} workers")
            with Workers(2) as fresh:  # a second cluster in one process did not start
                rows += fresh.run([partial(cluster_row, durations(minutes, options.databases), workers, size)])
    say(f"{options.databases} databases of {minutes:.1f} minutes in the mean, each on one worker:")
    say(f"{'workers':>8}{'hours':>10}{'least':>10}{'busy':>8}{'added':>16}{'a task':>10}{'full at':>10}{'moved':>10}")
    for row in rows:
        added = f"{row['added_s']:.2f} s ({row['added_percent']:.2g} %)"
        say(
            f"{row['workers']:>8}{row['makespan_h']:>10.2f}{row['least_h']:>10.2f}{row['busy_percent']:>6.0f} %"
            f"{added:>16}{row['processor_ms_per_task']:>7.1f} ms"
            f"{row['saturated_workers']:>10.0f}{row['moved_mb']:>7.0f} MB"
        )
    figures = {f"workers{row['workers']}_{name}": row[name] for row in rows for name in ("added_percent", "added_s")}
    return Report(figures, rows)
