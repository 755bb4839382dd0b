"""Cloth against itself, and one layer against another: pairs of features that may meet in a frame.

A pair is a vertex and a face, or two edges. Pairs are found once a frame, by boxes around patches of faces in a tree
that never changes; patches that hang together and are flat enough cannot touch one another and are left out (Volino
and Magnenat-Thalmann 1994). Each feature belongs to one face, so that no pair is found twice (Curtis, Tamstorf,
Manocha 2008). Within the frame a pair remembers the direction in which its features lie from one another; it is turned
along with them, so that what has gone through is told from what has gone around.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from pbd.blocks import LANES, empty_blocks
from pbd.engine import Launch
from pbd.mesh import edges_of
from pbd.model import Model, State
from pbd.pair_search import find_pairs
from pbd.pairs import PULL
from pbd.strain_limits import LONGEST
from pbd.tangles import Tangles

__all__ = ["SelfCollision"]

FURTHEST = 0.005  # that features of a pair go against each other between two searches [m]
LANDMARKS = 6  # vertices from which ways along the cloth are measured


def _patches(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Faces in patches that hang together along the cloth, these in groups, and a binary tree over the groups.

    Returns:
        order of the faces, offsets of the patches in it and of the groups in those, and the nodes for
        :func:`pbd.pair_search.find_pairs`.
    """
    edges, _ = edges_of(faces)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) + 1e-9
    graph = csr_matrix((lengths, (edges[:, 0], edges[:, 1])), (len(vertices), len(vertices)))
    count, part = connected_components(graph, directed=False)
    # Places are ways along the cloth to landmarks, each as far as can be from those before it.
    nearest = np.full(len(vertices), np.inf)
    places = [part * 1e3]
    for landmark in range(LANDMARKS):
        best = np.zeros(count)
        sources = np.zeros(count, np.int64)
        for piece in range(count):
            members = np.flatnonzero(part == piece)
            sources[piece] = members[0 if landmark == 0 else np.argmax(nearest[members])]
            best[piece] = nearest[sources[piece]]
        way = dijkstra(graph, directed=False, indices=sources, min_only=True)
        nearest = np.minimum(nearest, way)
        places.append(way)
    centres = np.stack(places, axis=1)[faces].mean(axis=1)
    order, starts, group_starts, nodes = [], [0], [0], []

    def halves(members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        spread = np.ptp(centres[members], axis=0)
        by_place = members[np.argsort(centres[members, np.argmax(spread)], kind="stable")]
        return by_place[: len(members) // 2], by_place[len(members) // 2 :]

    def cut(members: np.ndarray) -> None:
        if len(members) > LANES:
            for half in halves(members):
                cut(half)
        else:
            order.append(members)
            starts.append(starts[-1] + len(members))

    def build(members: np.ndarray) -> None:
        node = len(nodes)
        nodes.append([0, 0, -1])
        if len(members) > LANES * LANES:
            for half in halves(members):
                build(half)
        else:
            nodes[node][2] = len(group_starts) - 1
            cut(members)
            group_starts.append(len(starts) - 1)
        nodes[node][:2] = len(nodes), len(group_starts) - 2

    build(np.arange(len(faces)))
    offsets, group_offsets = np.array(starts, np.int32), np.array(group_starts, np.int32)
    return np.concatenate(order), offsets, group_offsets, np.array(nodes, np.int32)


class SelfCollision:
    """The pairs of one model, found anew every frame.

    Args:
        model: the garment, or several layers of garments.
        untangles: whether cloth that is through itself is told and pulled back; it costs time.

    Attributes:
        pairs: (vertex, corners of a face), or (a, -b - 1, c, d) for the edges a-b and c-d, int32, shape (c, 4).
        data: see :func:`pbd.pairs.solve_pairs`, float32, shape (c, 2, 4).
        ready: how many of them there are, how many are ready, and which, int32, shape (c + 2,).
        strain_limits: see :func:`pbd.strain_limits.solve_strain_limits`, float32, shape (e, 4).
    """

    def __init__(self, model: Model, untangles: bool = True) -> None:
        mesh = model.mesh
        count = len(mesh.vertices)
        order, self._patch_start, self._group_start, self._nodes = _patches(mesh.vertices, mesh.faces)
        self._faces = np.ascontiguousarray(mesh.faces[order], np.int32)
        edges, side_edge = edges_of(self._faces)
        self._edges = np.ascontiguousarray(edges[side_edge.ravel()])
        owned = np.zeros(len(order), np.int32)
        for bit, features in ((0, self._faces), (3, side_edge)):
            _, first = np.unique(features.ravel(), return_index=True)
            np.bitwise_or.at(owned, first // 3, 1 << (bit + first % 3))
        self._owned = owned
        # Patches that have a vertex in common; for each of their faces, bits of the other's faces that have one.
        patch = np.repeat(np.arange(len(self._patch_start) - 1), np.diff(self._patch_start))
        corners = np.repeat(np.arange(len(order)), 3), self._faces.ravel()
        used = csr_matrix((np.ones(self._faces.size), corners), (len(order), count))
        one, other = (used @ used.T).nonzero()
        pairs, neighbour = np.unique(patch[one].astype(np.int64) * len(order) + patch[other], return_inverse=True)
        self._neighbours = (pairs % len(order)).astype(np.int32)
        self._neighbour_start = np.searchsorted(pairs // len(order), np.arange(patch[-1] + 2)).astype(np.int32)
        lane = np.arange(len(order)) - self._patch_start[patch]
        self._common = np.zeros((len(pairs), LANES), np.uint8)
        np.bitwise_or.at(self._common, (neighbour, lane[one]), (1 << lane[other]).astype(np.uint8))
        self._rest = np.ascontiguousarray(mesh.vertices - mesh.vertices.mean(axis=0), np.float32)
        self._layer = model.layer
        self._longest = float(np.linalg.norm(np.diff(self._rest[self._edges], axis=1), axis=2).max())
        patches = len(self._patch_start) - 1
        self._course, self._normals = np.zeros((count, 3), np.float32), np.zeros((count, 4), np.float32)
        groups = len(self._group_start) - 1
        self._boxes = np.zeros((2 * len(self._nodes), 3), np.float32)
        self._patch_boxes, self._face_blocks = empty_blocks(groups, False), empty_blocks(patches, True)
        self._near_groups = np.zeros(groups, np.int32)
        self._cones = np.zeros((patches, 4), np.float32)
        self._chain = np.zeros(count, np.int32)
        self._fastest = np.zeros(1, np.float32)
        self._tangles, self._untangles = Tangles(self._faces, self._layer, mesh.vertex_areas), untangles
        self._untold = np.zeros((1, 3), np.int32)
        self._find = Launch(find_pairs)
        ends, lengths = mesh.edge_lengths()
        self.strain_limits = np.zeros((len(ends), 4), np.float32)
        self.strain_limits[:, :2], self.strain_limits[:, 2] = ends, LONGEST * lengths
        self._make_room(2 * count)

    def _make_room(self, count: int) -> None:
        self.pairs = np.zeros((count, 4), np.int32)
        self.data = np.zeros((count, 2, 4), np.float32)
        self.ready = np.zeros(count + 2, np.int32)

    def arrays(self) -> tuple[np.ndarray, ...]:
        """What :func:`pbd.advance.advance_kernel` takes of it."""
        return self.pairs, self.data, self.ready, self.strain_limits

    def find(self, state: State, h: float, steps: int, thickness: float) -> int:
        """Find the pairs that may touch in steps of h [s], at most so many, and say for how many they are good."""
        if len(self._chain) < len(self._layer) + len(state.pairs):
            self._chain = np.zeros(len(self._layer) + 2 * len(state.pairs), np.int32)
        tangles = self._tangles
        tangles.strayed[:] = 0
        self._search(state, steps * h, thickness)
        if not self._untangles:
            return self._good_for(steps)
        free = (state.contact > 2.0 * thickness) | (state.nearest[: len(state.contact)] < 0)
        pulls = tangles.pulls(state.position[:, :3], free)
        if pulls is not None:
            tangles.calm(state.velocity)
            self._search(state, steps * h, thickness)
            self._append(*pulls)
        return self._good_for(steps)

    def _good_for(self, steps: int) -> int:
        return max(1, int(steps * min(1.0, FURTHEST / max(float(self._fastest[0]), 1e-9))))

    def _search(self, state: State, dt: float, thickness: float) -> None:
        while True:
            self._find(
                state.position,
                state.velocity,
                self._course,
                self._normals,
                self._rest,
                self._layer,
                self._tangles.strayed,
                self._faces,
                self._owned,
                self._edges,
                self._patch_start,
                self._group_start,
                self._nodes,
                self._neighbour_start,
                self._neighbours,
                self._common,
                self._boxes,
                self._patch_boxes,
                self._face_blocks,
                self._cones,
                self._near_groups,
                state.pairs,
                state.pair_sides,
                self._chain,
                self.pairs,
                self.data,
                self.ready,
                self._tangles.crossed if self._untangles else self._untold,
                self._fastest,
                dt,
                thickness,
                self._longest,
            )
            if self.ready[0] > len(self.pairs):
                self._make_room(int(self.ready[0]) * 3 // 2)
            elif not self._untangles or self._tangles.has_room():
                return

    def _append(self, pairs: np.ndarray, data: np.ndarray) -> None:
        """Add pairs that were not searched for."""
        old = int(self.ready[0])
        count = old + len(pairs)
        if count > len(self.pairs):
            known = self.pairs[:old], self.data[:old]
            self._make_room(count * 3 // 2)
            self.pairs[:old], self.data[:old] = known
        self.pairs[old:count], self.data[old:count] = pairs, data
        self.ready[0] = count

    def remember(self, state: State) -> None:
        """Keep in the state the pairs that touch at the end of the frame, with their directions."""
        count = self.ready[0]
        data = self.data[:count]
        touching = (data[:, 1, 0] < data[:, 0, 3]) & (data[:, 1, 1] != PULL)
        state.pairs = np.ascontiguousarray(self.pairs[:count][touching])
        state.pair_sides = np.concatenate([self.data[:count, 0, :3], self.data[:count, 1, :1]], axis=1)[touching]
