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

from assets.patterns.pattern import Panel
from assets.patterns.sheet import edges_of_pieces, panel_of_outline
from assets.text import decoded
from pbd.errors import InputError

__all__ = ["read_dxf"]

Floats = NDArray[np.float64]

# Layers of ASTM D6673, "Standard practice for sewn products pattern data interchange".
_CUT_LINE, _TURN_POINTS, _GRAIN_LINE = "1", "2", "7"
_CURVES = ("LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "LWPOLYLINE", "POLYLINE")
_FLATTENING = 1e-5  # [m] between a curve and its chords
_METRIC, _ENGLISH = 1e-3, 0.0254  # [m]


def read_dxf(path: Path) -> tuple[Panel, ...]:
    """Read closed outlines as panels.

    A drawing with inserted blocks has a panel for each of them, named by the block: the cut line on layer 1, its
    corners as points on layer 2, the grain line on layer 7. Any other drawing has a panel on each layer, named by the
    layer. For their edges see :func:`assets.patterns.sheet.edges_of_pieces`.

    Raises:
        InputError: the file cannot be read, says no unit, has no panels, or an open outline.
    """
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
    inserts = space.query("INSERT")
    groups: dict[str, dict[str, list[Any]]] = {}
    if inserts:
        for insert in inserts:
            name = insert.dxf.name
            while name in groups:
                name += "_2"
            groups[name] = _by_layer(insert.virtual_entities())
    else:
        groups = {layer: {_CUT_LINE: entities} for layer, entities in _by_layer(space).items()}
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


def _panel(name: str, layers: dict[str, list[Any]], unit: float) -> Panel | None:
    """The panel of a block or layer; None if nothing is drawn on its cut line."""
    from ezdxf.path import make_path

    pieces = []
    for entity in layers.get(_CUT_LINE, []):
        if entity.dxftype() in _CURVES:
            curve = make_path(entity)
            points = np.array([(point.x, point.y) for point in curve.flattening(_FLATTENING / unit)]) * unit
            apart = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9)
            pieces.append(points[apart])
    if not pieces:
        return None
    turns = [entity.dxf.location for entity in layers.get(_TURN_POINTS, []) if entity.dxftype() == "POINT"]
    ends = np.array([(point.x, point.y) for point in turns]).reshape(-1, 2) * unit
    edges = edges_of_pieces(pieces, f"panel {name!r}", ends)
    grain = next((entity for entity in layers.get(_GRAIN_LINE, []) if entity.dxftype() == "LINE"), None)
    if grain is None:
        return panel_of_outline(name, edges)
    along = grain.dxf.end - grain.dxf.start
    return panel_of_outline(name, edges, np.array([along.x, along.y]))


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
