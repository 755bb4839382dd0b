"""`gube simulate`: the garment of a scene, simulated and baked."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.arguments import positive

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "simulate the garments of a scene and write an animation"
NO_BODY_SECONDS = 5.0  # of a garment without a body [s]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("scene", type=Path, metavar="SCENE", help="a scene file (.toml)")
    parser.add_argument(
        "-o",
        dest="output",
        type=Path,
        metavar="OUT",
        help="the animation, a file ending in .glb, .usdc, .pc2, .mdd or .obj (default: out/SCENE.glb)",
    )
    parser.add_argument(
        "--seconds",
        type=positive,
        metavar="S",
        help=f"length of the animation [s] (default: all of the motion; {NO_BODY_SECONDS:g} without a body)",
    )
    parser.add_argument(
        "--fine", action="store_true", help="simulate the subdivided mesh (default: off, simulate the coarse mesh)"
    )
    parser.add_argument(
        "--explain", action="store_true", help="print the scene with all defaults and simulate nothing (default: off)"
    )


def run(options: argparse.Namespace) -> Report:
    """Simulate a scene and write the animation, or only print the scene."""
    from assets.io.scene import load_scene, scene_text
    from runtime.output.figures import figure_lines
    from runtime.output.outputs import check_is_no_source
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    scene = load_scene(options.scene)
    from runtime.setup.garment_mesh import texture_of, with_subdivisions
    from runtime.setup.scene_body import body_of
    from runtime.setup.scene_simulation import garments_of, simulation_of

    if options.explain:
        say(scene_text(with_subdivisions(scene)).removesuffix("\n"), verbatim=True)
        return Report()
    from runtime.export.animation_baking import check_baked, clip_begin, simulated_frames, write_baked

    output = options.output or Path("out") / f"{options.scene.stem}.glb"
    check_baked(output)
    check_is_no_source(output, scene)
    body = None if scene.character is None else body_of(scene)  # as it is before its file changes
    openings: list[str] = []
    with Progress(sys.stderr) as progress:
        progress.later(f"setting up {options.scene}")
        simulation, motion = simulation_of(scene, options.fine, report=openings.append)
        longest = NO_BODY_SECONDS if motion is None else motion.duration - clip_begin(motion)
        seconds = longest if options.seconds is None else min(options.seconds, longest if motion else math.inf)
        frames, poses, rate, figures = simulated_frames(simulation, motion, scene, seconds, progress.later)
        faces, garments, texture = (
            simulation.model.mesh.faces,
            garments_of(scene, simulation),
            texture_of(scene, options.fine),
        )
        write_baked(output, faces, frames, rate, body=body, poses=poses, garments=garments, texture=texture)
    say("\n".join([*openings, *figure_lines(figures), f"baked to {output}"]))
    return Report(figures)
