"""Motion of the cloth's carrier: its rigid part, whether it is a teleport, and the greatest displacement in a frame."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

__all__ = ["RigidTransform", "detect_teleport", "fit_rigid_transform", "max_displacement"]

MIN_TELEPORT_SPEED = 30.0  # the carrier is faster than this against the cloth only if it was put elsewhere [m/s]
MAX_DEVIATION = 0.1  # from a rigid motion, as a share of the displacement [-]
MAX_POINTS = 64  # of a body that are fitted


class RigidTransform(NamedTuple):
    """A rigid motion: x goes to ``rotation`` (x - ``centre``) + ``centre`` + ``translation`` [m].

    Attributes:
        rotation: shape (3, 3).
        centre, translation: [m], shape (3,).
    """

    rotation: np.ndarray
    centre: np.ndarray
    translation: np.ndarray

    def points(self, x: np.ndarray) -> np.ndarray:
        """Moved points [m], shape (n, 3)."""
        return (x - self.centre) @ self.rotation.T + (self.centre + self.translation)


def detect_teleport(before: np.ndarray, after: np.ndarray, drift: np.ndarray, dt: float) -> RigidTransform | None:
    """The rigid motion with which points were put elsewhere; None if they moved there, or not all in the same way.

    Args:
        before, after: points that hold the cloth at the start and end of the frame [m], shape (p, 3).
        drift: mean velocity of the cloth [m/s], shape (3,).
        dt: frame time [s].
    """
    if not len(before):
        return None
    chosen = slice(None, None, max(1, len(before) // MAX_POINTS))
    translation = after[chosen].mean(axis=0, dtype=float) - before[chosen].mean(axis=0, dtype=float)
    if np.linalg.norm(translation - dt * drift) < MIN_TELEPORT_SPEED * dt:
        return None
    found = fit_rigid_transform(before[chosen], after[chosen])
    off = np.linalg.norm(found.points(before[chosen].astype(float)) - after[chosen], axis=1).max()
    return found if off <= MAX_DEVIATION * np.linalg.norm(found.translation) else None


def fit_rigid_transform(before: np.ndarray, after: np.ndarray) -> RigidTransform:
    """The rigid motion nearest to that of some points (Kabsch 1976).

    Args:
        before, after: [m], shape (k, 3), k > 0. Points on a line do not show how far they rolled: they do not roll.
    """
    before, after = before.astype(float), after.astype(float)
    centre = before.mean(axis=0)
    translation = after.mean(axis=0) - centre
    u, sizes, v = np.linalg.svd((before - centre).T @ (after - centre - translation))
    rotation = np.eye(3)
    if sizes[1] > 1e-6 * sizes[0]:
        rotation = v.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
    elif sizes[0] > 1e-12:
        rotation = _shortest_rotation(u[:, 0], v[0])
    return RigidTransform(rotation, centre, translation)


def _shortest_rotation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rotation from unit vector a to b by the least angle (Rodrigues); half a turn has no axis: no rotation."""
    axis, cosine = np.cross(a, b), float(a @ b)
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.eye(3) + cross + cross @ cross / (1.0 + cosine) if cosine > -0.999999 else np.eye(3)


def max_displacement(
    rows: np.ndarray, fields: np.ndarray, held_start: np.ndarray, held_end: np.ndarray, drift: np.ndarray
) -> float:
    """Greatest displacement of colliders or held vertices in a frame against the cloth's mean displacement [m].

    Args:
        rows: primitives as :meth:`pbd.Colliders.rows` gives them, shape (k, 14).
        fields: as :meth:`pbd.Colliders.fields` gives them, shape (l, 25); of each the corners of its box count.
        held_start, held_end: held vertices at its start and end [m], shape (p, 3).
        drift: mean displacement of the cloth over the frame [m], shape (3,).
    """
    displacements = [held_end - held_start - drift]
    if len(rows):
        ends = rows[:, 8:11] - rows[:, 2:5] - drift
        plane = rows[:, 0] == 0.0
        ends[plane] = np.einsum("ki,ki->k", ends[plane], rows[plane, 11:14])[:, None] * rows[plane, 11:14]
        capsule = rows[:, 0] == 2.0
        displacements += [ends, rows[capsule, 11:14] - rows[capsule, 5:8] - drift]
    for row in fields:
        size, first, axes = row[3] * (row[:3] - 1.0), row[4:7], row[7:16].reshape(3, 3)
        corners = (first + size * np.array(list(product((0.0, 1.0), repeat=3)))) @ axes
        displacements.append(row[19:22] + np.cross(row[22:25], corners) - drift)
    squares = np.concatenate([np.einsum("ki,ki->k", u, u) for u in displacements])
    return float(np.sqrt(squares.max(initial=0.0)))
