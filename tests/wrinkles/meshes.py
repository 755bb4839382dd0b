"""Meshes whose geometry is known exactly."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

__all__ = ["flat_sheet", "icosphere", "tube", "turned"]


def flat_sheet(count: int, size: float, jitter: float = 0.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Square sheet in the x-z plane, normals up: regular squares with one diagonal, or inner vertices moved about."""
    step = size / (count - 1)
    flat = np.stack(np.meshgrid(np.arange(count), np.arange(count), indexing="ij"), axis=-1).reshape(-1, 2) * step
    if jitter:
        inner = ((flat > 0.5 * step) & (flat < size - 0.5 * step)).all(axis=1)
        flat += inner[:, None] * np.random.default_rng(seed).uniform(-jitter, jitter, flat.shape) * step
        faces = Delaunay(flat).simplices
        side_1, side_2 = flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]]
        twice_area = side_1[:, 0] * side_2[:, 1] - side_1[:, 1] * side_2[:, 0]
        faces[twice_area > 0] = faces[twice_area > 0][:, ::-1]
        faces = faces[np.abs(twice_area) > 1e-6 * step**2]  # slivers along the border
    else:
        index = np.arange(count * count).reshape(count, count)
        a, b, c, d = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
        faces = np.concatenate([np.stack([a, c, b], axis=-1), np.stack([b, c, d], axis=-1)]).reshape(-1, 3)
    return np.stack([flat[:, 0], np.zeros(len(flat)), flat[:, 1]], axis=1), faces.astype(np.int32)


def icosphere(levels: int, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Sphere round the origin: a subdivided icosahedron, vertices on the sphere."""
    golden = (1 + 5**0.5) / 2
    base = [[-1, golden, 0], [1, golden, 0], [-1, -golden, 0], [1, -golden, 0]]
    vertices = np.concatenate([np.roll(base, shift, axis=1) for shift in (0, 1, 2)])
    faces = np.array(
        [[a, b, c] for a in range(12) for b in range(12) for c in range(12)
         if a < b and a < c and _outward(vertices, a, b, c)]
    )  # fmt: skip
    for _ in range(levels):
        sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        edges, inverse = np.unique(sides, axis=0, return_inverse=True)
        middle = inverse.reshape(-1, 3) + len(vertices)
        vertices = np.concatenate([vertices, vertices[edges].mean(axis=1)])
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
        a, b, c = faces.T
        ab, bc, ca = middle.T
        corners = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        faces = np.concatenate([np.stack(corner, axis=1) for corner in corners])
    return radius * vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces.astype(np.int32)


def tube(around: int, radius: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Open prism about Y, faces nearly equilateral, normals outward; around + 1 vertices a column."""
    step = 2 * np.pi * radius / around
    column, row = (part.ravel() for part in np.meshgrid(np.arange(around), np.arange(around + 1), indexing="ij"))
    angle = 2 * np.pi * column / around
    height = step / np.sqrt(0.75) * (row + 0.5 * (column % 2))
    index = lambda c, r: (c % around) * (around + 1) + r  # noqa: E731
    c, r = (part.ravel() for part in np.meshgrid(np.arange(around), np.arange(around), indexing="ij"))
    a, b, e, d = index(c, r), index(c + 1, r), index(c + 1, r + 1), index(c, r + 1)
    rising = (c % 2 == 1)[:, None]
    first = np.where(rising, np.stack([a, b, e], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(rising, np.stack([a, e, d], axis=1), np.stack([b, e, d], axis=1))
    faces = np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int32)
    return np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], axis=1), faces


def turned(vertices: np.ndarray, degrees: float, axis: int = 2) -> np.ndarray:
    """Vertices turned about a coordinate axis."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    out = np.array(vertices, float)
    out[..., j] = cosine * vertices[..., j] - sine * vertices[..., k]
    out[..., k] = sine * vertices[..., j] + cosine * vertices[..., k]
    return out


def _outward(vertices: np.ndarray, a: int, b: int, c: int) -> bool:
    """Three neighbouring corners of the icosahedron (edges of length 2), counter-clockwise seen from outside."""
    corner = vertices[[a, b, c]]
    sides = np.linalg.norm(corner - np.roll(corner, 1, axis=0), axis=1)
    return bool(np.allclose(sides, 2.0) and np.linalg.det(corner) > 0)
