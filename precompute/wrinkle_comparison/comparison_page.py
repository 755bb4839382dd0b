"""The page of a comparison: cost advantage, charts of error against time, one moment by some methods, all figures."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from precompute.learning.recording import body_source
from precompute.reporting.page import Chart, Picture, Point, Section, Table, Text, write_page
from precompute.wrinkle_comparison.compare import ERRORS, Comparison, Method
from runtime.pictures import Drawn, frame_camera, render, strip

__all__ = ["comparison_sections", "draw_methods", "plain_table", "verdict", "write_comparison"]

_PICTURE = (400, 460)
_WORDS = {
    "band": "worst band of the spectrum",
    "realism": "realism",
    "low_frequency": "large folds in their places",
    "normals": "normals",
}
_LABELS = {
    "band": "largest error of a band of the spectrum [-]",
    "realism": "realism: AUC of telling it from the truth [-]",
    "low_frequency": "low-frequency mismatch over the floor's [-]",
    "normals": "mean normal error [deg]",
}
_NOTES = """All methods run freely over the same motion, which nothing was learned from; they play some frames each in
turn. Times are medians of processor time on one core and count skinning, simulation, what makes the fine vertices, and
normals. Plain cloth is the fabric itself on one mesh of the chain, with the truth's own solver and 4 to 36 substeps a
frame; it is drawn smooth on the fine mesh, or "at rest": the fine mesh is relaxed for what is drawn.

The cost advantage is the time of the cheapest plain cloth whose error is at most ours (or at most the floor), over our
time. Where no plain cloth that was tried is as good, the dearest gives a lower bound, "at least". A plain cloth that
breaks is not good.

Realism is how well a classifier tells patches of a method's folds from the truth's: 0.5 if it cannot, 1 if it always
can. It learns on some parts of the motion and is asked on others.

The floor is what parts two converged simulations of the same scene, whose substeps differ by a factor of 1.5: folding
is chaotic, so an error within the floor means nothing. The truth stands in the charts at its own cost, with the floor
as its error."""


def verdict(comparison: Comparison) -> str:
    """The cost advantage, the figures of all methods and where realism is lost, in text."""
    ours, whole, both = comparison.method(""), comparison.cost_advantage(), comparison.cost_advantage_both()
    paragraphs = []
    if whole is not None and both is not None:
        if both.ratio < 1.0 and not both.at_least:
            better = f"plain cloth of equal error is the better choice, the {_called(both.cloth).removeprefix('the ')}"
        elif whole.ratio < 1.0 and not whole.at_least:
            better = "plain cloth is as good for less by one measure, but not by both, so ours is played"
        else:
            better = "ours pays"
        paragraphs.append(f"Cost advantage {whole}: {better}. Over plain cloth as good by both measures: {both}.")
    for name, words in _WORDS.items():
        found = comparison.advantage(name)
        if found is not None:
            why = "none that was tried is as good; the dearest is" if found.at_least else "the cheapest as good is"
            paragraphs.append(
                f"By {words} (ours {ours.figures[ERRORS[name]]:.3g}, floor "
                f"{comparison.method('floor_').figures[ERRORS[name]]:.3g}): {found}. Of plain cloths {why} "
                f"{_called(found.cloth)}, {found.cloth.frame_ms:.2f} ms, {found.cloth.figures[ERRORS[name]]:.3g}; "
                f"ours takes {ours.frame_ms:.2f} ms."
            )
    paragraphs.append(plain_table(comparison))
    paragraphs += [
        f"{m.name.capitalize()} is told from the truth by: {m.realism.told_by()}."
        for m in comparison.methods
        if m.realism is not None and not m.mesh and m.realism.auc > 0.6
    ]
    paragraphs += [
        f"{_called(m).capitalize()} broke: after {m.broke_at:.2f} s it had burst."
        for m in comparison.methods
        if m.broke_at is not None
    ]
    return "\n\n".join(paragraphs)


def plain_table(comparison: Comparison) -> str:
    """Time and errors of every method, a line each."""
    lines = [f"{'':<30}{'ms':>8}{'worst band':>12}{'energy':>8}{'low freq.':>11}{'normals':>9}{'realism':>9}"]
    names = (*[ERRORS["band"]], "bending_energy_ratio", ERRORS["low_frequency"], ERRORS["normals"], ERRORS["realism"])
    for method in comparison.methods:
        if method.prefix == "truth_":
            continue
        shown = "" if np.isnan(method.frame_ms) else f"{method.frame_ms:.2f}"
        cells = [f"{method.figures[name]:.2f}" if name in method.figures else "broke" for name in names]
        widths = (12, 8, 11, 9, 9)
        lines.append(f"{method.name:<30}{shown:>8}" + "".join(f"{c:>{w}}" for c, w in zip(cells, widths, strict=True)))
    return "\n".join(lines)


def write_comparison(path: str | os.PathLike[str], comparison: Comparison) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        comparison: what was found.
    """
    title = f"{comparison.garment}, {comparison.motion}: error against time"
    write_page(path, title, comparison_sections(comparison))


def comparison_sections(comparison: Comparison) -> list[Section]:
    """The cost advantage, charts of error against time, one moment by some methods, and all figures."""
    words = [part for part in verdict(comparison).split("\n\n") if "\n" not in part]
    return [
        Text("\n\n".join(words)),
        *(_chart(comparison, name) for name in ERRORS),
        *_pictures(comparison),
        _place_table(comparison),
        _figure_table(comparison),
        _band_table(comparison),
        Text(_NOTES),
    ]


def draw_methods(
    comparison: Comparison, methods: Sequence[Method], index: int | None = None, titles: Sequence[str] | None = None
) -> np.ndarray:
    """One moment by some methods: uint8, shape (h, w, 3).

    Args:
        comparison: of the methods.
        methods: to be drawn; one that broke is left out.
        index: number of the recorded frame; None takes the middle of the motion.
        titles: above the pictures; None takes the names.
    """
    truth = comparison.truth
    index = len(truth.frames) // 2 if index is None else index
    source = body_source(truth.run.body)
    body = np.zeros((len(source.vertices), 3), np.float32)
    source.skin(truth.run.poses[truth.recording.frames[index]], np.zeros(3), body)
    (camera,) = frame_camera(
        truth.frames[index : index + 1], azimuth_deg=30.0, aspect=_PICTURE[0] / _PICTURE[1], margin=1.15
    )
    cut = truth.levels.subdivision
    pattern = cut.flat_corners(truth.levels.pattern)
    shown = [(m.name, m.frames[index]) for m in methods if m.frames is not None]
    columns = [
        [render([Drawn.body(body, source.faces), Drawn(vertices, cut.faces, pattern=pattern)], camera, _PICTURE)]
        for _, vertices in shown
    ]
    return strip(columns, titles or [name for name, _ in shown], [""])


def _pictures(comparison: Comparison) -> list[Section]:
    names = ["smooth_", "", "floor_", "truth_"]
    plain = [comparison.equal_cost]
    plain += [one.cloth for name in ("band", "realism") if (one := comparison.advantage(name)) is not None]
    caption = "The same moment, {}. Free runs part company, so folds differ in place."
    found = [
        Picture(draw_methods(comparison, [comparison.method(n) for n in names]), caption.format("ours and the truth"))
    ]
    cloths = list({m.prefix: m for m in plain if m is not None}.values())
    if cloths:
        words = "plain cloth: at equal cost, and the cheapest as good as ours by bands and by realism"
        found.append(Picture(draw_methods(comparison, cloths), caption.format(words)))
    return list(found)


def _called(method: Method) -> str:
    return f"the {method.name.replace(', ', ' with ', 1)}" if method.mesh else method.name


def _group(method: Method) -> str:
    """Methods that share a marker."""
    if not method.mesh:
        return "ours" if method.ours else method.name
    rest = ", at rest" if method.settings.get("relaxation passes") else ""
    return f"{method.name.split(',')[0]}, {method.settings['simulated vertices']:,.0f} vertices{rest}"


def _chart(comparison: Comparison, error: str) -> Chart:
    figure = ERRORS[error]
    floor = comparison.method("floor_").figures[figure]
    points = []
    for method in comparison.methods:
        if np.isnan(method.frame_ms) or not method.figures:
            continue
        value = floor if method.prefix == "truth_" else method.figures[figure]
        if np.isfinite(value):
            label = f"{method.settings['substeps a frame']:.0f}" if method.mesh else method.name
            points.append(Point(method.frame_ms, value, _group(method), label, method.settings))
    return Chart(
        points,
        "time of a frame [ms]",
        _LABELS[error],
        log_y=error == "band" and min(point.y for point in points) > 0.0,
        floor=floor,
        x_lines={"our cost": comparison.method("").frame_ms},
        caption="Numbers beside plain cloth are its substeps a frame.",
    )


def _place_table(comparison: Comparison) -> Table:
    told = [m for m in comparison.methods if m.realism is not None]
    places = list(dict.fromkeys(place for m in told if m.realism is not None for place in m.realism.by_place))
    rows = [
        [m.name, m.realism.auc, *(m.realism.by_place[place] for place in places), m.realism.told_by()]
        for m in told
        if m.realism is not None
    ]
    return Table(["", "whole", *places, "told by"], rows, "Realism by place: 0.5 cannot be told from the truth")


def _figure_table(comparison: Comparison) -> Table:
    names = list(dict.fromkeys(name for m in comparison.methods for name in m.figures if "band_ratio_" not in name))
    rows = [[m.name, m.frame_ms, *(m.figures.get(name) for name in names)] for m in comparison.methods]
    settings = list(dict.fromkeys(name for m in comparison.methods for name in m.settings))
    for row, method in zip(rows, comparison.methods, strict=True):
        row += [method.settings.get(name) for name in settings]
    return Table(["", "frame_ms_p50", *names, *settings], rows, "Figures and settings")


def _band_table(comparison: Comparison) -> Table:
    start = "band_ratio_"
    names = [name for name in comparison.method("").figures if name.startswith(start)]
    rows = [
        [m.name, *(m.figures.get(name) for name in names)]
        for m in comparison.methods
        if any(name.startswith(start) for name in m.figures)
    ]
    header = ["", *(name.removeprefix(start).replace("_", " ") for name in names)]
    return Table(header, rows, "Bending energy over the truth's, by wavelength")
