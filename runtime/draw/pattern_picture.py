"""The picture of a sewing pattern as it lies on the table: matplotlib draws, imported where it is used."""

from __future__ import annotations

from typing import Any

import numpy as np

from assets.patterns.pattern import Band, EdgeName, Panel, Pattern

__all__ = ["draw_pattern"]

_ROOM = 0.06  # [m] between panels
_CLOTH, _INK, _BAND = "#efe9dc", "#2b2b30", "#c9bda2"
_DOTS_PER_INCH = 150
_WIDTH = 12.0  # [inch]


def draw_pattern(pattern: Pattern) -> np.ndarray:
    """Draw the panels of a pattern side by side, all to one scale and seen from their outer side.

    Both edges of a seam have one colour and one number in a circle; small numbers beside the outline count the edges.
    An arrow shows the grain, a darker strip a band, with its layers and its length ratio.

    Args:
        pattern: as :func:`assets.patterns.pattern_checks.check_pattern` accepts it.

    Returns:
        uint8, shape (height, width, 3).
    """
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    places, size = _places(pattern)
    figure = Figure(figsize=(_WIDTH, max(2.0, _WIDTH * size[1] / size[0])), dpi=_DOTS_PER_INCH, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, size[0]), ylim=(-size[1], 0.0), aspect="equal")
    axes.set_axis_off()
    for panel, place in zip(pattern.panels, places, strict=True):
        _draw_panel(axes, panel, place, [band for band in pattern.bands if band.edge.panel == panel.name])
    shift = dict(zip((panel.name for panel in pattern.panels), places, strict=True))
    colors = colormaps["tab20"]
    for number, seam in enumerate(pattern.seams):
        # Dark colours first: pairs of this map are a dark and a light one.
        color = colors((2 * number) % 20 + (number // 10) % 2)
        for name in (seam.first, seam.second):
            _draw_seam(axes, pattern, name, shift[name.panel], number, color)
    # A bar of 10 cm.
    axes.plot([0.02, 0.12], [-size[1] + 0.02] * 2, color=_INK, linewidth=3, solid_capstyle="butt")
    axes.text(0.13, -size[1] + 0.02, "10 cm", color=_INK, fontsize=8, va="center")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _places(pattern: Pattern) -> tuple[list[np.ndarray], tuple[float, float]]:
    """The shift of each panel that lays them in rows, and width and height of the sheet [m]."""
    boxes = [(panel.outline.min(axis=0), panel.outline.max(axis=0)) for panel in pattern.panels]
    spans = np.array([high - low for low, high in boxes]) + _ROOM
    width = max(float(spans[:, 0].max()), 1.5 * float(np.sqrt(spans.prod(axis=1).sum()))) + _ROOM
    places, x, top, row, right = [], _ROOM, _ROOM, 0.0, 0.0
    for (low, high), (across, down) in zip(boxes, spans, strict=True):
        if x + across > width:
            x, top, row = _ROOM, top + row, 0.0
        places.append(np.array([x - low[0], -top - high[1]]))
        x, row = x + across, max(row, down)
        right = max(right, x)
    return places, (right, top + row)


def _draw_panel(axes: Any, panel: Panel, place: np.ndarray, bands: list[Band]) -> None:
    outline = panel.outline + place
    axes.fill(*outline.T, facecolor=_CLOTH, edgecolor=_INK, linewidth=1.0)
    for band in bands:
        edge = panel.edges[band.edge.edge] + place
        strip = np.concatenate([edge, (edge + band.width * _left(edge))[::-1]])
        words = f"{band.layers:g} layers" + f", length {band.length_ratio:g}" * (band.length_ratio != 1.0)
        axes.fill(*strip.T, facecolor=_BAND, edgecolor="none", alpha=0.8)
        middle = edge[len(edge) // 2 - 1 : len(edge) // 2 + 1].mean(axis=0) + 0.5 * band.width * _left(edge)[0]
        axes.text(*middle, words, fontsize=5, color=_INK, ha="center", va="center")
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2.0
    length = 0.12 * np.ptp(outline, axis=0).min()
    tip, tail = middle + length * panel.grain, middle - length * panel.grain
    style = {"arrowstyle": "->", "color": _INK, "linewidth": 1.0}
    axes.annotate("", xy=tip, xytext=tail, arrowprops=style)
    text = axes.text(*(tail - [0.0, 0.008]), panel.name, fontsize=8, color=_INK, ha="center", va="top")
    text.set_in_layout(False)
    for number, edge in enumerate(panel.edges):
        spot, left = _middle(edge + place)
        axes.text(*(spot - 0.018 * left), str(number), fontsize=6, color="#808080", ha="center", va="center")


def _draw_seam(
    axes: Any, pattern: Pattern, name: EdgeName, place: np.ndarray, number: int, color: tuple[float, ...]
) -> None:
    edge = pattern.edge(name) + place
    axes.plot(*edge.T, color=color, linewidth=3.0, solid_capstyle="butt")
    spot, left = _middle(edge)
    box = {"boxstyle": "circle,pad=0.2", "facecolor": color, "edgecolor": "none"}
    axes.text(*(spot + 0.016 * left), str(number), fontsize=6, color="white", ha="center", va="center", bbox=box)


def _middle(edge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The point at half the length of a polyline, and the unit direction to its left there."""
    lengths = np.linalg.norm(np.diff(edge, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    spot = np.array([np.interp(along[-1] / 2.0, along, edge[:, axis]) for axis in (0, 1)])
    return spot, _left(edge)[min(int(np.searchsorted(along, along[-1] / 2.0)), len(edge) - 1)]


def _left(edge: np.ndarray) -> np.ndarray:
    """Unit direction to the left of a polyline at each point: into the panel. Shape (k, 2)."""
    along = np.gradient(edge, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    return np.stack([-along[:, 1], along[:, 0]], axis=1)
