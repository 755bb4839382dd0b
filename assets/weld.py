"""Welding vertices, and the check that lengths are metres."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbd.errors import InputError

__all__ = ["check_unit", "group_rows", "weld"]

_MAX_SIZE, _MIN_SIZE = 10.0, 0.01  # sizes [m] of clothes and bodies lie between
_USUAL_SIZES = (0.1, 3.0)  # most of them between these


def group_rows(rows: NDArray[Any]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Group equal rows.

    Args:
        rows: shape (n, k).

    Returns:
        First member of each group, ascending, shape (groups,), and the group of each row, shape (n,).
    """
    _, first, group = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.zeros(len(order), dtype=np.intp)
    rank[order] = np.arange(len(order))
    return first[order], rank[group.reshape(-1)]


def weld(
    vertices: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]:
    """Make one vertex of those at exactly the same position; the order of first appearance stays.

    Args:
        vertices: [m], shape (n, 3).
        faces: shape (m, 3).

    Returns:
        vertices [m], shape (k, 3); faces, shape (m, 3), some of which may have lost a corner; and the new index of each
        old vertex, shape (n,).
    """
    first, index_map = group_rows(vertices)
    return vertices[first], index_map[faces].astype(np.int32), index_map.astype(np.int32)


def check_unit(vertices: NDArray[np.float64], file: Path) -> None:
    """Refuse a mesh that can hardly be in metres.

    Args:
        vertices: [m], shape (n, 3).
        file: for the message.

    Raises:
        InputError: the bounding box's longest side is over 10 m or under 1 cm; the message guesses the unit.
    """
    size = float(np.ptp(vertices, axis=0).max())
    if _MIN_SIZE <= size <= _MAX_SIZE:
        return
    guesses = {"centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254}
    if size < _MIN_SIZE:
        guesses = {"metres that were scaled by 0.01": 100.0, "metres that were scaled by 0.001": 1000.0}
    fitting = [
        f"{name} (multiply by {scale:g})"
        for name, scale in guesses.items()
        if _USUAL_SIZES[0] <= size * scale <= _USUAL_SIZES[1]
    ]
    hint = f": looks like {' or '.join(fitting)}" if fitting else ""
    raise InputError(
        f"not in metres{hint}", file=file, key="bounding box", received=f"{size:.4g}", expected="0.01 to 10 m"
    )
