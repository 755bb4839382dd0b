"""A collider of any shape: signed distances on a grid, placed by a rigid pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pbd.arrays import floats, numbers
from pbd.errors import InputError

__all__ = ["MOTION", "ROW", "DistanceField", "field_rows", "vector"]

NO_GRID = "no grid of at least 2 x 2 x 2 points"
MAX_SKEW = 1e-4  # of a rotation: its rows may fail to be orthonormal by this [-]
# A field in a row: counts (3), spacing, first grid point (3), own axes in the world at the frame's end (9), position
# there (3); then its displacement (3) and spin (3) over the frame, which are zero where it stands still.
ROW, MOTION = 25, slice(19, 25)


@dataclass(eq=False)
class DistanceField:
    """Solid given by signed distances to its surface at the points of a grid, in a frame of its own.

    In between they are interpolated trilinearly; the normal is the gradient of that. Outside the grid nothing is
    touched: it should reach further from the surface than the cloth's thickness. ``position`` and ``rotation`` may be
    changed between frames; within a frame the field goes from the last pose to the current one, and turns by the least
    angle. :func:`wrinkles.field.field_of_mesh` makes one from a closed mesh.

    Attributes:
        values: negative inside [m], shape (a, b, c), at least 2 each; kept as float32.
        origin: of the grid's first point, in the field's own frame [m], shape (3,).
        spacing: between grid points [m].
        position: of the frame's origin in the world [m], shape (3,).
        rotation: from the frame to the world, shape (3, 3).

    Raises:
        InputError: distances that are not finite or no grid, or a bad origin or spacing.
    """

    values: np.ndarray
    origin: Sequence[float] | np.ndarray
    spacing: float
    position: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        shape = np.shape(numbers(self.values, "field.values", ("a", "b", "c"), NO_GRID))
        if min(shape) < 2:
            expected = "two points or more along each axis"
            raise InputError(NO_GRID, key="field.values", received=shape, expected=expected)
        self.values = np.ascontiguousarray(floats(self.values, "field.values", shape, unit=" [m]"), np.float32)
        if floats(self.spacing, "field.spacing", (), "bad spacing") <= 0:
            expected = "a finite number above 0 [m]"
            raise InputError("bad spacing", key="field.spacing", received=self.spacing, expected=expected)
        vector(self.origin, "field.origin")

    def row(self) -> np.ndarray:
        """Counts, spacing, first grid point, own axes in the world and position: shape (19,).

        Raises:
            InputError: a position that is not three finite numbers, or a matrix that is no rotation.
        """
        turn = np.asarray(floats(self.rotation, "field.rotation", (3, 3), "bad rotation"), float)
        if not np.abs(turn @ turn.T - np.eye(3)).max() < MAX_SKEW or np.linalg.det(turn) < 0:
            received = turn.tolist()
            raise InputError("bad rotation", key="field.rotation", received=received, expected="a rotation matrix")
        position = vector(self.position, "field.position")
        return np.concatenate([self.values.shape, [self.spacing], self.origin, turn.T.ravel(), position])


def field_rows(rows: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Rows for the kernel, float64, shape (k, 25).

    Args:
        rows, before: of :meth:`DistanceField.row` at the end of the frame and at its start, shape (k, 19).
    """
    displacement = rows[:, 16:] - before[:, 16:]
    axes, axes_before = rows[:, 7:16].reshape(-1, 3, 3), before[:, 7:16].reshape(-1, 3, 3)
    spin = [_spin(now.T @ last) for now, last in zip(axes, axes_before, strict=True)]
    return np.concatenate([rows, displacement, np.reshape(spin, (-1, 3))], axis=1)


def _spin(turn: np.ndarray) -> np.ndarray:
    """Axis times angle [rad] of a rotation matrix, shape (3,); at most half a turn."""
    across = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine, cosine = np.linalg.norm(across), 0.5 * (np.trace(turn) - 1.0)
    if sine > 1e-6:
        return across * (np.arctan2(sine, cosine) / sine)
    if cosine > 0:
        return across
    both = turn + np.eye(3)  # half a turn: twice the axis' outer product with itself
    axis = both[np.argmax(np.diag(both))]
    return np.pi * axis / np.linalg.norm(axis)


def vector(value: Sequence[float] | np.ndarray, key: str) -> np.ndarray:
    """Three finite numbers, float64, shape (3,); refuses anything else."""
    return np.asarray(floats(value, key, (3,), "bad vector"), float)
