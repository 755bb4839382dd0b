"""`gube export`: a played wrinkle database as a page that decodes the wrinkles live in a browser."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.arguments import add_motion

if TYPE_CHECKING:
    from runtime.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "write a page that plays a wrinkle database in a browser"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_motion(parser)
    parser.add_argument(
        "-o", dest="output", type=Path, required=True, metavar="PAGE", help="a folder for the page (required)"
    )


def run(options: argparse.Namespace) -> Report:
    """Play the first motion that is asked for, record it and write the page."""
    import sys

    from runtime.info import better_choice
    from runtime.outputs import check_folder
    from runtime.page import check_page_folder, page_text, write_page
    from runtime.plain_player import plain_choice
    from runtime.play import open_database
    from runtime.recording import record
    from runtime.report import Progress, Report

    check_page_folder(options.output)
    check_folder(options.output)
    database, inputs = open_database(
        options.database, character=options.character, clip=options.clip, fabric=options.fabric
    )
    motion = inputs.motions[0]
    if plain_choice(database) is not None:
        print(f"the page shows the wrinkles; the better choice is {better_choice(database.quality)}")
    about = page_text(database, motion.name)
    with Progress(sys.stderr) as progress:
        recording, figures = record(database, inputs, motion, options.seconds, about, progress)
    figures["page_mb"] = write_page(options.output, recording) / 1e6
    print(
        f"{motion.name}: {figures['frame_count']:.0f} frames of {figures['fine_vertex_count']:.0f} vertices, "
        f"{figures['page_mb']:.2f} MB\n"
        f"decoded vertices are within {figures['decoded_off_mm']:.2f} mm of the player's "
        f"({figures['uncorrected_off_mm']:.2f} mm without corrections of contact)\n"
        f"open {options.output / 'index.html'} in a browser"
    )
    return Report(figures)
