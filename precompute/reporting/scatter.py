"""A scatter chart as inline SVG: points by method, the Pareto front, floors as bands, labels that do not overlap.

The SVG says everything without a script; colours come from the page's style sheet (classes ``m0``, ``m1``, ...).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from typing import Any

from pbd.errors import InputError

__all__ = ["COLOR_COUNT", "Band", "Chart", "Line", "Point", "pareto_front", "show", "svg", "swatch"]

COLOR_COUNT = 8

_WIDTH, _HEIGHT = 880.0, 520.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 76.0, 856.0, 18.0, 464.0  # borders of the plot
_LETTER, _LINE = 6.4, 15.0  # size of a letter of a label, on average [px]

# Outlines in units of the marker's radius. With eight colours 104 methods differ in one of them.
_SHAPES = (
    "circle",
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
        quoted: taken from elsewhere, not measured here: a hollow marker, and no part of the front.
        color: of its own, 0 to 7; None for the method's.
        off_scale: the value along y is none: the point stands at the upper border and is no part of the front.
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


def show(value: Any) -> str:
    """A value as short text."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def swatch(index: int, hollow: bool = False, color: int | None = None) -> str:
    """The marker of a method as a small SVG, for a legend."""
    marker = _marker(index, 0.0, 0.0, hollow, color)
    return f'<svg class="swatch" viewBox="-9 -9 18 18" aria-hidden="true">{marker}</svg>'


def svg(chart: Chart, name: str) -> str:
    """The chart as an SVG element; its points carry ``data-row="NAME-pINDEX"``.

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
    corners = _corners([places[k] for k in front])
    stairs = [
        (min(a[0], b[0]), min(a[1], b[1]), max(a[0], b[0]) + 1, max(a[1], b[1]) + 1) for a, b in pairwise(corners)
    ]
    notes = _notes(chart, x_axis, y_axis)
    parts = [
        f'<svg class="plot" viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="group" '
        f'aria-label="{escape(chart.y_label)} against {escape(chart.x_label)}">',
        *(_band(band, y_axis) for band in chart.bands),
        *_grid(x_axis, y_axis, chart),
        *(_line(line, x_axis, y_axis) for line in chart.lines),
        f'<polyline class="front" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in corners)}"/>',
        *(_text(x, y, text, "note", "end") for x, y, text in notes),
        *_labels(chart.points, places, front, [*stairs, *(_box(x, y, text, "end") for x, y, text in notes)]),
        *(_point(chart, k, places[k], f"{name}-p{k}", k in front) for k in range(len(places))),
        "</svg>",
    ]
    return "\n".join(parts)


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
        """Pixel of a value; what lies outside is moved to the border."""
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


def _text(x: float, y: float, text: str, kind: str, anchor: str = "middle") -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _grid(x_axis: _Axis, y_axis: _Axis, chart: Chart) -> list[str]:
    parts = []
    for value in x_axis.ticks():
        x = x_axis.place(value)
        parts.append(
            f'<path class="grid" d="M{x:.1f} {_TOP}V{_BOTTOM}"/>' + _text(x, _BOTTOM + 18, f"{value:.10g}", "tick")
        )
    for value in y_axis.ticks():
        y = y_axis.place(value)
        parts.append(
            f'<path class="grid" d="M{_LEFT} {y:.1f}H{_RIGHT}"/>'
            + _text(_LEFT - 8, y + 4, f"{value:.10g}", "tick", "end")
        )
    parts.append(f'<path class="axis" d="M{_LEFT} {_TOP}V{_BOTTOM}H{_RIGHT}"/>')
    parts.append(_text((_LEFT + _RIGHT) / 2, _BOTTOM + 44, chart.x_label, "name"))
    middle = (_TOP + _BOTTOM) / 2
    parts.append(f'<g transform="translate(18 {middle}) rotate(-90)">{_text(0, 0, chart.y_label, "name")}</g>')
    return parts


def _band(band: Band, y_axis: _Axis) -> str:
    top, bottom = y_axis.place(band.high), y_axis.place(band.low)
    return (
        f'<rect class="band" x="{_LEFT}" y="{top:.1f}" width="{_RIGHT - _LEFT}" height="{max(bottom - top, 1.0):.1f}"/>'
    )


def _line(line: Line, x_axis: _Axis, y_axis: _Axis) -> str:
    if line.axis == "x":
        return f'<path class="mark" d="M{x_axis.place(line.value):.1f} {_TOP}V{_BOTTOM}"/>'
    return f'<path class="mark" d="M{_LEFT} {y_axis.place(line.value):.1f}H{_RIGHT}"/>'


def _notes(chart: Chart, x_axis: _Axis, y_axis: _Axis) -> list[tuple[float, float, str]]:
    """Names of bands and lines and the places that they end at: at the right, and at the top beside upright lines."""
    notes = []
    for band in chart.bands:
        top, bottom = y_axis.place(band.high), y_axis.place(band.low)
        notes.append((_RIGHT - 6, top + 14 if bottom - top > 18 else top - 5, band.label))
    for line in chart.lines:
        if line.axis == "x":
            notes.append((x_axis.place(line.value) - 5, _TOP + 12, line.label))
        else:
            notes.append((_RIGHT - 6, y_axis.place(line.value) - 5, line.label))
    return notes


def _corners(places: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The front as a staircase: the error of the best point so far, until a dearer point is better."""
    if not places:
        return []
    corners = [(places[0][0], _TOP), places[0]]
    for x, y in places[1:]:
        corners += [(x, corners[-1][1]), (x, y)]
    return [*corners, (_RIGHT, corners[-1][1])]


def _marker(index: int, x: float, y: float, hollow: bool, color: int | None = None) -> str:
    kind = f'class="marker m{(index if color is None else color) % COLOR_COUNT}{" hollow" if hollow else ""}"'
    shape = _SHAPES[index % len(_SHAPES)]
    if isinstance(shape, str):
        return f'<circle {kind} cx="{x:.1f}" cy="{y:.1f}" r="{_RADIUS:g}"/>'
    corners = " ".join(f"{x + _RADIUS * u:.1f},{y + _RADIUS * v:.1f}" for u, v in shape)
    return f'<polygon {kind} points="{corners}"/>'


def _point(chart: Chart, k: int, place: tuple[float, float], row: str, on_front: bool) -> str:
    point = chart.points[k]
    name = f"{point.method}, {point.label}" if point.label and point.label != point.method else point.method
    reached = "none" if point.off_scale else show(point.y)
    about = f"{name}: {chart.x_label} {show(point.x)}, {chart.y_label} {reached}"
    about += " (quoted)" if point.quoted else " (on the front)" if on_front else ""
    return (
        f'<g class="point" tabindex="0" role="button" data-row="{escape(row)}" data-method="{escape(point.method)}" '
        f'data-x="{point.x!r}" data-y="{point.y!r}" aria-label="{escape(about)}"><title>{escape(about)}</title>'
        f'<circle class="touch" cx="{place[0]:.1f}" cy="{place[1]:.1f}" r="13"/>'
        f"{_marker(chart.methods().index(point.method), *place, point.quoted, point.color)}</g>"
    )


_Box = tuple[float, float, float, float]  # left, top, right, bottom


def _box(x: float, y: float, text: str, anchor: str) -> _Box:
    """About the room that a text takes."""
    width = _LETTER * len(text)
    left = x - {"start": 0.0, "middle": width / 2, "end": width}[anchor]
    return left, y - _LINE + 3, left + width, y + 3


def _labels(
    points: Sequence[Point], places: Sequence[tuple[float, float]], front: Sequence[int], taken: list[_Box]
) -> list[str]:
    """Labels beside their points; one that finds no free place is left to the tooltip and the table."""
    taken = taken + [(x - _RADIUS - 1, y - _RADIUS - 1, x + _RADIUS + 1, y + _RADIUS + 1) for x, y in places]
    parts = []
    for k in sorted(range(len(points)), key=lambda k: k not in front):  # the front's points choose first
        for dx, dy, anchor in (
            (11, 4, "start"), (-11, 4, "end"), (6, 19, "start"), (-6, 19, "end"),
            (6, -10, "start"), (-6, -10, "end"), (0, -12, "middle"), (0, 21, "middle"),
        ):  # fmt: skip
            x, y = places[k][0] + dx, places[k][1] + dy
            box = _box(x, y, points[k].label, anchor)
            inside = _LEFT < box[0] and box[2] < _WIDTH and _TOP < box[1] and box[3] < _BOTTOM
            free = all(box[2] <= o[0] or o[2] <= box[0] or box[3] <= o[1] or o[3] <= box[1] for o in taken)
            if points[k].label and inside and free:
                taken.append(box)
                parts.append(_text(x, y, points[k].label, "label", anchor))
                break
    return parts
