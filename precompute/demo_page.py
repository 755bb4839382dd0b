"""What a newcomer wants to know of a demo: what was made, how good it is and how fast."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from precompute.learning.pipeline import Precomputed
from precompute.reporting.html_page import Heading, Picture, Section, Text
from runtime.output.verdict import verdict
from wrinkles.database import WrinkleDatabase

__all__ = ["duration", "newcomer_sections"]

_CAPTION = (
    "The coarse skirt, the truth and ours, each running freely: these part company, so that folds differ in place. "
    "On the right the same learned folds on the truth's own coarse skirt, where they can be held against the truth."
)


def duration(seconds: float) -> str:
    """A time as people say it: 40 s, 3 min."""
    return f"{10.0 * max(1, round(seconds / 10.0)):.0f} s" if seconds < 95.0 else f"{seconds / 60.0:.0f} min"


def newcomer_sections(
    learned: Precomputed, database: WrinkleDatabase, film: Path, picture: np.ndarray, seconds: float
) -> list[Section]:
    """The top of the page: three sentences, the film and the picture, and how they came about.

    Args:
        learned: what came out of learning.
        database: the same with what the comparison found.
        film: a WebP file.
        picture: uint8, shape (h, w, 3).
        seconds: that all of it took [s].
    """
    assert learned.evaluation is not None
    figures = learned.evaluation.figures
    free, free_smooth, floor = (figures[f"{kind}free_normal_error_deg"] for kind in ("", "smooth_", "floor_"))
    made = f"""In {duration(seconds)}, from nothing: this machine simulated a {database.fabric_name} skirt of
{database.fine_vertex_count:,} vertices on a mannequin that moves ({", ".join(database.trained_on)}), and learned how
its folds depend on a coarse skirt of {len(database.coarse_vertices):,} vertices. The mannequin then did what nothing
was learned from ({database.held_out[0]}).

Only the coarse skirt is simulated there. "Smooth" is that skirt with its facets rounded off, "ours" has the learned
folds besides, and "truth" is the fine simulation of the same motion, which takes {figures["fine_simulation_ms"]:.0f} ms
a frame; at 60 frames a second there are 16.7. skirt.glb, beside this page, is ours as an animation (in Blender: File,
Import, glTF 2.0)."""
    good = f"""The error of the surface's direction is measured with the folds put on the truth's own coarse skirt.
Played freely, fold by fold nobody can be right, since folding is chaotic: a second fine simulation of the same motion
is {floor:.1f} degrees off the first, ours {free:.1f} and smooth {free_smooth:.1f}. There the strength of folds, their
bending energy, is compared, which grows with the number of folds and their sharpness."""
    return [
        Text("\n\n".join(verdict(database))),
        Picture(film, "The coarse skirt, the truth and ours on the walk that nothing was learned from."),
        Picture(picture, _CAPTION),
        Heading("How it was made"),
        Text(made),
        Heading("How it was measured"),
        Text(good),
        Heading("Beside other ways"),
    ]
