"""GarmentCode specifications: sewing patterns as JSON.

The format is that of Korosteleva and Sorkine-Hornung, "GarmentCode: programming parametric sewing patterns", 2023. A
panel has vertices, edges between them, and a place around the body. The direction of its outline says where its outer
side looks: counter-clockwise outlines along the panel's own z axis, clockwise ones against it. Those are mirrored here,
so that every outline runs counter-clockwise seen from outside, and every seam joins the start of one edge to the end of
the other.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from assets.patterns.curves import arc, bezier, signed_area
from assets.patterns.pattern import EdgeName, Panel, Pattern, Placement, Seam
from assets.text import read_text
from pbd.errors import InputError

__all__ = ["read_garmentcode"]

Floats = NDArray[np.float64]

_WRONG_SIDE = "right_wrong"  # third entry of a stitch that joins an outer side to an inner one
_MIRROR = np.diag([-1.0, 1.0, -1.0])  # half a turn around the panel's y axis


def read_garmentcode(path: Path) -> Pattern:
    """Read a specification; the pattern is not checked yet.

    Raises:
        InputError: the file cannot be read, or is no specification; the message names the panel and the edge.
    """
    text = read_text(path, "a GarmentCode specification")
    try:
        document = json.loads(text, object_pairs_hook=_unique)
    except InputError as error:
        raise error.in_file(path) from error
    except ValueError as error:
        raise InputError(f"cannot be read: {error}", file=path, expected="a GarmentCode specification") from error
    try:
        panels, stitches = document["pattern"]["panels"], document["pattern"]["stitches"]
        unit = 1.0 / float(document["properties"]["units_in_meter"])
        coordinates = document["properties"].get("curvature_coords", "relative")
        entries, stitches = list(panels.items()), list(stitches)
    except (KeyError, TypeError, ValueError, AttributeError, ZeroDivisionError) as error:
        expected = "pattern.panels, pattern.stitches, properties.units_in_meter"
        raise InputError("no GarmentCode specification", file=path, received=str(error), expected=expected) from error
    if coordinates != "relative":
        key = "properties.curvature_coords"
        raise InputError("unknown coordinates", file=path, key=key, received=coordinates, expected="'relative'")
    errors: list[InputError] = []
    read, seams = [], []
    for name, entry in entries:
        try:
            read.append(_panel(name, entry, unit))
        except InputError as error:
            errors.append(error.in_file(path))
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            problem = f"a panel that cannot be read: {type(error).__name__} {error}"
            errors.append(InputError(problem, file=path, key=f"panel {name!r}", expected="vertices and edges"))
    for number, stitch in enumerate(stitches):
        try:
            one, two = (EdgeName(str(side["panel"]), int(side["edge"])) for side in stitch[:2])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            key = f"stitch {number}"
            expected = "two edges, each with panel and edge"
            errors.append(InputError("no stitch", file=path, key=key, received=str(error), expected=expected))
            continue
        seams.append(Seam(one, two, reversed=_WRONG_SIDE not in stitch[2:]))
    if errors:
        raise InputError.join(errors)
    return Pattern(path.stem.removesuffix("_specification"), tuple(read), tuple(seams), (), str(path))


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of the file, of which no key stands twice: the first panel of that name would be lost."""
    names = [name for name, _ in pairs]
    found = dict(pairs)
    if len(found) < len(pairs):
        name = next(name for name in found if names.count(name) > 1)
        raise InputError("the same name twice", key=repr(name), expected="a name of its own")
    return found


def _panel(name: str, entry: dict[str, Any], unit: float) -> Panel:
    """A panel in metres, counter-clockwise seen from its outer side."""
    vertices = unit * np.array(entry["vertices"], float).reshape(-1, 2)
    edges = []
    for number, edge in enumerate(entry["edges"]):
        start, end = (vertices[_vertex(k, len(vertices))] for k in edge["endpoints"])
        try:
            edges.append(_curve(start, end, edge.get("curvature"), unit))
        except (ValueError, TypeError, KeyError) as error:
            key = f"panel {name!r}, edge {number}"
            raise InputError(
                f"a curve that cannot be read: {error}",
                key=key,
                received=edge.get("curvature"),
                expected="quadratic, cubic or circle",
            ) from error
    degrees = np.array(entry.get("rotation", [0.0, 0.0, 0.0]), float)
    rotation = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    translation = unit * np.array(entry.get("translation", [0.0, 0.0, 0.0]), float)
    if signed_area(np.concatenate([edge[:-1] for edge in edges])) < 0.0:
        edges = [edge * [-1.0, 1.0] for edge in edges]
        rotation = rotation @ _MIRROR
    return Panel(name, tuple(edges), np.array([0.0, 1.0]), Placement(rotation, translation))


def _vertex(number: Any, count: int) -> int:
    if not isinstance(number, int) or not 0 <= number < count:
        raise ValueError(f"vertex {number!r}, of {count}")
    return number


def _curve(start: Floats, end: Floats, curvature: Any, unit: float) -> Floats:
    """The polyline of an edge. Control points are shares of the edge's vector, along it and to its left."""
    if curvature is None:
        return np.stack([start, end])
    if isinstance(curvature, list):  # older files
        curvature = {"type": "quadratic", "params": [curvature]}
    kind, values = curvature["type"], curvature["params"]
    if kind == "circle":
        radius, large, right = values  # an arc to the right of its chord turns left
        return arc(start, end, unit * float(radius), bool(large), bool(right))
    if {"quadratic": 1, "cubic": 2}.get(kind) != len(values):
        raise ValueError(f"type {kind!r} with {len(values)} control points")
    along = end - start
    left = np.array([-along[1], along[0]])
    inner = [start + float(x) * along + float(y) * left for x, y in values]
    return bezier(np.stack([start, *inner, end]))
