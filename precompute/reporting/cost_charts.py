"""Charts by matplotlib: cost against error of methods, with the Pareto front, a floor and lines; SVG and PNG."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from pbd.errors import InputError
from pbd.storage import replacing

__all__ = ["Chart", "Point", "chart_svg", "draw_charts", "panels", "pareto_front", "write_png"]

_COLORS = ("#0067a8", "#c24a00", "#00764f", "#a83e85", "#7d5c00", "#5847c0", "#b81f3c", "#4d5560")
_MARKERS = "os^DvPX*<>pdh"  # with eight colours 104 methods differ in one of them
_BESIDE = ((8, -3, "left"), (-8, -3, "right"), (5, -13, "left"), (-5, -13, "right"),
           (5, 7, "left"), (-5, 7, "right"), (0, 9, "center"), (0, -15, "center"))  # fmt: skip


@dataclass(frozen=True)
class Point:
    """One result.

    Attributes:
        x, y: where it stands, in the units of the axes; at the upper border where y is infinite.
        method: points of one method share a marker and, where they have none of their own, a colour.
        label: short name that stands beside the point; may be empty.
        settings: everything needed to repeat it, for the table below the chart.
        quoted: taken from elsewhere, not measured here: a hollow marker, and no part of the Pareto front.
        color: of its own, a key of the chart's ``colors``.
    """

    x: float
    y: float
    method: str
    label: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    quoted: bool = False
    color: str | None = None


@dataclass(frozen=True)
class Chart:
    """Cost along x, which is logarithmic, against error along y, lower is better on both.

    Attributes:
        points: the results.
        x_label, y_label: names of the axes with their units.
        log_y: whether y is logarithmic, too.
        floor: below this y differences mean nothing; 0 for none.
        x_lines, y_lines: straight lines across the chart at one x or y, such as a time budget, by name.
        caption: a sentence below the chart.
        colors: what the points' own colours mean: words by colour.
    """

    points: Sequence[Point]
    x_label: str
    y_label: str
    log_y: bool = False
    floor: float = 0.0
    x_lines: Mapping[str, float] = field(default_factory=dict)
    y_lines: Mapping[str, float] = field(default_factory=dict)
    caption: str = ""
    colors: Mapping[str, str] = field(default_factory=dict)


def pareto_front(points: Sequence[Point]) -> list[int]:
    """Indices of the measured points that no other measured point beats on both axes, by growing x."""
    measured = (k for k, point in enumerate(points) if not point.quoted and math.isfinite(point.y))
    front: list[int] = []
    for k in sorted(measured, key=lambda k: (points[k].x, points[k].y)):
        if not front or points[k].y < points[front[-1]].y:
            front.append(k)
    return front


def chart_svg(chart: Chart, name: str, titles: Sequence[str]) -> str:
    """A chart as an ``svg`` element, the same every time.

    Args:
        chart: labels stand where there is room.
        name: start of the names of its elements, which no other chart of the page has.
        titles: of the points, for a pointer.

    Raises:
        InputError: there is no point, or a value is not finite, negative, or zero on a logarithmic axis.
    """
    import matplotlib as mpl

    file = io.StringIO()
    with mpl.rc_context({"text.parse_math": False, "svg.fonttype": "none", "svg.hashsalt": name}):
        figure = draw_charts({"": chart}, 8.8, 5.0)
        _place_labels(figure, chart)
        for k in range(len(titles)):
            figure.axes[0].lines[k].set_gid(f"{name}-p{k}")
        figure.savefig(file, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    _, box, drawn = re.split(r'<svg [^>]*(viewBox="[^"]*")[^>]*>', file.getvalue(), maxsplit=1)
    drawn = re.sub(r' id="[\w.]+_\d+"', "", drawn)  # matplotlib's, which every chart of the page would have
    for k, title in enumerate(titles):
        start = f'<g id="{name}-p{k}">'
        drawn = drawn.replace(start, f"{start}<title>{escape(title)}</title>")
    about = escape(f"{chart.y_label} against {chart.x_label}")
    return f'<svg class="plot" {box} role="group" aria-label="{about}">{drawn}'


def write_png(path: Path, figure: Any) -> None:
    """Write a figure of matplotlib; the file appears whole or not at all."""
    with replacing(path) as beside:
        figure.savefig(beside, format="png")


def panels(count: int) -> tuple[Any, list[Any]]:
    """A figure of matplotlib with so many panels, at most four side by side, and the panels."""
    from matplotlib.figure import Figure

    across = min(count, 4)
    down = -(-count // across)
    figure: Any = Figure(figsize=(4.2 * across, 3.6 * down), layout="constrained")
    drawn = figure.subplots(down, across, squeeze=False).ravel().tolist()
    for panel in drawn[count:]:
        panel.set_axis_off()
    return figure, drawn[:count]


def draw_charts(charts: Mapping[str, Chart], width: float, height: float) -> Any:
    """Charts without labels, by title, at most two side by side, over one legend: a figure of matplotlib.

    Args:
        charts: with the same colours.
        width, height: of a chart [inch].

    Raises:
        InputError: see :func:`chart_svg`.
    """
    from matplotlib.figure import Figure

    methods = list(dict.fromkeys(point.method for chart in charts.values() for point in chart.points))
    across = min(2, len(charts))
    down = -(-len(charts) // across)
    figure: Any = Figure(layout="constrained", dpi=110)
    keys: dict[tuple[str, str], Any] = {}
    for k, (title, chart) in enumerate(charts.items()):
        axes = figure.add_subplot(down, across, k + 1, title=title)
        _draw(axes, chart, methods)
        keys |= {(key.get_label(), key.get_linestyle()): key for key in axes.get_legend_handles_labels()[0]}
    in_row = max(1, int(width * across / (0.6 + 0.07 * max(len(name) for name, _ in keys))))
    figure.set_size_inches(width * across, height * down + 0.18 * -(-len(keys) // in_row))
    handles = list(keys.values())
    figure.legend(handles=handles, loc="outside lower center", ncols=in_row, fontsize=8, frameon=False)
    return figure


def _draw(axes: Any, chart: Chart, methods: Sequence[str]) -> None:
    """Points, which are the first lines of the axes, then all else but labels; a key of the legend has no place."""
    from matplotlib.ticker import LogLocator, NullFormatter

    _check(chart)
    axes.set(xscale="log", yscale="log" if chart.log_y else "linear", xlabel=chart.x_label, ylabel=chart.y_label)
    axes.margins(0.07)
    axes.grid(alpha=0.25)
    for p in chart.points:
        off_scale = {"transform": axes.get_xaxis_transform()} if p.y == math.inf else {}
        style = _marker(methods.index(p.method), p.color, p.quoted)
        axes.plot([p.x], [1.0 if off_scale else p.y], **style, **off_scale, clip_on=False, zorder=3)
    for k, method in enumerate(methods):
        hollow = all(p.quoted for p in chart.points if p.method == method)
        axes.plot([], [], label=method, **_marker(k, "0.35" if chart.colors else None, hollow))
    for color, words in chart.colors.items():
        axes.plot([], [], label=words, **_marker(0, color))
    if any(p.quoted for p in chart.points):
        axes.plot([], [], label="hollow: quoted from elsewhere, not measured here", **_marker(0, "0.35", True))
    if chart.floor > 0.0:
        axes.axhspan(0.0, chart.floor, color="0.87", zorder=0, label="floor")
    for name, value in chart.x_lines.items():
        axes.axvline(value, color="0.4", lw=1.0, ls=":", label=name)
    for name, value in chart.y_lines.items():
        axes.axhline(value, color="0.4", lw=1.0, ls="-.", label=name)
    if not chart.log_y:
        axes.set_ylim(bottom=0.0)
    front = [chart.points[k] for k in pareto_front(chart.points)]
    right, top = axes.set_xlim(axes.get_xlim())[1], axes.set_ylim(axes.get_ylim())[1]
    x, y = np.repeat([*(p.x for p in front), right], 2)[:-1], np.repeat([top, *(p.y for p in front)], 2)[1:]
    axes.plot(x, y, "k--", lw=0.9, label="best of what was measured")
    for axis, log in ((axes.xaxis, True), (axes.yaxis, chart.log_y)):
        if log:
            low, high = axis.get_view_interval()
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 300.0 * low else (1.0,)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())


def _marker(index: int, color: str | None, hollow: bool = False) -> dict[str, Any]:
    """The sign of a method, as matplotlib's keywords."""
    color, marker = color or _COLORS[index % len(_COLORS)], _MARKERS[index % len(_MARKERS)]
    edge = {"mec": color, "mew": 1.5, "mfc": "white"} if hollow else {"mec": "white", "mew": 0.6}
    return {"marker": marker, "ls": "", "ms": 10.0 if marker == "*" else 7.0, "color": color, **edge}


def _check(chart: Chart) -> None:
    if not chart.points:
        raise InputError("a chart needs at least one point", key="points")
    for axis, log, lines in (("x", True, chart.x_lines), ("y", chart.log_y, chart.y_lines)):
        named = [(p.label or p.method, getattr(p, axis)) for p in chart.points if axis == "x" or p.y != math.inf]
        for name, value in [*named, *lines.items()]:
            if not math.isfinite(value) or value < 0.0 or (log and value == 0.0):
                expected = "a positive number" if log else "a number that is not negative"
                raise InputError("cannot be drawn", key=f"{axis} of {name!r}", received=value, expected=expected)


def _place_labels(figure: Any, chart: Chart) -> None:
    """Labels beside the points of a figure's chart; one that finds no free place is left to title and table."""
    from matplotlib.transforms import Bbox

    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # labels must not move what they are fitted to
    (axes,) = figure.axes
    points, front = axes.lines[: len(chart.points)], pareto_front(chart.points)
    spots = [line.get_transform().transform(line.get_xydata()[0]) for line in points]
    taken = [Bbox.from_extents(*(spot - 7.0), *(spot + 7.0)) for spot in spots]
    paths = [line.get_transform().transform_path(line.get_path()) for line in axes.lines if len(line.get_xdata()) > 1]
    for k in sorted(range(len(points)), key=lambda k: k not in front):  # the front's points choose first
        for *beside, side in _BESIDE if chart.points[k].label else ():
            style = {"xycoords": points[k].get_transform(), "textcoords": "offset points", "ha": side, "fontsize": 8}
            text = axes.annotate(chart.points[k].label, points[k].get_xydata()[0], beside, **style)
            box = text.get_window_extent().padded(2.0)
            inside = axes.bbox.contains(*box.min) and axes.bbox.contains(*box.max)
            if inside and not box.count_overlaps(taken) and not any(p.intersects_bbox(box, False) for p in paths):
                taken.append(box)
                break
            text.remove()
