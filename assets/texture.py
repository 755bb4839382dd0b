"""Texture coordinates of triangle meshes: a pair (u, v) at each corner of each face, v upwards.

A vertex on a seam of the texture has several. A face without texture coordinates has NaN at its corners.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pbd.arrays import numbers
from pbd.errors import InputError

__all__ = ["checked", "joined", "split"]

Floats = NDArray[np.float64]


def checked(texture: Floats, face_count: int, key: str = "texture") -> Floats:
    """Texture coordinates of so many faces, shape (face_count, 3, 2), as they came.

    Raises:
        InputError: something else than numbers, another shape, or a face of which some coordinates are not finite.
    """
    found = numbers(texture, key, (face_count, 3, 2), kind="numbers, or NaN at all corners of a face")
    without = np.isnan(found).all(axis=(1, 2))
    bad = np.argwhere(~np.isfinite(found) & ~without[:, None, None])
    if len(bad):
        received = float(found[tuple(bad[0])])
        expected = "finite numbers, or NaN at all corners of a face"
        raise InputError("values that are not finite", key=f"{key}[{bad[0, 0]}]", received=received, expected=expected)
    return found


def joined(parts: Iterable[tuple[Floats | None, int]]) -> Floats | None:
    """Texture coordinates of several meshes one behind the other.

    Args:
        parts: of each mesh its texture coordinates, shape (m, 3, 2), or None, and its number of faces m.

    Returns:
        shape (sum of m, 3, 2), float64; None where no face has any.
    """
    found = np.concatenate(
        [np.zeros((0, 3, 2)), *(np.full((count, 3, 2), np.nan) if part is None else part for part, count in parts)]
    )
    return None if np.isnan(found).all() else found


def split(faces: NDArray[np.int32], texture: Floats, vertex_count: int) -> tuple[NDArray[np.int64], NDArray, Floats]:
    """Copy vertices so that each has one pair of texture coordinates; the copies follow the n vertices.

    Args:
        faces: shape (m, 3).
        texture: shape (m, 3, 2); faces without any get zeros.
        vertex_count: number of vertices n.

    Returns:
        the vertex that each new vertex is or is a copy of, int, shape (k,); faces, int, shape (m, 3); texture
        coordinates of the new vertices, shape (k, 2).
    """
    corners = np.concatenate([faces.reshape(-1, 1), np.nan_to_num(texture).reshape(-1, 2)], axis=1)
    rows, row = np.unique(corners, axis=0, return_inverse=True)
    vertex = rows[:, 0].astype(np.int64)
    copied = np.diff(vertex, prepend=-1) == 0
    number = np.where(copied, vertex_count - 1 + np.cumsum(copied), vertex)
    source = np.concatenate([np.arange(vertex_count), vertex[copied]])
    places = np.zeros((len(source), 2))
    places[number] = rows[:, 1:]
    return source, number[row.reshape(-1, 3)], places
