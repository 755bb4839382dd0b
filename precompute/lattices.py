"""Triangles over lattices of vertices."""

from __future__ import annotations

import numpy as np

__all__ = ["square_faces"]


def square_faces(index: np.ndarray, *, alternating: bool = False) -> np.ndarray:
    """Two triangles for each square of a lattice.

    Args:
        index: of the vertices, int, shape (r, c). A lattice that closes upon itself repeats its first row or column.
        alternating: cut neighbours along different diagonals, so that no direction is stiffer; otherwise all along the
            diagonal from the square's first corner.

    Returns:
        shape (2 (r - 1) (c - 1), 3), both triangles of a square one after the other, rows first. All turn from the
        first axis of ``index`` to the second.
    """
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    first, second = np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)
    if alternating:
        row, column = np.divmod(np.arange(len(a)), index.shape[1] - 1)
        even = ((row + column) % 2 == 0)[:, None]
        first = np.where(even, first, np.stack([a, b, d], axis=1))
        second = np.where(even, second, np.stack([b, c, d], axis=1))
    return np.stack([first, second], axis=1).reshape(-1, 3)
