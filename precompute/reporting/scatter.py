"""A scatter chart in pixels: points by method, the Pareto front, floors as bands, labels that do not overlap.

The template ``plot.svg`` draws it as inline SVG, which says everything without a script; colours come from the page's
style sheet (classes ``m0``, ``m1``, ...).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

from pbd.errors import InputError

__all__ = ["COLOR_COUNT", "Band", "Chart", "Line", "Marker", "Plot", "Point", "corners", "pareto_front", "plot_of"]

COLOR_COUNT = 8

_WIDTH, _HEIGHT = 880.0, 520.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 76.0, 856.0, 18.0, 464.0  # borders of the plot
_LETTER, _LINE = 6.4, 15.0  # size of a letter of a label, on average [px]

# Outlines in units of the marker's radius; the first is a circle. With eight colours 104 methods differ in one of them.
_SHAPES = (
    (),
    ((-0.85, -0.85), (0.85, -0.85), (0.85, 0.85), (-0.85, 0.85)),
    ((0, -1.15), (1.05, 0.75), (-1.05, 0.75)),
    ((0, -1.25), (1.1, 0), (0, 1.25), (-1.1, 0)),
    ((0, 1.15), (1.05, -0.75), (-1.05, -0.75)),
    ((-0.4, -1.1), (0.4, -1.1), (0.4, -0.4), (1.1, -0.4), (1.1, 0.4), (0.4, 0.4),
     (0.4, 1.1), (-0.4, 1.1), (-0.4, 0.4), (-1.1, 0.4), (-1.1, -0.4), (-0.4, -0.4)),
    ((0, -1.15), (1.1, -0.35), (0.68, 0.93), (-0.68, 0.93), (-1.1, -0.35)),
    ((0, -1.3), (0.32, -0.42), (1.24, -0.4), (0.52, 0.17), (0.76, 1.05),
     (0, 0.54), (-0.76, 1.05), (-0.52, 0.17), (-1.24, -0.4), (-0.32, -0.42)),
    ((-1.25, -0.5), (1.25, -0.5), (1.25, 0.5), (-1.25, 0.5)),
    ((-0.5, -1.25), (0.5, -1.25), (0.5, 1.25), (-0.5, 1.25)),
    ((-1, -1), (1, -1), (0.15, 0), (1, 1), (-1, 1), (-0.15, 0)),
    ((-1.1, -1), (0, -0.2), (1.1, -1), (1.1, 0.2), (0, 1.1), (-1.1, 0.2)),
    ((-1, -1), (-1, 1), (-0.15, 0.15), (-0.15, 1), (1, 0), (-0.15, -1), (-0.15, -0.15)),
)  # fmt: skip
_RADIUS = 6.0


@dataclass(frozen=True)
class Point:
    """One result.

    Attributes:
        x, y: where it stands, in the units of the axes.
        method: points of one method share a marker and, where they have none of their own, a colour.
        label: short name that stands beside the point; may be empty.
        settings: everything needed to repeat it, shown when the point is selected.
        quoted: taken from elsewhere, not measured here: a hollow marker, and no part of the Pareto front.
        color: of its own, 0 to 7; None for the method's.
        off_scale: the value along y is none: the point stands at the upper border, outside the Pareto front.
    """

    x: float
    y: float
    method: str
    label: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    quoted: bool = False
    color: int | None = None
    off_scale: bool = False


@dataclass(frozen=True)
class Band:
    """A range of y, such as the floor below which differences mean nothing."""

    low: float
    high: float
    label: str


@dataclass(frozen=True)
class Line:
    """A straight line across the chart at one value of ``axis`` ("x" or "y"), such as a time budget."""

    axis: str
    value: float
    label: str


@dataclass(frozen=True)
class Chart:
    """Cost along x against error along y, lower is better on both; see :class:`Point`, :class:`Band`, :class:`Line`.

    ``colors`` says what the points' own colours mean: words by colour.
    """

    points: Sequence[Point]
    x_label: str
    y_label: str
    log_x: bool = False
    log_y: bool = False
    bands: Sequence[Band] = ()
    lines: Sequence[Line] = ()
    caption: str = ""
    colors: Mapping[int, str] = field(default_factory=dict)

    def methods(self) -> list[str]:
        """Methods in order of appearance: the order of markers and colours."""
        return list(dict.fromkeys(point.method for point in self.points))


def pareto_front(points: Sequence[Point]) -> list[int]:
    """Indices of the measured points that no other measured point beats on both axes, by growing x."""
    measured = (k for k, point in enumerate(points) if not (point.quoted or point.off_scale))
    order = sorted(measured, key=lambda k: (points[k].x, points[k].y))
    front: list[int] = []
    for k in order:
        if not front or points[k].y < points[front[-1]].y:
            front.append(k)
    return front


@dataclass(frozen=True)
class Marker:
    """The sign of a method in the plot and in the legend.

    Attributes:
        index: of the method; decides about the shape and, where ``color`` is None, about the colour.
        x, y: of its middle [px].
        hollow: drawn as an outline.
        color: 0 to 7.
    """

    index: int
    x: float = 0.0
    y: float = 0.0
    hollow: bool = False
    color: int | None = None
    radius: ClassVar[str] = f"{_RADIUS:g}"

    @property
    def style(self) -> str:
        """Classes of the style sheet."""
        color = (self.index if self.color is None else self.color) % COLOR_COUNT
        return f"marker m{color}{' hollow' if self.hollow else ''}"

    @property
    def corners(self) -> str:
        """Of a polygon; empty for a circle."""
        shape = _SHAPES[self.index % len(_SHAPES)]
        return corners([(self.x + _RADIUS * u, self.y + _RADIUS * v) for u, v in shape])


def corners(places: Sequence[tuple[float, float]]) -> str:
    """Pixels as SVG's attribute ``points`` has them."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in places)


@dataclass(frozen=True)
class PlotText:
    """A text in the plot.

    Attributes:
        x, y: of the end that ``anchor`` names ("start", "middle" or "end"), on the base line [px].
        text: plain text.
        style: class of the style sheet.
    """

    x: float
    y: float
    text: str
    style: str
    anchor: str


class PlotBox(NamedTuple):
    """A rectangle [px]."""

    left: float
    top: float
    right: float
    bottom: float


@dataclass(frozen=True)
class Plot:
    """A chart in pixels, as the template ``plot.svg`` draws it.

    Attributes:
        bands: upper and lower border of each.
        x_grid, y_grid: of the lines at round numbers.
        ticks: the round numbers.
        x_lines, y_lines: of :class:`Line`.
        stairs: corners of the Pareto front.
        notes: names of bands and lines.
        labels: names of the points that there is room for.
        places: of all points.
    """

    bands: Sequence[tuple[float, float]]
    x_grid: Sequence[float]
    y_grid: Sequence[float]
    ticks: Sequence[PlotText]
    x_lines: Sequence[float]
    y_lines: Sequence[float]
    stairs: Sequence[tuple[float, float]]
    notes: Sequence[PlotText]
    labels: Sequence[PlotText]
    places: Sequence[tuple[float, float]]
    width: ClassVar[str] = f"{_WIDTH:g}"
    height: ClassVar[str] = f"{_HEIGHT:g}"
    box: ClassVar[PlotBox] = PlotBox(_LEFT, _TOP, _RIGHT, _BOTTOM)


def plot_of(chart: Chart) -> Plot:
    """Where everything stands.

    Raises:
        InputError: there is no point, a value is not finite, or one on a logarithmic axis is not positive.
    """
    _check(chart)
    ys = [point.y for point in chart.points if not point.off_scale]
    ys += [edge for band in chart.bands for edge in (band.low, band.high)]
    x_axis = _Axis([p.x for p in chart.points] + _at(chart, "x"), chart.log_x, _LEFT, _RIGHT)
    y_axis = _Axis(ys + _at(chart, "y"), chart.log_y, _BOTTOM, _TOP)
    places = [(x_axis.place(p.x), _TOP if p.off_scale else y_axis.place(p.y)) for p in chart.points]
    front = pareto_front(chart.points)
    stairs = _stairs([places[k] for k in front])
    notes = _notes(chart, x_axis, y_axis)
    taken = [
        PlotBox(min(a[0], b[0]), min(a[1], b[1]), max(a[0], b[0]) + 1, max(a[1], b[1]) + 1) for a, b in pairwise(stairs)
    ] + [_box(note) for note in notes]
    bands = [(y_axis.place(band.high), y_axis.place(band.low)) for band in chart.bands]
    return Plot(
        bands=[(top, max(bottom, top + 1.0)) for top, bottom in bands],
        x_grid=[x_axis.place(value) for value in x_axis.ticks()],
        y_grid=[y_axis.place(value) for value in y_axis.ticks()],
        ticks=_ticks(x_axis, y_axis),
        x_lines=[x_axis.place(value) for value in _at(chart, "x")],
        y_lines=[y_axis.place(value) for value in _at(chart, "y")],
        stairs=stairs,
        notes=notes,
        labels=_labels(chart.points, places, front, taken),
        places=places,
    )


class _Axis:
    """From values to pixels, with round numbers to mark."""

    def __init__(self, values: Sequence[float], log: bool, start: float, end: float) -> None:
        self._log, self._start, self._end = log, start, end
        values = [value for value in values if value > 0.0] if log else values  # a floor may reach down to zero
        low, high = (self._scaled(edge) for edge in (min(values), max(values)))
        room = 0.07 * (high - low) or (0.3 if log else 0.5 * abs(high) or 1.0)
        from_zero = not log and low >= 0.0
        self._low, self._high = (0.0 if from_zero else low - room), high + room

    def _scaled(self, value: float) -> float:
        return math.log10(value) if self._log else value

    def place(self, value: float) -> float:
        """Pixel of a value; one outside is moved to the border."""
        at = self._low if self._log and value <= 0.0 else self._scaled(value)
        share = (min(max(at, self._low), self._high) - self._low) / (self._high - self._low)
        return self._start + share * (self._end - self._start)

    def ticks(self) -> list[float]:
        span = self._high - self._low
        if self._log:
            digits = (1, 2, 5) if span < 2.5 else (1,)
            step = max(1, round(span / 8.0))
            decades = range(math.floor(self._low), math.ceil(self._high) + 1, step)
            values = [digit * 10.0**decade for decade in decades for digit in digits]
            return [value for value in values if self._low <= math.log10(value) <= self._high]
        step = next(
            s for s in (m * 10.0 ** math.floor(math.log10(span / 8.0)) for m in (1, 2, 5, 10)) if span / s <= 8.0
        )
        return [k * step for k in range(math.ceil(self._low / step), math.floor(self._high / step) + 1)]


def _check(chart: Chart) -> None:
    if not chart.points:
        raise InputError("a chart needs at least one point", key="points")
    for line in chart.lines:
        if line.axis not in ("x", "y"):
            raise InputError("unknown axis", key=f"line {line.label!r}", received=line.axis, expected="'x' or 'y'")
    for axis, log in (("x", chart.log_x), ("y", chart.log_y)):
        values = [(p.label or p.method, getattr(p, axis)) for p in chart.points if not (p.off_scale and axis == "y")]
        values += [(line.label, line.value) for line in chart.lines if line.axis == axis]
        for label, value in values:
            if not math.isfinite(value) or (log and value <= 0.0):
                expected = "a positive number on a logarithmic axis" if log else "a finite number"
                raise InputError("cannot be drawn", key=f"{axis} of {label!r}", received=value, expected=expected)


def _at(chart: Chart, axis: str) -> list[float]:
    return [line.value for line in chart.lines if line.axis == axis]


def _ticks(x_axis: _Axis, y_axis: _Axis) -> list[PlotText]:
    along_x = [(x_axis.place(value), _BOTTOM + 18, value, "middle") for value in x_axis.ticks()]
    along_y = [(_LEFT - 8, y_axis.place(value) + 4, value, "end") for value in y_axis.ticks()]
    return [PlotText(x, y, f"{value:.10g}", "tick", anchor) for x, y, value, anchor in along_x + along_y]


def _notes(chart: Chart, x_axis: _Axis, y_axis: _Axis) -> list[PlotText]:
    """Names of bands and lines, which end at the right border, or at the top beside upright lines."""
    notes = []
    for band in chart.bands:
        top, bottom = y_axis.place(band.high), y_axis.place(band.low)
        notes.append((_RIGHT - 6, top + 14 if bottom - top > 18 else top - 5, band.label))
    for line in chart.lines:
        if line.axis == "x":
            notes.append((x_axis.place(line.value) - 5, _TOP + 12, line.label))
        else:
            notes.append((_RIGHT - 6, y_axis.place(line.value) - 5, line.label))
    return [PlotText(x, y, text, "note", "end") for x, y, text in notes]


def _stairs(places: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The Pareto front as a staircase: the error of the best point so far, until a dearer point is better."""
    if not places:
        return []
    found = [(places[0][0], _TOP), places[0]]
    for x, y in places[1:]:
        found += [(x, found[-1][1]), (x, y)]
    return [*found, (_RIGHT, found[-1][1])]


def _box(text: PlotText) -> PlotBox:
    """About the room that a text takes."""
    width = _LETTER * len(text.text)
    left = text.x - {"start": 0.0, "middle": width / 2, "end": width}[text.anchor]
    return PlotBox(left, text.y - _LINE + 3, left + width, text.y + 3)


def _labels(
    points: Sequence[Point], places: Sequence[tuple[float, float]], front: Sequence[int], taken: Sequence[PlotBox]
) -> list[PlotText]:
    """Labels beside their points; one that finds no free place is left to the tooltip and the table."""
    reach = _RADIUS + 1
    taken = [*taken, *(PlotBox(x - reach, y - reach, x + reach, y + reach) for x, y in places)]
    found = []
    for k in sorted(range(len(points)), key=lambda k: k not in front):  # the Pareto front's points choose first
        for dx, dy, anchor in (
            (11, 4, "start"), (-11, 4, "end"), (6, 19, "start"), (-6, 19, "end"),
            (6, -10, "start"), (-6, -10, "end"), (0, -12, "middle"), (0, 21, "middle"),
        ):  # fmt: skip
            label = PlotText(places[k][0] + dx, places[k][1] + dy, points[k].label, "label", anchor)
            box = _box(label)
            inside = _LEFT < box.left and box.right < _WIDTH and _TOP < box.top and box.bottom < _BOTTOM
            if points[k].label and inside and not any(_overlap(box, other) for other in taken):
                taken.append(box)
                found.append(label)
                break
    return found


def _overlap(one: PlotBox, other: PlotBox) -> bool:
    across = one.left < other.right and other.left < one.right
    return across and one.top < other.bottom and other.top < one.bottom
