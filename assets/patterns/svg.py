"""Panels from SVG drawings.

svgpathtools (MIT) reads paths, basic shapes, groups and transforms; svgelements, which also knows units, has had no
release since 2023. Units and the direction of y are dealt with here, what is hidden in
:mod:`assets.patterns.svg_display`.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.extras import require_extra
from assets.patterns.curves import bezier
from assets.patterns.pattern import Panel
from assets.patterns.sheet import edges_of_pieces, panel_of_outline
from assets.patterns.svg_display import declared, drawn_shapes
from assets.text import read_text
from pbd.errors import InputError

__all__ = ["read_svg"]

Floats = NDArray[np.float64]

_INCH = 0.0254  # [m]
_UNITS = {"mm": 1e-3, "cm": 1e-2, "q": 2.5e-4, "in": _INCH, "pt": _INCH / 72, "pc": _INCH / 6, "px": _INCH / 96}  # [m]
_UNIT_NAMES = "mm, cm, Q, in, pt, pc or px"
_ARC_PIECES = 128
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LENGTH = rf"\s*({_NUMBER})\s*([a-zA-Z]*)\s*"
_GRAIN = ".grain"
_STRETCH = 1e-3  # ratio of both scales of a drawing over 1 [-]


def read_svg(path: Path) -> tuple[Panel, ...]:
    """Read closed paths, polygons, rectangles and round shapes as panels, each named by its id.

    For the edges of a path see :func:`assets.patterns.sheet.edges_of_pieces`. A line with the id ``NAME.grain`` is the
    grain of a panel. Hidden elements are left out.

    Raises:
        InputError: the file cannot be read, says no unit, has no panels, an open outline, a panel of several outlines,
            a grain line without its panel, or a shape that is drawn and not read
            (:func:`assets.patterns.svg_display.drawn_shapes`).
    """
    require_extra("sew", path)
    try:
        return _panels(path)
    except InputError:
        raise
    except Exception as error:  # of damaged files svgpathtools raises AttributeError, IndexError and others
        read_text(path, "an SVG drawing")  # refuses an encoding that the file does not declare
        raise InputError(f"cannot be read: {error}", file=path, expected="an SVG drawing") from error


def _panels(path: Path) -> tuple[Panel, ...]:
    from svgpathtools import Document

    document = Document(str(path), strict_transform_parsing=True)
    shapes = drawn_shapes(document.root, path)
    paths = document.paths(path_filter=lambda element: element in shapes)
    unit = _unit(document.root, path)
    drawn: list[tuple[str, list[Floats]]] = []
    grains: list[tuple[str, Floats]] = []
    errors: list[InputError] = []
    for number, one in enumerate(paths):
        name = one.element.get("id") or f"panel{number}"
        pieces = [points for segment in one if np.ptp(points := _points(segment, unit), axis=0).any()]
        if name.endswith(_GRAIN):
            grains.append((name.removesuffix(_GRAIN), pieces[-1][-1] - pieces[0][0] if pieces else np.zeros(2)))
        elif pieces:
            try:
                drawn.append((name, _edges(one, pieces, f"panel {name!r}")))
            except InputError as error:
                errors.append(error.in_file(path))
    errors += [error.in_file(path) for error in _grain_errors([name for name, _ in drawn], grains)] if drawn else []
    if errors or not drawn:
        raise InputError.join(errors or [InputError("a drawing without panels", file=path, expected="closed paths")])
    grain_of = dict(grains)
    return tuple(panel_of_outline(name, edges, grain_of.get(name)) for name, edges in drawn)


def _grain_errors(panels: list[str], grains: list[tuple[str, Floats]]) -> list[InputError]:
    """Grain lines that say nothing."""
    errors = []
    names = [name for name, _ in grains]
    for name, along in grains:
        key = f"line {name + _GRAIN!r}"
        if name not in panels:
            errors.append(InputError("a grain line without its panel", key=key, expected=f"a panel {name!r}"))
        elif names.count(name) > 1:
            errors.append(InputError("the same name twice", key=key, expected="one grain line for a panel"))
        elif not np.linalg.norm(along) > 0.0:
            errors.append(InputError("a grain line that ends where it starts", key=key, expected="a straight line"))
    return errors


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
    """Length of the drawing's own unit [m]: width or height over that of viewBox, or 1/96 inch without a viewBox."""
    words = root.get("viewBox")
    box = [float(word) for word in re.findall(_NUMBER, words or "")]
    if words is not None and len(box) != 4:
        raise InputError("bad viewBox", file=path, key="viewBox", received=words, expected="four numbers")
    style = declared(root.get("style"))
    scales = []
    for place, key in ((2, "width"), (3, "height")):
        texts = [text for text in (style.get(key), root.get(key)) if text]
        match = next((found for text in texts if (found := re.fullmatch(_LENGTH, text))), None)
        if match:  # others are a share of the window, such as 100% or auto
            number, unit, size = float(match[1]), match[2].lower() or "px", box[place] if box else 1.0
            if unit not in _UNITS or not number > 0.0 or not size > 0.0:
                received, expected = match[0], f"a positive size in {_UNIT_NAMES}"
                raise InputError("bad size", file=path, key=key, received=received, expected=expected)
            scales.append(_UNITS[unit] * number / size)
    if not scales:
        received = {key: style.get(key) or root.get(key) for key in ("width", "height")}
        expected = f"a size of the page in {_UNIT_NAMES}"
        raise InputError("a drawing without unit", file=path, key="width", received=received, expected=expected)
    if not box:
        return _UNITS["px"]
    fit = root.get("preserveAspectRatio") or ""
    if "none" in fit and max(scales) > min(scales) * (1.0 + _STRETCH):
        expected = "width and height in the ratio of the viewBox"
        raise InputError("a stretched drawing", file=path, key="preserveAspectRatio", received=fit, expected=expected)
    return max(scales) if "slice" in fit else min(scales)
