"""The upper edge of skirts and trousers: a waist line with darts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from assets.patterns.drafts.drawing import Outline
from assets.patterns.pattern import Seam

__all__ = ["dart_seams", "share_surplus", "waist_line"]

Floats = NDArray[np.float64]

_NARROWEST_DART = 0.008  # [m] narrower ones go into the side


def share_surplus(surplus: float, side_share: float, side_most: float, widest: float) -> tuple[float, list[float]]:
    """Share out what hip is wider than waist: part of it goes into the side, the rest into darts [m].

    Args:
        surplus: half width at the hip minus half width at the waist [m].
        side_share: part of it that the side takes in [-].
        side_most: the most that the side takes in [m].
        widest: of a dart [m]; a wider one is made two.

    Returns:
        what the side takes in, and the widths of the darts from the middle outwards.
    """
    if surplus <= 0.0:
        return surplus, []
    side = min(side_share * surplus, side_most)
    rest = surplus - side
    if rest < _NARROWEST_DART:
        return surplus, []
    count = 1 if rest <= widest else 2
    return side, [rest / count] * count


def waist_line(
    start: tuple[float, float], end: tuple[float, float], darts: list[float], depth: float
) -> dict[str, Floats]:
    """Edges of a waist line from one side to the other, with darts evenly between them.

    Args:
        start: where the line begins [m]; the outline runs on to smaller x.
        end: where it ends [m].
        darts: their widths [m], in the order of the outline.
        depth: of the darts [m].

    Returns:
        edges waist_0, dart_0_in, dart_0_out, waist_1, up to the last waist.
    """
    first, last = np.array(start, float), np.array(end, float)
    along = last - first
    length = float(np.linalg.norm(along))
    along /= length
    down = np.array([-along[1], along[0]])  # left of the direction of travel is inside
    edges: dict[str, Floats] = {}
    here = first
    for number, width in enumerate(darts):
        middle = first + along * length * (number + 1) / (len(darts) + 1)
        begin, finish = middle - 0.5 * width * along, middle + 0.5 * width * along
        tip = middle + depth * down
        edges[f"waist_{number}"] = np.array([here, begin])
        edges[f"dart_{number}_in"] = np.array([begin, tip])
        edges[f"dart_{number}_out"] = np.array([tip, finish])
        here = finish
    edges[f"waist_{len(darts)}"] = np.array([here, last])
    return edges


def dart_seams(outline: Outline) -> list[Seam]:
    """Every dart of a panel, closed."""
    return [
        Seam(outline.edge(name), outline.edge(name.replace("_in", "_out")))
        for name in outline.edges
        if name.startswith("dart_") and "_in" in name
    ]
