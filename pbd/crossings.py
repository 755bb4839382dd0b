"""Self-intersections of a cloth: which edges go through which faces, and which faces have boxes that overlap.

Boxes are put into the cells of a grid, which is hashed (Teschner et al. 2003, "Optimized spatial hashing for collision
detection of deformable objects"). Tests of crossings are in float64 here. The solver's search for contact has a tree of
its own and tests in float32.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from pbd.engine import ensure_initialized, ti
from pbd.errors import InputError
from pbd.geometry import Double3, Int1, Int2, Int3, Vec3, Vec4, vec3
from pbd.mesh import ClothMesh, edges_of
from pbd.taichi_internals import Launch

__all__ = ["FaceGrid", "SelfCrossings", "crossings", "note_crossings", "owned_features", "seams_of"]

CELL_EXTENTS = 1.5  # size of a cell over the mean of the boxes' longest sides [-]
SHORT = 2e-4  # edges shorter than this may cross faces: slivers of delivered meshes [m]
LEVEL = 0.5  # least cosine between the normals around a vertex and their mean with which no two faces cross [-]
ROUNDING = 1e-6  # boxes so little apart count as overlapping [m]
MAX_CELLS = 8  # that a box may reach along an axis: cells are larger where one is very large


@ti.func
def goes_through(b, x1, x2, x3):
    """Whether the segment from the origin to b goes through a triangle.

    It does if its ends lie on different sides of the triangle's plane and its line passes inside the three sides. A
    segment that only touches a side, or lies in the plane, does not. For float32 and float64.
    """
    normal = (x2 - x1).cross(x3 - x1)
    sides = -x1.dot(normal) * (b - x1).dot(normal) < 0.0
    v1, v2, v3 = b.dot(x1.cross(x2)), b.dot(x2.cross(x3)), b.dot(x3.cross(x1))
    return sides and ((v1 > 0.0 and v2 > 0.0 and v3 > 0.0) or (v1 < 0.0 and v2 < 0.0 and v3 < 0.0))


@ti.func
def point(position: ti.template(), i: ti.i32):
    """Position of a vertex in the type that the array has [m]."""
    p = position[i]
    return ti.Vector([p[0], p[1], p[2]])


@ti.func
def note_crossings(
    f: ti.i32,
    g: ti.i32,
    position: ti.template(),
    faces: ti.template(),
    edges: ti.template(),
    owned: ti.template(),
    crossed: ti.template(),
):
    """Add the own sides of either of two faces that go through the other, if there is room for crossings at all."""
    if crossed.shape[0] > 1:
        for n in range(6):
            one, two, side = f, g, n
            if n >= 3:
                one, two, side = g, f, n - 3
            e, t = edges[3 * one + side], faces[two]
            shared = e[0] == t[0] or e[0] == t[1] or e[0] == t[2] or e[1] == t[0] or e[1] == t[1] or e[1] == t[2]
            if (owned[one] >> (3 + side)) & 1 and not shared:
                a = point(position, e[0])
                if goes_through(
                    point(position, e[1]) - a,
                    point(position, t[0]) - a,
                    point(position, t[1]) - a,
                    point(position, t[2]) - a,
                ):
                    count = crossed[0][0] + 1
                    crossed[0] = ti.Vector([count, 0, 0])
                    if count < crossed.shape[0]:
                        crossed[count] = ti.Vector([e[0], e[1], two])


def owned_features(faces: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Bits of the corners and sides that belong to each face, shape (m,).

    Each feature belongs to the first face that has it, so that no pair is found twice (Curtis, Tamstorf, Manocha 2008).

    Args:
        faces, sides: numbers of the corners and of the edges of each face, int, shapes (m, 3).
    """
    owned = np.zeros(len(faces), np.int32)
    for bit, features in ((0, faces), (3, sides)):
        _, first = np.unique(features.ravel(), return_index=True)
        np.bitwise_or.at(owned, first // 3, 1 << (bit + first % 3))
    return owned


@ti.kernel
def list_pairs(
    start: Double3,
    end: Double3,
    faces: Int3,
    chosen: Int1,
    margin: ti.f32,
    low: Vec3,
    high: Vec3,
    cells: Int3,
    heads: Int1,
    entries: Int3,
    pairs: Int2,
    counts: Int1,
):
    """List the pairs of chosen faces whose boxes over a motion overlap.

    Args:
        start, end: of the motion of each vertex [m]; ``margin``: by which each box is larger [m].
        faces, chosen: corners of all faces, and numbers of those that count.
        low, high, cells: workspace, a row for each face.
        heads, entries: workspace: of each hash its first entry; the face, the cell and the next entry of each entry.
        pairs: receives them; ``counts``: receives how many there are, and how many entries there would be.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        per_cell = fill_boxes(start, end, faces, chosen, margin, low, high)
        for r in range(heads.shape[0]):
            heads[r] = -1
        counts[0], counts[1] = 0, 0
        for c in range(chosen.shape[0]):
            first, last = ti.floor(low[c] * per_cell, ti.i32), ti.floor(high[c] * per_cell, ti.i32)
            cells[c] = first
            low_c, high_c = low[c], high[c]
            for x in range(first[0], last[0] + 1):
                for y in range(first[1], last[1] + 1):
                    for z in range(first[2], last[2] + 1):
                        key = (x & 1023) | (y & 1023) << 10 | (z & 1023) << 20
                        place = (x * 73856093 ^ y * 19349663 ^ z * 83492791) & (heads.shape[0] - 1)
                        entry = heads[place]
                        while entry >= 0:
                            d = entries[entry][0]
                            if entries[entry][1] == key and near_boxes(low_c, high_c, low[d], high[d]):
                                own = ti.max(first, cells[d])
                                # Of the cells that both have in common, the pair is noted in the lowest.
                                if own[0] == x and own[1] == y and own[2] == z:
                                    if counts[0] < pairs.shape[0]:
                                        pairs[counts[0]] = ti.Vector([chosen[d], chosen[c]])
                                    counts[0] += 1
                            entry = entries[entry][2]
                        if counts[1] < entries.shape[0]:
                            entries[counts[1]] = ti.Vector([c, key, heads[place]])
                            heads[place] = counts[1]
                        counts[1] += 1


@ti.func
def fill_boxes(
    start: ti.template(),
    end: ti.template(),
    faces: ti.template(),
    chosen: ti.template(),
    margin: ti.f32,
    low: ti.template(),
    high: ti.template(),
) -> ti.f32:
    """Fill the boxes of :func:`list_pairs`; returns one over the size of a cell [1/m]."""
    longest, total = 0.0, 0.0
    for c in range(chosen.shape[0]):
        f = faces[chosen[c]]
        least, most = ti.min(start[f[0]], end[f[0]]), ti.max(start[f[0]], end[f[0]])
        for k in ti.static((1, 2)):
            least = ti.min(least, ti.min(start[f[k]], end[f[k]]))
            most = ti.max(most, ti.max(start[f[k]], end[f[k]]))
        low[c], high[c] = least - margin, most + margin
        extent = (high[c] - low[c]).max()
        longest = ti.max(longest, extent)
        total += extent
    return 1.0 / ti.max(CELL_EXTENTS * total / chosen.shape[0], longest / MAX_CELLS)


@ti.func
def near_boxes(low_a: vec3, high_a: vec3, low_b: vec3, high_b: vec3):
    """Whether two boxes overlap. Their corners are rounded to float32, so that they overlap a little sooner."""
    apart = ti.max(ti.max(low_a - high_b, low_b - high_a), vec3(0.0))
    return apart.max() <= ROUNDING


@ti.func
def common(f, g):
    """How many corners two faces have in common."""
    count = 0
    for k in ti.static(range(3)):
        count += ti.select(f[k] == g[0] or f[k] == g[1] or f[k] == g[2], 1, 0)
    return count


@ti.kernel
def find_crossings(position: Double3, faces: Int3, edges: Int2, owned: Int1, pairs: Int2, count: ti.i32, crossed: Int3):
    """Find the edges that go through faces, of the first ``count`` pairs of faces; ``crossed``: as of Untangling."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        crossed[0] = ti.Vector([0, 0, 0])
        for r in range(count):
            f, g = pairs[r][0], pairs[r][1]
            if common(faces[f], faces[g]) < 2 and not (aside(f, g, position, faces) or aside(g, f, position, faces)):
                note_crossings(f, g, position, faces, edges, owned, crossed)


@ti.func
def aside(f: ti.i32, g: ti.i32, position: ti.template(), faces: ti.template()):
    """Whether face g lies on one side of the plane of face f."""
    origin = position[faces[f][0]]
    normal = (position[faces[f][1]] - origin).cross(position[faces[f][2]] - origin)
    a, b, c = (
        (position[faces[g][0]] - origin).dot(normal),
        (position[faces[g][1]] - origin).dot(normal),
        (position[faces[g][2]] - origin).dot(normal),
    )
    return (a >= 0.0 and b >= 0.0 and c >= 0.0) or (a <= 0.0 and b <= 0.0 and c <= 0.0)


@ti.kernel
def find_fan_crossings(
    position: Vec4,
    faces: Int3,
    edges: Int2,
    owned: Int1,
    fan_start: Int1,
    fan: Int1,
    branching: Int1,
    normals: Vec3,
    crossed: Int3,
):
    """Find the edges that go through faces with which their own face has one vertex in common.

    Faces around a vertex whose normals are all within 60 degrees of their mean do not cross: seen along the mean they
    lie beside one another. ``branching`` says where that is not so, because more than one sheet has the vertex.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        crossed[0] = ti.Vector([0, 0, 0])
        for f in range(faces.shape[0]):
            c = faces[f]
            a = point(position, c[0])
            n = (point(position, c[1]) - a).cross(point(position, c[2]) - a)
            normals[f] = n / ti.max(n.norm(), 1e-20)
        for i in range(position.shape[0]):
            mean = vec3(0.0)
            for r in range(fan_start[i], fan_start[i + 1]):
                mean += normals[fan[r]]
            folded, size = branching[i] != 0, mean.norm()
            for r in range(fan_start[i], fan_start[i + 1]):
                folded = folded or normals[fan[r]].dot(mean) < LEVEL * size
            if folded:
                for r in range(fan_start[i], fan_start[i + 1]):
                    for s in range(r + 1, fan_start[i + 1]):
                        if common(faces[fan[r]], faces[fan[s]]) == 1:
                            note_crossings(fan[r], fan[s], position, faces, edges, owned, crossed)


class FaceGrid:
    """Finds pairs of faces of one mesh that are near one another, and edges that go through faces.

    Args:
        faces: int, shape (m, 3).
        seam: number of the seam of each vertex, int32, shape (n,); features of one seam may go through one another, and
            vertices of none have numbers of their own. None where nothing is stitched.

    Attributes:
        seam: the same, without rows where nothing is stitched.
        faces, edges: corners of the faces, int32, shape (m, 3), and ends of their sides, int32, shape (3 m, 2).
        owned: see :func:`owned_features`.
        side_edge: number of the edge of each side, int, shape (m, 3).
    """

    def __init__(self, faces: np.ndarray, seam: np.ndarray | None = None) -> None:
        ensure_initialized()
        self.seam = np.zeros(0, np.int32) if seam is None else seam
        self.faces = np.ascontiguousarray(faces, np.int32)
        unique, self.side_edge = edges_of(self.faces)
        self.edges = np.ascontiguousarray(unique[self.side_edge.ravel()], np.int32)
        self.owned = owned_features(self.faces, self.side_edge)
        self._all = np.arange(len(faces), dtype=np.int32)
        self._low, self._high = np.zeros((2, len(faces), 3), np.float32)
        self._cells = np.zeros((len(faces), 3), np.int32)
        self._heads = np.zeros(1 << max(len(faces), 1).bit_length(), np.int32)
        self._entries = np.zeros((8 * len(faces), 3), np.int32)
        self._pairs = np.zeros((16 * len(faces), 2), np.int32)
        self._counts = np.zeros(2, np.int32)
        self._crossed = np.zeros((256, 3), np.int32)
        self._list, self._find = Launch(list_pairs), Launch(find_crossings)
        self._find_in_fans = Launch(find_fan_crossings)
        self._fans: tuple[np.ndarray, ...] = ()

    def pairs(
        self,
        start: np.ndarray,
        end: np.ndarray,
        margin: float = 0.0,
        *,
        chosen: np.ndarray | None = None,
        most: float = np.inf,
    ) -> tuple[np.ndarray, int]:
        """Pairs of faces whose boxes overlap over a straight motion of their corners, in a buffer, and how many.

        Args:
            start, end: of the vertices [m], float64, shape (n, 3).
            margin: by which each box is larger [m].
            chosen: numbers of the faces that count, int32; None for all.
            most: pairs, and cells of boxes, for which there is to be memory; of more none is given.
        """
        chosen = self._all if chosen is None else chosen
        if not len(chosen):
            return self._pairs, 0
        while True:
            self._list(
                start, end, self.faces, chosen, margin, self._low, self._high, self._cells, self._heads,
                self._entries, self._pairs, self._counts,
            )  # fmt: skip
            count, entries = self._counts.tolist()
            if max(count, entries) > most:  # asked first: the answer must not depend on what there was room for before
                return self._pairs, 0
            if count <= len(self._pairs) and entries <= len(self._entries):
                return self._pairs, count
            if count > len(self._pairs):
                self._pairs = np.zeros((count * 3 // 2, 2), np.int32)
            if entries > len(self._entries):
                self._entries = np.zeros((entries * 3 // 2, 3), np.int32)

    def fan_crossings(self, position: np.ndarray) -> np.ndarray:
        """The edges that go through faces with which their own face has one vertex in common, see :func:`crossings`.

        Args:
            position: of the vertices [m], float32, shape (n, 4).
        """
        if not self._fans:
            self._fans = *fans(self.faces, self.side_edge, len(position)), np.zeros((len(self.faces), 3), np.float32)
        while True:
            self._find_in_fans(position, self.faces, self.edges, self.owned, *self._fans, self._crossed)
            if (rows := self._found()) is not None:
                return self.unjoined(rows)

    def _found(self) -> np.ndarray | None:
        """The crossings that a kernel found, sorted; None if they were more than there was room for, now there is."""
        found = int(self._crossed[0, 0])
        if found >= len(self._crossed):
            self._crossed = np.zeros((2 * found, 3), np.int32)
            return None
        rows = self._crossed[1 : found + 1].astype(np.int64)
        rows[:, :2].sort(axis=1)
        return rows[np.lexsort(rows.T[::-1])]

    def crossings(self, vertices: np.ndarray, chosen: np.ndarray | None = None) -> np.ndarray:
        """The edges that go through faces, see :func:`crossings`.

        Args:
            vertices: [m], float64, shape (n, 3).
            chosen: numbers of the faces that count, int32; None for all.
        """
        pairs, count = self.pairs(vertices, vertices, chosen=chosen)
        while True:
            self._find(vertices, self.faces, self.edges, self.owned, pairs, count, self._crossed)
            if (rows := self._found()) is not None:
                return self.unjoined(rows)

    def unjoined(self, rows: np.ndarray) -> np.ndarray:
        """Those rows of :meth:`crossings` whose edge and face have no seam in common."""
        if not len(rows) or not len(self.seam):
            return rows
        ends, corners = self.seam[rows[:, :2]], self.seam[self.faces[rows[:, 2]]]
        return rows[(ends[:, :, None] != corners[:, None, :]).all(axis=(1, 2))]

    def crossing_faces(self, rows: np.ndarray) -> np.ndarray:
        """Numbers of the faces that go through another: those crossed, and those beside the crossing edges.

        Args:
            rows: see :meth:`crossings`.
        """
        if not len(rows):
            return np.zeros(0, np.int64)
        keys = np.sort(self.edges, axis=1).astype(np.int64) @ [len(self.edges), 1]
        beside = np.flatnonzero(np.isin(keys, rows[:, :2] @ [len(self.edges), 1])) // 3
        return np.union1d(beside, rows[:, 2])


class SelfCrossings:
    """Finds where the cloth of one mesh goes through itself.

    Faces that are stitched to one another may cross, and so may edges that are shorter than :data:`SHORT` at rest.

    Args:
        mesh: the cloth.
    """

    def __init__(self, mesh: ClothMesh) -> None:
        self._grid, self._count = FaceGrid(mesh.faces), len(mesh.vertices)
        v, a, b = mesh.stitches.T.astype(np.int64)
        self._stitched = np.unique(np.concatenate([self._keys(v, a), self._keys(v, b)]))
        edges, lengths = mesh.edge_lengths()
        self._short = np.sort(self._keys(*edges[lengths < SHORT].T.astype(np.int64)))

    def _keys(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """One number for each pair of vertices, in either order."""
        return np.minimum(one, other) * self._count + np.maximum(one, other)

    def find(self, vertices: np.ndarray) -> np.ndarray:
        """Rows of :func:`crossings` that count; ``vertices``: [m], float64, shape (n, 3)."""
        rows = self._grid.crossings(vertices)
        if len(rows) and len(self._stitched):
            pairs = self._keys(rows[:, :2, None], self._grid.faces[rows[:, 2]][:, None, :].astype(np.int64))
            rows = rows[~np.isin(pairs, self._stitched).any(axis=(1, 2))]
        if len(rows) and len(self._short):
            rows = rows[~np.isin(self._keys(rows[:, 0], rows[:, 1]), self._short)]
        return rows

    def faces_of(self, rows: np.ndarray) -> np.ndarray:
        """Numbers of the faces that go through another, see :meth:`FaceGrid.crossing_faces`."""
        return self._grid.crossing_faces(rows)


def fans(faces: np.ndarray, side_edge: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offsets of the vertices in the faces around them, these faces, and 1 for a vertex that is no plain fan, else 0.

    The faces around a vertex are a plain fan if they hang together by their edges and no edge has more than two.

    Args:
        faces: int, shape (m, 3).
        side_edge: number of the edge of each side, int, shape (m, 3).
        count: of vertices.
    """
    corners = faces.ravel()
    start = np.concatenate([[0], np.cumsum(np.bincount(corners, minlength=count))])
    fan = np.argsort(corners, kind="stable") // 3
    ends = np.zeros((int(side_edge.max(initial=-1)) + 1, 2), np.int64)
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)
    ends[side_edge.ravel()] = sides.reshape(-1, 2)
    uses = np.bincount(side_edge.ravel(), minlength=len(ends))
    rim = np.bincount(ends.ravel(), np.repeat(uses == 1, 2), minlength=count)
    branching = rim > 2  # sides at the rim: a vertex with more than two has several fans
    branching[ends[uses > 2]] = True
    return start.astype(np.int32), fan.astype(np.int32), branching.astype(np.int32)


def seams_of(stitches: np.ndarray, count: int) -> np.ndarray | None:
    """Number of the seam of each vertex, see :class:`FaceGrid`; None where nothing is stitched.

    Args:
        stitches: (v, a, b), int, shape (s, 3).
        count: of vertices.
    """
    if not len(stitches):
        return None
    v, a, b = stitches.T
    links = coo_matrix((np.ones(2 * len(v)), (np.tile(v, 2), np.concatenate([a, b]))), (count, count))
    return connected_components(links, directed=False)[1].astype(np.int32)


def crossings(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Find the edges that go through faces with which they share no vertex.

    Args:
        vertices: [m], shape (n, 3).
        faces: int, shape (m, 3).

    Returns:
        Sorted rows of the two ends of an edge and the face that it goes through, int64, shape (k, 3).

    Raises:
        InputError: vertices that are not finite.
    """
    vertices = np.ascontiguousarray(vertices, float)
    if not np.isfinite(vertices).all():
        raise InputError("vertices are not finite", key="vertices", expected="finite numbers [m]")
    return FaceGrid(faces).crossings(vertices)
