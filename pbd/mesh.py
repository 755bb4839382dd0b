"""Cloth meshes: topology, rest metric and areas. Functions on plain arrays, and a dataclass of their results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pbd.arrays import floats, integers
from pbd.errors import InputError

__all__ = [
    "MAX_STRETCH",
    "ClothMesh",
    "Hinges",
    "edges_of",
    "flatten_by_lengths",
    "flatten_by_surface",
    "greedy_colors",
    "hinges_of",
    "lattice_faces",
    "vertex_rings",
]

MAX_STRETCH = 1.5  # greatest length of an edge over its rest length [-]


def edges_of(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Undirected edges of a triangle mesh.

    Args:
        faces: int, shape (m, 3).

    Returns:
        edges (int32, shape (e, 2), each row ascending, rows sorted) and the edge of each face side
        (int32, shape (m, 3); side s joins corners s and s + 1).
    """
    faces = np.asarray(faces, np.int64)
    following = np.roll(faces, -1, axis=1)
    count = faces.max(initial=0) + 1
    # Numbers are sorted ten times as fast as rows.
    key, inverse = np.unique(np.minimum(faces, following) * count + np.maximum(faces, following), return_inverse=True)
    return np.stack(np.divmod(key, count), axis=1).astype(np.int32), inverse.reshape(-1, 3).astype(np.int32)


def hinges_of(faces: np.ndarray) -> np.ndarray:
    """Inner edges with the corners that face them: int32, shape (h, 4), rows (i, j, k, l).

    The edge runs i to j in the face of k; l is the corner of the other face.

    Raises:
        InputError: an edge with more than two faces, or one that both faces run in the same direction.
    """
    edges, side_edge = edges_of(faces)
    order = np.argsort(side_edge.ravel(), kind="stable")
    counts = np.bincount(side_edge.ravel(), minlength=len(edges))
    if counts.size and counts.max() > 2:
        bad = edges[np.argmax(counts)]
        raise InputError("non-manifold edge", key=f"edge {bad[0]}-{bad[1]}", received=int(counts.max()), expected="2")
    start = np.concatenate([[0], np.cumsum(counts)])[:-1][counts == 2]
    first, second = order[start], order[start + 1]
    corner = faces.ravel()
    face, side = first // 3, first % 3
    i, j = corner[first], faces[face, (side + 1) % 3]
    same = corner[second] == i
    if np.any(same):  # also a face given twice
        bad = np.argmax(same)
        raise InputError(
            "faces wound against each other", key=f"edge {i[bad]}-{j[bad]}", expected="each edge run once each way"
        )
    k = faces[face, (side + 2) % 3]
    other = faces[second // 3, (second % 3 + 2) % 3]
    return np.stack([i, j, k, other], axis=1).astype(np.int32)


def flatten_by_surface(vertices: np.ndarray, faces: np.ndarray, warp: np.ndarray) -> np.ndarray:
    """Flat rest shape of each face, turned so that its first axis is the warp direction laid into the face.

    Args:
        vertices: [m], shape (n, 3).
        faces: int, shape (m, 3).
        warp: direction in space, shape (3,). Faces that stand across it take a direction at right angles to it.

    Returns:
        Columns are the sides 0-1 and 0-2 in (warp, weft): [m], shape (m, 2, 2).
    """
    corner = vertices[faces]
    side_1, side_2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    normal = np.cross(side_1, side_2)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    warp = np.asarray(warp, float) / np.linalg.norm(warp)
    spare = np.eye(3)[np.argmin(np.abs(warp))]
    axis = warp - normal * (normal @ warp)[:, None]
    across = np.linalg.norm(axis, axis=1) < 0.1
    axis[across] = spare - normal[across] * (normal[across] @ spare)[:, None]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    weft = np.cross(normal, axis)
    dot = lambda a, b: np.einsum("ij,ij->i", a, b)  # noqa: E731
    row_1 = np.stack([dot(side_1, axis), dot(side_2, axis)], axis=1)
    row_2 = np.stack([dot(side_1, weft), dot(side_2, weft)], axis=1)
    return np.stack([row_1, row_2], axis=1)


def flatten_by_lengths(flat: np.ndarray, faces: np.ndarray, lengths: np.ndarray, side_edge: np.ndarray) -> np.ndarray:
    """Give flat faces other side lengths and keep the direction of their first side against the warp.

    Args:
        flat: [m], shape (m, 2, 2), as :func:`flatten_by_surface` gives.
        faces: int, shape (m, 3).
        lengths: of the edges [m], shape (e,).
        side_edge: int, shape (m, 3), as :func:`edges_of` gives.

    Raises:
        InputError: lengths that close no triangle; names the face.
    """
    a, b, c = (lengths[side_edge[:, s]] for s in range(3))  # sides 0-1, 1-2, 2-0
    along = (a**2 + c**2 - b**2) / (2.0 * a)
    height_squared = c**2 - along**2
    if np.any(height_squared <= 0):
        face = int(np.argmin(height_squared))
        raise InputError(
            "rest lengths close no triangle",
            key=f"face {face}",
            received=[float(a[face]), float(b[face]), float(c[face])],
            expected="each below the sum of the others",
        )
    direction = flat[:, :, 0] / np.linalg.norm(flat[:, :, 0], axis=1, keepdims=True)
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    side_1 = direction * a[:, None]
    side_2 = direction * along[:, None] + normal * np.sqrt(height_squared)[:, None]
    return np.stack([side_1, side_2], axis=2)


def greedy_colors(members: np.ndarray, vertex_count: int) -> np.ndarray:
    """Colours such that no two rows of one colour share a vertex: int32, shape (c,).

    Args:
        members: vertices of each constraint, int, shape (c, k).
        vertex_count: number of vertices.
    """
    used = [0] * vertex_count  # colours around each vertex, as bits
    colors = np.zeros(len(members), np.int32)
    for row, vertices in enumerate(members.tolist()):
        taken = 0
        for vertex in vertices:
            taken |= used[vertex]
        color = (~taken & (taken + 1)).bit_length() - 1
        colors[row] = color
        for vertex in vertices:
            used[vertex] |= 1 << color
    return colors


def vertex_rings(faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours of each vertex by edges, as (offsets int32 (n + 1,), indices int32 (2 e,))."""
    edges, _ = edges_of(faces)
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    counts = np.bincount(both[:, 0], minlength=vertex_count)
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return offsets.astype(np.int32), both[:, 1].astype(np.int32).copy()


def lattice_faces(index: np.ndarray, alternating: bool = True) -> np.ndarray:
    """Triangles of a lattice of squares, each square cut along a diagonal: int32, shape (2 (p - 1) (q - 1), 3).

    The triangles are counter-clockwise where the first axis of the lattice points right and the second one up.

    Args:
        index: vertex at each point of the lattice, int, shape (p, q).
        alternating: whether neighbouring squares are cut along different diagonals, so that the cloth prefers neither;
            otherwise all diagonals rise.
    """
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    row, column = np.divmod(np.arange(len(a)), max(index.shape[1] - 1, 1))
    rising = ((row + column) % 2 == 0)[:, None] | (not alternating)
    first = np.where(rising, np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(rising, np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    return np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int32)


class Hinges(NamedTuple):
    """Hinges with the rows of the quadratic bending operator.

    Attributes:
        vertices: (i, j, k, l) as :func:`hinges_of` gives them, int32, shape (h, 4).
        rows: K, shape (h, 4).
        areas: of both faces, as far as they can bend [m2], shape (h,).
        angle: of the edge to the warp [rad], shape (h,).
    """

    vertices: np.ndarray
    rows: np.ndarray
    areas: np.ndarray
    angle: np.ndarray


@dataclass(frozen=True)
class ClothMesh:
    """A triangle mesh with a flat rest shape of every face.

    Attributes:
        vertices: start positions [m], float64, shape (n, 3).
        faces: int32, shape (m, 3).
        flat: rest shape of each face, columns are its sides 0-1 and 0-2 in (warp, weft) [m], shape (m, 2, 2).
        stitches: vertices (v, a, b), each v sewn to a point of the edge a-b, int32, shape (s, 3).
        stitch_weights: w of each stitch, x_v = (1 - w) x_a + w x_b, shape (s,).
        seam_hinges: hinges across the seams; None where seams bend freely, or there are none.
        rest_bends: of each hinge of :func:`hinges_of` at rest, see :func:`pbd.bending.bends_of` [m], shape (h,); None
            where the cloth rests flat. Only the default solver knows them.
        cloth_areas: of the cloth in each face [m2], shape (m,); None where it is as much as the rest shape has, and not
            gathered.
        layers: of cloth that lie on one another in each face and are sewn together [-], shape (m,); None where there is
            one everywhere.
        max_stretch: greatest length of the edges of each face over their rest length [-], shape (m,): less than that of
            :mod:`pbd.contact.strain_limits` in waistbands; None where all have that.
    """

    vertices: np.ndarray
    faces: np.ndarray
    flat: np.ndarray
    stitches: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.int32))
    stitch_weights: np.ndarray = field(default_factory=lambda: np.zeros(0))
    seam_hinges: Hinges | None = None
    rest_bends: np.ndarray | None = None
    cloth_areas: np.ndarray | None = None
    layers: np.ndarray | None = None
    max_stretch: np.ndarray | None = None

    @classmethod
    def from_surface(cls, vertices: np.ndarray, faces: np.ndarray, warp: tuple = (0.0, 1.0, 0.0)) -> ClothMesh:
        """The mesh in space is the rest shape; the warp is a direction in space laid into each face.

        Raises:
            InputError: arrays of another shape, values that are not finite, faces of vertices
                that are not there, or a warp without direction.
        """
        vertices, faces = np.asarray(floats(vertices, "vertices", ("n", 3)), float), _checked_faces(faces, vertices)
        direction = floats(warp, "warp", (3,))
        if not direction.any():
            raise InputError("no direction", key="warp", received=warp, expected="a direction in space")
        return cls(vertices, faces, flatten_by_surface(vertices, faces, direction))

    @classmethod
    def from_pattern(
        cls, vertices: np.ndarray, faces: np.ndarray, pattern: np.ndarray, layers: np.ndarray | None = None
    ) -> ClothMesh:
        """The flat pattern is the rest shape: corner coordinates (warp, weft) [m], shape (m, 3, 2).

        Mirrored panels keep their lengths; only the sign of the second axis changes.

        Raises:
            InputError: arrays of another shape, values that are not finite, or faces of vertices that are not there.
        """
        faces = _checked_faces(faces, vertices)
        pattern = floats(pattern, "pattern", (len(faces), 3, 2))
        sides = np.stack([pattern[:, 1] - pattern[:, 0], pattern[:, 2] - pattern[:, 0]], axis=2)
        flipped = np.linalg.det(sides) < 0
        sides[flipped, 1] *= -1.0
        return cls(np.asarray(vertices, float), faces, sides, layers=layers)

    @classmethod
    def grid(
        cls,
        width: float,
        height: float,
        columns: int,
        rows: int,
        centre: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
        *,
        level: bool = False,
    ) -> ClothMesh:
        """A rectangle of squares cut along alternating diagonals, with the warp along its height.

        Vertex ``column * (rows + 1) + row`` stands at column 0 to ``columns`` from the left and row 0 to ``rows`` from
        below.

        Args:
            width, height: [m].
            columns, rows: number of squares along the width and the height.
            centre: of the rectangle [m], shape (3,).
            level: False for a curtain, its width along x, its height along y and its normals along z; True for a
                tablecloth, its height along -z and its normals along y.

        Raises:
            InputError: a size that is not positive, no whole number of columns or rows, or a bad centre.
        """
        for key, value in (("width", width), ("height", height)):
            if not (np.isfinite(value) and value > 0):
                raise InputError("bad size", key=key, received=value, expected="a finite number above 0 [m]")
        for key, value in (("columns", columns), ("rows", rows)):
            if value != int(value) or value < 1:
                raise InputError("bad number of squares", key=key, received=value, expected="a whole number above 0")
        x, y = np.meshgrid(
            width * (np.arange(columns + 1) / columns - 0.5), height * (np.arange(rows + 1) / rows - 0.5), indexing="ij"
        )
        up = (0.0, 0.0, -1.0) if level else (0.0, 1.0, 0.0)
        vertices = (
            floats(centre, "centre", (3,), unit=" [m]") + x.reshape(-1, 1) * [1.0, 0.0, 0.0] + y.reshape(-1, 1) * up
        )
        faces = lattice_faces(np.arange(x.size).reshape(x.shape))
        return cls.from_surface(vertices, faces, warp=up)

    def __post_init__(self) -> None:
        keep = lambda name, array: object.__setattr__(self, name, array)  # noqa: E731
        keep("vertices", floats(self.vertices, "vertices", ("n", 3), unit=" [m]"))
        keep("faces", _checked_faces(self.faces, self.vertices))
        keep("flat", floats(self.flat, "flat", (len(self.faces), 2, 2), unit=" [m]"))
        missing = "stitch of a vertex that does not exist"
        keep("stitches", integers(self.stitches, "stitches", ("s", 3), len(self.vertices), outside=missing))
        keep("stitch_weights", floats(self.stitch_weights, "stitch_weights", (len(self.stitches),)))
        if self.rest_bends is not None:
            count = len(hinges_of(self.faces))
            keep("rest_bends", floats(self.rest_bends, "rest_bends", (count,), "bad bends at rest", unit=" [m]"))
        for name, problem in (
            ("cloth_areas", "bad areas of cloth"),
            ("layers", "bad numbers of layers"),
            ("max_stretch", "bad limits of stretch"),
        ):
            if getattr(self, name) is not None:
                keep(name, floats(getattr(self, name), name, (len(self.faces),), problem))
                lowest = getattr(self, name).min()
                if lowest <= 0.0:
                    raise InputError(problem, key=name, received=float(lowest), expected="numbers above 0")
        area = self.face_areas
        if np.any(area <= 1e-12):
            face = int(np.argmin(area))
            raise InputError(
                "face without area in the rest shape",
                key=f"face {face}",
                received=float(area[face]),
                expected="over 1e-12 m2, wound as its flat shape",
            )

    @property
    def face_areas(self) -> np.ndarray:
        """Rest areas [m2], shape (m,)."""
        return 0.5 * np.linalg.det(self.flat)

    @property
    def vertex_areas(self) -> np.ndarray:
        """A third of the rest areas around each vertex [m2], shape (n,)."""
        return self._thirds(self.face_areas)

    @property
    def face_cloth_areas(self) -> np.ndarray:
        """Areas of the cloth in each face [m2], shape (m,). Mass and stiffness follow from these areas."""
        areas = self.face_areas if self.cloth_areas is None else np.asarray(self.cloth_areas)
        return areas if self.layers is None else areas * self.layers

    @property
    def vertex_cloth_areas(self) -> np.ndarray:
        """A third of the cloth around each vertex [m2], shape (n,)."""
        return self._thirds(self.face_cloth_areas)

    def _thirds(self, areas: np.ndarray) -> np.ndarray:
        return np.bincount(self.faces.ravel(), weights=np.repeat(areas / 3.0, 3), minlength=len(self.vertices))

    def side_lengths(self) -> np.ndarray:
        """Rest lengths of the sides 0-1, 1-2, 2-0 of each face [m], shape (m, 3)."""
        side_1, side_2 = self.flat[:, :, 0], self.flat[:, :, 1]
        return np.stack([np.linalg.norm(s, axis=1) for s in (side_1, side_2 - side_1, side_2)], axis=1)

    def edge_limits(self, usual: float) -> np.ndarray:
        """Greatest length over rest length of each edge, the lesser of both faces [-], shape (e,).

        Args:
            usual: where the mesh has no limits of its own [-].
        """
        edges, side_edge = edges_of(self.faces)
        limits = np.full(len(edges), usual)
        if self.max_stretch is not None:
            np.minimum.at(limits, side_edge.ravel(), np.repeat(self.max_stretch, 3))
        return limits

    def edge_lengths(self) -> tuple[np.ndarray, np.ndarray]:
        """Edges (int32, shape (e, 2)) and their rest lengths [m], shape (e,); mean of both faces."""
        edges, side_edge = edges_of(self.faces)
        total = np.bincount(side_edge.ravel(), weights=self.side_lengths().ravel(), minlength=len(edges))
        return edges, total / np.bincount(side_edge.ravel(), minlength=len(edges))


def _checked_faces(faces: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Faces of a mesh of these vertices, int32, shape (m, 3)."""
    count = len(floats(vertices, "vertices", ("n", 3), unit=" [m]"))
    checked = integers(faces, "faces", ("m", 3), count, outside="face points outside the mesh")
    if not len(checked):
        raise InputError("empty cloth mesh", key="faces", received=0, expected="at least one face")
    return checked
