"""What a newcomer wants to know of a demo: what was made, how good it is and how fast."""

from __future__ import annotations

import numpy as np

from precompute.learning.pipeline import Precomputed
from precompute.reporting.html_page import Heading, Picture, Section, Text

__all__ = ["duration", "newcomer_sections", "words_of"]

_CAPTION = (
    "The coarse skirt, the truth and ours, each running freely: these part company, so that folds differ in place. "
    "On the right the same learned folds on the truth's own coarse skirt, where they can be held against the truth."
)


def duration(seconds: float) -> str:
    """A time as people say it: 40 s, 3 min."""
    return f"{10.0 * max(1, round(seconds / 10.0)):.0f} s" if seconds < 95.0 else f"{seconds / 60.0:.0f} min"


def words_of(figures: dict[str, float], frame_ms: float) -> tuple[str, ...]:
    """How near to the truth, how fast and how many vertices, in sentences."""
    ours, smooth = figures["normal_error_deg"], figures["normal_error_smooth_deg"]
    return (
        f"Ours is {_nearer(ours, smooth)} than smooth: put on the truth's coarse skirt, its normals are {ours:.1f} "
        f"degrees off, those of smooth {smooth:.1f}.",
        f"A frame takes {frame_ms:.1f} ms of one core; at 60 Hz there are 16.7.",
        f"{figures['coarse_vertex_count']:,.0f} vertices are simulated and {figures['fine_vertex_count']:,.0f} shown.",
    )


def _nearer(ours: float, smooth: float) -> str:
    share = 100.0 * (1.0 - ours / smooth)
    return f"{abs(share):.0f} % {'nearer to' if share >= 0.0 else 'further from'} the truth"


def newcomer_sections(
    learned: Precomputed, frame_ms: float, picture: np.ndarray, seconds: float, better: str
) -> list[Section]:
    """The top of the page: what was made, how good it is and how fast, and the picture.

    Args:
        learned: what came out of learning.
        frame_ms: processor time of a frame, body included [ms].
        picture: uint8, shape (h, w, 3).
        seconds: that all of it took [s].
        better: the better choice, see :func:`runtime.output.database_info.better_choice`.
    """
    database, truth = learned.database, learned.truth
    assert truth is not None and learned.evaluation is not None
    figures = learned.evaluation.figures
    fine, coarse = (f"{figures[f'{kind}_vertex_count']:,.0f}" for kind in ("fine", "coarse"))
    ours, smooth = figures["normal_error_deg"], figures["normal_error_smooth_deg"]
    energy, smooth_energy = figures["bending_energy_ratio"], figures["smooth_bending_energy_ratio"]
    free, free_smooth, floor = (figures[f"{kind}free_normal_error_deg"] for kind in ("", "smooth_", "floor_"))
    slow, share = figures["fine_simulation_ms"], 100.0 * frame_ms * 60.0 / 1000.0
    made = f"""In {duration(seconds)}, from nothing: this machine simulated a {database.fabric_name} skirt of {fine}
vertices on a mannequin that moves ({", ".join(database.trained_on)}), and learned how its folds depend on a coarse
skirt of {coarse} vertices. The mannequin then did what nothing was learned from ({database.held_out[0]}).

Only the coarse skirt is simulated there. "Smooth" is that skirt with its facets rounded off, "ours" has the learned
folds besides, and "truth" is the fine simulation of the same motion. skirt.glb, beside this page, is ours as an
animation (in Blender: File, Import, glTF 2.0)."""
    good = f"""Put on the truth's own coarse skirt, our folds turn the surface {ours:.1f} degrees away from the truth on
average; without them (smooth) it is {smooth:.1f} degrees. So ours is
{_nearer(ours, smooth)}.

Played freely, ours has {100.0 * energy:.0f} % of the truth's bending energy, which measures how many folds there are
and how sharp, and smooth has {100.0 * smooth_energy:.0f} %. Fold by fold nobody can be right there, since folding is
chaotic: a second fine simulation of the same motion is {floor:.1f} degrees off the first, ours {free:.1f} and smooth
{free_smooth:.1f}."""
    fast = f"""A frame of ours takes {frame_ms:.1f} ms on one core of this machine, body included. At 60 frames a second
there are 16.7 ms for everything, so that this skirt takes {share:.0f} % of one core. A frame of the fine simulation
takes {slow:.0f} ms, {slow / frame_ms:.1f} times as long. By the comparison below the better choice for this skirt is
{better}."""
    return [
        Heading("What was made"),
        Text(made),
        Heading("How good it is"),
        Text(good),
        Heading("How fast it is"),
        Text(fast),
        Picture(picture, _CAPTION),
        Heading("Beside other ways"),
    ]
