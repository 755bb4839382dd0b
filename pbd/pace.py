"""How fast the world moves beside the cloth: when to cut a frame finer, and when the cloth was taken elsewhere."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

__all__ = ["Carry", "carry_of", "fastest_way", "rigid_motion"]

TELEPORT = 30.0  # what holds the cloth goes faster than this against it only if it was put somewhere else [m/s]
RIGID = 0.1  # part of the way by which it may deviate from a rigid motion [-]
FEW = 64  # points of a body that are looked at


class Carry(NamedTuple):
    """A rigid motion, x to ``turn`` (x - ``centre``) + ``centre`` + ``way`` [m]."""

    turn: np.ndarray
    centre: np.ndarray
    way: np.ndarray

    def points(self, x: np.ndarray) -> np.ndarray:
        """Moved points [m], shape (n, 3)."""
        return (x - self.centre) @ self.turn.T + (self.centre + self.way)


def carry_of(before: np.ndarray, after: np.ndarray, drift: np.ndarray, dt: float) -> Carry | None:
    """The rigid motion with which points were put elsewhere; None if they moved, or not all alike.

    Args:
        before, after: points that hold the cloth at the start and end of the frame [m], shape (p, 3).
        drift: mean velocity of the cloth [m/s], shape (3,).
        dt: frame time [s].
    """
    if not len(before):
        return None
    chosen = slice(None, None, max(1, len(before) // FEW))
    found = rigid_motion(before[chosen], after[chosen])
    if np.linalg.norm(found.way - dt * drift) < TELEPORT * dt:
        return None
    off = np.linalg.norm(found.points(before[chosen].astype(float)) - after[chosen], axis=1).max()
    return found if off <= RIGID * np.linalg.norm(found.way) else None


def rigid_motion(before: np.ndarray, after: np.ndarray) -> Carry:
    """The rigid motion nearest to that of some points (Kabsch 1976).

    Args:
        before, after: [m], shape (k, 3), k > 0. Points on a line do not tell how far they rolled: not at all.
    """
    before, after = before.astype(float), after.astype(float)
    centre = before.mean(axis=0)
    way = after.mean(axis=0) - centre
    u, sizes, v = np.linalg.svd((before - centre).T @ (after - centre - way))
    turn = np.eye(3)
    if sizes[1] > 1e-6 * sizes[0]:
        turn = v.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
    elif sizes[0] > 1e-12:
        turn = _shortest_turn(u[:, 0], v[0])
    return Carry(turn, centre, way)


def _shortest_turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rotation from unit vector a to b by the least angle (Rodrigues); half a turn has no axis and is left out."""
    axis, cosine = np.cross(a, b), float(a @ b)
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.eye(3) + cross + cross @ cross / (1.0 + cosine) if cosine > -0.999999 else np.eye(3)


def fastest_way(
    rows: np.ndarray, fields: np.ndarray, held_0: np.ndarray, held_1: np.ndarray, drift: np.ndarray
) -> float:
    """The furthest that colliders or held vertices go in a frame against the cloth's mean way [m].

    Args:
        rows: primitives as :meth:`pbd.Colliders.rows` gives them, shape (k, 14).
        fields: as :meth:`pbd.Colliders.fields` gives them, shape (l, 25); of each the corners of its box count.
        held_0, held_1: held vertices at its start and end [m], shape (p, 3).
        drift: mean way of the cloth over the frame [m], shape (3,).
    """
    ways = [held_1 - held_0 - drift]
    if len(rows):
        ends = rows[:, 8:11] - rows[:, 2:5] - drift
        plane = rows[:, 0] == 0.0
        ends[plane] = np.einsum("ki,ki->k", ends[plane], rows[plane, 11:14])[:, None] * rows[plane, 11:14]
        capsule = rows[:, 0] == 2.0
        ways += [ends, rows[capsule, 11:14] - rows[capsule, 5:8] - drift]
    for row in fields:
        size, first, axes = row[3] * (row[:3] - 1.0), row[4:7], row[7:16].reshape(3, 3)
        corners = (first + size * np.array(list(product((0.0, 1.0), repeat=3)))) @ axes
        ways.append(row[19:22] + np.cross(row[22:25], corners) - drift)
    squares = np.concatenate([np.einsum("ki,ki->k", way, way) for way in ways])
    return float(np.sqrt(squares.max(initial=0.0)))
