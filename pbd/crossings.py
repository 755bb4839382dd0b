"""Self-intersections of a cloth: which edges go through which faces, and which faces have boxes that overlap.

Tests of crossings are in float64 here. The solver's search for contact has a tree of its own and tests in float32.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from pbd.crossing_search import find_crossings, find_fan_crossings, list_pairs, owned_features
from pbd.engine import ensure_initialized
from pbd.errors import InputError
from pbd.mesh import ClothMesh, edges_of
from pbd.taichi_internals import Launch

__all__ = ["FaceGrid", "SelfCrossings", "crossings", "seams_of"]

SHORT = 2e-4  # edges shorter than this may cross faces: slivers of delivered meshes [m]


class FaceGrid:
    """Finds pairs of faces of one mesh that are near one another, and edges that go through faces.

    Args:
        faces: int, shape (m, 3).
        seam: number of the seam of each vertex, int32, shape (n,); features of one seam may go through one another, and
            vertices of none have numbers of their own. None where nothing is stitched.

    Attributes:
        seam: the same, without rows where nothing is stitched.
        faces, edges: corners of the faces, int32, shape (m, 3), and ends of their sides, int32, shape (3 m, 2).
        owned: see :func:`pbd.crossing_search.owned_features`.
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
