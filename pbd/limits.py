"""Limits painted on a garment: how far its vertices may go from where the body carries them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from pbd.arrays import floats, integers
from pbd.attachment import Attachment, smooth_normals
from pbd.errors import InputError

__all__ = ["NONE", "LimitTargets", "Limits", "SkinnedTargets"]

NONE = 1e6  # a distance from here on limits nothing [m]


@dataclass(frozen=True, eq=False)
class Limits:
    """Soft and hard limits about the points to which a body carries vertices, as game engines paint them.

    Attributes:
        vertices: that are limited, ascending, int32, shape (l,).
        maximum_distance: of each from its target [m], float32, shape (l,); ``NONE`` for no limit.
        backstop: how deep it may go under its target, against the garment's normal there [m], shape (l,); ``NONE`` for
            any depth.
        stiffness: of springs that draw it to its target, per area of the cloth [N/m3], shape (l,): with k/rho_A = w^2
            it swings w/(2 pi) times a second.

    Raises:
        InputError: arrays of other lengths, vertices twice or not ascending, values below zero or not finite.
    """

    vertices: np.ndarray
    maximum_distance: np.ndarray
    backstop: np.ndarray
    stiffness: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", integers(self.vertices, "limits.vertices", ("l",)))
        if (np.diff(self.vertices) <= 0).any():
            expected = "each vertex once, ascending"
            raise InputError("bad limits", key="vertices", received=self.vertices.tolist()[:8], expected=expected)
        for name in ("maximum_distance", "backstop", "stiffness"):
            values = np.asarray(floats(getattr(self, name), f"limits.{name}", self.vertices.shape), np.float32)
            if (values < 0).any():
                received, expected = float(values.min()), "finite numbers, at least 0"
                raise InputError("bad limits", key=name, received=received, expected=expected)
            object.__setattr__(self, name, values)

    @classmethod
    def none(cls) -> Limits:
        """Limits of no vertex."""
        return cls(np.zeros(0, np.int32), *np.zeros((3, 0), np.float32))

    def rows(self, areas: np.ndarray) -> np.ndarray:
        """As :class:`pbd.xpbd.views.ConstraintArrays` has them, without targets, float32, shape (l, 4, 4).

        Args:
            areas: of all vertices [m2], shape (n,).
        """
        rows = np.zeros((len(self.vertices), 4, 4), np.float32)
        rows[:, 0, 3] = self.vertices
        law = rows[:, 3]
        law[:] = -1.0
        for column, values in enumerate((self.maximum_distance, self.backstop)):
            law[values < NONE, column] = values[values < NONE]
        soft = self.stiffness > 0
        law[soft, 2] = 1.0 / (self.stiffness[soft] * areas[self.vertices[soft]])
        return rows

    def part(self, vertices: np.ndarray) -> Limits:
        """Limits of some vertices, numbered among these.

        Args:
            vertices: ascending, int, shape (k,).
        """
        kept = np.isin(self.vertices, vertices)
        own = np.searchsorted(vertices, self.vertices[kept])
        return Limits(own, self.maximum_distance[kept], self.backstop[kept], self.stiffness[kept])

    def taken(self, stand_in: np.ndarray) -> Limits:
        """Limits of other vertices, each those of the vertex that stands for it, int, shape (k,)."""
        row = np.full(max(int(stand_in.max(initial=-1)), int(self.vertices.max(initial=-1))) + 1, -1)
        row[self.vertices] = np.arange(len(self.vertices))
        rows = row[stand_in]
        vertices = np.flatnonzero(rows >= 0).astype(np.int32)
        rows = rows[vertices]
        return Limits(vertices, self.maximum_distance[rows], self.backstop[rows], self.stiffness[rows])

    def between(self, matrix: csr_matrix) -> Limits:
        """Limits of points between the vertices: where all that they lie between are limited.

        Args:
            matrix: weights of the vertices for each point, shape (N, n).
        """
        marks, values = np.zeros((2, matrix.shape[1], 3))
        for column, name in enumerate(("maximum_distance", "backstop", "stiffness")):
            value = getattr(self, name).astype(float)
            there = (value > 0) if name == "stiffness" else (value < NONE)
            marks[self.vertices[there], column] = 1.0
            values[self.vertices[there], column] = value[there]
        size = abs(matrix)
        held = size @ marks > 0.999 * np.asarray(size.sum(axis=1))
        found = np.where(held, np.maximum(matrix @ values, 0.0), [NONE, NONE, 0.0])
        vertices = np.flatnonzero(held.any(axis=1)).astype(np.int32)
        return Limits(vertices, *found[vertices].T)


class LimitTargets(NamedTuple):
    """Where a body carries limited vertices in a frame.

    Attributes:
        start, end: targets in the world at its start and end [m], shape (l, 3).
        normals: of the garment there at its end, unit, shape (l, 3).
    """

    start: np.ndarray
    end: np.ndarray
    normals: np.ndarray


class SkinnedTargets:
    """Targets of limited vertices, which ride on a body.

    Args:
        limits: of a garment.
        vertices, faces: of the garment on the body's bind pose [m], shape (n, 3), int, shape (m, 3).
        body_vertices, body_faces: of the body in its bind pose.
    """

    def __init__(
        self,
        limits: Limits,
        vertices: np.ndarray,
        faces: np.ndarray,
        body_vertices: np.ndarray,
        body_faces: np.ndarray,
    ) -> None:
        points = np.asarray(vertices, float)[limits.vertices]
        self._attachment = Attachment.bind(points, body_vertices, body_faces)
        self._tips = self._attachment.moved(smooth_normals(vertices, faces)[limits.vertices], body_vertices)

    def targets(self, before: np.ndarray, after: np.ndarray, origin: np.ndarray) -> LimitTargets:
        """Targets for the body's poses at the start and end of a frame, shape (b, 3), about an origin [m]."""
        start, end = self._attachment.targets(before), self._attachment.targets(after)
        return LimitTargets(start + origin, end + origin, self._tips.targets(after) - end)
