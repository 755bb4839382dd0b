"""Figures by which garments are judged: their names, units and meaning, and tables of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

__all__ = ["FIRST", "Label", "figure_lines", "figure_of", "figure_table", "value_texts"]


class Label(NamedTuple):
    """A figure in words.

    Attributes:
        label: its name in plain words.
        unit: "-" for a share, a ratio or a count.
        meaning: what is measured.
    """

    label: str
    unit: str
    meaning: str


RIVALS = ("chance", "smooth", "floor", "truth")  # prefixes of figures that stand beside ours
FIGURES = {
    "normal_error_deg": Label(
        "normal error", "deg", "angle between our normals and the truth's, given the truth's coarse state"
    ),
    "normal_skill": Label("normal error removed", "-", "share of smooth's normal error that is removed: 0 none, 1 all"),
    "normal_correlation_p50": Label(
        "correlation of wrinkles, median frame",
        "-",
        "correlation of wrinkles with the truth's: 1 the same, 0 unrelated; median frame",
    ),
    "normal_correlation_p90": Label(
        "correlation of wrinkles, best frames", "-", "the same in the best tenth of the frames"
    ),
    "rmse_mm": Label("distance of vertices", "mm", "distance of vertices from the truth's"),
    "rmse_skill": Label("distance removed", "-", "share of smooth's distance that is removed"),
    "sted": Label("error of edge lengths (STED)", "-", "error of edge lengths, in space and time"),
    "worse_than_smooth_percent": Label(
        "worse than smooth", "%", "patch-frames with a larger normal error than smooth's"
    ),
    "unfamiliarity_spearman": Label(
        "novelty against error", "-", "rank correlation of novelty with the error: 1 the same order"
    ),
    "faded_percent": Label("faded", "%", "patch-frames whose wrinkles are weakened because they are unfamiliar"),
    "bending_energy_ratio": Label("bending energy", "-", "running freely: bending energy over the truth's, 1 is right"),
    "spectrum_band_error_max": Label(
        "error of the worst band", "-", "running freely: largest error of a band of wavelengths, as a share"
    ),
    "octave_error_max": Label("error of the worst octave", "-", "the same without the shortest, the mesh's noise"),
    "ridge_coherence_3_cm": Label(
        "run of folds within 3 cm", "-", "running freely: how far folds keep their direction, over the truth's"
    ),
    "ridge_coherence_6_cm": Label("run of folds within 6 cm", "-", "the same within 6 cm; below 1 folds are lumps"),
    "low_frequency_bias": Label(
        "bias of the large motion",
        "-",
        "running freely: distance of the mean large motion from the truth's, over the truth's spread; 0 is right",
    ),
    "low_frequency_spread": Label(
        "spread of the large motion", "-", "running freely: how far runs part from one another, over true runs'"
    ),
    "free_normal_error_deg": Label(
        "normal error, running freely", "deg", "running freely: normal error; below the floor it means nothing"
    ),
    "contact_bending_ratio": Label(
        "bending energy on the body",
        "-",
        "running freely: bending energy over the truth's where the cloth lies on the body",
    ),
    "inside_body_percent": Label("inside the body", "%", "vertices inside the body"),
    "deepest_mm": Label("deepest inside the body", "mm", "largest depth of a vertex in the body"),
    "inside_body_with_room_percent": Label(
        "inside the body where there is room", "%", "vertices inside the body at places where there is room for cloth"
    ),
    "deepest_with_room_mm": Label("deepest where there is room", "mm", "largest depth of a vertex at such a place"),
    "body_seen_px": Label("body through the garment", "px", "pixels of a picture in which the body shows through"),
    "body_seen_frames_percent": Label(
        "frames with body through the garment", "%", "frames in which any pixel shows it"
    ),
    "body_seen_whole_px": Label(
        "body through the garment, as it is", "px", "the same if the body were not drawn in under the garment"
    ),
    "self_crossed_percent": Label("through itself", "%", "faces that go through another one, mean over the frames"),
    "self_crossed_worst_percent": Label("through itself at worst", "%", "the same in the worst frame"),
    "training_left_out_percent": Label(
        "training left out", "%", "frames that are not learned from, because the fine cloth is through itself"
    ),
    "crossed_layers_percent": Label(
        "garments through one another", "%", "vertices on edges that go through another garment of the outfit"
    ),
    "crossed_layers_at_end_percent": Label(
        "garments through one another at the end", "%", "the same in the last frame of the clip"
    ),
    "popping": Label("popping", "-", "largest change of a patch's wrinkles in a frame, over the size of all wrinkles"),
    "jitter_px": Label("jitter", "px", "jumps from frame to frame on a standard screen, 95th percentile"),
    "rest_jitter_px": Label("jitter at rest", "px", "jumps of vertices while the body stands still after its motion"),
    "rest_speed_mm_s": Label("speed at rest", "mm/s", "speed of the coarse garment in the third second of a pause"),
    "reverse_gap_mm": Label(
        "memory of a slow motion", "mm", "distance of vertices at equal poses of a slow motion there and back"
    ),
    "attached_off_mm": Label("error of attachment", "mm", "largest distance of an attached vertex from its target"),
    "frame_ms_p50": Label("time of a frame", "ms", "processor time of a whole frame, median"),
    "frame_ms_p99": Label("time of a slow frame", "ms", "processor time of a whole frame, slowest hundredth"),
    "frame_cpu_ms": Label("processor time of a frame", "ms", "a whole frame, processor time"),
    "skin_ms_p50": Label("time for the body", "ms", "part of a frame: the body"),
    "coarse_ms_p50": Label("time for the coarse garment", "ms", "part of a frame: the coarse garment"),
    "decode_ms_p50": Label("time for wrinkles", "ms", "part of a frame: wrinkles"),
    "relax_ms_p50": Label("time for relaxation", "ms", "part of a frame: relaxation"),
    "normals_ms_p50": Label("time for normals", "ms", "part of a frame: normals"),
    "us_per_fine_vertex": Label("time for a fine vertex", "us", "decoding, relaxation and normals"),
    "fine_simulation_ms": Label("time of a frame, simulated finely", "ms", "a frame of the fine simulation"),
    "speedup_over_fine": Label("speed-up", "-", "time of a frame of the fine simulation over ours"),
    "cost_advantage": Label(
        "cost advantage",
        "-",
        "time of the cheapest plain cloth that is as good by all errors at once, over ours; below 1 it is better",
    ),
    "cost_advantage_is_at_least": Label(
        "cost advantage is a lower bound",
        "-",
        "1 where no plain cloth that was tried is as good: then the advantage is larger",
    ),
    "plain_frame_ms": Label(
        "time of a frame of plain cloth",
        "ms",
        "a whole frame of the plain cloth that the cost advantage is about, median",
    ),
    "plain_substeps": Label("substeps of plain cloth", "-", "substeps a frame of that plain cloth"),
    "plain_passes": Label(
        "relaxation of plain cloth", "-", "relaxation passes of the fine mesh for what is shown of that plain cloth"
    ),
    "plain_vertex_count": Label("vertices of plain cloth", "-", "simulated vertices of that plain cloth"),
    "coarse_vertex_count": Label("coarse vertices", "-", "of the garment that is simulated while playing"),
    "fine_vertex_count": Label("fine vertices", "-", "of the garment that is drawn"),
    "atoms_kept": Label("held by the dictionary", "-", "share of the slopes of all wrinkles that its atoms can draw"),
}
BAND = "band_ratio_"  # how the name of the figure of one band of wavelengths begins
# The figures that somebody reads first, by what they are about.
FIRST = {
    "Quality": (
        "normal_error_deg",
        "normal_skill",
        "bending_energy_ratio",
        "inside_body_percent",
        "self_crossed_percent",
        "jitter_px",
    ),
    "Cost": ("frame_ms_p50", "fine_simulation_ms", "speedup_over_fine", "cost_advantage"),
}
DIGITS = 3  # that the largest value of a row shows


def figure_of(name: str) -> Label:
    """A figure by its name in files, without the prefix of a rival; one that is not declared here keeps its name."""
    if name in FIGURES:
        return FIGURES[name]
    if name.startswith(BAND):
        words = name.removeprefix(BAND).removesuffix("_mm").replace("_", " ")
        meaning = "running freely: bending energy in this band of wavelengths over the truth's, 1 is right"
        return Label(f"bending energy, {words} mm", "-", meaning)
    for declared, figure in FIGURES.items():
        if name.endswith(f"_{declared}"):  # of another fabric that the garment has learned
            return figure._replace(label=f"{figure.label}, {name.removesuffix(f'_{declared}')}")
    return Label(name.replace("_", " "), "", "")


def value_texts(values: Sequence[float | None]) -> list[str]:
    """Numbers of one figure with equally many decimals, so that they can be compared at a glance; "" for None."""
    known = [value for value in values if value is not None]
    largest = max(map(abs, known), default=0.0)
    whole = all(float(value).is_integer() for value in known)
    decimals = 0 if whole else min(max(DIGITS - 1 - math.floor(math.log10(largest)), 0), 4)
    return ["" if value is None else f"{value:.{decimals}f}" for value in values]


def figure_lines(figures: Mapping[str, float]) -> list[str]:
    """A table of figures, those of baselines in columns beside ours, in the order in which they are declared here.

    Args:
        figures: numbers by name; the prefix of a name says whose figure it is.
    """
    columns, table = figure_table(figures)
    lines = ["  " + " " * 30 + "".join(f"{column.replace('_', ' '):>17}" for column in columns)]
    for name, row in table.items():
        cells = "".join(f"{row[c]:17.5g}" if c in row else " " * 16 + "-" for c in columns)
        lines.append(f"  {name:<30}{cells}  {figure_of(name).meaning}".rstrip())
    return lines


def figure_table(figures: Mapping[str, float]) -> tuple[list[str], dict[str, dict[str, float]]]:
    """Columns of the table of figures, ours and baselines, and its rows: values by column, by name of the figure."""
    table: dict[str, dict[str, float]] = {name: {} for name in FIGURES}
    for name, value in figures.items():
        column, base = _column(name)
        table.setdefault(base, {})[column] = value
    columns = [c for c in ("ours", *RIVALS) if any(c in row for row in table.values())]
    return columns, {name: row for name, row in table.items() if row}


def _column(name: str) -> tuple[str, str]:
    """Column of a figure, and its name without the column: ("smooth", "rmse_mm") for "rmse_smooth_mm"."""
    for rival in RIVALS:
        if name.startswith(f"{rival}_"):
            return rival, name.removeprefix(f"{rival}_")
    plain = name.replace("_smooth_", "_")
    return ("smooth", plain) if plain != name and plain in FIGURES else ("ours", name)
