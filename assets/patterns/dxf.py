"""Panels from DXF drawings, plain ones and those of pattern systems (AAMA, ASTM D6673).

ezdxf (MIT, kept) reads the file, its blocks and its curves.
"""

from __future__ import annotations

import codecs
import io
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.extras import require_extra
from assets.patterns.fold import unfolded
from assets.patterns.pattern import Panel
from assets.patterns.sheet import MAX_GAP, edges_of_pieces, panel_of_outline
from assets.text import decoded
from pbd.errors import InputError

__all__ = ["read_dxf"]

Floats = NDArray[np.float64]

# Layers of ASTM D6673, "Standard practice for sewn products pattern data interchange".
_CUT_LINE, _TURN_POINTS, _MIRROR_LINE, _GRAIN_LINE, _CUTOUTS, _SEW_LINE = "1", "2", "6", "7", "11", "14"
_OUTLINES = {_CUT_LINE, _SEW_LINE, _CUTOUTS, _MIRROR_LINE}
# They change no outline: points, notches, grade lines, lines to draw, stripes, drill holes, text, curves of validation.
_MARKS = {"2", "3", "4", "5", "8", "9", "10", "12", "13", "15", *map(str, range(80, 88))}
_MAX_ALLOWANCE = 0.1  # [m] between cut line and sew line
_CURVES = ("LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "LWPOLYLINE", "POLYLINE")
_FLATTENING = 1e-5  # [m] between a curve and its chords
_METRIC, _ENGLISH = 1e-3, 0.0254  # [m]


def read_dxf(path: Path) -> tuple[Panel, ...]:
    """Read closed outlines as panels.

    A drawing with inserted blocks has a panel for each of them, named by the block: the sew line on layer 14, or the
    cut line on layer 1 where there is none, its corners as points on layer 2, the grain line on layer 7. A half piece
    is unfolded along the mirror line on layer 6. Any other drawing has a panel on each layer, named by the layer. For
    their edges see :func:`assets.patterns.sheet.edges_of_pieces`. Layers that are off or frozen are left out.

    Raises:
        InputError: the file cannot be read, says no unit, has no panels, an open outline, curves beside its blocks,
            blocks in blocks, a clipped block, or a block that has a cutout, no outline, or a sew line that does not
            belong to its cut line.
    """
    require_extra("sew", path)
    try:
        return _panels(path)
    except InputError:
        raise
    except Exception as error:  # of damaged files ezdxf raises StopIteration, IndexError, OverflowError and others
        problem = f"cannot be read: {error or type(error).__name__}"
        raise InputError(problem, file=path, expected="a DXF drawing") from error


def _panels(path: Path) -> tuple[Panel, ...]:
    document = _document(path)
    space: Any = document.modelspace()
    unit = _unit(document, space, path)
    shown = [entity for entity in space if _is_shown(document, entity)]
    inserts: list[Any] = [entity for entity in shown if entity.dxftype() == "INSERT"]
    groups: dict[str, dict[str, list[Any]]] = {}
    for insert in inserts:
        name = insert.dxf.name
        while name in groups:
            name += "_2"
        _check_insert(document, insert, path)
        groups[name] = _by_layer(entity for entity in insert.virtual_entities() if _is_shown(document, entity))
    beside = _by_layer(entity for entity in shown if entity.dxftype() in _CURVES)
    if inserts and beside.keys() - _MARKS:
        received, expected = sorted(beside.keys() - _MARKS), "all outlines in blocks, or none"
        problem = "outlines beside the blocks"
        raise InputError(problem, file=path, key="layers", received=received, expected=expected)
    if not inserts:
        groups = {layer: {_CUT_LINE: entities} for layer, entities in beside.items()}
    panels, errors = [], []
    for name, layers in groups.items():
        try:
            panel = _panel(name, layers, unit)
        except InputError as error:
            errors.append(error.in_file(path))
            continue
        panels += [panel] if panel else []
    if errors or not panels:
        expected = "closed polylines, on layer 1 of a block or on layers of their own"
        raise InputError.join(errors or [InputError("a drawing without panels", file=path, expected=expected)])
    return tuple(panels)


def _by_layer(entities: Iterable[Any]) -> dict[str, list[Any]]:
    layers: dict[str, list[Any]] = defaultdict(list)
    for entity in entities:
        layers[entity.dxf.layer].append(entity)
    return layers


def _is_shown(document: Any, entity: Any) -> bool:
    name = entity.dxf.layer
    layer = document.layers.get(name) if document.layers.has_entry(name) else None
    return layer is None or not (layer.is_off() or layer.is_frozen())


def _check_insert(document: Any, insert: Any, path: Path) -> None:
    """Refuse what would be lost of a block: copies in rows and columns, a clip, and outlines in a block inside it."""
    from ezdxf.xclip import XClip

    key = f"block {insert.dxf.name!r}"
    clip = XClip(insert)
    if clip.has_clipping_path and clip.is_clipping_enabled:
        raise InputError("a clipped block", file=path, key=key, expected="a block without clip (XCLIP, Delete)")
    if insert.mcount > 1:
        raise InputError("a block in rows and columns", file=path, key=key, expected="one insert for each piece")
    for inner in document.blocks.get(insert.dxf.name, ()):
        if inner.dxftype() == "INSERT" and _is_shown(document, inner):
            layers = {inner.dxf.layer, *(entity.dxf.layer for entity in document.blocks.get(inner.dxf.name, ()))}
            if layers & _OUTLINES:
                received, expected = inner.dxf.name, "pieces that are drawn in their own block"
                raise InputError("a block inside a block", file=path, key=key, received=received, expected=expected)


def _panel(name: str, layers: dict[str, list[Any]], unit: float) -> Panel | None:
    """The panel of a block or layer; None if nothing is drawn there but marks and text."""
    key = f"panel {name!r}"
    curves = {layer: found for layer, entities in layers.items() if (found := _polylines(entities, unit))}
    if not curves.keys() - _MARKS:
        return None
    if not curves.keys() & {_CUT_LINE, _SEW_LINE}:
        received, expected = sorted(curves), "a cut line on layer 1 or a sew line on layer 14"
        raise InputError("a block without an outline", key=key, received=received, expected=expected)
    if _CUTOUTS in curves:
        expected = "nothing on layer 11: a panel has no holes; divide the piece, or delete the cutout"
        raise InputError("a cutout inside a piece", key=key, received="curves on layer 11", expected=expected)
    turns = [entity.dxf.location for entity in layers.get(_TURN_POINTS, []) if entity.dxftype() == "POINT"]
    points = np.array([(point.x, point.y) for point in turns]).reshape(-1, 2) * unit
    outlines = {}
    for layer, word in ((_CUT_LINE, "cut line"), (_SEW_LINE, "sew line")):
        if layer in curves:
            line = f"{key}, {word}" if _SEW_LINE in curves else key
            pieces, ends = curves[layer], points
            if _MIRROR_LINE in curves:
                pieces, ends = unfolded(pieces, points, _axis(curves[_MIRROR_LINE], key), line)
            outlines[layer] = edges_of_pieces(pieces, line, ends)
    if len(outlines) == 2:
        _check_allowance(outlines[_CUT_LINE], outlines[_SEW_LINE], key)
    edges = outlines.get(_SEW_LINE) or outlines[_CUT_LINE]
    grains = [line[-1] - line[0] for line in curves.get(_GRAIN_LINE, [])]
    grain = max(grains, key=lambda along: float(np.linalg.norm(along)), default=None)  # others are its arrow heads
    if grain is not None and not np.linalg.norm(grain) > 0.0:
        raise InputError("a grain line that ends where it starts", key=key, expected="a straight line on layer 7")
    return panel_of_outline(name, edges, grain)


def _polylines(entities: Iterable[Any], unit: float) -> list[Floats]:
    """The curves among entities as polylines [m]."""
    from ezdxf.path import make_path

    found = []
    for entity in entities:
        if entity.dxftype() in _CURVES:
            curve = make_path(entity)
            points = np.array([(point.x, point.y) for point in curve.flattening(_FLATTENING / unit)]) * unit
            apart = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9)
            found.append(points[apart])
    return found


def _axis(lines: list[Floats], key: str) -> Floats:
    """Both ends of the mirror line [m], shape (2, 2)."""
    if len(lines) > 1:
        expected = "one: unfold the piece along the others"
        raise InputError("several mirror lines", key=key, received=len(lines), expected=expected)
    return lines[0][[0, -1]]


def _check_allowance(cut: list[Floats], sewn: list[Floats], key: str) -> None:
    """Refuse a sew line that does not go around inside the cut line."""
    outer, inner = np.concatenate(cut), np.concatenate(sewn)
    left, right = inner.min(axis=0) - outer.min(axis=0), outer.max(axis=0) - inner.max(axis=0)
    sides = np.concatenate([left, right])
    if sides.min() < -MAX_GAP or sides.max() > _MAX_ALLOWANCE:
        received = "allowances of " + ", ".join(f"{1e3 * side:.0f}" for side in sides) + " mm"
        expected = f"0 to {1e3 * _MAX_ALLOWANCE:.0f} mm left, below, right and above"
        raise InputError("a sew line that does not follow its cut line", key=key, received=received, expected=expected)


def _document(path: Path) -> Any:
    """The drawing, without a byte order mark, which ezdxf would take for a part of the first line."""
    from ezdxf.filemanagement import read, readfile

    data = path.read_bytes()
    if data.startswith((codecs.BOM_UTF8, codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return read(io.StringIO(decoded(data, path)))
    document = readfile(path)
    names = [entity.dxf.layer for entity in document.modelspace()] + [block.name for block in document.blocks]
    if not all(map(str.isprintable, names)):  # bytes that are not of the encoding that the file names
        decoded(data, path)
    return document


def _unit(document: Any, space: Any, path: Path) -> float:
    """Length of the drawing's unit [m]: from $INSUNITS, or from the text UNITS of a pattern system."""
    from ezdxf import units
    from ezdxf.enums import InsertUnits

    if document.units:
        return float(units.conversion_factor(document.units, InsertUnits.Meters))
    texts = [entity.dxf.text.upper().replace(" ", "") for entity in space.query("TEXT")]
    for words, unit in (("UNITS:METRIC", _METRIC), ("UNITS:ENGLISH", _ENGLISH)):
        if words in texts:
            return unit
    expected = "$INSUNITS, or a text 'UNITS: METRIC' or 'UNITS: ENGLISH'"
    raise InputError("a drawing without unit", file=path, key="$INSUNITS", expected=expected)
