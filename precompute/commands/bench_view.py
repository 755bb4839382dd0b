"""`gube bench view`: how many pictures of the viewer reach a browser."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from runtime.arguments import add_database, positive

if TYPE_CHECKING:
    from runtime.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "count the pictures that the viewer sends to one client, and to several, slow ones among them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_database(parser)
    parser.add_argument(
        "--seconds",
        type=positive,
        metavar="S",
        default=60.0,
        help="time with one client, over which the growth of the memory is measured [s] (default: %(default)g)",
    )


def run(options: argparse.Namespace) -> Report:
    """Play the database's wrinkles to clients that draw nothing, and print the figures."""
    from precompute.benchmarks.viewer import bench_viewer
    from runtime.figures import figure_lines
    from runtime.report import Progress, Report
    from runtime.terminal import say

    with Progress(sys.stderr) as progress:
        figures = bench_viewer(options.database, options.seconds, progress)
    say("\n".join(figure_lines(figures)))
    return Report(figures)
