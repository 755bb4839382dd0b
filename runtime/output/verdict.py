"""What somebody wants to know of a wrinkle database first: three sentences and a few rows, in everyday words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from runtime.output.figures import figure_table, value_texts
from wrinkles.database import WrinkleDatabase

__all__ = ["cost_sentence", "first_lines", "verdict"]


class FirstFigure(NamedTuple):
    """A figure that is shown first.

    Attributes:
        figure: its name in files.
        label: what it is, without a word of the glossary.
        unit: written behind the number.
    """

    figure: str
    label: str
    unit: str


ROWS = (
    FirstFigure("normal_error_deg", "error of the surface's direction", "degrees"),
    FirstFigure("bending_energy_ratio", "strength of the folds, 1 is right", ""),
    FirstFigure("inside_body_percent", "points in the body", "%"),
    FirstFigure("self_crossed_percent", "faces that go through other cloth", "%"),
    FirstFigure("body_seen_px", "skin that shows through the cloth", "pixels"),
    FirstFigure("jitter_px", "jumps from picture to picture", "pixels"),
    FirstFigure("frame_ms_p50", "processor time of a picture", "ms"),
    FirstFigure("frame_ms_p99", "processor time of a slow picture", "ms"),
    FirstFigure("fine_simulation_ms", "the exact simulation's time", "ms"),
    FirstFigure("first_frame_s", "start to first picture", "s"),
)
# Whose figures stand beside a row, by their column in the table of figures.
BESIDE = {"smooth": "without learned folds", "truth": "the exact simulation"}


def verdict(database: WrinkleDatabase) -> tuple[str, str, str]:
    """What a database is, how good it is beside the exact simulation, and what it costs beside other ways.

    None of the sentences has a word that needs the glossary.

    Args:
        database: with the figures that learning and comparing left in it.
    """
    simulated, drawn = len(database.coarse_vertices), database.fine_vertex_count
    what = (
        f"The garment '{database.garment_name}' ({database.fabric_name}) moves in real time: {simulated:,} points are "
        f"simulated, and {drawn:,} are drawn with small folds that were learned from an exact, slow simulation."
    )
    return what, _quality_sentence(database.quality), cost_sentence(database.quality)


def _quality_sentence(quality: Mapping[str, float]) -> str:
    names = "normal_error_deg", "normal_error_smooth_deg", "bending_energy_ratio"
    if any(name not in quality for name in names):
        return "How near they come to it was not measured."
    error, without, strength = (quality[name] for name in names)
    share = 100.0 * (1.0 - error / without)
    change = f"take away {share:.0f} %" if share >= 0.0 else f"add {-share:.0f} %"
    return (
        f"On a motion from which nothing was learned, they {change} of the error of the surface's direction "
        f"({without:.1f} degrees without them, {error:.1f} with them), and the strength of the "
        f"garment's folds is {100.0 * strength:.0f} % of the exact simulation's."
    )


def cost_sentence(quality: Mapping[str, float]) -> str:
    """What a picture costs, whether cloth without learned folds would do as well, and so which of both is played.

    Args:
        quality: figures of a database; `gube compare` leaves in them what other cloth costs.
    """
    ratio = quality.get("cost_advantage")
    if ratio is None:
        time = quality.get("frame_ms_p50")
        cost = "Its cost was not measured" if time is None else f"A picture takes {time:.1f} ms of one processor core"
        return f"{cost}; `gube compare` finds out whether cloth without learned folds would do as well."
    plain_ms = quality["plain_frame_ms"]
    rest = ", smoothed" if quality["plain_passes"] else ""
    cloth = f"{quality['plain_vertex_count']:,.0f} points in {quality['plain_substeps']:.0f} steps{rest}"
    cost = f"A picture takes {plain_ms / ratio:.1f} ms of one processor core"
    if quality["cost_advantage_is_at_least"]:
        return (
            f"{cost}; of the cloths without learned folds that were tried, none is as good up to {plain_ms:.1f} ms "
            f"({cloth}): the learned folds are played."
        )
    if ratio < 1.0:
        return (
            f"{cost}; cloth without learned folds ({cloth}) is as good and takes {plain_ms:.1f} ms: "
            "that cloth is played instead."
        )
    return (
        f"{cost}; the cheapest cloth without learned folds that is as good ({cloth}) takes {plain_ms:.1f} ms: "
        "the learned folds are played."
    )


def first_lines(figures: Mapping[str, float]) -> list[str]:
    """The rows that come first, in everyday words: figures, and beside them those of other ways.

    Args:
        figures: numbers by name, as a database or a played motion has them.
    """
    table, lines = figure_table(figures)[1], []
    for row in ROWS:
        values = table.get(row.figure, {})
        if "ours" not in values:
            continue
        beside = {words: values[column] for column, words in BESIDE.items() if column in values}
        own, *others = value_texts([values["ours"], *beside.values()])
        more = ", ".join(f"{words} {text}" for words, text in zip(beside, others, strict=True))
        unit = f" {row.unit}" if row.unit else ""
        lines.append(f"  {row.label:<36}{own}{unit}" + (f" ({more})" if more else ""))
    return lines
