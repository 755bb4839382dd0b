"""`gube bake`: a played wrinkle database as an animation."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_file, add_playback, positive

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "play a wrinkle database and write an animation"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_playback(parser)
    add_output_file(parser, "OUT", "the animation, a file ending in .glb, .usdc, .pc2, .mdd or .obj")
    parser.add_argument(
        "--rate",
        type=positive,
        metavar="HZ",
        default=30.0,
        help="rate of the animation's frames [Hz] (default: %(default)g)",
    )


def run(options: argparse.Namespace) -> Report:
    """Play the first motion that is asked for and write it."""
    from runtime.draw.shown_body import shown_body
    from runtime.export.animation_baking import baked_frames, check_baked, write_baked
    from runtime.output.outputs import check_is_no_source
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say
    from runtime.output.verdict import cost_sentence
    from runtime.setup.garment_setup import scene_of
    from runtime.setup.playback_inputs import open_database
    from wrinkles.levels import garment_vertices

    check_baked(options.output)
    database, inputs = open_database(
        options.database,
        character=options.character,
        clip=options.clip,
        fabric=options.fabric,
        wrinkles=options.wrinkles,
    )
    check_is_no_source(options.output, options.character or scene_of(database))
    motion = inputs.motions[0]
    with Progress(sys.stderr) as progress:
        arguments = database, inputs, motion, options.rate, options.seconds
        player, frames, normals, poses = baked_frames(*arguments, report=progress.later)
        progress.later(f"writing {options.output}")
        faces, body = player.levels.subdivision.faces, shown_body(inputs.body, player.levels)
        garments, texture = garment_vertices(player.levels), database.fine_texture
        write_baked(
            options.output,
            faces,
            frames,
            options.rate,
            normals,
            body=body,
            poses=poses,
            garments=garments,
            texture=texture,
        )
    if player.cloth is not None:
        say(f"{cost_sentence(database.quality)} --wrinkles plays the learned folds.")
    say(f"{motion.name}: {len(frames)} frames of {frames.shape[1]} vertices baked to {options.output}")
    return Report({"frame_count": len(frames), "fine_vertex_count": frames.shape[1]})
