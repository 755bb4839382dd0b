"""`gube demo`: everything once, on the built-in scene."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from runtime.arguments import add_output_folder

if TYPE_CHECKING:
    from runtime.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "learn the built-in skirt, play it and write a page with pictures"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_output_folder(parser, "out/demo", "a folder for the page, the pictures, the animation and the database")
    parser.add_argument(
        "--full",
        action="store_true",
        help="learn from more motion and compare more ways, in a quarter of an hour (default: off, three minutes)",
    )


def run(options: argparse.Namespace) -> Report:
    """Learn, play, compare and draw; say what will be done, and print where the results are."""
    from precompute.demo import FULL, SHORT, introduction, run_demo
    from runtime.outputs import check_folder
    from runtime.report import Progress, Report

    check_folder(options.output)
    demo = FULL if options.full else SHORT
    print(introduction(demo, options.output), flush=True)
    with Progress(sys.stderr) as progress:
        made = run_demo(options.output, demo, say=progress.say, report=progress)
    print("\n".join(made.words))
    print(f"page:      {made.page}")
    print(f"picture:   {made.picture} (coarse | truth | ours | ours on the truth's own coarse skirt)")
    print(f"animation: {made.animation} (Blender: File, Import, glTF)")
    print(f"database:  {made.database}")
    print(f"next: gube view {made.database}")
    print(f"      gube info {made.database}")
    print(f"      gube play {made.database} --loop 60 --hz 60")
    return Report(made.figures)
