"""Skins out of files: pieces merged into one mesh, with the best four influences of each vertex."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.texture import joined
from assets.weld import group_rows

__all__ = ["MAX_SAMPLES", "best_influences", "merge_pieces"]

Floats = NDArray[np.float64]

MAX_SAMPLES = 2**26  # of one clip, joints times frames: more is a damaged file
_INFLUENCE_COUNT = 4
_TOLERANCE = 1e-3  # differences of weights below this are rounding [-]


def merge_pieces(
    pieces: list[tuple[Floats, Any, Any, Floats | None]],
) -> tuple[Floats, NDArray[np.int32], NDArray[np.float32], Floats | None]:
    """One mesh of all pieces, one vertex for each position unless the weights there differ; unused vertices go.

    Args:
        pieces: of each the vertices in the world [m], shape (n, 3), faces, shape (m, 3), weights of all joints [-],
            shape (n, joints), and texture coordinates of each face corner, shape (m, 3, 2), or None.

    Returns:
        the same four of the mesh; texture coordinates as :func:`assets.texture.joined` gives them.
    """
    offsets = np.cumsum([0, *(len(piece[0]) for piece in pieces)])
    vertices = np.concatenate([piece[0] for piece in pieces])
    faces = np.concatenate([piece[1] + offset for piece, offset in zip(pieces, offsets[:-1], strict=True)])
    weights = np.concatenate([piece[2] for piece in pieces])
    # Positions are compared as the file stores them, in float32: the way into the world adds rounding of its own.
    first, same = group_rows(vertices.astype(np.float32))
    torn = np.zeros(len(first), dtype=bool)  # positions where parts meet that move apart
    np.logical_or.at(torn, same, np.abs(weights - weights[first[same]]).max(axis=1) > _TOLERANCE)
    compared = np.where(torn[same][:, None], weights, 0.0).astype(np.float32)
    first, same = group_rows(np.concatenate([vertices.astype(np.float32), compared], axis=1))
    faces = same[faces]
    a, b, c = faces.T
    whole = (a != b) & (b != c) & (c != a)
    texture = joined((piece[3], len(piece[1])) for piece in pieces)
    used, faces = np.unique(faces[whole], return_inverse=True)
    keep = first[used]
    faces = faces.reshape(-1, 3).astype(np.int32)
    return vertices[keep], faces, weights[keep], None if texture is None else texture[whole]


def best_influences(weights: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The four largest influences of each vertex, largest first, scaled to sum to 1; joint 0 where there is none.

    Args:
        weights: of all joints [-], shape (n, joints).

    Returns:
        joints, shape (n, 4), and their weights [-], shape (n, 4).
    """
    if weights.shape[1] < _INFLUENCE_COUNT:
        weights = np.pad(weights, ((0, 0), (0, _INFLUENCE_COUNT - weights.shape[1])))
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :_INFLUENCE_COUNT]
    best = np.take_along_axis(weights, joints, axis=1).astype(np.float64)
    best /= best.sum(axis=1, keepdims=True)
    return np.where(best > 0.0, joints, 0).astype(np.int32), best.astype(np.float32)
