"""Even triangles on a surface that is given finely: a partition into equal cells, its dual, and small repairs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from assets.garment import boundary_loops
from assets.implicit import Faces, Field, Floats, project
from pbd.mesh import edges_of

__all__ = ["decimated", "drop_vertices", "even_mesh", "even_triangles", "flip_edges", "relax"]


def even_mesh(
    field: Field, fine: Floats, fine_faces: Faces, count: int, anchors: NDArray[np.int64] | None = None
) -> tuple[Floats, Faces]:
    """Nearly equilateral triangles on the zero set of a field.

    Args:
        field: the solid.
        fine, fine_faces: a fine mesh of it, or of a part of it, at least eight vertices for each one asked for.
        count: vertices to start from; about a tenth is taken out again for better triangles.
        anchors: fine vertices that must be among them and stay: all that the result's boundary will have.

    Returns:
        vertices [m], shape (n, 3), the anchors first; faces, wound as the fine ones, shape (m, 3).
    """
    chosen, faces = even_triangles(fine, fine_faces, count, anchors=anchors)
    vertices = fine[chosen]
    held = 0 if anchors is None else len(anchors)
    for _ in range(6):
        vertices, faces = drop_vertices(vertices, faces)
        faces = flip_edges(vertices, faces)
        vertices = relax(field, vertices, edges_of(faces)[0], 3, np.arange(len(vertices)) < held)
    return vertices, faces


def decimated(
    vertices: Floats, faces: Faces, count: int, marked: NDArray[np.int64] | None = None
) -> tuple[NDArray[np.int64], Faces]:
    """Nearly equilateral triangles between some vertices of a fine mesh, its boundary loops kept.

    Args:
        vertices, faces: the fine mesh, manifold, at least eight vertices for each one asked for.
        count: vertices to start from; about a tenth is taken out again for better triangles.
        marked: fine vertices each of which is to have a chosen one among them within about an edge of the result.

    Returns:
        the chosen vertices, shape (n,), and faces between them.
    """
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2.0
    spacing = np.sqrt(2.0 / np.sqrt(3.0) * area / count)
    anchors = []
    for loop in boundary_loops(faces):
        steps = np.linalg.norm(np.roll(vertices[loop], -1, axis=0) - vertices[loop], axis=1)
        places = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
        number = max(6, round(steps.sum() / spacing))
        anchors.append(loop[np.unique(np.searchsorted(places, steps.sum() * np.arange(number) / number))])
    fixed = np.concatenate([np.zeros(0, np.int64), *anchors])
    if marked is not None:
        fixed = _with_marked(vertices, fixed, marked, spacing)
    chosen, coarse = even_triangles(vertices, faces, count, anchors=fixed if len(fixed) else None)
    points = vertices[chosen]
    for _ in range(4):
        points, coarse = drop_vertices(points, coarse)
        coarse = flip_edges(points, coarse)
    return chosen[cKDTree(vertices[chosen]).query(points)[1]], coarse


def _with_marked(
    vertices: Floats, anchors: NDArray[np.int64], marked: NDArray[np.int64], spacing: float
) -> NDArray[np.int64]:
    """Anchors, of which some are moved to a marked vertex beside them, and marked ones where there was none."""
    kept = anchors.tolist()
    own = set(marked.tolist())
    for vertex in marked.tolist():
        away = np.linalg.norm(vertices[kept] - vertices[vertex], axis=1) if kept else np.full(1, np.inf)
        near = np.flatnonzero(away < spacing)
        if not len(near):
            kept.append(vertex)
        elif not any(kept[k] in own for k in near):
            kept[int(away.argmin())] = vertex
    return np.array(kept, np.int64)


def even_triangles(
    vertices: Floats,
    faces: Faces,
    count: int,
    *,
    anchors: NDArray[np.int64] | None = None,
    rounds: int = 40,
    seed: int = 0,
) -> tuple[NDArray[np.int64], Faces]:
    """Nearly equilateral triangles on a fine mesh: the dual of a centroidal Voronoi partition of its vertices.

    Lloyd's iteration with distances along the mesh; after Valette and Chassery, "Approximated centroidal Voronoi
    diagrams for uniform polygonal mesh coarsening", 2004.

    Args:
        vertices, faces: the fine mesh, at least eight vertices for each one asked for.
        count: vertices wanted.
        anchors: fine vertices that must be among them (a boundary keeps its shape by its anchors).
        rounds: iterations.
        seed: of the start.

    Returns:
        indices of the chosen fine vertices, at most `count`, the anchors first; faces between them.
    """
    fixed = np.zeros(0, dtype=np.int64) if anchors is None else np.asarray(anchors, dtype=np.int64)
    sites, label = _voronoi(vertices, faces, count, fixed, rounds, seed)
    triangles = label[faces]
    split = (
        (triangles[:, 0] != triangles[:, 1])
        & (triangles[:, 1] != triangles[:, 2])
        & (triangles[:, 2] != triangles[:, 0])
    )
    triangles = triangles[split]
    # A cluster with two neighbours makes a triangle and its mirror image: both go, and the vertex with them.
    _, group, copies = np.unique(np.sort(triangles, axis=1), axis=0, return_inverse=True, return_counts=True)
    triangles = triangles[copies[group] == 1]
    used = np.unique(triangles)
    return sites[used], np.searchsorted(used, triangles).astype(np.int32)


def _voronoi(
    vertices: Floats, faces: Faces, count: int, fixed: NDArray[np.int64], rounds: int, seed: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sites, shape (count,), the fixed ones first, and for each vertex the number of its site, shape (n,)."""
    edges = edges_of(faces)[0]
    edges = np.concatenate([edges, edges[:, ::-1]])
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weight = np.bincount(faces.ravel(), np.repeat(area, 3), len(vertices))
    rim, rim_label = _rim(vertices, faces, fixed)
    # The boundary belongs to the anchors: a path leads onto it or along it only within the part of its own anchor.
    part = np.full(len(vertices), -1)
    part[rim] = rim_label
    allowed = (part[edges[:, 1]] < 0) | (part[edges[:, 0]] == part[edges[:, 1]])
    graph = sparse.csr_matrix((lengths[allowed], tuple(edges[allowed].T)), shape=(len(vertices), len(vertices)))
    free = np.setdiff1d(np.arange(len(vertices)), rim)
    chosen = np.random.default_rng(seed).choice(
        free, count - len(fixed), replace=False, p=weight[free] / weight[free].sum()
    )
    sites = np.concatenate([fixed, chosen])

    def nearest_sites() -> NDArray[np.int64]:
        """For each vertex the number of the site that is nearest along the mesh."""
        _, _, nearest = csgraph.dijkstra(graph, indices=sites, min_only=True, return_predecessors=True)
        number = np.zeros(len(vertices), dtype=np.int64)
        number[sites] = np.arange(count)
        return number[nearest]

    label = nearest_sites()
    for _ in range(rounds):
        mass = np.bincount(label, weight, count)
        centre = (
            np.stack([np.bincount(label, weight * vertices[:, k], count) for k in range(3)], axis=1) / mass[:, None]
        )
        gap = np.linalg.norm(vertices - centre[label], axis=1)
        order = np.lexsort((gap, label))
        first = np.searchsorted(label[order], np.arange(count))
        sites[len(fixed) :] = order[first][len(fixed) :]
        label = nearest_sites()
    return sites, label


def _rim(vertices: Floats, faces: Faces, anchors: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Boundary vertices, and which anchor each is nearest to along the boundary: the boundary belongs to no others."""
    if not len(anchors):
        return anchors, anchors
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges, uses = np.unique(sides, axis=0, return_counts=True)
    edges = edges[uses == 1]
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    graph = sparse.csr_matrix((lengths, tuple(edges.T)), shape=(len(vertices), len(vertices)))
    _, _, nearest = csgraph.dijkstra(graph, directed=False, indices=anchors, min_only=True, return_predecessors=True)
    rim = np.unique(edges).astype(np.int64)
    order = np.argsort(anchors)
    return rim, order[np.searchsorted(anchors[order], nearest[rim])]


def relax(
    field: Field, vertices: Floats, edges: NDArray[np.int64], rounds: int, fixed: NDArray[np.bool_] | None = None
) -> Floats:
    """Pull every vertex to the mean of its neighbours and back onto the surface, which leaves a tangential move.

    A neighbour with long edges pulls more, so that crowded vertices spread.

    Args:
        field: the solid.
        vertices: near its surface [m], shape (n, 3).
        edges: pairs of neighbours, shape (edges, 2).
        rounds: iterations.
        fixed: vertices that stay, shape (n,).
    """
    n = len(vertices)
    free = np.ones(n, dtype=bool) if fixed is None else ~fixed
    both = np.concatenate([edges, edges[:, ::-1]])
    degree = np.bincount(both[:, 0], minlength=n)
    vertices = vertices.copy()
    for _ in range(rounds):
        length = np.linalg.norm(vertices[both[:, 0]] - vertices[both[:, 1]], axis=1)
        pull = (np.bincount(both[:, 0], length, n) / degree)[both[:, 1]] ** 2
        pull = sparse.csr_matrix((pull, tuple(both.T)), shape=(n, n))
        mean = (pull @ vertices) / np.asarray(pull.sum(axis=1))
        vertices[free] = project(field, (0.4 * vertices + 0.6 * mean)[free], 1)
    vertices[free] = project(field, vertices[free])
    return vertices


def flip_edges(vertices: Floats, faces: Faces) -> Faces:
    """One sweep of Delaunay flips: an edge turns where the two angles that face it exceed half a turn together."""
    faces = faces.copy()
    n = len(vertices)
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    apex = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]]).astype(np.int64)
    owner = np.tile(np.arange(len(faces)), 3)
    key, mirror = directed[:, 0] * n + directed[:, 1], directed[:, 1] * n + directed[:, 0]
    order = np.argsort(key)
    slot = np.searchsorted(key[order], mirror).clip(0, len(key) - 1)
    twin = np.where(key[order][slot] == mirror, order[slot], -1)
    half = np.flatnonzero((twin >= 0) & (directed[:, 0] < directed[:, 1]))
    a, b, c, d = *directed[half].T, apex[half], apex[twin[half]]

    excess = _angle(vertices, c, a, b) + _angle(vertices, d, b, a) - np.pi
    exists = np.isin(np.minimum(c, d) * n + np.maximum(c, d), np.minimum(key, mirror))
    valence = np.bincount(faces.ravel(), minlength=n)
    used, taken = np.zeros(len(faces), dtype=bool), set()
    for k in np.argsort(-excess):
        left, right = owner[half[k]], owner[twin[half[k]]]
        if excess[k] < 1e-3:
            break
        pair = (min(c[k], d[k]), max(c[k], d[k]))
        if exists[k] or used[left] or used[right] or pair in taken or min(valence[a[k]], valence[b[k]]) < 4:
            continue
        taken.add(pair)
        valence[[a[k], b[k]]] -= 1
        used[left] = used[right] = True
        faces[left], faces[right] = (a[k], d[k], c[k]), (b[k], c[k], d[k])
    return faces


def _angle(vertices: Floats, corner: NDArray[np.int64], one: NDArray[np.int64], other: NDArray[np.int64]) -> Floats:
    u, v = vertices[one] - vertices[corner], vertices[other] - vertices[corner]
    return np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), (u * v).sum(axis=1))


def drop_vertices(vertices: Floats, faces: Faces) -> tuple[Floats, Faces]:
    """Take out inner vertices with three or four neighbours: their triangles can only be poor ones.

    Args:
        vertices: [m], shape (n, 3).
        faces: shape (m, 3).

    Returns:
        the other vertices, in their order, and faces between them.
    """
    faces, n = faces.copy(), len(vertices)
    valence = np.bincount(faces.ravel(), minlength=n)
    around: list[list[int]] = [[] for _ in range(n)]
    for face, corners in enumerate(faces):
        for corner in corners:
            around[corner].append(face)
    edges = {tuple(edge) for edge in edges_of(faces)[0]}
    touched, kept, gone = np.zeros(n, dtype=bool), np.ones(len(faces), dtype=bool), np.zeros(n, dtype=bool)
    for vertex in np.flatnonzero(valence <= 4):
        if touched[vertex]:
            continue
        following = {}
        for face in around[vertex]:
            k = int(np.flatnonzero(faces[face] == vertex)[0])
            following[int(faces[face, (k + 1) % 3])] = int(faces[face, (k + 2) % 3])
        ring = [next(iter(following))]
        while len(ring) < len(following) and following[ring[-1]] in following:
            ring.append(following[ring[-1]])
        if following.get(ring[-1]) != ring[0] or touched[ring].any():
            continue
        if len(ring) == 4:
            # The shorter diagonal, if the mesh does not have it elsewhere.
            if np.linalg.norm(vertices[ring[0]] - vertices[ring[2]]) > np.linalg.norm(
                vertices[ring[1]] - vertices[ring[3]]
            ):
                ring = ring[1:] + ring[:1]
            diagonal = (min(ring[0], ring[2]), max(ring[0], ring[2]))
            if diagonal in edges:
                continue
            edges.add(diagonal)
        touched[[*ring, vertex]] = gone[vertex] = True
        kept[around[vertex]] = False
        for k in range(len(ring) - 2):
            faces[around[vertex][k]] = (ring[0], ring[k + 1], ring[k + 2])
            kept[around[vertex][k]] = True
    number = np.cumsum(~gone) - 1
    return vertices[~gone], number[faces[kept]].astype(np.int32)
