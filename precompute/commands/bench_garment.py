"""`gube bench garment`: the same garment on the same body in other engines."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_folder, positive

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "play garments on their moving bodies by other engines beside ours: time and errors"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("databases", nargs="+", type=Path, metavar="DB.h5", help="databases of the garments")
    add_output_folder(parser, "out/bench", "a folder for tables (NAME.csv, NAME_tries.csv), charts and pictures")
    parser.add_argument(
        "--rivals",
        action="store_true",
        help="play by other engines too, from pip install 'gube[rivals]' (default: off)",
    )
    parser.add_argument(
        "--seconds",
        type=positive,
        metavar="S",
        default=4.0,
        help="of the first held-out motion, at most [s] (default: %(default)g)",
    )


def run(options: argparse.Namespace) -> Report:
    """Play everything, write tables and pictures."""
    from precompute.benchmarks.garment_bench import bench_garments, bench_text, write_garments
    from precompute.wrinkle_comparison.compare_database import check_motions
    from runtime.output.outputs import check_folder
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    check_folder(options.output)
    for path in options.databases:
        check_motions(path, seconds=options.seconds)
    with Progress(sys.stderr) as progress:
        benches = bench_garments(options.databases, rivals=options.rivals, seconds=options.seconds, report=progress)
    options.output.mkdir(parents=True, exist_ok=True)
    write_garments(options.output, benches)
    say("\n\n".join(bench_text(one) for one in benches))
    say(f"\nwritten to {options.output}")
    return Report({}, [row for one in benches for row in one.rows()])
