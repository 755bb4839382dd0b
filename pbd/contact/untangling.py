"""Cloth that is through itself: which edges go through faces, which vertices are on the wrong side, how they come back.

Layers know their sides. Within a garment, two sheets that go through one another meet in a curve. The edges that go
through faces along that curve cut each sheet in two (after the flood fill of Baraff, Witkin and Kass 2003, "Untangling
cloth"). A curve that ends before a border is closed by the least cut::

    above |  upper part: kept
    ------+------------------ the other sheet
    below |  lower part, smaller: on the wrong side

The smallest part is on the wrong side, and of the other sheet the part to which it points. Contact counts a vertex on
the wrong side as if it were on the other side of the feature that it touches. Ends of edges that are on the wrong side
are pulled back through the face, no faster than a body pushes, and velocities against one another are damped there.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from pbd.contact.pairs import PULL
from pbd.contact.sheet_cuts import NEAR, CutCurve, SheetCuts
from pbd.mesh import edges_of

__all__ = ["Untangling"]

PULL_BEYOND = 1e-4  # an end of an edge on the wrong side is pulled so far beyond the plane of the face [m]
MAX_CURVES = 4  # along which sheets are brought back at once
# Edges that may still join both sides of a curve: a share of the edges that it goes through, or at least some.
MAX_JOINING_SHARE, MIN_JOINING = 0.5, 4
MIN_CLOSED_EDGES = 8  # a curve through fewer edges is not closed by a cut, except near its ends
KEPT_MOTION = 0.3  # share of their relative velocity that vertices on the wrong side keep at a search [-]
MIN_CROSSINGS = 256  # that the buffer takes at first


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


class _Crossings:
    """Edges that go through faces.

    Args:
        rows: (end, end, face), shape (k, 3).
        edge: number of the edge of each row, shape (k,).
        faces: shape (m, 3).
        position: [m], shape (n, 3).

    Attributes:
        ends: shape (k, 2); edge: number of the edge, face: shape (k,); points: where they go through [m], shape (k, 3).
        heights: of the ends over the face, times twice its area [m3], shape (k, 2).
        along: cosine between the edge and the vector from the crossing to each corner of the face, shape (k, 3).
    """

    def __init__(self, rows: np.ndarray, edge: np.ndarray, faces: np.ndarray, position: np.ndarray) -> None:
        self.edge = edge
        self.ends, self.face, self._corners = rows[:, :2], rows[:, 2], faces[rows[:, 2]]
        corners, tips = position[self._corners].astype(float), position[self.ends].astype(float)
        self._normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.heights = np.einsum("kei,ki->ke", tips - corners[:, :1], self._normals)
        share = np.abs(self.heights) / np.maximum(np.abs(self.heights).sum(axis=1, keepdims=True), 1e-30)
        self.points = np.einsum("ke,kei->ki", share[:, ::-1], tips)
        vectors = _unit(corners - self.points[:, None])
        self.along = np.einsum("kci,ki->kc", vectors, _unit(tips[:, 1] - tips[:, 0]))

    def pulls(self, wrong_side: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pairs that pull ends on the wrong side back, and their data for :func:`pbd.contact.pairs.solve_pairs`."""
        lost = wrong_side[self.ends] > 0
        one = np.flatnonzero(lost[:, 0] != lost[:, 1])
        where = lost[one].argmax(axis=1)
        vertex = self.ends[one, where]
        # One pull a vertex, where it is nearest: each would add its speed.
        order = np.lexsort((np.linalg.norm(position[vertex] - self.points[one], axis=1), vertex))
        order = order[np.unique(vertex[order], return_index=True)[1]]
        one, where, vertex = one[order], where[order], vertex[order]
        through, point, normal = self._corners[one], self.points[one], self._normals[one]
        a, b, c = (position[through[:, k]].astype(float) - point for k in range(3))
        size = np.maximum((normal * normal).sum(axis=1), 1e-30)
        data = np.zeros((len(one), 2, 4), np.float32)
        for k, (p, q) in enumerate(((b, c), (c, a), (a, b))):
            data[:, 0, k] = (np.cross(p, q) * normal).sum(axis=1) / size
        data[:, 0, 3] = PULL_BEYOND
        data[:, 1, 1:3] = PULL, 1.0
        data[:, 1, 3] = -np.sign(self.heights[one, where])
        return np.column_stack([vertex, through]).astype(np.int32), data


class Untangling:
    """The crossings of one cloth, its vertices on the wrong side, and the pairs that bring them back.

    Args:
        faces: int32, shape (m, 3).
        layer: of each vertex, int32, shape (n,).
        areas: of each vertex [m2], shape (n,).

    Attributes:
        crossed: how many edges go through faces, then as many rows (end, end, face), int32, shape (k, 3).
        wrong_side: 1 for vertices that are on the wrong side of their own garment, int32, shape (n,).
    """

    def __init__(self, faces: np.ndarray, layer: np.ndarray, areas: np.ndarray) -> None:
        self._faces, self._layer, self._areas = faces, layer, areas
        edges, side_edge = edges_of(faces)
        self._edges = edges.astype(np.int64)
        order = np.argsort(side_edge.ravel(), kind="stable")
        starts = np.searchsorted(side_edge.ravel()[order], np.arange(len(edges) + 1))
        # The first and the last face of an edge; the same where it has one.
        self._beside = np.stack([order[starts[:-1]], order[starts[1:] - 1]], axis=1) // 3
        self._keys = self._edges @ [len(layer), 1]
        count = len(layer)
        graph = coo_matrix((np.ones(len(edges)), edges.T), (count, count))
        self._pieces = connected_components(graph, directed=False)[1]
        self._cuts = SheetCuts(edges, count)
        self.crossed = np.zeros((MIN_CROSSINGS, 3), np.int32)
        self.wrong_side = np.zeros(len(layer), np.int32)

    def has_room(self) -> bool:
        """Whether the buffer took all crossings; if not, it is larger now."""
        count = int(self.crossed[0, 0])
        if count < len(self.crossed):
            return True
        self.crossed = np.zeros((2 * count, 3), np.int32)
        return False

    def rows(self) -> np.ndarray:
        """The edges that go through faces: their ends, and the face, int64, shape (k, 3)."""
        return self.crossed[1 : int(self.crossed[0, 0]) + 1].astype(np.int64)

    def around(self, rows: np.ndarray, times: int = 1) -> np.ndarray:
        """Vertices a few edges from crossings at most, as a mask.

        Args:
            rows: of :meth:`rows`.
            times: as many times those few edges.
        """
        near = self.spread(np.concatenate([rows[:, :2].ravel(), self._faces[rows[:, 2]].ravel()]))
        for _ in range(times - 1):
            near = self.spread(np.flatnonzero(near))
        return near

    def spread(self, vertices: np.ndarray) -> np.ndarray:
        """Vertices a few edges from some at most (their numbers), as a mask."""
        return self._cuts.around(vertices, np.ones(len(self.wrong_side), bool))

    def pulls(self, position: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Mark the vertices on the wrong side, and find the pairs that bring them back; None if there are none.

        Args:
            position: [m], shape (n, 3).
            free: which vertices no body touches, shape (n,): cloth that limbs pinch has no right side.

        Returns:
            Pairs and their data as :func:`pbd.contact.pairs.solve_pairs` takes them.
        """
        rows = self.rows()
        rows = rows[self._layer[rows[:, 0]] == self._layer[self._faces[rows[:, 2], 0]]]  # layers know their sides
        rows = rows[free[rows[:, :2]].any(axis=1) & free[self._faces[rows[:, 2]]].any(axis=1)]
        if not len(rows):
            return None
        rows = rows[np.lexsort(rows.T[::-1])]
        edge = np.searchsorted(self._keys, np.sort(rows[:, :2], axis=1) @ [len(self._layer), 1])
        found = _Crossings(rows, edge, self._faces, position)
        for first, second in self._contours(found):
            self._mark(found, first, second)
        self.wrong_side[~free] = 0
        return found.pulls(self.wrong_side, position) if self.wrong_side.any() else None

    def damp_relative_velocity(self, velocity: np.ndarray) -> np.ndarray:
        """Damp the relative velocity [m/s] of the vertices on the wrong side and around them, in place.

        Args:
            velocity: of all vertices, shape (n, 3). The mean over those vertices stays.

        Returns:
            1 for those vertices, int32, shape (n,).
        """
        near = self._cuts.around(np.flatnonzero(self.wrong_side), np.ones(len(self.wrong_side), bool))
        if near.any():
            weight = self._areas[near, None]
            mean = (weight * velocity[near]).sum(axis=0) / weight.sum()
            velocity[near] = mean + KEPT_MOTION * (velocity[near] - mean)
        return near.astype(np.int32)

    def _contours(self, found: _Crossings) -> list[tuple[np.ndarray, np.ndarray]]:
        """Crossings along each curve in which two sheets meet: whose edges are of the first and of the second sheet."""
        count = len(found.face)
        # A crossing is an end of the segments in which its face meets those beside its edge. Everything is there
        # twice: with the edge in the first sheet, and in the second.
        beside, face = self._beside[found.edge].ravel(), np.repeat(found.face, 2)
        lower, upper = np.minimum(beside, face), np.maximum(beside, face)
        _, segment = np.unique(lower * len(self._faces) + upper, return_inverse=True)
        turned = (beside > face).astype(np.int64)
        crossing = np.repeat(np.arange(count), 2)
        one = np.concatenate([2 * crossing, 2 * crossing + 1])
        other = 2 * count + np.concatenate([2 * segment + turned, 2 * segment + 1 - turned])
        nodes = 2 * count + 2 * int(segment.max() + 1)
        part = connected_components(coo_matrix((np.ones(len(one)), (one, other)), (nodes, nodes)), directed=False)[1]
        part = part[: 2 * count].reshape(count, 2)
        curves = np.minimum(part[:, 0], part[:, 1])
        names, sizes = np.unique(curves, return_counts=True)
        chosen = names[np.argsort(-sizes, kind="stable")][:MAX_CURVES]
        return [(np.flatnonzero(part[:, 0] == name), np.flatnonzero(part[:, 1] == name)) for name in chosen]

    def _mark(self, found: _Crossings, first: np.ndarray, second: np.ndarray) -> None:
        """Mark the vertices on the wrong side along one curve.

        Of the sheet with the smallest part, that part; of the other, that to which it points, unless by far the larger.
        """
        halves = [self._halves(found, which) for which in (first, second)]
        known = [(area, sheet, side) for sheet in (0, 1) for side, (_, area) in enumerate(halves[sheet])]
        if not known:
            return
        _, sheet, side = min(known)
        part = halves[sheet][side][0]
        self._add(part, found.ends[(first, second)[sheet]])
        if halves[1 - sheet]:
            ends, which = found.ends[(first, second)[sheet]], (first, second)[sheet]
            sign = np.where(part[ends[:, 1]], 1.0, -1.0)[:, None]
            corners, along = self._faces[found.face[which]], sign * found.along[which]
            ahead = [
                area * np.exp(-2.0 * along[half[corners]].mean()) if half[corners].any() else np.inf
                for half, area in halves[1 - sheet]
            ]
            self._add(halves[1 - sheet][int(np.argmin(ahead))][0], found.ends[(second, first)[sheet]])

    def _halves(self, found: _Crossings, which: np.ndarray) -> list[tuple[np.ndarray, float]]:
        """The two parts of a sheet that its crossings cut apart, as masks with their areas [m2]; none if they do not.

        A curve that ends near a border need not go through the last edges: it cuts the cloth if few edges are left.
        """
        if not len(which):
            return []
        ends, heights = found.ends[which], found.heights[which]
        rows = np.arange(len(ends))
        above, below = ends[rows, heights.argmax(axis=1)], ends[rows, heights.argmin(axis=1)]
        curve = CutCurve(*(part.astype(np.int32) for part in (found.edge[which], above, below)))
        nearby = len(which) < MIN_CLOSED_EDGES  # only a corner can be cut off, which lies near
        upper = self._cuts.upper(curve, max(MAX_JOINING_SHARE * len(which), MIN_JOINING), nearby)
        if upper is None:
            return []
        lower = ~upper & (self._pieces == self._pieces[np.setdiff1d(below, above)[0]])
        if nearby and self._cuts.closed:
            lower &= (self._cuts.marks & NEAR) > 0
        return [(half, float(self._areas[half].sum())) for half in (upper, lower)]

    def _add(self, part: np.ndarray, ends: np.ndarray) -> None:
        """Mark the vertices of a part that are a few edges from ends of crossing edges."""
        self.wrong_side[self._cuts.around(ends, part)] = 1
