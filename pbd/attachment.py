"""Vertices attached to a body: each rides on a point of a body face at a fixed distance along its normal."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from pbd.engine import ensure_initialized, ti
from pbd.errors import InputError
from pbd.taichi_internals import Launch

__all__ = ["Attachment", "closest_points", "closest_weights", "push_outside", "smooth_normals"]

double3 = ti.types.vector(3, ti.f64)
Double3 = ti.types.ndarray(dtype=double3, ndim=1)
Double3Rows = ti.types.ndarray(dtype=double3, ndim=2)


def closest_points(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, candidates: int = 24
) -> tuple[np.ndarray, np.ndarray]:
    """Closest point of a triangle mesh to each point.

    The search covers the faces with the nearest centroids. It is exact where the mesh is finer than the distance
    between its sheets; attachments and start positions need no more.

    Args:
        points: [m], shape (p, 3).
        vertices: [m], shape (n, 3).
        faces: int, shape (m, 3).
        candidates: faces tried for each point.

    Returns:
        face (int, shape (p,)) and barycentric weights (shape (p, 3)).
    """
    corners = vertices[faces]
    _, near = cKDTree(corners.mean(axis=1)).query(points, k=min(candidates, len(faces)))
    near = near.reshape(len(points), -1)
    a, b, c = (corners[near][:, :, i] for i in range(3))
    weights = closest_weights(points[:, None, :], a, b, c)
    found = weights[..., :1] * a + weights[..., 1:2] * b + weights[..., 2:] * c
    best = np.argmin(np.linalg.norm(found - points[:, None, :], axis=2), axis=1)
    rows = np.arange(len(points))
    return near[rows, best], weights[rows, best]


def closest_weights(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Barycentric weights of the closest point: the inner one where it lies inside, else the best of the sides."""
    dot = lambda u, v: np.einsum("...i,...i->...", u, v)  # noqa: E731
    ab, ac, ap = b - a, c - a, p - a
    d00, d01, d11, d20, d21 = dot(ab, ab), dot(ab, ac), dot(ac, ac), dot(ap, ab), dot(ap, ac)
    scale = 1.0 / np.maximum(d00 * d11 - d01 * d01, 1e-30)
    v, w = (d11 * d20 - d01 * d21) * scale, (d00 * d21 - d01 * d20) * scale
    inner = np.stack([1.0 - v - w, v, w], axis=-1)
    inside = (inner >= 0.0).all(axis=-1)
    best, best_distance = inner, np.where(inside, -1.0, np.inf)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        start, side = (a, b, c)[first], (a, b, c)[second] - (a, b, c)[first]
        t = np.clip(dot(p - start, side) / np.maximum(dot(side, side), 1e-30), 0.0, 1.0)
        weights = np.zeros_like(inner)
        weights[..., first], weights[..., second] = 1.0 - t, t
        distance = np.linalg.norm(start + t[..., None] * side - p, axis=-1)
        nearer = distance < best_distance
        best = np.where(nearer[..., None], weights, best)
        best_distance = np.where(nearer, distance, best_distance)
    return best


def smooth_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit vertex normals, weighted by area, shape (n, 3)."""
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros_like(vertices, float)
    for i in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, i], weights=normal[:, axis], minlength=len(vertices))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


def push_outside(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, clearance: float) -> np.ndarray:
    """Move points that lie inside a body, or nearer to it than ``clearance`` [m], out along its normals.

    Args:
        points: [m], shape (p, 3).
        vertices: of the body [m], shape (n, 3).
        faces: of the body, int, shape (m, 3).
        clearance: distance wanted [m].

    Returns:
        [m], shape (p, 3).
    """
    normals = smooth_normals(vertices, faces)
    points = np.array(points, float)
    for _ in range(4):  # a point pushed out of one face may come too near to the next
        face, weights = closest_points(points, vertices, faces)
        surface = np.einsum("pc,pci->pi", weights, vertices[faces[face]])
        normal = np.einsum("pc,pci->pi", weights, normals[faces[face]])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        short = clearance - np.einsum("pi,pi->p", points - surface, normal)
        near = np.linalg.norm(points - surface, axis=1) < 0.05
        move = np.where((short > 1e-6) & near, short, 0.0)
        points += move[:, None] * normal
        if not move.any():
            break
    return points


@ti.kernel
def _ride(corners: Double3Rows, weights: Double3, offset: Double3, out: Double3):
    """Points with weights and offsets in the frames of faces with these corners [m], as :meth:`Attachment._frames`."""
    ti.loop_config(serialize=True)
    for i in range(corners.shape[0]):
        w, d, a = weights[i], offset[i], corners[i, 0]
        first, second = corners[i, 1] - a, corners[i, 2] - a
        normal = first.cross(second)
        side = first / ti.max(first.norm(), 1e-30)
        normal /= ti.max(normal.norm(), 1e-30)
        out[i] = a + w[1] * first + w[2] * second + d[0] * side + d[1] * normal + d[2] * side.cross(normal)


@dataclass(frozen=True)
class Attachment:
    """Points that ride on a body.

    Attributes:
        corners: body vertices of the face that carries each point, int32, shape (p, 3).
        weights: barycentric, shape (p, 3).
        offset: in the face's frame (first side, normal, their cross product) [m], shape (p, 3).
    """

    corners: np.ndarray
    weights: np.ndarray
    offset: np.ndarray
    _launch: Launch = field(default_factory=lambda: Launch(_ride), init=False, repr=False, compare=False)

    @classmethod
    def bind(cls, points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> "Attachment":
        """Attach points [m], shape (p, 3), to the nearest faces of a body in its bind pose."""
        points = np.asarray(points, float).reshape(-1, 3)
        if not len(points):
            return cls(np.zeros((0, 3), np.int32), np.zeros((0, 3)), np.zeros((0, 3)))
        if not len(faces):
            raise InputError("nothing to attach to", key="body", received="no faces", expected="a body with faces")
        face, weights = closest_points(points, np.asarray(vertices, float), faces)
        corners = np.asarray(faces[face], np.int32)
        surface, frame = cls(corners, weights, np.zeros_like(points))._frames(np.asarray(vertices, float))
        return cls(corners, weights, np.einsum("pi,pij->pj", points - surface, frame))

    def _frames(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b, c = (vertices[self.corners[:, i]].astype(float) for i in range(3))
        side = b - a
        side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-30)
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        w = self.weights
        surface = w[:, :1] * a + w[:, 1:2] * b + w[:, 2:] * c
        return surface, np.stack([side, normal, np.cross(side, normal)], axis=2)

    def moved(self, displacements: np.ndarray, vertices: np.ndarray) -> "Attachment":
        """The same points, each moved by its displacement [m], shape (p, 3), in the bind pose (``vertices`` [m])."""
        _, frame = self._frames(np.asarray(vertices, float))
        return replace(self, offset=self.offset + np.einsum("pi,pij->pj", displacements, frame))

    def targets(self, vertices: np.ndarray) -> np.ndarray:
        """Where the points are for a pose of the body [m], shape (n, 3): float64, shape (p, 3)."""
        ensure_initialized()
        corners, out = self._workspace
        corners[:] = np.take(vertices, self.corners, axis=0)
        self._launch(corners, self.weights, self.offset, out)
        return out.copy()

    @cached_property
    def _workspace(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners and points of the last call: the same arrays need not be handed to the kernel again."""
        return np.zeros((len(self.corners), 3, 3)), np.zeros(self.offset.shape)
