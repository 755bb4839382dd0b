"""`gube fuzz`: readers fed with broken files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_folder, positive

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "read broken files and tell what gets through"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    files = "good files to break, beside small ones of every kind (default: none)"
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help=files)
    parser.add_argument(
        "--seconds", type=positive, default=30.0, metavar="S", help="time by the clock [s] (default: %(default)g)"
    )
    parser.add_argument(
        "--workers", type=int, choices=range(1, 65), default=1, metavar="N",
        help="number of processes, 1 to 64 [-] (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of all choices [-] (default: %(default)s)"
    )
    add_output_folder(parser, "out/fuzz", "a folder for the files that get through")


def run(options: argparse.Namespace) -> Report:
    """Break files, read them, and list what got through."""
    from precompute.fuzzing.fuzzing import fuzz
    from precompute.fuzzing.readers import write_good_files
    from precompute.scratch import scratch_folder
    from runtime.output.outputs import check_folder
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    check_folder(options.output)
    with scratch_folder() as folder, Progress(sys.stderr) as progress:
        files = [path.absolute() for path in options.files] + write_good_files(folder)
        result = fuzz(
            files, options.output, seconds=options.seconds, workers=options.workers, seed=options.seed, report=progress
        )
    for ending, count in sorted(result.cases.items()):
        say(f"{ending:6} {count:8} cases")
    for escape in result.escapes.values():
        say(f"got through: {escape.problem}: {escape.path}")
    figures = {
        "cases": result.cases.total(),
        "refused_percent": 100.0 * result.refused / max(1, result.cases.total()),
        "lines_reached": len(result.lines),
        "escapes": len(result.escapes),
    }
    say(", ".join(f"{name} {value:g}" for name, value in figures.items()))
    return Report(figures, passed=not result.escapes)
