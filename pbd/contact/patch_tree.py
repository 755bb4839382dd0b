"""The tree of patches of faces over which cloth is searched for itself: made once for a garment, it never changes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from pbd.contact.blocks import LANES, empty_blocks
from pbd.crossing_search import owned_features
from pbd.mesh import ClothMesh, edges_of

__all__ = ["joined_groups", "search_memory", "search_tree"]

LANDMARKS = 6  # vertices from which distances along the cloth are measured


def _landmark_distances(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distances along the edges to landmarks, in a column each, after the number of the piece [km]: shape (n, 7)."""
    edges, _ = edges_of(faces)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) + 1e-9
    graph = csr_matrix((lengths, (edges[:, 0], edges[:, 1])), (len(vertices), len(vertices)))
    count, part = connected_components(graph, directed=False)
    # Each landmark is as far as possible from those before it.
    nearest = np.full(len(vertices), np.inf)
    coordinates = [part * 1e3]
    for landmark in range(LANDMARKS):
        sources = np.zeros(count, np.int64)
        for piece in range(count):
            members = np.flatnonzero(part == piece)
            sources[piece] = members[0 if landmark == 0 else np.argmax(nearest[members])]
        distance = dijkstra(graph, directed=False, indices=sources, min_only=True)
        nearest = np.minimum(nearest, distance)
        coordinates.append(distance)
    return np.stack(coordinates, axis=1)


def _patches(
    landmarks: np.ndarray, faces: np.ndarray, layer: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Faces in patches that hang together along the cloth, these in groups, and a binary tree over the groups.

    The tree parts the layers first.

    Args:
        landmarks: see :func:`_landmark_distances`.
        faces: shape (m, 3).
        layer: of each face, shape (m,).

    Returns:
        order of the faces, offsets of the patches in it and of the groups in those, and the nodes for
        :func:`pbd.contact.pair_search.find_pairs`.
    """
    centres = landmarks[faces].mean(axis=1)
    order, starts, group_starts, nodes = [], [0], [0], []

    def halves(members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        first, last = layer[members].min(), layer[members].max()
        if first < last:
            outer = 2 * layer[members] > first + last
            return members[~outer], members[outer]
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
        node, first, last = len(nodes), layer[members].min(), layer[members].max()
        nodes.append([0, 0, -1, first if first == last else -1])
        if first < last or len(members) > LANES * LANES:
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


def _in_one_piece(
    faces: np.ndarray, side_edge: np.ndarray, part: np.ndarray, beside: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Whether the faces of each part hang together by their edges, and no edge of theirs has more than two: bool.

    Where sheets branch, the one faces the way of the other and touches it: a pocket that is sewn to cloth.

    Args:
        faces: shape (m, 3); ``side_edge``: number of the edge of each side, shape (m, 3).
        part: of each face, ascending, shape (m,).
        beside: pairs of faces with a common edge.
    """
    within = part[beside[0]] == part[beside[1]]
    graph = csr_matrix((np.ones(within.sum()), (beside[0][within], beside[1][within])), (len(faces), len(faces)))
    pieces = np.unique(np.stack([part, connected_components(graph, directed=False)[1]], axis=1), axis=0)
    whole = np.bincount(pieces[:, 0], minlength=int(part[-1]) + 1) == 1
    whole[part[(np.bincount(side_edge.ravel()) > 2)[side_edge].any(axis=1)]] = False
    return whole


def _neighbours(
    faces: np.ndarray, side_edge: np.ndarray, patch_start: np.ndarray, vertex_count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patches that share a vertex, itself too, and for each of their faces bits of the other's faces that share one.

    Returns:
        offsets of the patches in the neighbours; the neighbours, each number doubled, and one added if both are in one
        piece and have an edge in common; the bits of each of both (uint8, shape (k, 8)).
    """
    count = len(faces)
    patch = np.repeat(np.arange(len(patch_start) - 1), np.diff(patch_start))
    corners = np.repeat(np.arange(count), 3), faces.ravel()
    used = csr_matrix((np.ones(faces.size), corners), (count, vertex_count))
    shared = (used @ used.T).tocoo()
    one, other = shared.row, shared.col
    pairs, neighbour = np.unique(patch[one].astype(np.int64) * count + patch[other], return_inverse=True)
    starts = np.searchsorted(pairs // count, np.arange(patch[-1] + 2)).astype(np.int32)
    lane = np.arange(count) - patch_start[patch]
    common = np.zeros((len(pairs), LANES), np.uint8)
    np.bitwise_or.at(common, (neighbour, lane[one]), (1 << lane[other]).astype(np.uint8))
    by_edge = shared.data > 1
    whole = _in_one_piece(faces, side_edge, patch, (one[by_edge], other[by_edge]))
    hinged = np.zeros(len(pairs), bool)
    hinged[neighbour[by_edge]] = True
    hinged &= whole[pairs // count] & whole[pairs % count]
    return starts, (2 * (pairs % count) + hinged).astype(np.int32), common


def joined_groups(
    faces: np.ndarray, side_edge: np.ndarray, group: np.ndarray, vertex_count: int
) -> tuple[np.ndarray, np.ndarray]:
    """For each group in one piece those that share an edge with it, itself too: offsets, and the groups, ascending.

    Args:
        faces: shape (m, 3); ``side_edge``: number of the edge of each side, shape (m, 3).
        group: of each face, ascending.
        vertex_count: of the mesh.
    """
    corners = np.repeat(np.arange(len(faces)), 3), faces.ravel()
    used = csr_matrix((np.ones(faces.size), corners), (len(faces), vertex_count))
    one, other = ((used @ used.T) > 1).nonzero()
    whole = _in_one_piece(faces, side_edge, group, (one, other))
    joined = np.unique(np.stack([group[one], group[other]], axis=1), axis=0)
    joined = joined[whole[joined].all(axis=1)]
    starts = np.searchsorted(joined[:, 0], np.arange(int(group[-1]) + 2))
    return starts.astype(np.int32), np.ascontiguousarray(joined[:, 1], np.int32)


def search_tree(mesh: ClothMesh, layer: np.ndarray) -> dict[str, np.ndarray]:
    """Arguments of the search that never change: faces in their patches and groups, and what is near along the cloth.

    Args:
        mesh: the garment.
        layer: number of the garment that each vertex belongs to, shape (n,).
    """
    count = len(mesh.vertices)
    distances = _landmark_distances(mesh.vertices, mesh.faces)
    landmarks = np.zeros((count, 2, 4), np.float32)
    landmarks.reshape(count, 8)[:, : LANDMARKS + 1] = distances
    order, patch_start, group_start, nodes = _patches(distances, mesh.faces, layer[mesh.faces[:, 0]])
    faces = np.ascontiguousarray(mesh.faces[order], np.int32)
    unique_edges, side_edge = edges_of(faces)
    neighbour_start, neighbours, common = _neighbours(faces, side_edge, patch_start, count)
    group = np.repeat(np.arange(len(group_start) - 1), np.diff(patch_start[group_start]))
    joined_start, joined = joined_groups(faces, side_edge, group, count)
    return {
        "rest": np.ascontiguousarray(mesh.vertices - mesh.vertices.mean(axis=0), np.float32),
        "landmarks": landmarks,
        "faces": faces,
        "owned": owned_features(faces, side_edge),
        "edges": np.ascontiguousarray(unique_edges[side_edge.ravel()]),
        "patch_start": patch_start,
        "group_start": group_start,
        "nodes": nodes,
        "neighbour_start": neighbour_start,
        "neighbours": neighbours,
        "common": common,
        "joined_start": joined_start,
        "joined": joined,
    }


def search_memory(tree: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays that the search over a tree of :func:`search_tree` fills anew."""
    count, patches, groups = len(tree["rest"]), len(tree["patch_start"]) - 1, len(tree["group_start"]) - 1
    return {
        "displacement": np.zeros((count, 3), np.float32),
        "normals": np.zeros((count, 4), np.float32),
        "boxes": np.zeros((2 * len(tree["nodes"]), 3), np.float32),
        "patch_boxes": empty_blocks(groups, False),
        "face_blocks": empty_blocks(patches, True),
        "cones": np.zeros((patches + groups, 4), np.float32),
        "near_groups": np.zeros(groups, np.int32),
        "stale_patches": np.zeros(groups, np.int32),
        "stale_faces": np.zeros(patches, np.int32),
        "seen_position": np.zeros((count, 3), np.float32),
        "seen_velocity": np.zeros((count, 3), np.float32),
        "stale": np.zeros(count, np.int32),
    }
