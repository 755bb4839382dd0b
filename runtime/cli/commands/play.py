"""`gube play`: a wrinkle database played without a window."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from runtime.cli.arguments import add_all, add_output_folder, add_playback, positive

if TYPE_CHECKING:
    from assets.motion import Motion
    from runtime.output.report import Report
    from runtime.setup.playback_inputs import PlaybackInputs
    from wrinkles.database import WrinkleDatabase

__all__ = ["SUMMARY", "add_arguments", "play_motions", "run"]

SUMMARY = "play a wrinkle database without a window"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_playback(parser)
    add_output_folder(parser, "out/play", "a folder for pictures")
    add_all(parser)
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument(
        "--truth",
        action="store_true",
        help="simulate the fine mesh too and compare both in figures and pictures (default: off)",
    )
    mode.add_argument(
        "--loop",
        type=positive,
        metavar="S",
        help="play for so long by the clock, with a gust of wind and without pictures [s] "
        "(default: off, play every frame)",
    )
    parser.add_argument(
        "--hz", type=int, choices=(30, 60), default=60, help="rate of frames of --loop [Hz] (default: %(default)s)"
    )


def run(options: argparse.Namespace) -> Report:
    """Play every motion that is asked for and draw it, or play it by the clock."""
    from runtime.export.free_run import loop_figures, play_motion
    from runtime.output.report import Progress

    def figures_of(database: WrinkleDatabase, inputs: PlaybackInputs, motion: Motion) -> dict[str, Any]:
        if options.loop is not None:
            return dict(loop_figures(database, inputs, motion, options.loop, options.hz))
        with Progress(sys.stderr) as progress:
            progress.later(f"playing {motion.name}")
            return dict(play_motion(database, inputs, motion, options.seconds, options.output))

    return play_motions(options, figures_of)


def play_motions(
    options: argparse.Namespace, figures_of: Callable[[WrinkleDatabase, PlaybackInputs, Motion], dict[str, Any]]
) -> Report:
    """Play every motion that is asked for.

    Args:
        options: of the command.
        figures_of: plays one motion of the cast and returns its figures.
    """
    from assets.extras import require_extra
    from runtime.output.figures import figure_lines
    from runtime.output.outputs import check_folder
    from runtime.output.report import Report, numbers_of, process_age
    from runtime.output.terminal import say
    from runtime.output.verdict import first_lines, verdict
    from runtime.play.plain_cloth import plain_choice
    from runtime.setup.playback_inputs import open_database

    import_s = process_age()
    if options.loop is None:
        check_folder(options.output)
        require_extra("report")
    database, inputs = open_database(
        options.database,
        character=options.character,
        clip=options.clip,
        fabric=options.fabric,
        wrinkles=options.wrinkles,
    )
    is_better = plain_choice(database) is not None
    plain = is_better and not options.truth and not inputs.wrinkles
    lines = [*verdict(database)]
    if is_better:
        lines.append("--wrinkles plays the learned folds." if plain else "Here the learned folds are played.")
    lines_of = figure_lines if options.all else first_lines
    rows: list[dict[str, float | str]] = []
    for motion in inputs.motions:
        rows.append(
            {
                "motion": motion.name,
                "method": "plain cloth" if plain else "wrinkles",
                "import_s": import_s,
                **figures_of(database, inputs, motion),
            }
        )
        say("\n".join([*lines, "", f"{motion.name}:", *lines_of(numbers_of(rows[-1]))]))
        lines = []
        if options.all and "state_hash" in rows[-1]:
            say(f"  state_hash {rows[-1]['state_hash']}")
    if options.loop is None:
        say(f"pictures: {options.output}")
    return Report({name: value for name, value in rows[0].items() if name not in ("motion", "method")}, rows)
