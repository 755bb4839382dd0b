"""`gube export`: a played wrinkle database as a page that shows it in a browser."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_motion

if TYPE_CHECKING:
    from assets.motion import Motion
    from runtime.export.recording import RecordedTruth
    from runtime.output.report import Report
    from runtime.setup.playback_inputs import PlaybackInputs
    from wrinkles.database import WrinkleDatabase

    FindTruth = Callable[[WrinkleDatabase, PlaybackInputs, Motion, Callable[[str], None]], RecordedTruth]

__all__ = ["SUMMARY", "add_arguments", "export_page", "run"]

SUMMARY = "write a page that plays a wrinkle database in a browser"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_motion(parser)
    parser.add_argument(
        "-o", dest="output", type=Path, required=True, metavar="PAGE", help="a folder for the page (required)"
    )
    parser.add_argument(
        "--truth",
        action="store_true",
        help="show the fine simulation too; it is run if it is not recorded yet (default: off)",
    )


def run(options: argparse.Namespace) -> Report:
    """Play the first motion that is asked for, record it and write the page."""
    return export_page(options)


def export_page(options: argparse.Namespace, find_truth: FindTruth | None = None) -> Report:
    """Play the first motion that is asked for, record it and write the page.

    Args:
        options: of the command.
        find_truth: gives the fine simulation of a motion; None leaves it out.
    """
    import sys

    from runtime.export.page import check_page_folder, page_text, write_page
    from runtime.export.recording import record
    from runtime.output.outputs import check_folder
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say
    from runtime.output.verdict import cost_sentence
    from runtime.play.plain_cloth import plain_choice
    from runtime.setup.playback_inputs import open_database

    check_page_folder(options.output)
    check_folder(options.output)
    database, inputs = open_database(
        options.database, character=options.character, clip=options.clip, fabric=options.fabric
    )
    motion = inputs.motions[0]
    if plain_choice(database) is not None:
        say(f"{cost_sentence(database.quality)} The page shows the learned folds.")
    about = page_text(database, motion.name)
    with Progress(sys.stderr) as progress:
        truth = None if find_truth is None else find_truth(database, inputs, motion, progress)
        recording, figures = record(database, inputs, motion, options.seconds, about, progress, truth=truth)
    figures["page_mb"] = write_page(options.output, recording) / 1e6
    if figures.get("truth_frame_count") == 0:
        say("the truth is left out: with it the page would be larger than 6 MB for ten seconds")
    say(
        f"{motion.name}: {figures['frame_count']:.0f} frames of {figures['fine_vertex_count']:.0f} vertices, "
        f"{figures['page_mb']:.2f} MB\n"
        f"decoded vertices are within {figures['decoded_off_mm']:.2f} mm of the player's\n"
        f"open {options.output / 'index.html'} in a browser"
    )
    return Report(figures)
