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


def run(options: argparse.Namespace) -> Report:
    """Learn, play, compare and draw; print where the results are."""
    from precompute.demo import run_demo
    from runtime.outputs import check_folder
    from runtime.report import Progress, Report

    check_folder(options.output)
    with Progress(sys.stderr) as progress:
        figures = run_demo(options.output, report=progress)
    out = options.output
    print(f"page:      {out / 'index.html'}")
    print(f"picture:   {out / 'demo.png'} (coarse | truth | ours)")
    print(f"animation: {out / 'skirt.glb'} (Blender: File, Import, glTF)")
    print(f"database:  {out / 'skirt.h5'}")
    print(f"next: gube info {out / 'skirt.h5'}")
    print(f"      gube play {out / 'skirt.h5'} --loop 60 --hz 60")
    return Report(figures)
