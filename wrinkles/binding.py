"""Delivered fine meshes: each vertex is bound to a point of the smooth surface of a coarse mesh made by decimation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import splu

from assets.remesh import decimated
from assets.seams import Seams, Sewn, sew, without_pleats
from pbd import ClothMesh
from pbd.attachment import closest_weights
from pbd.bending import hinge_rows
from pbd.mesh import Hinges, edges_of
from wrinkles.surface import Subdivision

__all__ = ["Binding", "bind", "faces_around", "label_of", "nearest_places"]

ROUNDS = 4  # of binding and fitting
SMOOTH_STEPS = 3  # of smoothing the bound surface,
SMOOTH_SHARE = 0.7  # each so much of the way to the mean of the neighbours
CROWDED = (0.5, 1.5)  # lengths on the bound surface, as shares of the pattern's, beyond which places crowd or jump
CROWDED_RINGS = 2  # of faces around them
COTANGENTS = (0.05, 5.0)  # bounds of their weights, so that slivers neither tear nor tie
PLACE_STEP = 2.0**-12  # places are rounded to this share of a face, some micrometres, so that a file holds them exactly
FLAT_STEP = 2.0**-18  # and the pattern to this [m]
STRAIGHT = 0.05  # weight of straightness against the places of vertices where the coarse mesh is laid out
MOST = 4.0  # the pattern is never so many times as long as the smooth surface
THIN = 0.98  # longest side over the sum of the others, from which a coarse face keeps the smooth surface's sides
STRAY = 12  # fewer vertices that no edge of a panel joins to others tell nothing of lengths
SLIVER = 1e-3  # cut faces below this share of the mean area carry no hinge
BEYOND = 1.0  # how far outside its border a face still carries vertices, as a share of itself


@dataclass(frozen=True)
class Binding:
    """Vertices of a delivered fine mesh on the smooth surface of a coarse one.

    Attributes:
        face: face of the subdivided coarse mesh that carries each vertex, int32, shape (N,).
        place: weights of that face's corners, below 0 for vertices beyond the border, shape (N, 3).
        panels: faces of the delivered mesh, int32, shape (M, 3).
        flat: place of each vertex in the pattern [m], shape (N, 2).
        stitches: between the panels, (v, a, b) of each, int32, shape (s, 3).
        stitch_weights: x_v = (1 - w) x_a + w x_b, shape (s,).
    """

    face: np.ndarray
    place: np.ndarray
    panels: np.ndarray
    flat: np.ndarray
    stitches: np.ndarray
    stitch_weights: np.ndarray

    @cached_property
    def sewn(self) -> Sewn:
        """The panels closed to one surface."""
        return sew(self.panels, self.flat, Seams(self.stitches, self.stitch_weights))

    @cached_property
    def smoothing(self) -> csr_matrix:
        """Some steps of each vertex towards the mean of its neighbours, those of the border stay: shape (N, N).

        In pleats that the coarse mesh does not have, places crowd and jump, and the surface that they make is rough.
        """
        return self.smoothing_where(np.ones(len(self.face), bool))

    def smoothing_where(self, chosen: np.ndarray) -> csr_matrix:
        """The same steps for some vertices alone, bool, shape (N,): shape (N, N)."""
        mean, stays = _mean_of_neighbours(self.sewn, len(self.face))
        share = np.where(chosen & ~stays, SMOOTH_SHARE, 0.0)
        step = identity(len(stays)) + diags(share) @ (mean - identity(len(stays)))
        made = identity(len(stays), format="csr")
        for _ in range(SMOOTH_STEPS):
            made = (step @ made).tocsr()
        return made[self.sewn.one]

    def crowded(self, bound: np.ndarray) -> np.ndarray:
        """Vertices whose places crowd or jump, and those around them: bool, shape (N,).

        Args:
            bound: where their places lie on the surface at rest [m], shape (N, 3).
        """
        faces, flat = self.sewn.faces, self.sewn.flat
        corners = bound[faces]
        length, rest = (np.linalg.norm(np.roll(c, -1, axis=1) - c, axis=2) for c in (corners, flat))
        bad = (length < CROWDED[0] * rest) | (length > CROWDED[1] * rest)
        found = np.zeros(len(bound), bool)
        found[faces[bad]] = found[np.roll(faces, -1, axis=1)[bad]] = True
        for _ in range(CROWDED_RINGS):
            found[faces[found[faces].any(axis=1)]] = True
        return found[self.sewn.one]

    def mesh(self, vertices: np.ndarray) -> ClothMesh:
        """The panels, stitched, with the pattern as their rest shape, at given places [m], shape (N, 3)."""
        made = ClothMesh.from_pattern(vertices, self.panels, _upright(self.flat[self.panels]))
        seams = self._seam_hinges(vertices)
        return replace(made, stitches=self.stitches, stitch_weights=self.stitch_weights, seam_hinges=seams)

    def coarse_lengths(self, coarse: ClothMesh, face: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Rest lengths of the coarse edges that agree with the pattern [m], shape (e,).

        The coarse mesh is laid out in the plane of the pattern: places of its vertices, linear on each face, that fit
        those of the fine vertices, and go on straight where there are few. At seams it comes apart: what no edge of a
        panel joins has vertices of its own. Lengths that are fitted one by one make no flat surface, and what is not
        flat buckles by itself.

        Args:
            coarse: the coarse mesh with the rest shape of its smooth surface, for what carries no vertices.
            face, place: coarse face and weights of each fine vertex, shapes (N,), (N, 3).
        """
        faces, count = coarse.faces, len(face)
        ends = edges_of(self.panels)[0]
        inside = face[ends[:, 0]] == face[ends[:, 1]]
        cell_count, cell = _components(count, ends[inside])  # what lies together in one coarse face
        cell_face = np.zeros(cell_count, np.int64)
        cell_face[cell] = face
        pairs = np.unique(np.sort(cell[ends[~inside]], axis=1), axis=0)
        same = faces[cell_face[pairs[:, 0]]][:, :, None] == faces[cell_face[pairs[:, 1]]][:, None, :]
        pair, one, other = np.nonzero(same)
        links = np.stack([3 * pairs[pair, 0] + one, 3 * pairs[pair, 1] + other], axis=1)
        node_count, node = _components(3 * cell_count, links)
        node = node.reshape(-1, 3)
        data = _rows(place, node[cell], node_count)
        straight = _rows(*self._hinges_between(coarse, cell_face, pairs, node), node_count)
        left = data.T @ data + STRAIGHT * (straight.T @ straight) + 1e-8 * identity(node_count)
        laid = splu(left.tocsc()).solve(data.T @ self.flat)
        corner = laid[node]
        squares = ((np.roll(corner, -1, axis=1) - corner) ** 2).sum(axis=2)
        # A few vertices beside their own part of a panel lie anywhere.
        share = np.bincount(cell, minlength=cell_count)
        together = _components(cell_count, pairs)[1]
        most = np.zeros(len(faces), np.int64)
        np.maximum.at(most, cell_face, share)
        counted = (np.bincount(together, share)[together] >= STRAY) & (4 * share >= most[cell_face])
        own = coarse.side_lengths()
        ratio = np.sqrt(squares) / own[cell_face]
        counted &= (ratio > 1.0 / MOST).all(axis=1) & (ratio < MOST).all(axis=1)
        total, weight = np.zeros((2, len(faces), 3))
        np.add.at(total, cell_face[counted], (share[:, None] * squares)[counted])
        np.add.at(weight, cell_face[counted], share[counted, None])
        empty = weight == 0.0
        total[empty], weight[empty] = own[empty] ** 2, 1.0
        edges, side_edge = edges_of(faces)
        mean = lambda sides: np.bincount(side_edge.ravel(), sides.ravel()) / np.bincount(side_edge.ravel())  # noqa: E731
        lengths, smooth = np.sqrt(mean(total / weight)), mean(own)
        for _ in range(len(edges)):
            sides = lengths[side_edge]
            thin = 2.0 * sides.max(axis=1) > THIN * sides.sum(axis=1)
            thin &= ~np.isclose(sides, smooth[side_edge]).all(axis=1)
            if not thin.any():
                break
            lengths[side_edge[thin]] = smooth[side_edge[thin]]
        return lengths

    @staticmethod
    def _hinges_between(
        coarse: ClothMesh, cell_face: np.ndarray, pairs: np.ndarray, node: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the coarse hinges between cells, and the nodes that they act on: shapes (h, 4)."""
        hinges, rows, _, _ = hinge_rows(coarse)
        count = len(coarse.vertices)
        faces = coarse.faces[cell_face]
        # Its edge and each of the corners that face it tell which two faces a hinge joins.
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
        """Hinges between the faces on both sides of a seam, but where more than two meet."""
        sewn = self.sewn
        side_edge = edges_of(sewn.faces)[1].ravel()
        order = np.argsort(side_edge, kind="stable")
        order = order[np.bincount(side_edge)[side_edge[order]] == 2]
        one, other = order.reshape(-1, 2).T // 3
        # What a panel's own face or edge has between its two sides is no seam.
        own = sewn.panel_face[one] == sewn.panel_face[other]
        corners = np.sort(self.panels, axis=1)[sewn.panel_face]
        shared = (corners[one][:, :, None] == corners[other][:, None, :]).sum(axis=(1, 2)) == 2
        sides = sewn.flat[:, 1:] - sewn.flat[:, :1]
        area = 0.5 * np.abs(np.linalg.det(sides))
        seam = ~own & ~shared & (np.minimum(area[one], area[other]) > SLIVER * area.mean())
        if not seam.any():
            return None
        # Each hinge from two faces of its own, so that what meets elsewhere does not matter.
        pairs = np.stack([one, other], axis=1)[seam]
        flat = _upright(sewn.flat[pairs].reshape(-1, 3, 2))
        apart = sewn.faces[pairs] + len(vertices) * np.arange(len(pairs))[:, None, None]
        numbers, local = np.unique(apart, return_inverse=True)
        mesh = ClothMesh.from_pattern(vertices[numbers % len(vertices)], local.reshape(-1, 3), flat)
        hinges, rows, areas, angle = hinge_rows(mesh)
        return Hinges((numbers % len(vertices))[hinges].astype(np.int32), rows, areas, angle)


def _components(count: int, links: np.ndarray) -> tuple[int, np.ndarray]:
    """Number of connected components, and that of each of ``count`` things: int, shape (count,)."""
    return connected_components(csr_matrix((np.ones(len(links)), tuple(links.T)), (count, count)), directed=False)


def _rows(values: np.ndarray, columns: np.ndarray, width: int) -> csr_matrix:
    """A sparse matrix from the same number of entries in each row, both shape (r, k)."""
    index = np.repeat(np.arange(len(values)), values.shape[1])
    return csr_matrix((values.ravel(), (index, columns.ravel())), (len(values), width))


def _upright(flat: np.ndarray) -> np.ndarray:
    """A pattern is laid out upright: its second axis is the warp."""
    return flat[..., ::-1].copy()


def bind(
    vertices: np.ndarray, faces: np.ndarray, flat: np.ndarray, seams: Seams | None, count: int, levels: int
) -> tuple[np.ndarray, Subdivision]:
    """Coarse mesh of a fine one, and the subdivision between them.

    The panels are closed at their seams and decimated. Then each fine vertex takes the nearest point of the coarse
    mesh's smooth surface, near its place along the cloth, and coarse vertices take the places whose smooth surface fits
    best, in turn. Beyond the border a vertex goes on in the plane of the last face.

    Args:
        vertices: of the fine mesh [m], shape (N, 3).
        faces: int, shape (M, 3).
        flat: place of each vertex in the pattern [m], shape (N, 2).
        seams: stitches between the panels, None without any.
        count: coarse vertices to start from, see :func:`assets.remesh.decimated`.
        levels: times that each coarse face is cut in four.

    Returns:
        coarse vertices [m], shape (n, 3), and the subdivision.
    """
    flat = np.round(flat / FLAT_STEP) * FLAT_STEP
    seams = seams or Seams(np.zeros((0, 3), np.int32), np.zeros(0))
    sewn = sew(faces, flat, seams)
    whole, shrunk = without_pleats(sewn.faces)
    stands = shrunk[sewn.one]
    used, whole = np.unique(whole, return_inverse=True)
    whole = whole.reshape(-1, 3).astype(np.int32)
    number = np.searchsorted(used, stands)  # of each fine vertex in the closed surface
    chosen, coarse_faces = decimated(vertices[used], whole, count)
    plain = Subdivision.of(coarse_faces, len(chosen), levels)
    near = faces_around(coarse_faces, label_of(vertices[used], whole, chosen)[number])
    coarse = vertices[used][chosen]
    for _ in range(ROUNDS):
        face, place = nearest_places(plain, plain.upsample(coarse), coarse, vertices, near)
        near = faces_around(coarse_faces, coarse_faces[face // 4**levels])
        binding = Binding(face, place, faces, flat, seams.vertices, seams.weights)
        bound = Subdivision.of(coarse_faces, len(chosen), levels, binding)
        # A little weight on staying, for coarse vertices that carry next to nothing.
        left = bound.matrix.T @ bound.matrix + 0.02 * identity(len(coarse))
        coarse = splu(left.tocsc()).solve(bound.matrix.T @ vertices + 0.02 * coarse)
    return coarse, bound


def _mean_of_neighbours(sewn: Sewn, count: int) -> tuple[csr_matrix, np.ndarray]:
    """Mean of each vertex's neighbours, weighted as the pattern lies, and which vertices have no mean to go to.

    The weights are those of the harmonic map (Pinkall and Polthier 1993), none below 0. What stands for no vertex and
    what lies on the border stays.

    Returns:
        a matrix of shape (n, n) and bool, shape (n,).
    """
    rows, columns, values = [], [], []
    for k in range(3):
        one, other, apex = (sewn.flat[:, (k + turn) % 3] for turn in range(3))
        u, v = one - apex, other - apex
        twice_area = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        cotangent = np.clip((u * v).sum(axis=1) / np.maximum(twice_area, 1e-12), *COTANGENTS)
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


def label_of(vertices: np.ndarray, faces: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The chosen vertex that is nearest along the mesh to each vertex, as a number in the choice: int, shape (n,)."""
    edges = edges_of(faces)[0]
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    graph = csr_matrix((lengths, tuple(edges.T)), (len(vertices),) * 2)
    _, _, source = dijkstra(graph, directed=False, indices=chosen, min_only=True, return_predecessors=True)
    order = np.argsort(chosen)
    return order[np.searchsorted(chosen[order], source)]


def faces_around(faces: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Faces around some vertices in each row, filled up with the first: int, shape (p, k).

    Args:
        faces: int, shape (m, 3).
        corners: vertices, int, shape (p,) or (p, c).
    """
    count = faces.max() + 1
    at = csr_matrix((np.ones(faces.size), (faces.ravel(), np.repeat(np.arange(len(faces)), 3))), (count, len(faces)))
    corners = corners.reshape(len(corners), -1)
    rows = np.repeat(np.arange(len(corners)), corners.shape[1])
    found = (csr_matrix((np.ones(rows.size), (rows, corners.ravel())), (len(corners), count)) @ at).tocsr()
    found.sort_indices()
    sizes = np.diff(found.indptr)
    slot = np.arange(sizes.max())
    return found.indices[found.indptr[:-1, None] + np.where(slot < sizes[:, None], slot, 0)]


def nearest_places(
    plain: Subdivision, smooth: np.ndarray, coarse: np.ndarray, points: np.ndarray, near: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest points of a smooth surface: face of it, int32, shape (p,), and weights of its corners, shape (p, 3).

    Args:
        plain: of the coarse mesh.
        smooth: its vertices [m], shape (q, 3).
        coarse: coarse vertices [m], shape (n, 3).
        points: [m], shape (p, 3).
        near: coarse faces to look at, shape (p, k).
    """
    rows = np.arange(len(points))[:, None]
    cut = 4 ** len(plain.steps)
    away = _distance(points[:, None], coarse[plain.coarse_faces[near]])[0]
    best = near[rows, np.argsort(away, axis=1, kind="stable")[:, :4]]
    candidates = (cut * best[:, :, None] + np.arange(cut)).reshape(len(points), -1)
    away, weights = _distance(points[:, None], smooth[plain.faces[candidates]])
    first = away.argmin(axis=1)[:, None]
    face, weights = candidates[rows, first][:, 0], weights[rows, first][:, 0]
    # On the border the nearest point is a foot on it: the vertex keeps its own distance in the face's plane instead.
    edges, side_edge = edges_of(plain.faces)
    rim = (np.bincount(side_edge.ravel(), minlength=len(edges)) == 1)[side_edge]
    opposite = np.roll(weights, 1, axis=1) < 1e-9  # of side s the corner s - 1 has no weight
    beyond = (rim[face] & opposite).any(axis=1)
    weights[beyond] = _in_plane(points[beyond], smooth[plain.faces[face[beyond]]])
    weights = np.clip(weights, -BEYOND, 1.0 + BEYOND)
    place = np.round(weights[:, 1:] / PLACE_STEP) * PLACE_STEP
    return face.astype(np.int32), np.concatenate([1.0 - place.sum(axis=1, keepdims=True), place], axis=1)


def _distance(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    weights = closest_weights(points, corners[..., 0, :], corners[..., 1, :], corners[..., 2, :])
    return np.linalg.norm(np.einsum("pkc,pkci->pki", weights, corners) - points, axis=2), weights


def _in_plane(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric weights of points laid into the planes of triangles, shape (p, 3)."""
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    inner = np.einsum("pai,pi->pa", np.linalg.pinv(sides), points - corners[:, 0])
    return np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
