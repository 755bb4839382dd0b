"""`gube export --truth`: a page that shows the fine simulation too.

The arguments are those of :mod:`runtime.cli.commands.export`.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from runtime.cli.commands.export import export_page

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["run"]


def run(options: argparse.Namespace) -> Report:
    """Play the first motion that is asked for, take its fine simulation from the cache or run it, write the page."""
    from collections.abc import Callable

    from assets.motion import Motion
    from precompute.learning.pipeline import default_cache
    from precompute.learning.run_recording import record_runs
    from precompute.learning.truth import database_run
    from runtime.export.recording import TRUTH_HZ, RecordedTruth
    from runtime.setup.playback_inputs import PlaybackInputs
    from wrinkles.database import WrinkleDatabase

    def truth_of(
        database: WrinkleDatabase, inputs: PlaybackInputs, motion: Motion, progress: Callable[[str], None]
    ) -> RecordedTruth:
        run = database_run(database, inputs, motion)
        (recording,) = record_runs([run], default_cache(options.database), 1, report=progress)
        kept = recording.frames % max(1, round(database.frame_rate / TRUTH_HZ)) == 0
        return RecordedTruth(recording.frames[kept], recording.positions[kept])

    return export_page(options, truth_of)
