"""Pieces around a body before they are sewn: where the pattern places them, or where their stitches want them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from assets.patterns.pattern import Placement
from assets.sewing.body import StandingBody
from assets.sewing.pieces import Pieces
from pbd.distance import BodyDistance
from pbd.errors import InputError

__all__ = ["arranged"]

Floats = NDArray[np.float64]

CLEARANCE = 0.003  # of a piece from the body at the start [m]
STAYING = 0.05  # weight that keeps a piece at its height, over that of its stitches [-]
LIFTS = tuple(0.01 * k for k in (0, 1, 2, 3, 4, 5, 6, 7, 8, -1, -2, -3))  # of all pieces together [m]
POINTS = 24  # parts of the straight line between two stitched vertices
STEP, MAX_MOVE = 0.01, 0.40  # by which a piece is moved out of the body at a time, and at most [m]


def arranged(pieces: Pieces, placements: Sequence[Placement | None], body: StandingBody) -> Floats:
    """Positions of the pieces around the body [m], shape (n, 3).

    A piece without a placement is laid, as flat as it is, as near as possible to what it is sewn to. Flat pieces go up
    or down until those that are sewn together are level, and all together until the fewest stitches lead through the
    body; a pattern with bent pieces was placed for its body. A piece that stands in the body is moved out along its
    outer side, or away from the body's axis, whichever is shorter.

    Args:
        pieces: to be sewn.
        placements: of each piece.
        body: to sew on.

    Raises:
        InputError: no piece has a placement, a piece is sewn to none that has one, or a piece does not get free of the
            body; the message names the piece.
    """
    positions = np.full((len(pieces.flat), 3), np.nan)
    outward = np.zeros((len(pieces.names), 3))
    for number, placement in enumerate(placements):
        if placement is not None:
            own_vertices = pieces.piece_of_vertex == number
            positions[own_vertices] = placement.apply(pieces.flat[own_vertices])
            outward[number] = placement.rotation[:, 2]
    _lay_beside_neighbours(pieces, positions, outward)
    distance = BodyDistance(body.faces)
    if all(placement is None or placement.bend_radius is None for placement in placements):
        positions[:, 1] += _level(pieces, positions)[pieces.piece_of_vertex]
        positions[:, 1] += _lift(pieces, positions, body, distance)
    for number, name in enumerate(pieces.names):
        own_vertices = pieces.piece_of_vertex == number
        positions[own_vertices] += _way_out(name, positions[own_vertices], outward[number], body, distance)
    return positions


def _lay_beside_neighbours(pieces: Pieces, positions: Floats, outward: Floats) -> None:
    """Place the pieces that have no positions yet, those with most stitches to placed ones first."""
    while True:
        missing = np.isnan(positions[:, 0])
        if not missing.any():
            return
        both = np.concatenate([pieces.stitches, pieces.stitches[:, ::-1]])
        both = both[missing[both[:, 0]] & ~missing[both[:, 1]]]
        if not len(both):
            names = [pieces.names[k] for k in np.unique(pieces.piece_of_vertex[missing])]
            expected = "a placement, or stitches to a piece that has one"
            raise InputError("pieces without a place", key=", ".join(names), expected=expected)
        number = int(np.bincount(pieces.piece_of_vertex[both[:, 0]]).argmax())
        ends = both[pieces.piece_of_vertex[both[:, 0]] == number]
        own_vertices = pieces.piece_of_vertex == number
        flat = np.insert(pieces.flat[ends[:, 0]], 2, 0.0, axis=1)
        # Kabsch 1976: the rotation of least squares.
        near = positions[ends[:, 1]]
        u, _, v = np.linalg.svd((flat - flat.mean(axis=0)).T @ (near - near.mean(axis=0)))
        turn = v.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
        solid = np.insert(pieces.flat[own_vertices], 2, 0.0, axis=1)
        positions[own_vertices] = (solid - flat.mean(axis=0)) @ turn.T + near.mean(axis=0)
        outward[number] = turn[:, 2]


def _level(pieces: Pieces, positions: Floats) -> Floats:
    """How far each piece goes up so that its stitches are as level as possible [m], shape (p,).

    Least squares over all stitches; a part of the weight keeps each piece where it was.
    """
    count = len(pieces.names)
    first, second = pieces.piece_of_vertex[pieces.stitches].T
    drop = positions[pieces.stitches[:, 1], 1] - positions[pieces.stitches[:, 0], 1]
    matrix = np.zeros((len(drop) + count, count))
    rows = np.arange(len(drop))
    matrix[rows, first] += 1.0
    matrix[rows, second] -= 1.0
    matrix[len(drop) :] = np.sqrt(STAYING * max(len(drop), 1) / count) * np.eye(count)
    return np.asarray(np.linalg.lstsq(matrix, np.append(drop, np.zeros(count)), rcond=None)[0], float)


def _lift(pieces: Pieces, positions: Floats, body: StandingBody, distance: BodyDistance) -> float:
    """How far all pieces go up so that the fewest points between stitched vertices are inside the body [m].

    Shoulders show why: panels that are placed too low would close under the arms.
    """
    start, end = positions[pieces.stitches[:, 0]], positions[pieces.stitches[:, 1]]
    share = (np.arange(1, POINTS) / POINTS)[:, None, None]
    points = ((1.0 - share) * start + share * end).reshape(-1, 3)
    if not len(points):
        return 0.0
    best, fewest = 0.0, np.inf
    for lift in LIFTS:
        inside = (distance.signed_distance(points + [0.0, lift, 0.0], body.vertices) < CLEARANCE).sum()
        if inside < fewest:
            best, fewest = lift, inside
    return best


def _is_free(points: Floats, body: StandingBody, distance: BodyDistance) -> bool:
    return bool(distance.signed_distance(points, body.vertices).min() >= CLEARANCE)


def _way_out(name: str, points: Floats, outward: Floats, body: StandingBody, distance: BodyDistance) -> Floats:
    """The shortest move of a piece along one of a few directions that frees it from the body [m], shape (3,)."""
    if _is_free(points, body, distance):
        return np.zeros(3)
    away = points.mean(axis=0) - body.vertices.mean(axis=0)
    away[1] = 0.0
    away /= max(np.linalg.norm(away), 1e-9)
    for step in range(1, round(MAX_MOVE / STEP) + 1):
        for direction in (outward, away):
            move = STEP * step * direction
            if _is_free(points + move, body, distance):
                return move
    expected = f"free of the body after a move of {100.0 * MAX_MOVE:g} cm"
    raise InputError("a piece that stands in the body", key=f"panel {name!r}", expected=expected)
