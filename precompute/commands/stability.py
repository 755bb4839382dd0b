"""`gube stability`: where methods fail, and how."""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_folder, add_scheduler

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "draw maps of the settings at which methods fail"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "--method",
        action="append",
        metavar="M",
        help="name of a solver; may be repeated (default: the default solver and an explicit one)",
    )
    parser.add_argument(
        "--cell",
        metavar="MAP:X:Y",
        help="name of a map and coordinates in it; run only this cell and print how it fails (default: all cells)",
    )
    add_scheduler(parser)
    add_output_folder(parser, "out/stability", "a folder for the page")


def run(options: argparse.Namespace) -> Report:
    """Run all cells of the maps and write the page, or run one cell."""
    from precompute.cluster import workers_of
    from precompute.stability.stability_cells import run_cell
    from precompute.stability.stability_maps import chosen_cell
    from precompute.stability.stability_page import cell_row, cell_text, stability_text, write_stability
    from precompute.stability.stability_sweep import METHODS, check_methods, sweep
    from runtime.output.outputs import check_folder
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    if options.cell is not None:
        cell = chosen_cell(options.cell)
        cells = [run_cell(*cell, method) for method in check_methods(options.method or METHODS[:1])]
        say("\n".join(map(cell_text, cells)))
        return Report(cells[0].figures, [cell_row(one) for one in cells])
    check_folder(options.output)
    with Progress(sys.stderr) as progress, workers_of(options.scheduler, os.cpu_count() or 1) as workers:
        found = sweep(options.method or METHODS, workers=workers, report=progress)
        progress("drawing")
        files = write_stability(options.output, found)
    say(stability_text(found))
    say(f"\n{files[0]}")
    return Report(found.figures, [cell_row(cell) for cell in found.cells])
