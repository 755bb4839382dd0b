"""Half pieces, which are drawn on one side of the line along which the cloth is folded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from assets.patterns.sheet import MAX_GAP, closed_loop, turns
from pbd.errors import InputError

__all__ = ["unfolded"]

Floats = NDArray[np.float64]


def unfolded(pieces: Sequence[Floats], ends: Floats, axis: Floats, key: str) -> tuple[list[Floats], Floats]:
    """The outline of a whole piece, without the fold, from that of its half.

    An outline on both sides of the axis is that of a whole piece and stays as it is.

    Args:
        pieces: polylines of the outline [m] in any order and direction, shape (k, 2); the fold may be left open.
        ends: where edges end [m], shape (k, 2). On the fold they count where the whole outline has a corner.
        axis: both ends of the fold [m], shape (2, 2).
        key: names the outline in messages.

    Returns:
        pieces and ends of the whole.

    Raises:
        InputError: the axis has no length, the outline does not close, or its half does not lie along the axis once.
    """
    along = axis[1] - axis[0]
    if not np.linalg.norm(along) > MAX_GAP:
        raise InputError("a mirror line without length", key=key, expected="a straight line along the fold")
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)

    def away(points: Floats) -> Floats:
        return (points - axis[0]) @ normal

    def reflected(points: Floats) -> Floats:
        return points - 2.0 * away(points)[:, None] * normal

    apart = away(np.concatenate(pieces))
    if apart.min() < -MAX_GAP and apart.max() > MAX_GAP:
        return list(pieces), ends
    loose = _loose_ends(pieces)
    closing = [loose] if len(loose) == 2 and (np.abs(away(loose)) <= MAX_GAP).all() else []
    loop = closed_loop([*pieces, *closing], key)
    parts = _off_the_axis(loop, [np.abs(away(piece)) <= MAX_GAP for piece in loop])
    if parts is None:
        expected = "one straight part of the outline along the mirror line of a half piece"
        raise InputError("a half piece that cannot be unfolded", key=key, expected=expected)
    if len(pieces) == 1:  # a polyline may begin anywhere
        parts = [np.concatenate([parts[0], *(part[1:] for part in parts[1:])])]
    half = [part.copy() for part in parts]
    for part, end in ((half[0], 0), (half[-1], -1)):
        part[end] -= away(part[end]) * normal
    other = [reflected(part)[::-1] for part in reversed(half)]
    tips = np.stack([half[0][0], half[-1][-1]])
    leaving = np.stack([half[0][1] - half[0][0], other[0][1] - other[0][0]])
    arriving = np.stack([other[-1][-1] - other[-1][-2], half[-1][-1] - half[-1][-2]])
    if len(ends):
        inner = ends[np.abs(away(ends)) > MAX_GAP]
        ends = np.concatenate([inner, reflected(inner), tips[turns(arriving, leaving)]])
    if len(pieces) == 1:
        return [np.concatenate([half[0], other[0][1:]])], ends
    return [*half, *other], ends


def _loose_ends(pieces: Sequence[Floats]) -> Floats:
    """Ends of polylines where no other one begins or ends, shape (k, 2)."""
    ends = np.concatenate([piece[[0, -1]] for piece in pieces])
    return ends[cKDTree(ends).query_ball_point(ends, MAX_GAP, return_length=True) == 1]


def _off_the_axis(loop: Sequence[Floats], on_axis: Sequence[NDArray[np.bool_]]) -> list[Floats] | None:
    """What is left of a closed outline without its part on the axis, from that part's end to its start.

    Args:
        loop: polylines one after another.
        on_axis: for each of their points whether it lies on the axis.

    Returns:
        polylines; None if no part, or more than one, lies on the axis.
    """
    parts: list[Floats | None] = []  # None for a part on the axis
    for piece, on in zip(loop, on_axis, strict=True):
        fold = on[:-1] & on[1:]
        starts = np.flatnonzero(np.append(True, fold[1:] != fold[:-1]))
        for start, stop in zip(starts, np.append(starts[1:], len(fold)), strict=True):
            parts.append(None if fold[start] else piece[start : stop + 1])
    folds = [k for k, part in enumerate(parts) if part is None and parts[k - 1] is not None]
    if len(folds) != 1:
        return None
    return [part for part in parts[folds[0] :] + parts[: folds[0]] if part is not None]
