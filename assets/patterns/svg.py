"""Panels from SVG drawings.

svgpathtools (MIT) reads paths, basic shapes, groups and transforms; svgelements, which also knows units, has had no
release since 2023. Units and the direction of y are dealt with here.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.patterns.curves import bezier
from assets.patterns.pattern import Panel
from assets.patterns.sheet import edges_of_pieces, panel_of_outline
from assets.text import read_text
from pbd.errors import InputError

__all__ = ["read_svg"]

Floats = NDArray[np.float64]

_UNITS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72.0, "pc": 0.0254 / 6.0, "px": 0.0254 / 96.0}  # [m]
_ARC_PIECES = 128
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_GRAIN = ".grain"


def read_svg(path: Path) -> tuple[Panel, ...]:
    """Read closed paths, polygons, rectangles and round shapes as panels, each named by its id.

    For the edges of a path see :func:`assets.patterns.sheet.edges_of_pieces`. A line with the id ``NAME.grain`` is the
    grain of a panel.

    Raises:
        InputError: the file cannot be read, has no panels, an open outline, or a panel of several outlines.
    """
    try:
        return _panels(path)
    except InputError:
        raise
    except Exception as error:  # of damaged files svgpathtools raises AttributeError, IndexError and others
        read_text(path, "an SVG drawing")  # refuses an encoding that the file does not declare
        raise InputError(f"cannot be read: {error}", file=path, expected="an SVG drawing") from error


def _panels(path: Path) -> tuple[Panel, ...]:
    from svgpathtools import Document

    document = Document(str(path))
    paths = document.paths()
    unit = _unit(document.root, path)
    drawn, grains = {}, {}
    errors: list[InputError] = []
    for number, one in enumerate(paths):
        name = one.element.get("id") or f"panel{number}"
        pieces = [_points(segment, unit) for segment in one if segment.start != segment.end]
        if name.endswith(_GRAIN) and pieces:
            grains[name.removesuffix(_GRAIN)] = pieces[-1][-1] - pieces[0][0]
        elif pieces:
            try:
                drawn[name] = _edges(one, pieces, f"panel {name!r}")
            except InputError as error:
                errors.append(error.in_file(path))
    if errors or not drawn:
        raise InputError.join(errors or [InputError("a drawing without panels", file=path, expected="closed paths")])
    return tuple(panel_of_outline(name, edges, grains.get(name)) for name, edges in drawn.items())


def _edges(one: Any, pieces: list[Floats], key: str) -> list[Floats]:
    outlines = len(one.continuous_subpaths())
    if outlines != 1:
        raise InputError("a panel of several outlines", key=key, received=outlines, expected="one path for each panel")
    return edges_of_pieces(pieces, key)


def _points(segment: Any, unit: float) -> Floats:
    """A segment of a path as a polyline [m], y upwards."""
    is_arc = hasattr(segment, "radius")  # which a transform may have made elliptic
    points = map(segment.point, np.linspace(0.0, 1.0, _ARC_PIECES + 1)) if is_arc else segment.bpoints()
    placed = np.array([(unit * point.real, -unit * point.imag) for point in points])
    return placed if is_arc or len(placed) == 2 else bezier(placed)


def _unit(root: Any, path: Path) -> float:
    """Length of the drawing's own unit [m]: width over viewBox, or 1/96 inch."""
    box = [float(word) for word in re.findall(_NUMBER, root.get("viewBox") or "")]
    scales = []
    for size, key in zip(box[2:4], ("width", "height"), strict=False):
        match = re.fullmatch(rf"\s*({_NUMBER})\s*([a-z]*)\s*", root.get(key) or "")
        if match:
            number, unit = float(match[1]), match[2] or "px"
            if unit not in _UNITS or not number > 0.0 or not size > 0.0:
                expected = "a positive size in one of " + ", ".join(_UNITS)
                raise InputError("bad size", file=path, key=key, received=root.get(key), expected=expected)
            scales.append(_UNITS[unit] * number / size)
    return min(scales, default=_UNITS["px"])
