"""Colliders: planes, spheres, capsules, distance fields and one animated triangle mesh (a body)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from pbd.arrays import floats, integers, numbers
from pbd.contact.distance_field import ROW, DistanceField, field_rows, vector
from pbd.errors import InputError
from pbd.geometry import FAR, surface_normals
from pbd.mesh import vertex_rings
from pbd.taichi_internals import Launch

__all__ = ["Body", "Capsule", "Colliders", "DistanceField", "Plane", "Primitive", "Sphere"]

EDGES = 8  # of a vertex, in tables of a fixed width; few vertices have more
MAX_PROBES = 1_000_000  # points on the large faces of a body, about


@dataclass
class Plane:
    """Half space below a plane. ``point`` [m] may be moved between frames; ``normal`` points to the free side."""

    point: Sequence[float] | np.ndarray
    normal: Sequence[float] | np.ndarray = (0.0, 1.0, 0.0)

    def row(self) -> np.ndarray:
        """Kind 0, no radius, point [m] and unit normal: shape (8,).

        Raises:
            InputError: vectors that are not three finite numbers, or a normal without direction.
        """
        normal = vector(self.normal, "plane.normal")
        size = np.linalg.norm(normal)
        if size == 0:
            raise InputError("plane without direction", key="plane.normal", received=self.normal, expected="not zero")
        return np.concatenate([[0.0, 0.0], vector(self.point, "plane.point"), normal / size])


@dataclass
class Sphere:
    """Ball; ``centre`` [m] may be moved between frames."""

    centre: Sequence[float] | np.ndarray
    radius: float

    def row(self) -> np.ndarray:
        """Kind 1, radius and centre [m], three zeros: shape (8,).

        Raises:
            InputError: a radius that is not positive, or a centre that is not three finite numbers.
        """
        _positive_radius(self.radius, "sphere.radius")
        return np.concatenate([[1.0, self.radius], vector(self.centre, "sphere.centre"), np.zeros(3)])


@dataclass
class Capsule:
    """Points within ``radius`` [m] of a segment; both ends [m] may be moved between frames."""

    start: Sequence[float] | np.ndarray
    end: Sequence[float] | np.ndarray
    radius: float

    def row(self) -> np.ndarray:
        """Kind 2, radius and both ends [m]: shape (8,).

        Raises:
            InputError: a radius that is not positive, or an end that is not three finite numbers.
        """
        _positive_radius(self.radius, "capsule.radius")
        ends = vector(self.start, "capsule.start"), vector(self.end, "capsule.end")
        return np.concatenate([[2.0, self.radius], *ends])


def _positive_radius(radius: float, key: str) -> None:
    if floats(radius, key, (), "bad radius", unit=" [m]") <= 0:
        raise InputError("bad radius", key=key, received=radius, expected="a finite number above 0 [m]")


class Body:
    """An animated triangle mesh to collide with: the last two poses of a frame, and its neighbourhoods.

    Args:
        faces: int, shape (m, 3), counter-clockwise seen from outside.
        vertex_count: number of vertices.

    Raises:
        InputError: faces of another shape, or of vertices that are not there.

    Attributes:
        previous, current: positions about ``origin`` at the start and end of the frame [m], float32, shape (n, 3).
        normals: unit vertex normals of the current pose, float32, shape (n, 3).
        probes: corners of faces too large to be found by their vertices, int32, shape (k, 3), with the barycentric
            weights ``probe_weights`` of points spread over them, float32, shape (k, 3).
        surface: vertices that lie in a face, int32, shape (s,).
    """

    def __init__(self, faces: np.ndarray, vertex_count: int) -> None:
        vertex_count = int(integers(vertex_count, "vertex_count", ()))
        outside = "body face points outside the mesh"
        self.faces = np.ascontiguousarray(integers(faces, "faces", ("m", 3), vertex_count, outside=outside))
        self.previous = np.zeros((vertex_count, 3), np.float32)
        self.current = np.zeros((vertex_count, 3), np.float32)
        self.normals = np.zeros((vertex_count, 3), np.float32)
        self.ring_start, self.ring = vertex_rings(self.faces, vertex_count)
        order = np.argsort(self.faces.ravel(), kind="stable")
        counts = np.bincount(self.faces.ravel(), minlength=vertex_count)
        self.fan_start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        face, corner = np.divmod(order, 3)
        others = [self.faces[face, (corner + k) % 3] for k in (1, 2)]
        self.fan = np.ascontiguousarray(np.stack(others, axis=1), np.int32)
        self.surface = np.flatnonzero(counts).astype(np.int32)
        self.probes, self.probe_weights = np.zeros((0, 3), np.int32), np.zeros((0, 3), np.float32)
        self.origin = np.zeros(3)
        self._placed = False
        self._normals = Launch(surface_normals)

    @cached_property
    def first_edges(self) -> tuple[np.ndarray, np.ndarray]:
        """The first edges of ``ring`` from each vertex, :data:`EDGES` of them, for loops of a fixed length.

        Returns:
            where they end, int32, shape (8 n,), the vertex itself in places that are left; the third corners of the
            faces to their left and right, int32, shape (8 n, 2), both the same on a rim.
        """
        count = len(self.previous)
        vertex = np.repeat(np.arange(count), np.diff(self.ring_start))
        place = np.arange(len(self.ring)) - self.ring_start[vertex]
        first = place < EDGES
        edge, beside = vertex * count + self.ring, np.full((len(self.ring), 2), -1, np.int32)
        for k in range(3):
            a, b, c = (self.faces[:, (k + turn) % 3].astype(np.int64) for turn in range(3))
            beside[np.searchsorted(edge, a * count + b), 0] = c
            beside[np.searchsorted(edge, a * count + c), 1] = b
        beside = np.where(beside < 0, beside[:, ::-1], beside)
        ends = np.repeat(np.arange(count, dtype=np.int32), EDGES)
        sides = np.stack([ends, ends], axis=1)
        place = (EDGES * vertex + place)[first]
        ends[place], sides[place] = self.ring[first], beside[first]
        return ends, sides

    def advance(self, vertices: np.ndarray) -> None:
        """Make ``vertices`` [m], float32, shape (n, 3), the current pose; the last becomes the previous.

        Raises:
            InputError: vertices of another shape or not finite; then nothing has changed.
        """
        vertices = self._checked(vertices)
        self.begin_pose()
        self.current[:] = vertices
        self.finish_pose()

    def begin_pose(self) -> None:
        """Make the current pose the previous one, before ``current`` is written in place.

        It is copied: the same arrays need not be handed to the kernels again.
        """
        self.previous[:] = self.current

    def finish_pose(self) -> None:
        """Bring normals up to date after ``current`` was written in place."""
        if not self._placed:
            self.previous[:] = self.current
            self.probes, self.probe_weights = _probes(self.current, self.faces)
            self._placed = True
        self._normals(self.current, self.faces, self.normals)

    def place(self, vertices: np.ndarray) -> None:
        """Put the body somewhere without motion; see :meth:`advance`."""
        vertices = self._checked(vertices)
        self._placed = False
        self.begin_pose()
        self.current[:] = vertices
        self.finish_pose()

    def _checked(self, vertices: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore"):  # a number too large for float32 becomes infinite
            vertices = numbers(vertices, "vertices", self.current.shape).astype(np.float32, copy=False)
        return floats(vertices, "vertices", self.current.shape, unit=" [m]")

    def thinned(self, vertices: np.ndarray, spacing: float) -> np.ndarray:
        """Vertices that are enough to find the surface by: any other has one of them beside it, nearer than a spacing.

        Args:
            vertices: in the bind pose [m], shape (n, 3).
            spacing: [m].

        Returns:
            int32, shape (s,), ascending.

        Raises:
            InputError: vertices of another shape or not finite.
        """
        vertices = floats(vertices, "vertices", self.current.shape, unit=" [m]")
        left = np.ones(len(vertices), bool)
        chosen = []
        for vertex in self.surface.tolist():
            if left[vertex]:
                chosen.append(vertex)
                ring = self.ring[self.ring_start[vertex] : self.ring_start[vertex + 1]]
                left[ring[np.linalg.norm(vertices[ring] - vertices[vertex], axis=1) < spacing]] = False
        return np.array(chosen, np.int32)

    def move_origin(self, origin: np.ndarray) -> None:
        """Count from another origin; see :meth:`pbd.State.move_origin`."""
        origin = floats(origin, "origin", (3,), unit=" [m]")
        if origin.tolist() != self.origin.tolist():
            shift = (origin - self.origin).astype(np.float32)
            self.previous -= shift
            self.current -= shift
            self.origin = np.array(origin, float)


def _probes(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points no further than FAR apart on faces with sides longer than 1.5 FAR; see :class:`Body`.

    Bodies of many metres, which may be a mistake of scale, get a bounded number, further apart.
    """
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1, initial=0.0)
    apart = max(FAR, float(np.sqrt(0.5 * np.sum(longest.astype(float) ** 2) / MAX_PROBES)))
    parts = np.where(longest > 1.5 * apart, np.ceil(longest / apart), 1).astype(int)
    probes, weights = [np.zeros((0, 3), np.int32)], [np.zeros((0, 3), np.float32)]
    for count in np.unique(parts[parts > 1]):
        a, b = np.divmod(np.arange((count + 1) ** 2), count + 1)
        grid = np.stack([a, b, count - a - b], axis=1)
        grid = grid[(grid[:, 2] >= 0) & (grid.max(axis=1) < count)]  # the corners are found already
        large = faces[parts == count]
        probes.append(np.repeat(large, len(grid), axis=0))
        weights.append(np.tile(grid / count, (len(large), 1)).astype(np.float32))
    return np.concatenate(probes), np.concatenate(weights)


Primitive: TypeAlias = Plane | Sphere | Capsule | DistanceField


class Colliders:
    """What a garment collides with in one step.

    Args:
        primitives: planes, spheres, capsules in world coordinates, and distance fields.
        body: animated mesh, or None.
    """

    def __init__(self, primitives: Sequence[Primitive] = (), body: Body | None = None) -> None:
        self.primitives = list(primitives)
        self.body = body
        self._last: np.ndarray | None = None
        self._none = np.zeros((0, 14), np.float32)
        self._last_fields: np.ndarray | None = None
        self._no_fields = np.zeros((0, ROW), np.float32)
        self._grids: list[np.ndarray] = []
        self._values = np.zeros(1, np.float32)

    def rows(self, origin: np.ndarray) -> np.ndarray:
        """Planes, spheres, capsules at the start and end of the frame about an origin: float32, shape (k, 14)."""
        found = [p.row() for p in self.primitives if not isinstance(p, DistanceField)]
        if not found:
            self._last = None
            return self._none
        origin, now = floats(origin, "origin", (3,), unit=" [m]"), np.array(found).reshape(-1, 8)
        before = self._last if self._last is not None and self._last.shape == now.shape else now
        self._last = now
        rows = np.concatenate([before, now[:, 2:]], axis=1)
        rows[:, 2:5] -= origin
        rows[:, 8:11] -= origin
        capsule = rows[:, 0] == 2.0
        rows[capsule, 5:8] -= origin
        rows[capsule, 11:14] -= origin
        return rows.astype(np.float32)

    def fields(self, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance fields and how they move in the frame, about an origin; and the values of all, end to end [m].

        Returns:
            float32, shape (k, 25), see :mod:`pbd.contact.distance_field`; float32, shape (sum of all grids,), the same
            array as long as the grids are the same.
        """
        found = [p for p in self.primitives if isinstance(p, DistanceField)]
        if not found:
            self._last_fields = None
            return self._no_fields, self._values
        origin, now = floats(origin, "origin", (3,), unit=" [m]"), np.array([p.row() for p in found])
        before = self._last_fields if self._last_fields is not None and self._last_fields.shape == now.shape else now
        self._last_fields = now
        if [id(p.values) for p in found] != [id(grid) for grid in self._grids]:
            self._grids = [p.values for p in found]
            self._values = np.concatenate([grid.ravel() for grid in self._grids])
        rows = field_rows(now, before)
        rows[:, 16:19] -= origin
        return rows.astype(np.float32), self._values
