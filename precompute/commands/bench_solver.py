"""`gube bench solver`: time against stretch on a swinging square."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_folder

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "measure the solver's time and stretch on a swinging square at many settings"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_output_folder(parser, "out/bench", "a folder for solver.html and solver.csv")
    parser.add_argument(
        "--rivals",
        action="store_true",
        help="measure other engines too, from pip install 'gube[rivals]' (default: off)",
    )


def run(options: argparse.Namespace) -> Report:
    """Measure all settings, write page and table."""
    from precompute.benchmarks.solver_bench import bench_rows, bench_solver, bench_verdict, write_bench
    from runtime.output.outputs import check_folder
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    check_folder(options.output)
    with Progress(sys.stderr) as progress:
        bench = bench_solver(report=progress, with_baselines=options.rivals)
    options.output.mkdir(parents=True, exist_ok=True)
    write_bench(options.output, bench)
    say(bench_verdict(bench))
    say(f"\n{options.output / 'solver.html'}")
    return Report(bench.figures(), bench_rows(bench))
