"""The page of a comparison: cost advantage, charts of error against time, one moment by some methods, all figures."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from precompute.learning.evaluation import CHANCE
from precompute.reporting.html_page import Chart, Heading, Picture, Point, Section, Table, Text, write_page
from precompute.wrinkle_comparison.comparison import ERRORS, Comparison, Method, MotionComparison
from runtime.draw.picture_content import Drawn, frame_camera
from runtime.draw.pictures import render, strip
from runtime.play.simulation import body_source

__all__ = ["comparison_sections", "draw_methods", "plain_table", "verdict", "write_comparison"]

_PICTURE = (400, 460)
_WORDS = {
    "octaves": "largest error of an octave",
    "realism": "realism",
    "normals": "normals [deg]",
    "bias": "bias of the large motion",
    "spread": "spread of the large motion",
}
_LABELS = {
    "octaves": "largest error of an octave of wavelengths but the shortest [-]",
    "realism": "realism: AUC of telling it from the truth [-]",
    "normals": "mean normal error [deg]",
    "bias": "bias of the large motion over the truth's spread [-]",
}
"""Of errors that have a chart: few methods are run often enough to have a spread."""
_NOTES = """All methods run freely over the same motions, which nothing was learned from; they play some frames each in
turn. Times are medians of processor time on one core and count skinning, simulation, what makes the fine vertices, and
normals. Plain cloth is the fabric itself on one mesh of the chain, with the truth's own solver and 3 to 36 substeps a
frame; it is drawn smooth on the fine mesh, or "at rest": the fine mesh is relaxed for what is drawn.

The cost advantage is the time of the cheapest plain cloth that is as good as ours by everything at once, in every
motion, over our time: by the largest error of an octave of wavelengths but the shortest, which holds the noise of the
mesh; by realism; by normals; by bias and spread of the large motion. As good is no worse than ours or than the floor,
by more than two standard errors. Where no plain cloth that was tried is as good, the dearest gives a lower bound, "at
least". A finer mesh that takes over four times as long as ours in its first frames is too dear and not played on; the
cheapest of these gives the lower bound. A plain cloth that breaks is not good.

Folding is chaotic. Ours, the truth and the plain cloth that decides are therefore run several times from starts that
differ by 0.01 mm: figures are means, and the plus or minus is the standard deviation over runs, for large motion the
standard error. Bias is the distance of the mean large motion of ours from the truth's, over the truth's own spread, or
over its distance from a true run in finer steps where that is larger. Spread is how far our runs part from one another,
over the same of true runs. The bias of a method that ran once takes its spread to be the truth's.

Realism is how well a classifier tells patches of a method's folds from the truth's: 0.5 if it cannot, 1 if it always
can. It learns on some parts of the motion and is asked on others.

The floor is the worst that the other true runs and the one in finer steps have against the first: an error within it
means nothing. The truth stands in the charts at its own cost, with the floor as its error."""


def verdict(comparison: Comparison) -> str:
    """The cost advantage, the figures of all methods and where realism is lost, in text."""
    paragraphs, found = [], comparison.cost_advantage
    if found is not None:
        times = f"takes {found.frame_ms:.2f} ms, ours {comparison.frame_ms():.2f} ms"
        if found.at_least:
            what = "cheapest that was too dear to be played" if found.cloth.too_dear else "dearest"
            why = f"Ours pays: of plain cloths none that was tried is as good by all errors at once; the {what} {times}"
        elif found.ratio < 1.0:
            why = f"Plain cloth is the better choice: the cheapest that is as good by all errors at once {times}"
        else:
            why = f"Ours pays: the cheapest plain cloth that is as good by all errors at once {times}"
        paragraphs.append(f"{why} ({_called(found.cloth)}; cost advantage {found}).")
    for motion in comparison.motions:
        paragraphs += _motion_words(motion, None if found is None else found.cloth.prefix)
    return "\n\n".join(paragraphs)


def _motion_words(one: MotionComparison, prefix: str | None) -> list[str]:
    """What was found on one motion, in paragraphs."""
    header, rows = _errors(one, prefix)
    lines = [f"{row[0]:<36}" + "".join(f"{cell:>34}" for cell in row[1:]) for row in ([one.motion, *header[1:]], *rows)]
    told = [
        f"{m.name.capitalize()} is told from the truth by: {m.realism.told_by()}."
        for m in one.methods
        if m.realism is not None and not m.mesh and m.realism.auc > 0.6
    ]
    broke = [
        f"{_called(m).capitalize()} broke: after {m.broke_at:.2f} s it had burst."
        for m in one.methods
        if m.broke_at is not None
    ]
    return ["\n".join(lines), plain_table(one), *told, *broke]


def _errors(one: MotionComparison, prefix: str | None) -> tuple[list[str], list[list[str]]]:
    """What ours, the plain cloth of the cost advantage and the floor are judged by: a header, and rows."""
    shown = [one.method(""), *([] if prefix is None else [one.method(prefix)]), one.method("floor_")]
    rows = [[words, *(_with_chance(m, ERRORS[name]) for m in shown)] for name, words in _WORDS.items()]
    return ["", *(method.name for method in shown)], rows


def _with_chance(method: Method, name: str) -> str:
    """A figure and how far it is moved by chance."""
    if name not in method.figures:
        return "unknown"
    chance = method.figures.get(CHANCE + name)
    return f"{method.figures[name]:.3g}" + ("" if chance is None else f" (+- {chance:.2g})")


def plain_table(one: MotionComparison) -> str:
    """Time and errors of every method, a line each."""
    heads = ("worst octave", "energy", "bias", "spread", "normals", "realism")
    names = (ERRORS["octaves"], "bending_energy_ratio", *(ERRORS[n] for n in ("bias", "spread", "normals", "realism")))
    lines = [f"{'':<36}{'ms':>8}" + "".join(f"{head:>14}" for head in heads)]
    for method in one.methods:
        if method.prefix == "truth_":
            continue
        shown = "" if np.isnan(method.frame_ms) else f"{method.frame_ms:.2f}"
        missing = "-" if method.figures else "too dear" if method.too_dear else "broke"
        cells = [f"{method.figures[name]:.2f}" if name in method.figures else missing for name in names]
        lines.append(f"{method.name:<36}{shown:>8}" + "".join(f"{cell:>14}" for cell in cells))
    return "\n".join(lines)


def write_comparison(path: str | os.PathLike[str], comparison: Comparison) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        comparison: what was found.
    """
    title = f"{comparison.garment}: error against time"
    write_page(path, title, comparison_sections(comparison))


def comparison_sections(comparison: Comparison) -> list[Section]:
    """The cost advantage; of each motion charts of error against time, one moment by some methods, and all figures."""
    found = comparison.cost_advantage
    prefix = None if found is None else found.cloth.prefix
    words = [part for part in verdict(comparison).split("\n\n") if "\n" not in part]
    sections: list[Section] = [Text("\n\n".join(words))]
    for one in comparison.motions:
        sections += [
            Heading(one.motion),
            Table(*_errors(one, prefix), "What decides; +- is chance"),
            *(_chart(one, name) for name in _LABELS),
            *_pictures(one, prefix),
            _place_table(one),
            _figure_table(one),
            _band_table(one),
        ]
    return [*sections, Text(_NOTES)]


def draw_methods(comparison: MotionComparison, methods: Sequence[Method]) -> np.ndarray:
    """The middle of the motion by some methods: uint8, shape (h, w, 3); one that broke is left out."""
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
    shown = [(m.name, m.frames[index]) for m in methods if m.frames is not None]
    columns = [
        [render([Drawn.body(body, source.faces), Drawn(vertices, cut.faces, pattern=pattern)], camera, _PICTURE)]
        for _, vertices in shown
    ]
    return strip(columns, [name for name, _ in shown], [""])


def _pictures(one: MotionComparison, prefix: str | None) -> list[Section]:
    names = ["smooth_", "", "floor_", "truth_"]
    plain = [one.equal_cost, None if prefix is None else one.method(prefix)]
    caption = "The same moment, {}. Free runs part company, so folds differ in place."
    found = [Picture(draw_methods(one, [one.method(n) for n in names]), caption.format("ours and the truth"))]
    cloths = list({m.prefix: m for m in plain if m is not None}.values())
    if cloths:
        words = "plain cloth: at equal cost, and the one of the cost advantage"
        found.append(Picture(draw_methods(one, cloths), caption.format(words)))
    return list(found)


def _called(method: Method) -> str:
    return f"the {method.name.replace(', ', ' with ', 1)}" if method.mesh else method.name


def _group(method: Method) -> str:
    """Methods that share a marker."""
    if not method.mesh:
        return "ours" if method.ours else method.name
    rest = ", at rest" if method.settings.get("relaxation passes") else ""
    return f"{method.name.split(',')[0]}, {method.settings['simulated vertices']:,.0f} vertices{rest}"


def _chart(comparison: MotionComparison, error: str) -> Chart:
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
        log_y=error == "octaves" and min(point.y for point in points) > 0.0,
        floor=floor,
        x_lines={"our cost": comparison.method("").frame_ms},
        caption="Numbers beside plain cloth are its substeps a frame.",
    )


def _place_table(comparison: MotionComparison) -> Table:
    told = [m for m in comparison.methods if m.realism is not None]
    places = list(dict.fromkeys(place for m in told if m.realism is not None for place in m.realism.by_place))
    rows = [
        [m.name, m.realism.auc, *(m.realism.by_place[place] for place in places), m.realism.told_by()]
        for m in told
        if m.realism is not None
    ]
    return Table(["", "whole", *places, "told by"], rows, "Realism by place: 0.5 cannot be told from the truth")


def _figure_table(comparison: MotionComparison) -> Table:
    names = list(dict.fromkeys(name for m in comparison.methods for name in m.figures if "band_ratio_" not in name))
    rows = [[m.name, m.frame_ms, *(m.figures.get(name) for name in names)] for m in comparison.methods]
    settings = list(dict.fromkeys(name for m in comparison.methods for name in m.settings))
    for row, method in zip(rows, comparison.methods, strict=True):
        row += [method.settings.get(name) for name in settings]
    return Table(["", "frame_ms_p50", *names, *settings], rows, "Figures and settings")


def _band_table(comparison: MotionComparison) -> Table:
    start = "band_ratio_"
    names = [name for name in comparison.method("").figures if name.startswith(start)]
    rows = [
        [m.name, *(m.figures.get(name) for name in names)]
        for m in comparison.methods
        if any(name.startswith(start) for name in m.figures)
    ]
    header = ["", *(name.removeprefix(start).replace("_", " ") for name in names)]
    return Table(header, rows, "Bending energy over the truth's, by wavelength")
