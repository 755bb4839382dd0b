"""The output of `gube stability`: a picture of each map, a page that holds them all, a table of cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke

from precompute.experiment.error_classes import LIMITS, ErrorClass, classify
from precompute.reporting.cost_charts import write_png
from precompute.reporting.html_page import Heading, Picture, Section, Table, Text, write_page
from precompute.reporting.tables import write_table
from precompute.stability.stability_cells import Cell
from precompute.stability.stability_maps import Axis, StabilityMap
from precompute.stability.stability_sweep import Border, StabilitySweep, cell_command, lost
from precompute.stability.stability_theory import theory_of

__all__ = ["cell_row", "cell_text", "stability_text", "write_stability"]

COLORS = ("#4c9f70", "#a9d18e", "#f4c95d", "#b3202c")  # of the classes, from best to worst
WORDS = ("imperceptible", "visible, accepted", "visible, not accepted", "catastrophic")
DRAWN_BELOW = 3.0  # a map is drawn down to this factor below its lowest border


def write_stability(folder: Path, found: StabilitySweep) -> list[Path]:
    """Write ``stability.html``, ``stability.csv`` and a PNG of each map and method; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    page, table = folder / "stability.html", folder / "stability.csv"
    names = ["map", "x", "y", "method", "class", "went", "failed_s", "frame_ms", "dt_s", "chaotic", "floor_px"]
    write_table(table, [cell_row(cell) for cell in found.cells], columns=[*names, *LIMITS, "message", "command"])
    sections: list[Section] = [Text(_foreword(found)), _counts(found)]
    files = [page, table]
    for method in found.methods:
        for one in found.maps:
            path = folder / f"{one.name}-{method.replace('/', '-')}.png"
            _draw(path, one, method, found)
            files.append(path)
            sections += [Heading(f"{one.title}: {method}"), Picture(path, _caption(one, method, found))]
    sections += [Heading("Borders"), _border_table(found.borders), Heading("Catastrophic cells"), _lost_table(found)]
    write_page(page, "Where methods fail", sections)
    return files


def cell_row(cell: Cell) -> dict[str, Any]:
    """A cell as a row of the table."""
    row: dict[str, Any] = {
        "map": cell.map,
        "x": cell.x,
        "y": cell.y,
        "method": cell.method,
        "class": cell.error_class.name.lower(),
        "went": cell.went,
        "failed_s": cell.failed_s,
        "frame_ms": cell.frame_ms,
        "dt_s": cell.dt,
        "chaotic": cell.chaotic,
        "floor_px": cell.floor_px,
        "message": cell.message,
        "command": cell_command(cell),
    }
    return row | cell.figures


def cell_text(cell: Cell) -> str:
    """The result of one cell, for a terminal."""
    went = f", {cell.went}" if cell.went else ""
    lines = [f"{cell.map} {cell.x:g} {cell.y:g} by {cell.method}: {WORDS[cell.error_class]}{went}"]
    if not math.isnan(cell.failed_s):
        lines.append(f"  first catastrophic limit passed by {cell.failed_s:.3g} s")
    if cell.message:
        lines.append(f"  the solver said: {cell.message}")
    lines.append(f"  a frame of {cell.dt:.4g} s takes {cell.frame_ms:.3g} ms")
    agree = "chaotic: compared as distributions" if cell.chaotic else f"converged to {cell.floor_px:.2g} px"
    lines.append(f"  reference: {agree}")
    classes = classify(cell.figures)
    lines += [f"  {name:24s} {value:10.4g}  {WORDS[classes[name]]}" for name, value in cell.figures.items()]
    return "\n".join(lines)


def stability_text(found: StabilitySweep) -> str:
    """The counts, the explicit limits, and the commands that run catastrophic cells again."""
    lines = []
    for method in found.methods:
        lines.append(f"{method}:")
        for one in found.maps:
            cells = found.of(one, method)
            gone = [cell for cell in cells if lost(cell)]
            lines.append(f"  {one.title.lower():42s} {len(gone):4d} of {len(cells)} cells catastrophic")
            shown = gone if method == "default" else gone[:1]
            lines += [f"    {cell.went}: {cell_command(cell)}" for cell in shown]
    for limit in found.limits:
        lines.append(
            f"explicit limit, {limit.lattice}: {1e3 * limit.found:.4g} ms, theory {1e3 * limit.theory:.4g} ms, "
            f"{limit.error_percent:.2g} % off"
        )
    return "\n".join(lines)


def _foreword(found: StabilitySweep) -> str:
    return (
        "Each cell is a second of one small scene, classed beside a converged run of the same scene. A cell says what "
        "was worst and what a frame takes; the black line is the border of what is catastrophic, found by bisection; "
        "dashed lines are theory. The default solver splits a frame into substeps and has its tethers, every other "
        f"method takes the time step as it is.\n\n{len(found.cells)} cells. Every catastrophic one can be run again by "
        "the command in the table below, or in stability.csv."
    )


def _counts(found: StabilitySweep) -> Table:
    rows = []
    for method in found.methods:
        for one in found.maps:
            classes = [cell.error_class for cell in found.of(one, method)]
            rows.append([method, one.title, *(classes.count(kind) for kind in ErrorClass)])
    return Table(["method", "map", *WORDS], rows, "Cells by class")


def _caption(one: StabilityMap, method: str, found: StabilitySweep) -> str:
    cells = found.of(one, method)
    went = [cell.went for cell in cells if lost(cell)]
    counts = ", ".join(f"{went.count(word)} {word}" for word in dict.fromkeys(went))
    return f"{len(went)} of {len(cells)} cells are catastrophic{': ' + counts if counts else ''}."


def _border_table(borders: Sequence[Border]) -> Table:
    rows = [[b.method, b.map, b.x, b.safe, b.catastrophic] for b in borders]
    return Table(["method", "map", "x", "y not catastrophic", "y catastrophic"], rows)


def _lost_table(found: StabilitySweep) -> Table:
    rows = [[cell.went, cell.failed_s, cell_command(cell)] for cell in found.cells if lost(cell)]
    return Table(["went", "after [s]", "command"], rows)


def _draw(path: Path, one: StabilityMap, method: str, found: StabilitySweep) -> None:
    cells = {(cell.x, cell.y): cell for cell in found.of(one, method)}
    figure = Figure(figsize=(10.5, 7.5), layout="constrained")
    axes = figure.subplots()
    kinds = np.array([[cells[x, y].error_class for x in one.x.values] for y in one.y.values], float)
    colors = ListedColormap(list(COLORS))
    axes.pcolormesh(
        _walls(one.x), _walls(one.y), kinds, cmap=colors, norm=BoundaryNorm([-0.5, 0.5, 1.5, 2.5, 3.5], 4),
        edgecolors="white", linewidth=0.8,
    )  # fmt: skip
    bottom, top = _walls(one.y)[[0, -1]]
    border = [b for b in found.borders if (b.map, b.method) == (one.name, method)]
    if border:
        at = [0.5 * (b.safe + b.catastrophic) for b in border]
        axes.plot([b.x for b in border], at, "o-", color="black", markersize=4, label="border, by bisection")
        bottom = min(bottom, min(at) / DRAWN_BELOW)
    tall = bottom == _walls(one.y)[0]  # cells have room for several lines
    for cell in cells.values():
        went = cell.went.replace(" ", "\n") + "\n" if tall and cell.went else f"{cell.went} "
        color = "white" if lost(cell) else "black"
        axes.text(
            cell.x, cell.y, f"{went}{cell.frame_ms:.2g} ms", ha="center", va="center",
            fontsize=5.5 if tall else 4.5, color=color,
        )  # fmt: skip
    for curve, style in zip(theory_of(one, method), ("--", ":"), strict=False):
        around = [Stroke(linewidth=4.5, foreground="white"), Normal()]
        axes.plot(curve.x, curve.y, style, color="#1f3fbf", linewidth=2.2, label=curve.label, path_effects=around)
    for axis, set_scale in ((one.x, axes.set_xscale), (one.y, axes.set_yscale)):
        set_scale("log" if axis.log else "linear")
    axes.set_xlim(*_walls(one.x)[[0, -1]])
    axes.set_ylim(bottom, top)
    axes.set_xlabel(one.x.label)
    axes.set_ylabel(one.y.label)
    axes.set_title(f"{one.title}: {method}")
    handles, labels = axes.get_legend_handles_labels()
    handles = [Patch(color=color) for color in COLORS] + handles
    figure.legend(handles, [*WORDS, *labels], loc="outside lower center", ncols=4, fontsize=8)
    write_png(path, figure)


def _walls(axis: Axis) -> np.ndarray:
    """Where cells meet: halfway between their values, and as far out at both ends."""
    values = np.log(axis.values) if axis.log else np.array(axis.values)
    middle = 0.5 * (values[1:] + values[:-1])
    walls = np.concatenate([[2.0 * values[0] - middle[0]], middle, [2.0 * values[-1] - middle[-1]]])
    return np.exp(walls) if axis.log else walls
