"""`gube view --truth`: a database in the browser beside the fine simulation.

The arguments are those of :mod:`runtime.cli.commands.view`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.commands.view import view

if TYPE_CHECKING:
    from runtime.output.report import Report
    from runtime.setup.playback_inputs import PlaybackInputs
    from runtime.viewer.garments import ShownTruth
    from wrinkles.database import WrinkleDatabase

__all__ = ["run"]


def run(options: argparse.Namespace) -> Report:
    """Find or simulate the fine runs, then serve until the command is interrupted."""
    return view(options, _recorded_truths)


def _recorded_truths(path: Path, database: WrinkleDatabase, inputs: PlaybackInputs) -> Mapping[str, ShownTruth]:
    """The fine simulation of each motion, from the runs that are kept beside the database."""
    from precompute.learning.pipeline import default_cache
    from precompute.learning.run_recording import record_runs
    from precompute.learning.truth import database_run
    from runtime.output.report import Progress
    from runtime.viewer.garments import ShownTruth

    runs = [database_run(database, inputs, motion) for motion in inputs.motions]
    with Progress(sys.stderr) as progress:
        recordings = record_runs(runs, default_cache(path), report=progress)
    return {run.name: ShownTruth(one.frames, one.positions) for run, one in zip(runs, recordings, strict=True)}
