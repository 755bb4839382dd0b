"""`gube play --truth`: a wrinkle database played beside the fine simulation.

The arguments are those of :mod:`runtime.cli.commands.play`.
"""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING, Any

from runtime.cli.commands.play import play_motions

if TYPE_CHECKING:
    from assets.motion import Motion
    from runtime.output.report import Report
    from runtime.setup.playback_inputs import PlaybackInputs
    from wrinkles.database import WrinkleDatabase

__all__ = ["run"]


def run(options: argparse.Namespace) -> Report:
    """Play every motion that is asked for, simulate the fine mesh in it and draw both."""

    def figures_of(database: WrinkleDatabase, inputs: PlaybackInputs, motion: Motion) -> dict[str, Any]:
        return _beside_truth(options, database, inputs, motion)

    return play_motions(options, figures_of)


def _beside_truth(
    options: argparse.Namespace, database: WrinkleDatabase, inputs: PlaybackInputs, motion: Motion
) -> dict[str, Any]:
    """Figures of a motion beside the fine simulation, and pictures of both."""
    from precompute.learning.evaluation import evaluate
    from precompute.learning.pipeline import default_cache
    from precompute.learning.truth import database_run, truth_of
    from precompute.wrinkle_comparison.baselines import player_times, typical_ms
    from runtime.draw.shown_body import shown_body
    from runtime.draw.strips import draw_strips
    from runtime.export.free_run import posed_bodies
    from runtime.output.report import Progress

    run = database_run(database, inputs, motion)
    with Progress(sys.stderr) as progress:
        truth = truth_of(run, default_cache(options.database), os.cpu_count() or 1, progress)
        if options.seconds is not None:
            truth = truth.until(options.seconds)
        evaluation = evaluate(database, truth, default_cache(options.database), progress)
        figures: dict[str, Any] = dict(evaluation.figures)
        ours_ms, _ = player_times(database, truth)
        figures["frame_cpu_ms"] = typical_ms(ours_ms)
        progress("drawing")
        numbers = truth.recording.frames
        shown = numbers % 10 == 0
        free = evaluation.free
        columns = {"smooth": free.smooth[shown], "truth": truth.frames[shown], "ours": free.frames[shown]}
        subdivision = run.levels.subdivision
        garment = (subdivision.faces, subdivision.flat_corners(inputs.pattern), run.levels.fine_layer)
        body = shown_body(inputs.body, run.levels)
        bodies = posed_bodies(body, run.poses[numbers[shown]])
        draw_strips(options.output, motion.name, columns, *garment, bodies, body.faces, numbers[shown], run.dt)
    return figures | {"state_hash": free.state_hash}
