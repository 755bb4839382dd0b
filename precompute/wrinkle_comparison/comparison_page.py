"""The page of a comparison: who wins, charts of error against time, one moment by all methods, all figures."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from precompute.learning.recording import body_source
from precompute.reporting.page import Band, Chart, Line, Picture, Point, Section, Table, Text, write_page
from precompute.stability.stability import StabilityLimit
from precompute.wrinkle_comparison.compare import AT_EQUAL_COST, Comparison, Method
from runtime.pictures import Drawn, frame_camera, render, strip

__all__ = ["comparison_sections", "draw_methods", "verdict", "write_comparison"]

_ARTICLE = {"middle_mesh_": "the middle mesh", "equal_cost_fine_": "the fine cloth"}
_ELSEWHERE = ("substeps_per_frame",)  # figures that stand among the settings
_PICTURE = (400, 460)
_JUDGED = {
    "spectrum_band_error_max": "the spectrum of folds (largest relative error of a band's bending energy)",
    "free_normal_error_deg": "normals (mean angle to the truth's) [deg]",
    "low_frequency_ratio_to_floor": "large folds in their places (low-frequency mismatch over the floor's)",
}
_CHARTED = {
    "spectrum_band_error_max": "largest error of a band of the spectrum [-]",
    "free_normal_error_deg": "mean normal error [deg]",
    "low_frequency_ratio_to_floor": "low-frequency mismatch over the floor's [-]",
}
_NOTES = """All methods run freely over the same motion, which nothing was learned from; times are medians of
processor time on one core and count skinning, simulation, what makes the fine vertices, and normals. Baselines take the
whole number of substeps that brings their time nearest to ours, at least one; they are the fabric itself, with the
truth's own solver.

The floor is what parts two converged simulations of the same scene, whose substeps differ by a factor of 1.5: folding
is chaotic, so neither an error within the floor nor a difference of less than 5 % means anything. The truth stands in
the charts at its own cost, with the floor as its error."""
_STABILITY_NOTES = """The largest stable substep is found by bisection over 3.5 s of the motion. A run is a catastrophe
if it is not finite, if an edge is stretched by 100 % of its length more than ever with substeps of 1/2000 s, or if a
vertex is faster than 3 sqrt(2 g H) and the body's fastest vertex."""


def verdict(comparison: Comparison) -> str:
    """Who wins at equal cost, in sentences; a baseline that wins is named as plainly as ours would be."""
    times = [f"{_called(m)} {m.frame_ms:.2f} ms" for m in _baselines(comparison)]
    paragraphs = [f"Time of a frame, body included: {', '.join(times)}."]
    paragraphs += [_sentence(comparison, figure, words) for figure, words in _JUDGED.items()]
    ours = comparison.method("")
    paragraphs += [
        f"The fine cloth cannot be had at our cost: with {_count(fine)} a frame takes {fine.frame_ms:.2f} ms."
        for fine in comparison.methods
        if fine.prefix == "equal_cost_fine_" and fine.frame_ms > 1.25 * ours.frame_ms
    ]
    told = [f"{_called(m)} {m.figures['edge_stretch_p99_percent']:.3g} %" for m in comparison.methods if m.figures]
    paragraphs.append(f"Stretch that 1 % of the edges exceed: {', '.join(told)}.")
    paragraphs += [
        f"{_called(m).capitalize()}, substeps of {1e3 * m.settings['substep [s]']:.3g} ms, runs beyond what it stands: "
        f"{1e3 * limit.dt_max:.3g} ms is its largest stable substep, and {limit.first_to_go} goes first."
        for m, limit in _beyond_their_limits(comparison)
    ]
    paragraphs += [
        f"{_called(m).capitalize()} broke: after {m.broke_at:.2f} s it had burst."
        for m in comparison.methods
        if m.broke_at is not None
    ]
    return "\n\n".join(paragraphs)


def write_comparison(path: str | os.PathLike[str], comparison: Comparison) -> None:
    """Write the page: who wins, charts of error against time, one moment by all methods, and all figures.

    Args:
        path: the HTML file.
        comparison: what was found.
    """
    title = f"{comparison.garment}, {comparison.motion}: error against time"
    write_page(path, title, comparison_sections(comparison))


def comparison_sections(comparison: Comparison) -> list[Section]:
    """Who wins, charts of error against time, one moment by all methods, and all figures."""
    return [
        Text(verdict(comparison)),
        *(_chart(comparison, figure, label) for figure, label in _CHARTED.items()),
        *_pictures(comparison),
        _figure_table(comparison),
        _band_table(comparison),
        *([_stability_table(comparison)] if comparison.stability else []),
        Text(_NOTES),
        *([Text(_STABILITY_NOTES)] if comparison.stability else []),
    ]


def draw_methods(comparison: Comparison, methods: Sequence[Method]) -> np.ndarray:
    """One moment, from the middle of the motion, by some methods: uint8, shape (h, w, 3)."""
    truth = comparison.truth
    index = len(truth.frames) // 2
    source = body_source(truth.run.body)
    body = np.zeros((len(source.vertices), 3), np.float32)
    source.skin(truth.run.poses[truth.recording.frames[index]], np.zeros(3), body)
    (camera,) = frame_camera(
        truth.frames[index : index + 1], azimuth_deg=30.0, aspect=_PICTURE[0] / _PICTURE[1], margin=1.15
    )
    cut = truth.levels.subdivision
    pattern = cut.flat_corners(truth.levels.pattern)
    shown = {m.name: m.frames[index] for m in methods if m.frames is not None}
    columns = [
        [render([Drawn.body(body, source.faces), Drawn(vertices, cut.faces, pattern=pattern)], camera, _PICTURE)]
        for vertices in shown.values()
    ]
    return strip(columns, list(shown), [""])


def _pictures(comparison: Comparison) -> list[Section]:
    cheap = _baselines(comparison)
    dear = [m for m in comparison.methods if m.prefix not in AT_EQUAL_COST]
    caption = "The same moment, {}. Free runs part company, so folds differ in place."
    return [
        Picture(draw_methods(comparison, cheap), caption.format("methods at equal cost")),
        Picture(draw_methods(comparison, dear), caption.format("converged simulations")),
    ]


def _baselines(comparison: Comparison) -> list[Method]:
    return [m for m in comparison.methods if m.prefix in AT_EQUAL_COST]


def _count(method: Method) -> str:
    count = method.settings["substeps a frame"]
    return "one substep" if count == 1 else f"{count} substeps"


def _called(method: Method) -> str:
    known = _ARTICLE.get(method.prefix)
    return f"{known} with {_count(method)}" if known else method.name


def _beyond_their_limits(comparison: Comparison) -> list[tuple[Method, StabilityLimit]]:
    """Baselines at equal cost whose substep is a catastrophe, with the limit."""
    limits = {one.name: one for one in comparison.stability}
    pairs = [("middle_mesh_", "middle_mesh"), ("equal_cost_fine_", "fine")]
    found = [
        (m, limits[name]) for m in comparison.methods for prefix, name in pairs if m.prefix == prefix and name in limits
    ]
    return [(m, limit) for m, limit in found if m.settings["substep [s]"] > 1.001 * limit.dt_max]


def _sentence(comparison: Comparison, figure: str, words: str) -> str:
    floor = comparison.method("floor_").figures[figure]
    called = {m.prefix: f"{_called(m)} {m.figures[figure]:.3g}" for m in _baselines(comparison) if m.figures}
    won = comparison.winners(figure)
    rest = [text for prefix, text in called.items() if prefix not in won]
    against = f", against {', '.join(rest)}" if rest else ""
    if len(won) != 1:
        names = ", ".join(called[prefix] for prefix in won)
        behind = f"; behind them {', '.join(rest)}" if rest else ""
        return f"By {words} nobody wins: {names} are alike{behind}; the floor is {floor:.3g}."
    method = comparison.method(won[0])
    figures = f"{method.figures[figure]:.3g}{against}; the floor is {floor:.3g}"
    return f"By {words} {_called(method)} wins at equal cost: {figures}."


def _chart(comparison: Comparison, figure: str, label: str) -> Chart:
    floor = comparison.method("floor_").figures[figure]
    points = []
    for method in comparison.methods:
        if np.isnan(method.frame_ms) or not method.figures:
            continue
        error = floor if method.prefix == "truth_" else method.figures[figure]
        if np.isfinite(error):
            points.append(Point(method.frame_ms, error, method.name, method.name, method.settings))
    ours = comparison.method("").frame_ms
    return Chart(
        points,
        "time of a frame [ms]",
        label,
        log_x=True,
        log_y=figure == "spectrum_band_error_max" and min(point.y for point in points) > 0.0,
        bands=[Band(0.0, floor, "floor")],
        lines=[Line("x", ours, "our cost")],
    )


def _figure_table(comparison: Comparison) -> Table:
    names = list(
        dict.fromkeys(
            name
            for m in comparison.methods
            for name in m.figures
            if name not in _ELSEWHERE and "band_ratio_" not in name
        )
    )
    rows = [["frame_ms_p50", *(m.frame_ms for m in comparison.methods)]]
    rows += [[name, *(m.figures.get(name) for m in comparison.methods)] for name in names]
    settings = list(dict.fromkeys(name for m in comparison.methods for name in m.settings))
    rows += [[name, *(m.settings.get(name) for m in comparison.methods)] for name in settings]
    return Table(["", *(m.name for m in comparison.methods)], rows, "Figures and settings")


def _band_table(comparison: Comparison) -> Table:
    start = "band_ratio_"
    shown = [m for m in comparison.methods if any(name.startswith(start) for name in m.figures)]
    names = [name for name in comparison.method("").figures if name.startswith(start)]
    rows = [[name.removeprefix(start).replace("_", " "), *(m.figures.get(name) for m in shown)] for name in names]
    return Table(["wavelength", *(m.name for m in shown)], rows, "Bending energy over the truth's, by wavelength")


def _stability_table(comparison: Comparison) -> Table:
    rows = [
        [
            one.name.replace("_", " "),
            1e3 * one.dt_max,
            1e3 * one.unstable if np.isfinite(one.unstable) else None,
            one.first_to_go or "nothing",
        ]
        for one in comparison.stability
    ]
    header = ["garment", "largest stable substep [ms]", "shortest unstable one [ms]", "what went first there"]
    return Table(header, rows, "Largest stable substep")
