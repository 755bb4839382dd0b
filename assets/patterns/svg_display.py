"""What an SVG drawing shows: shapes that are not hidden, and those that the reader of panels would miss."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pbd.errors import InputError

__all__ = ["declared", "drawn_shapes"]

_SVG = "{http://www.w3.org/2000/svg}"
_HREF = "{http://www.w3.org/1999/xlink}href"
_SHAPES = {"path", "circle", "ellipse", "line", "polyline", "polygon", "rect"}
_NEVER_DRAWN = {"defs", "symbol", "clipPath", "mask", "marker", "pattern", "foreignObject"}
# What a style can say about the shape of an outline, beside attributes, which are read.
_MOVED = {"transform", "translate", "rotate", "scale"}
_GEOMETRY = _MOVED | {"d", "x", "y", "width", "height", "cx", "cy", "r", "rx", "ry"}
_CLIPS = ("clip-path", "mask")
_ATTRIBUTES = ("display", "visibility", "transform-origin", *_CLIPS)
_READ = {*_ATTRIBUTES, *_GEOMETRY}


def drawn_shapes(root: Any, path: Path) -> set[Any]:
    """The shapes of a drawing that are shown.

    Hidden are elements with ``display: none`` and all that is in them (layers that are switched off in Inkscape and
    Illustrator), and those with ``visibility: hidden`` or ``collapse``. Attributes, ``style`` and style sheets with
    rules for an element, a class or an id are read.

    Args:
        root: the element svg, of :mod:`xml.etree.ElementTree`.
        path: of the file, for messages.

    Raises:
        InputError: a clone (use), a shape in an element other than a group, a style that changes an outline, a clip or
            mask that may cut shapes off, or a style sheet with other rules about what is shown; all of them are named.
    """
    rules = _rules(root, path)
    named = {element.get("id"): element for element in root.iter()}
    shown: set[Any] = set()
    errors: list[InputError] = []
    waiting = [(root, "visible", "")]
    while waiting:
        element, visibility, inside = waiting.pop()
        kind = element.tag.removeprefix(_SVG)
        style = _style_of(element, kind, rules)
        if kind in _NEVER_DRAWN or style.get("display") == "none":
            continue
        if style.get("visibility", "inherit") != "inherit":
            visibility = style["visibility"]
        key = f"{kind} {element.get('id')!r}" if element.get("id") else kind
        moving = _MOVED | ({"transform-origin"} if element.get("transform") else set())
        geometry = {"g": moving, "svg": _MOVED}.get(kind, _GEOMETRY | moving if kind in _SHAPES else set())
        received = {name: style[name] for name in sorted(geometry) if style.get(name, "none") != "none"}
        if received:
            expected = "the attribute transform and those of the shape"
            errors.append(InputError("a style that changes an outline", key=key, received=received, expected=expected))
        clips = {name: style[name] for name in _CLIPS if style.get(name, "none") != "none"}
        if clips and _has_shapes_in(element) and not all(_is_page(clip, named, root) for clip in clips.values()):
            expected = "outlines as they are drawn (Inkscape: Object, Clip, Release Clip)"
            errors.append(InputError("a clip that may cut outlines off", key=key, received=clips, expected=expected))
        if kind in _SHAPES | {"use"} and visibility in ("hidden", "collapse"):
            continue
        if kind in _SHAPES and inside:
            expected = "paths in groups (g) only"
            errors.append(InputError("a shape that is not read", key=key, received=f"in {inside}", expected=expected))
        elif kind in _SHAPES:
            shown.add(element)
        elif kind == "use" and _has_shapes(target := element.get("href") or element.get(_HREF) or "", named):
            expected = "a path of its own (Inkscape: Edit, Clone, Unlink Clone)"
            errors.append(InputError("a clone, which is not read", key=key, received=target, expected=expected))
        else:
            outside = inside or ("" if element is root or kind == "g" else kind)
            waiting += [(child, visibility, outside) for child in element]
    if errors:
        raise InputError.join([error.in_file(path) for error in errors])
    return shown


def declared(style: str | None) -> dict[str, str]:
    """The properties that are read here, of the text of a style, in small letters."""
    found = {}
    for one in (style or "").split(";"):
        name, _, value = one.partition(":")
        if name.strip().lower() in _READ:
            found[name.strip().lower()] = value.partition("!")[0].strip().lower()
    return found


def _style_of(element: Any, kind: str, rules: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """What is said of an element: by attributes, rules for its kind, classes and id, and its own style, in this order.

    Of attributes only those that the library does not read.
    """
    found = {name: element.get(name).strip().lower() for name in _ATTRIBUTES if element.get(name)}
    for selector in (kind, *(f".{one}" for one in (element.get("class") or "").split()), f"#{element.get('id')}"):
        found |= rules.get(selector, {})
    return found | declared(element.get("style"))


def _rules(root: Any, path: Path) -> dict[str, dict[str, str]]:
    """Rules of the style sheets about the properties that are read here, by selector.

    Raises:
        InputError: such a rule with another selector than an element, a class or an id.
    """
    rules: dict[str, dict[str, str]] = {}
    for sheet in root.iter(f"{_SVG}style"):
        text = re.sub(r"/\*.*?\*/", " ", "".join(sheet.itertext()), flags=re.DOTALL)
        for block in text.split("}"):
            selectors, _, body = block.rpartition("{")
            properties = declared(body)
            for selector in selectors.split(",") if properties else ():
                if not re.fullmatch(r"[.#]?[\w-]+", selector.strip()):
                    problem, expected = "a rule that is not read", "rules for an element, a class or an id"
                    key, received = f"style {selector.strip()!r}", properties
                    raise InputError(problem, file=path, key=key, received=received, expected=expected)
                rules.setdefault(selector.strip(), {}).update(properties)
    return rules


def _has_shapes_in(element: Any) -> bool:
    return any(one.tag.removeprefix(_SVG) in {*_SHAPES, "use"} for one in element.iter())


def _is_page(clip: str, named: Mapping[str | None, Any], root: Any) -> bool:
    """Whether a clip is the page itself, which drawing programs write around everything: one rectangle around it."""
    match = re.fullmatch(r"""url\(\s*["']?#(.+?)["']?\s*\)""", clip)
    cut = next((one for name, one in named.items() if match and name and name.lower() == match[1]), None)
    if cut is None:
        return False
    shapes = list(cut)
    if len(shapes) != 1 or shapes[0].tag != f"{_SVG}rect" or cut.get("clipPathUnits") == "objectBoundingBox":
        return False
    try:
        box = [float(word) for word in (root.get("viewBox") or "").replace(",", " ").split()]
        x, y, width, height = (float(shapes[0].get(name) or 0.0) for name in ("x", "y", "width", "height"))
    except ValueError:  # a length with a unit, or a bad viewBox, which is refused where it is read
        return False
    if len(box) != 4 or any(one.get("transform") for one in (cut, shapes[0])):
        return False
    around = x + width >= box[0] + box[2] and y + height >= box[1] + box[3]
    return x <= box[0] and y <= box[1] and around


def _has_shapes(target: str, named: Mapping[str | None, Any]) -> bool:
    """Whether the element that a clone stands for has outlines, or is in another file."""
    element = named.get(target.removeprefix("#")) if target.startswith("#") else None
    return element is None or _has_shapes_in(element)
