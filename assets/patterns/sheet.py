"""Panels drawn side by side on a sheet, and the side file that says how they are sewn.

A drawing holds outlines. Seams, bands and places around the body stand in ``NAME.seams.toml`` beside ``NAME.svg`` or
``NAME.dxf``, so that both kinds of drawing are sewn in the same way.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from assets.io.settings import AllowedValues, Reader, Refused, choice, entry, number, table, tables, text, truth, vector
from assets.patterns.curves import signed_area
from assets.patterns.pattern import Band, EdgeName, Panel, Pattern, Placement, Seam
from assets.text import read_text
from pbd.errors import InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["MAX_GAP", "closed_loop", "edges_of_pieces", "panel_of_outline", "turns", "with_side_file"]

Floats = NDArray[np.float64]

MAX_GAP = 1e-4  # [m] that the ends of drawn pieces may lie apart
_CORNER = math.cos(math.radians(20.0))  # an outline of straight pieces has a corner where it turns further
_FACINGS = {"front": 0.0, "left": 90.0, "back": 180.0, "right": 270.0}  # [deg] around the vertical axis


def panel_of_outline(name: str, edges: Sequence[Floats], grain: Floats | None = None) -> Panel:
    """A panel from the edges of a closed outline, drawn in any direction, with y upwards.

    Edges are numbered counter-clockwise from the first point of the outline.

    Args:
        name: of the panel.
        edges: polylines [m], each from the end of the last one, shape (k, 2).
        grain: direction of the warp, shape (2,); upwards if None.
    """
    if signed_area(np.concatenate([edge[:-1] for edge in edges])) < 0.0:
        edges = [edge[::-1] for edge in reversed(edges)]
    up = np.array([0.0, 1.0])
    return Panel(name, tuple(edges), up if grain is None else grain / np.linalg.norm(grain))


def edges_of_pieces(pieces: Sequence[Floats], key: str, ends: Floats | None = None) -> list[Floats]:
    """Edges of a panel that is drawn as pieces of its outline.

    Each piece is an edge if some are curved. Of straight pieces, or of a single one, the edges run from corner to
    corner: where the outline turns by over 20 degrees, or where a point of ``ends`` lies, if there are any.

    Args:
        pieces: polylines [m] in any order and direction, shape (k, 2).
        key: names the outline in messages.
        ends: [m], shape (k, 2); those off the outline do not count.

    Raises:
        InputError: as :func:`closed_loop`.
    """
    loop = closed_loop(pieces, key)
    outline = np.concatenate([piece[:-1] for piece in loop])
    corners = np.zeros(0, int)
    if ends is not None and len(ends):
        away, nearest = cKDTree(outline).query(ends)
        corners = np.unique(nearest[away < MAX_GAP])
    if len(loop) > 1 and any(len(piece) > 2 for piece in loop) and not len(corners):
        return loop
    return _edges_between_corners(outline, corners)


def closed_loop(pieces: Sequence[Floats], key: str) -> list[Floats]:
    """Pieces of an outline one after another, each from exactly where the last one ends, some of them turned round.

    Args:
        pieces: polylines [m] in any order and direction, shape (k, 2).
        key: names the outline in messages.

    Raises:
        InputError: the pieces do not close, or are several outlines.
    """
    loop, left = [pieces[0]], list(pieces[1:])
    while left:
        end = loop[-1][-1]
        gaps = [[float(np.linalg.norm(piece[k] - end)) for k in (0, -1)] for piece in left]
        best = int(np.argmin(np.min(gaps, axis=1)))
        if min(gaps[best]) > MAX_GAP:
            break
        piece = left.pop(best)
        loop.append(piece if gaps[best][0] <= gaps[best][1] else piece[::-1])
    gap = float(np.linalg.norm(loop[-1][-1] - loop[0][0]))
    if left and gap <= MAX_GAP:  # a second outline, or a line beside the first
        loop = left[:1]
        gap = float(np.linalg.norm(loop[0][-1] - loop[0][0]))
        if gap <= MAX_GAP:
            raise InputError("a panel of several outlines", key=key, expected="one outline for each panel")
    if gap > MAX_GAP:
        x, y = 1e2 * loop[-1][-1]
        received = f"an end at {x:.2f}, {y:.2f} cm, {1e3 * gap:.3g} mm from the start"
        expected = "a closed one; hide what is no outline"
        raise InputError("an open outline", key=key, received=received, expected=expected)
    starts = [piece[0] for piece in loop]
    return [np.concatenate([piece[:-1], end[None]]) for piece, end in zip(loop, starts[1:] + starts[:1], strict=True)]


def turns(before: Floats, after: Floats) -> NDArray[np.bool_]:
    """Where an outline has a corner, shape (k,): at turns from one direction to another one, shape (k, 2)."""
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return (before * after).sum(axis=1) / np.maximum(lengths, 1e-300) < _CORNER


def _edges_between_corners(outline: Floats, corners: NDArray[np.int64]) -> list[Floats]:
    """A closed outline [m], shape (n, 2), cut at the points of these numbers; at its corners if there are none."""
    if not len(corners):
        ahead = np.roll(outline, -1, axis=0) - outline
        corners = np.flatnonzero(turns(np.roll(ahead, 1, axis=0), ahead))
    if len(corners) < 2:
        corners = np.array([0, len(outline) // 2])  # a round piece: two halves
    last = np.append(corners[1:], corners[0] + len(outline))
    return [outline[np.arange(a, b + 1) % len(outline)] for a, b in zip(corners, last, strict=True)]


def _edge() -> AllowedValues:
    """An edge as [panel, number]."""

    def convert(reader: Reader, value: Any, key: str) -> EdgeName:
        if not isinstance(value, list) or len(value) != 2:
            raise Refused
        if not isinstance(value[0], str) or not isinstance(value[1], int) or isinstance(value[1], bool):
            raise Refused
        return EdgeName(value[0], value[1])

    return AllowedValues("an edge: [panel, number]", convert)


def _seams() -> AllowedValues:
    """Seams as [panel, number, panel, number]."""

    def convert(reader: Reader, value: Any, key: str) -> tuple[Seam, ...]:
        if not isinstance(value, list):
            raise Refused
        one = _edge()
        seams = []
        for index, item in enumerate(value):
            place = f"{key}[{index}]"
            if not isinstance(item, list) or len(item) != 4:
                expected = "[panel, number, panel, number]"
                reader.errors.append(
                    InputError("no seam", file=reader.file, key=place, received=item, expected=expected)
                )
                continue
            first, second = reader.value(one, item[:2], place), reader.value(one, item[2:], place)
            if first and second:
                seams.append(Seam(first, second))
        return tuple(seams)

    return AllowedValues("a list of seams: [panel, number, panel, number]", convert)


@dataclass(frozen=True)
class _BandEntry:
    """A band of the side file."""

    edge: EdgeName = entry(_edge())
    width: float = entry(number(above=0.0, unit="m"))
    layers: float = entry(number(at_least=1.0), 2.0)
    length_ratio: float = entry(number(above=0.0), 1.0)


@dataclass(frozen=True)
class _PanelEntry:
    """A panel of the side file.

    Attributes:
        name: as in the drawing.
        faces: side of the body that the outer side looks to.
        position: where the middle of the panel's box stands before it is sewn [m].
        mirrored: whether the drawing shows the inner side.
    """

    name: str = entry(text())
    faces: str | None = entry(choice(*_FACINGS), None)
    position: tuple[float, ...] | None = entry(vector(unit="m"), None)
    mirrored: bool = entry(truth(), False)


@dataclass(frozen=True)
class _SideFile:
    seams: tuple[Seam, ...] = entry(_seams())
    panel: tuple[_PanelEntry, ...] = entry(tables(table(_PanelEntry), unique="name"), ())
    band: tuple[_BandEntry, ...] = entry(tables(table(_BandEntry)), ())


def with_side_file(path: Path, panels: Sequence[Panel]) -> Pattern:
    """The pattern of a drawing: its panels, with the seams, bands and places of the side file.

    Args:
        path: of the drawing.
        panels: from it.

    Raises:
        InputError: the side file is missing, is no TOML, or has entries that cannot be; all of them are named.
    """
    file = path.with_suffix(".seams.toml")
    if not file.exists():
        expected = 'seams = [["front", 1, "back", 3], ...]'
        raise InputError("a drawing without its file of seams", file=file, expected=expected)
    content = read_text(file, "a TOML file")
    try:
        values = tomllib.loads(content)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"cannot be read: {error}", file=file, expected="a TOML file") from error
    reader = Reader(file)
    side: _SideFile | None = reader.table(_SideFile, values)
    names = [panel.name for panel in panels]
    for index, one in enumerate(side.panel if side else ()):
        if one.name not in names:
            expected = "one of " + ", ".join(map(repr, names))
            key = f"panel[{index}].name"
            reader.errors.append(InputError("no such panel", file=file, key=key, received=one.name, expected=expected))
        if (one.faces is None) != (one.position is None):
            expected = "both 'faces' and 'position', or none"
            reader.errors.append(InputError("half a place", file=file, key=f"panel[{index}]", expected=expected))
    if reader.errors or side is None:
        raise InputError.join(reader.errors)
    entries = {one.name: one for one in side.panel}
    placed = tuple(_placed(panel, entries[panel.name]) if panel.name in entries else panel for panel in panels)
    bands = tuple(Band(one.edge, one.width, one.layers, one.length_ratio) for one in side.band)
    return Pattern(path.stem, placed, side.seams, bands, str(path))


def _placed(panel: Panel, one: _PanelEntry) -> Panel:
    """The panel as its entry in the side file says. The edges of a mirrored one count clockwise in the drawing."""
    if one.mirrored:
        edges = tuple((edge * [-1.0, 1.0])[::-1] for edge in reversed(panel.edges))
        panel = replace(panel, edges=edges, grain=panel.grain * [-1.0, 1.0])
    if one.faces is None or one.position is None:
        return panel
    angle = math.radians(_FACINGS[one.faces])
    cosine, sine = math.cos(angle), math.sin(angle)
    rotation = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    outline = panel.outline
    middle = np.append((outline.min(axis=0) + outline.max(axis=0)) / 2.0, 0.0)
    return replace(panel, placement=Placement(rotation, np.array(one.position) - rotation @ middle))
