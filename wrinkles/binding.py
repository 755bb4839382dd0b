"""Fine meshes that come with a garment: each vertex is bound to a point of a coarse mesh's smooth surface.

:mod:`wrinkles.coarsening` makes the coarse mesh. The solver moves it, and the fine mesh follows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from assets.seams import Seams, Sewn, sew
from pbd import ClothMesh
from pbd.bending import hinge_rows
from pbd.mesh import Hinges, edges_of

__all__ = ["Binding"]

SMOOTHING_STEPS = 3  # of the bound surface; each step moves a vertex
SMOOTHING_SHARE = 0.7  # of the distance to the mean of its neighbours
REGULAR_EDGE_RATIO = (0.5, 1.5)  # bound length over pattern length [-]; outside this range bound points crowd or jump
CROWDED_RINGS = 2  # rings of faces around such edges that are smoothed too
COTANGENT_RANGE = (0.05, 5.0)  # of the weights; beyond it slivers would tear the surface or stiffen it
STRAIGHTNESS_WEIGHT = 0.05  # of straight continuation against pattern positions, where the coarse mesh is laid out
MAX_LENGTH_RATIO = 4.0  # a side's length in the layout over its smooth length, or the inverse; beyond it the fit failed
MAX_THINNESS = 0.98  # longest side over the sum of the others; a thinner coarse face takes its smooth sides [-]
MIN_PANEL_VERTICES = 12  # connected fine vertices; fewer do not determine the lengths of coarse edges
MIN_HINGE_AREA = 1e-3  # of a cut face, as a share of the mean area; smaller faces carry no seam hinge


@dataclass(frozen=True)
class _Cells:
    """Cells: groups of fine vertices that lie in one coarse face and that edges of a panel join.

    A coarse face at a seam has several cells, one on each panel.

    Attributes:
        of_vertex: cell of each fine vertex, int, shape (N,).
        face: coarse face of each cell, int, shape (c,).
        pairs: neighbouring cells, which an edge of a panel joins, int, shape (p, 2).
        node: node of the layout at each corner of a cell's face, int, shape (c, 3).
        node_count: number of nodes of the layout.
    """

    of_vertex: np.ndarray
    face: np.ndarray
    pairs: np.ndarray
    node: np.ndarray
    node_count: int


@dataclass(frozen=True)
class Binding:
    """Where each vertex of a delivered fine mesh lies on the smooth surface of a coarse one.

    Attributes:
        face: face of the subdivided coarse mesh that carries each vertex, int32, shape (N,).
        place: barycentric weights of that face's corners, below 0 for vertices beyond the border, shape (N, 3).
        panels: faces of the delivered mesh, int32, shape (M, 3).
        flat: position of each vertex in the pattern [m], shape (N, 2).
        stitches: vertices (v, a, b) of each stitch between the panels, int32, shape (s, 3).
        stitch_weights: w of each stitch in x_v = (1 - w) x_a + w x_b, shape (s,).
    """

    face: np.ndarray
    place: np.ndarray
    panels: np.ndarray
    flat: np.ndarray
    stitches: np.ndarray
    stitch_weights: np.ndarray

    @cached_property
    def sewn(self) -> Sewn:
        """The panels, closed at their seams to one surface."""
        return sew(self.panels, self.flat, Seams(self.stitches, self.stitch_weights))

    @cached_property
    def smoothing(self) -> csr_matrix:
        """Matrix that smooths the bound surface: steps of each vertex to its neighbours' mean, shape (N, N).

        Vertices of the border stay. The coarse mesh has no pleats; where the fine mesh has them, bound points crowd
        and jump, and the surface through them is rough.
        """
        return self.smoothing_where(np.ones(len(self.face), bool))

    def smoothing_where(self, chosen: np.ndarray) -> csr_matrix:
        """The matrix of :attr:`smoothing` that moves only the chosen vertices, shape (N, N).

        Args:
            chosen: bool, shape (N,).
        """
        mean, stays = _mean_of_neighbours(self.sewn, len(self.face))
        share = np.where(chosen & ~stays, SMOOTHING_SHARE, 0.0)
        step = identity(len(stays)) + diags(share) @ (mean - identity(len(stays)))
        made = identity(len(stays), format="csr")
        for _ in range(SMOOTHING_STEPS):
            made = (step @ made).tocsr()
        return made[self.sewn.one]

    def crowded(self, bound: np.ndarray) -> np.ndarray:
        """Vertices whose bound points crowd or jump, and the vertices around them: bool, shape (N,).

        Args:
            bound: the bound points on the surface at rest [m], shape (N, 3).
        """
        faces, flat = self.sewn.faces, self.sewn.flat
        corners = bound[faces]
        length, rest = (np.linalg.norm(np.roll(c, -1, axis=1) - c, axis=2) for c in (corners, flat))
        bad = (length < REGULAR_EDGE_RATIO[0] * rest) | (length > REGULAR_EDGE_RATIO[1] * rest)
        found = np.zeros(len(bound), bool)
        found[faces[bad]] = found[np.roll(faces, -1, axis=1)[bad]] = True
        for _ in range(CROWDED_RINGS):
            found[faces[found[faces].any(axis=1)]] = True
        return found[self.sewn.one]

    def mesh(self, vertices: np.ndarray) -> ClothMesh:
        """The stitched panels at given positions [m], shape (N, 3), with the pattern as their rest shape."""
        made = ClothMesh.from_pattern(vertices, self.panels, _upright(self.flat[self.panels]))
        seams = self._seam_hinges(vertices)
        return replace(made, stitches=self.stitches, stitch_weights=self.stitch_weights, seam_hinges=seams)

    def coarse_lengths(self, coarse: ClothMesh, face: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Rest lengths of the coarse edges that agree with the pattern [m], shape (e,).

        The coarse mesh is laid out in the plane of the pattern. The layout is linear on each coarse face, fits the
        pattern positions of the fine vertices, and continues straight where a face carries few of them. At seams it
        comes apart: faces that no edge of a panel joins have corners of their own. The lengths are measured in this
        layout, because lengths that are fitted one by one fit no flat surface, and cloth whose rest shape is not flat
        buckles by itself.

        Args:
            coarse: the coarse mesh with the rest shape of its smooth surface, which decides where no vertices lie.
            face: coarse face of each fine vertex, int, shape (N,).
            place: barycentric weights in that face, shape (N, 3).
        """
        cells = self._cells(coarse.faces, face)
        squares = self._squared_sides(coarse, cells, place)
        size = np.bincount(cells.of_vertex, minlength=len(cells.face))
        smooth_sides = coarse.side_lengths()
        counted = _is_reliable(cells, size, len(coarse.faces))
        ratio = np.sqrt(squares) / smooth_sides[cells.face]
        counted &= (ratio > 1.0 / MAX_LENGTH_RATIO).all(axis=1) & (ratio < MAX_LENGTH_RATIO).all(axis=1)
        total, weight = np.zeros((2, len(coarse.faces), 3))
        np.add.at(total, cells.face[counted], (size[:, None] * squares)[counted])
        np.add.at(weight, cells.face[counted], size[counted, None])
        empty = weight == 0.0
        total[empty], weight[empty] = smooth_sides[empty] ** 2, 1.0
        side_edge = edges_of(coarse.faces)[1]
        mean = lambda sides: np.bincount(side_edge.ravel(), sides.ravel()) / np.bincount(side_edge.ravel())  # noqa: E731
        return _without_thin_faces(np.sqrt(mean(total / weight)), mean(smooth_sides), side_edge)

    def _cells(self, faces: np.ndarray, face: np.ndarray) -> _Cells:
        """Part the fine vertices into cells; cells that an edge of a panel joins share the corners of both faces."""
        ends = edges_of(self.panels)[0]
        inside = face[ends[:, 0]] == face[ends[:, 1]]
        cell_count, cell = _components(len(face), ends[inside])
        cell_face = np.zeros(cell_count, np.int64)
        cell_face[cell] = face
        pairs = np.unique(np.sort(cell[ends[~inside]], axis=1), axis=0)
        same = faces[cell_face[pairs[:, 0]]][:, :, None] == faces[cell_face[pairs[:, 1]]][:, None, :]
        pair, one, other = np.nonzero(same)
        links = np.stack([3 * pairs[pair, 0] + one, 3 * pairs[pair, 1] + other], axis=1)
        node_count, node = _components(3 * cell_count, links)
        return _Cells(cell, cell_face, pairs, node.reshape(-1, 3), node_count)

    def _squared_sides(self, coarse: ClothMesh, cells: _Cells, place: np.ndarray) -> np.ndarray:
        """Squared side lengths of each cell's coarse face in the layout [m2], shape (c, 3).

        Args:
            coarse, place: as for :meth:`coarse_lengths`.
            cells: of the fine vertices.
        """
        data = _rows(place, cells.node[cells.of_vertex], cells.node_count)
        straight = _rows(*self._hinges_between(coarse, cells.face, cells.pairs, cells.node), cells.node_count)
        left = data.T @ data + STRAIGHTNESS_WEIGHT * (straight.T @ straight) + 1e-8 * identity(cells.node_count)
        corner = splu(left.tocsc()).solve(data.T @ self.flat)[cells.node]
        return ((np.roll(corner, -1, axis=1) - corner) ** 2).sum(axis=2)

    @staticmethod
    def _hinges_between(
        coarse: ClothMesh, cell_face: np.ndarray, pairs: np.ndarray, node: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the coarse hinges between cells, and the nodes of the layout that they act on: shapes (h, 4).

        Args:
            coarse: the coarse mesh.
            cell_face, pairs, node: as in :class:`_Cells`.
        """
        hinges, rows, _, _ = hinge_rows(coarse)
        count = len(coarse.vertices)
        faces = coarse.faces[cell_face]
        # A hinge's edge and the two corners opposite to it identify the two faces that the hinge joins.
        key = lambda corners: (np.sort(corners, axis=1) * np.array([count**2, count, 1], np.int64)).sum(axis=1)  # noqa: E731
        sides = np.stack(
            [key(hinges[:, [0, 1, 2]].astype(np.int64)), key(hinges[:, [0, 1, 3]].astype(np.int64))], axis=1
        )
        of_cell = key(faces.astype(np.int64))
        hinge_of = {tuple(side): number for number, side in enumerate(sides.tolist())}
        found, acting = [], []
        for a, b in pairs.tolist():
            for first, second in ((a, b), (b, a)):
                hinge = hinge_of.get((int(of_cell[first]), int(of_cell[second])))
                if hinge is not None:
                    i, j, k, m = hinges[hinge]
                    at = lambda cell, vertex: node[cell, np.flatnonzero(faces[cell] == vertex)[0]]  # noqa: E731
                    found.append(rows[hinge])
                    acting.append([at(first, i), at(first, j), at(first, k), at(second, m)])
        return np.array(found).reshape(-1, 4), np.array(acting, np.int64).reshape(-1, 4)

    def _seam_hinges(self, vertices: np.ndarray) -> Hinges | None:
        """Hinges between the two faces at a seam; edges where more than two faces meet have none.

        Args:
            vertices: of the delivered mesh [m], shape (N, 3).
        """
        sewn = self.sewn
        side_edge = edges_of(sewn.faces)[1].ravel()
        order = np.argsort(side_edge, kind="stable")
        order = order[np.bincount(side_edge)[side_edge[order]] == 2]
        one, other = order.reshape(-1, 2).T // 3
        # Two parts of one panel face, or two panel faces with a common edge, do not meet at a seam.
        own = sewn.panel_face[one] == sewn.panel_face[other]
        corners = np.sort(self.panels, axis=1)[sewn.panel_face]
        shared = (corners[one][:, :, None] == corners[other][:, None, :]).sum(axis=(1, 2)) == 2
        sides = sewn.flat[:, 1:] - sewn.flat[:, :1]
        area = 0.5 * np.abs(np.linalg.det(sides))
        seam = ~own & ~shared & (np.minimum(area[one], area[other]) > MIN_HINGE_AREA * area.mean())
        if not seam.any():
            return None
        # Each pair of faces becomes a mesh of its own, so that no hinge with another face is made.
        pairs = np.stack([one, other], axis=1)[seam]
        flat = _upright(sewn.flat[pairs].reshape(-1, 3, 2))
        apart = sewn.faces[pairs] + len(vertices) * np.arange(len(pairs))[:, None, None]
        numbers, local = np.unique(apart, return_inverse=True)
        mesh = ClothMesh.from_pattern(vertices[numbers % len(vertices)], local.reshape(-1, 3), flat)
        hinges, rows, areas, angle = hinge_rows(mesh)
        return Hinges((numbers % len(vertices))[hinges].astype(np.int32), rows, areas, angle)


def _is_reliable(cells: _Cells, size: np.ndarray, face_count: int) -> np.ndarray:
    """Cells whose sides in the layout are trusted: bool, shape (c,).

    A few vertices beside their own part of a panel may lie anywhere in the layout.

    Args:
        cells: of the fine vertices.
        size: number of vertices in each cell, int, shape (c,).
        face_count: number of coarse faces.
    """
    panel = _components(len(size), cells.pairs)[1]
    largest = np.zeros(face_count, np.int64)
    np.maximum.at(largest, cells.face, size)
    return (np.bincount(panel, size)[panel] >= MIN_PANEL_VERTICES) & (4 * size >= largest[cells.face])


def _without_thin_faces(lengths: np.ndarray, smooth: np.ndarray, side_edge: np.ndarray) -> np.ndarray:
    """The lengths, with those of the smooth surface for every face that would be too thin [m], shape (e,).

    A replaced edge can make the next face too thin, so the replacement repeats until no face changes.

    Args:
        lengths: of the coarse edges in the layout [m], shape (e,); changed in place.
        smooth: of the same edges on the smooth surface [m], shape (e,).
        side_edge: edge of each side of a face, int, shape (m, 3).
    """
    for _ in range(len(lengths)):
        sides = lengths[side_edge]
        thin = 2.0 * sides.max(axis=1) > MAX_THINNESS * sides.sum(axis=1)
        thin &= ~np.isclose(sides, smooth[side_edge]).all(axis=1)
        if not thin.any():
            break
        lengths[side_edge[thin]] = smooth[side_edge[thin]]
    return lengths


def _components(count: int, links: np.ndarray) -> tuple[int, np.ndarray]:
    """Number of connected components of a graph, and the component of each of its nodes: int, shape (count,).

    Args:
        count: number of nodes.
        links: pairs of connected nodes, int, shape (k, 2).
    """
    return connected_components(csr_matrix((np.ones(len(links)), tuple(links.T)), (count, count)), directed=False)


def _rows(values: np.ndarray, columns: np.ndarray, width: int) -> csr_matrix:
    """A sparse matrix of shape (r, width) with the same number of entries in each row: values, columns (r, k)."""
    index = np.repeat(np.arange(len(values)), values.shape[1])
    return csr_matrix((values.ravel(), (index, columns.ravel())), (len(values), width))


def _upright(flat: np.ndarray) -> np.ndarray:
    """Pattern coordinates in the order (warp, weft): the second axis of a pattern is the warp."""
    return flat[..., ::-1].copy()


def _mean_of_neighbours(sewn: Sewn, count: int) -> tuple[csr_matrix, np.ndarray]:
    """Matrix of the weighted mean of each vertex's neighbours, and the vertices that smoothing must not move.

    The weights are the cotangents of the harmonic map (Pinkall and Polthier 1993, "Computing discrete minimal surfaces
    and their conjugates") in the pattern, none below 0. Vertices without a face and those of the border stay.

    Args:
        sewn: the closed surface.
        count: number of vertices n.

    Returns:
        a matrix of shape (n, n) and bool, shape (n,).
    """
    rows, columns, values = [], [], []
    for k in range(3):
        one, other, apex = (sewn.flat[:, (k + turn) % 3] for turn in range(3))
        u, v = one - apex, other - apex
        twice_area = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        cotangent = np.clip((u * v).sum(axis=1) / np.maximum(twice_area, 1e-12), *COTANGENT_RANGE)
        ends = sewn.faces[:, [k, (k + 1) % 3]]
        rows += [ends[:, 0], ends[:, 1]]
        columns += [ends[:, 1], ends[:, 0]]
        values += [cotangent, cotangent]
    weights = csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (count, count))
    total = np.asarray(weights.sum(axis=1)).ravel()
    stays = total == 0.0
    edges, side_edge = edges_of(sewn.faces)
    stays[edges[np.bincount(side_edge.ravel()) == 1]] = True
    return diags(1.0 / np.where(total == 0.0, 1.0, total)) @ weights, stays
