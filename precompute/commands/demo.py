"""`gube demo`: everything once, on the built-in scene."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_folder

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "learn the built-in skirt, play it and write a page with pictures"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_output_folder(parser, "out/demo", "a folder for the page, the pictures, the animation and the database")
    parser.add_argument(
        "--full",
        action="store_true",
        help="learn from more motion and compare more ways, in a quarter of an hour (default: off, six minutes)",
    )


def run(options: argparse.Namespace) -> Report:
    """Learn, play, compare and draw; say what will be done, and print where the results are."""
    from precompute.demo_run import FULL, SHORT, introduction, run_demo
    from runtime.output.outputs import check_folder
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    check_folder(options.output)
    demo = FULL if options.full else SHORT
    say(introduction(demo, options.output))
    with Progress(sys.stderr) as progress:
        made = run_demo(options.output, demo, say=progress.say, report=progress)
    say("\n".join(made.words))
    say(f"page:      {made.page}")
    say(f"picture:   {made.picture} (coarse | truth | ours | ours on the truth's own coarse skirt)")
    say(f"film:      {made.film} (coarse | truth | ours)")
    say(f"animation: {made.animation} (Blender: File, Import, glTF)")
    say(f"database:  {made.database}")
    say(f"next: gube view {made.database}")
    say(f"      gube info {made.database}")
    say(f"      gube play {made.database} --loop 60 --hz 60")
    return Report(made.figures)
