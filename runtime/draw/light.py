"""How much light reaches each vertex of a picture: soft shadow of the key light, ambient occlusion of the sky.

Everything casts shadow on everything. A light is many directions; along each of them the surfaces are projected to a
grid that keeps the height of the topmost one, and a vertex is lit where nothing is above it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

__all__ = ["LitSurface", "directions_about", "directions_everywhere", "exposure"]

CELL = 0.005  # of the grids [m]
_MAX_CELLS = 1000  # along a side; a larger scene has larger cells
# A slanting surface rises within a cell. A vertex is in shadow of what is further above it than that, so that a surface
# does not shade itself. (Moving vertices off their surface instead pushes them through the next layer of a pleat.)
_OFFSET = 0.8  # cells from the surface, all the same
_RISE = 0.5  # cells times the tangent of the angle between normal and light
_MAX_RISE = 6.0  # cells
_SOFT = 1.2  # cells; a vertex deeper than this below another surface is in its full shadow
_MAX_CUTS = 24  # of a face's sides, for samples


@dataclass(frozen=True)
class LitSurface:
    """A mesh that casts and receives shadow.

    Attributes:
        vertices: [m], float32, shape (n, 3).
        faces: int, shape (m, 3).
        normals: unit, float32, shape (n, 3).
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray


def directions_everywhere(count: int) -> np.ndarray:
    """Unit directions spread evenly over the sphere (Fibonacci lattice), shape (count, 3)."""
    height = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    turn = np.arange(count) * math.pi * (3.0 - math.sqrt(5.0))
    radius = np.sqrt(1.0 - height**2)
    return np.stack([radius * np.cos(turn), height, radius * np.sin(turn)], axis=1)


def directions_about(axis: np.ndarray, half_angle_deg: float, count: int) -> np.ndarray:
    """Unit directions spread evenly over a disc around an axis, as a light of that half angle: shape (count, 3)."""
    side, up, axis = _frame(axis).T
    radius = math.tan(math.radians(half_angle_deg)) * np.sqrt((np.arange(count) + 0.5) / count)[:, None]
    turn = (np.arange(count) * math.pi * (3.0 - math.sqrt(5.0)))[:, None]
    spread = axis + radius * (np.cos(turn) * side + np.sin(turn) * up)
    return spread / np.linalg.norm(spread, axis=1, keepdims=True)


def exposure(
    surfaces: Sequence[LitSurface], points: np.ndarray, normals: np.ndarray, directions: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Share of a light that reaches each point, on both sides of its surface: float32, shape (n, 2), 0 to 1.

    The share is weighted by the light's cosine to the surface. A side that the light faces nowhere has share 1: its
    cosine is 0 anyway.

    Args:
        surfaces: all that casts shadow.
        points: [m], float32, shape (n, 3).
        normals: unit, of the first side, float32, shape (n, 3).
        directions: unit, towards the light, shape (k, 3).
        weights: of the directions, above 0, shape (k,).
    """
    ends = np.array([(surface.vertices.min(axis=0), surface.vertices.max(axis=0)) for surface in surfaces])
    size = float(np.linalg.norm(ends[:, 1].max(axis=0) - ends[:, 0].min(axis=0)))
    cell = max(CELL, size / _MAX_CELLS)
    # Rows, each contiguous, in cells.
    samples = np.ascontiguousarray(np.concatenate([_samples(surface, cell) for surface in surfaces]).T) / cell
    points, normals = np.ascontiguousarray(points.T) / cell, np.ascontiguousarray(normals.T)
    lit, whole = np.zeros((2, 2, points.shape[1]), np.float32)
    for direction, weight in zip(directions, weights, strict=True):
        frame = _frame(direction).T.astype(np.float32)
        cosine = frame[2] @ normals
        moved = points + np.where(cosine < 0.0, np.float32(-_OFFSET), np.float32(_OFFSET)) * normals
        slant = np.sqrt(np.maximum(np.float32(1.0) - cosine**2, 0.0)) / np.maximum(np.abs(cosine), np.float32(1e-3))
        at = frame @ moved
        at[2] += np.minimum(np.float32(_RISE) * slant, np.float32(_MAX_RISE))
        open_to = np.float32(1.0) - _covered(frame @ samples, at)
        for side, facing in enumerate((np.maximum(cosine, 0.0), np.maximum(-cosine, 0.0))):
            share = np.float32(weight) * facing
            whole[side] += share
            lit[side] += share * open_to
    return np.where(whole > 1e-6, lit / np.maximum(whole, 1e-6), 1.0).T.astype(np.float32)


class Rings:
    """The neighbours of each vertex of a mesh.

    Args:
        edges: int, shape (e, 2).
        count: number of vertices.
    """

    def __init__(self, edges: np.ndarray, count: int) -> None:
        self._edges = edges
        ones = np.ones(2 * len(edges), np.float32)
        both = np.concatenate([edges, edges[:, ::-1]])
        self._sum = csr_matrix((ones, (both[:, 0], both[:, 1])), (count, count))
        self._size = np.maximum(np.bincount(both[:, 0], minlength=count), 1).astype(np.float32)[:, None]

    def smoothed(self, values: np.ndarray, steps: int) -> np.ndarray:
        """Values, shape (n, k), each moved half way to the mean of its neighbours so many times."""
        for _ in range(steps):
            values = 0.5 * (values + (self._sum @ values) / self._size)
        return values

    def curvature(self, vertices: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Mean curvature at each vertex, above 0 where the surface is convex [1/m], shape (n, 1).

        The normal curvature along an edge is how much the normal turns over its length; the mean is over all edges.
        """
        first, second = self._edges.T
        along = vertices[second] - vertices[first]
        turn = np.einsum("ei,ei->e", normals[second] - normals[first], along)
        bend = turn / np.maximum(np.einsum("ei,ei->e", along, along), 1e-12)
        total = sum(np.bincount(end, bend, len(vertices)) for end in (first, second))
        return self.smoothed((total[:, None] / self._size).astype(np.float32), 1)


def _covered(samples: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How much each point is below the samples, 0 to 1: shape (n,).

    Both are three rows in cells, the third of which points to the light.
    """
    low = samples[:2].min(axis=1) - np.float32(2.0)
    rows, columns = np.ceil(samples[:2].max(axis=1) - low).astype(int) + 2
    top = np.full(rows * columns, -np.inf, np.float32)
    across, along = (samples[:2] - low[:, None]).astype(np.int32)
    np.maximum.at(top, across * columns + along, samples[2])
    place = points[:2] - low[:, None] - np.float32(0.5)
    place[0].clip(0.0, rows - 1.5, out=place[0])  # nothing is above the border
    place[1].clip(0.0, columns - 1.5, out=place[1])
    corner = place.astype(np.int32)
    (u, v), first = place - corner, corner[0] * columns + corner[1]
    covered = np.zeros(points.shape[1], np.float32)
    for step, share in ((0, (1 - u) * (1 - v)), (1, (1 - u) * v), (columns, u * (1 - v)), (columns + 1, u * v)):
        above = (top[first + step] - points[2]) * np.float32(1.0 / _SOFT)
        covered += share * above.clip(0.0, 1.0)
    return covered


def _frame(direction: np.ndarray) -> np.ndarray:
    """Two axes at right angles to a direction, and the direction: the columns of a rotation, shape (3, 3)."""
    axis = np.asarray(direction, float) / np.linalg.norm(direction)
    side = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(axis, side), axis], axis=1)


def _samples(surface: LitSurface, cell: float) -> np.ndarray:
    """Points on the faces, no further apart than a cell [m]: float32, shape (s, 3)."""
    corners = surface.vertices[surface.faces]
    longest = np.sqrt(((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1))
    cuts = np.clip(np.ceil(longest / cell), 1, _MAX_CUTS).astype(int)
    found = [surface.vertices]
    for count in np.unique(cuts):
        i, j = np.divmod(np.arange(count * count), count)
        keep = i + j < count
        weights = (np.stack([i, j], axis=1)[keep] + 1.0 / 3.0) / count
        weights = np.column_stack([weights, 1.0 - weights.sum(axis=1)]).astype(np.float32)
        found.append(np.einsum("si,fic->fsc", weights, corners[cuts == count]).reshape(-1, 3))
    return np.concatenate(found)
