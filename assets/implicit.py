"""Closed surfaces from signed functions: blends, a mesher, and even triangles on the result.

A *field* maps points [m], shape (n, 3), to values [m], shape (n,), negative inside. It only has to be close to a
distance near its zero set: every step that needs the surface itself walks there by Newton's method.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial.transform import Rotation

__all__ = [
    "Field",
    "ellipsoid",
    "drop_vertices",
    "edges_of_polygons",
    "even_mesh",
    "even_triangles",
    "field_gradient",
    "flip_edges",
    "loft",
    "project",
    "relax",
    "smooth_max",
    "smooth_min",
    "smooth_table",
    "surface_mesh",
    "tapered_tube",
]

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]
Field = Callable[[Floats], Floats]


def smooth_min(first: Floats, second: Floats, width: float) -> Floats:
    """Union of two solids with a fillet [m] where both fields differ by less than `width` [m]."""
    overlap = np.maximum(width - np.abs(first - second), 0.0) / width
    return np.minimum(first, second) - overlap**2 * (width / 4.0)


def smooth_max(first: Floats, second: Floats, width: float) -> Floats:
    """Intersection of two solids with an edge rounded over `width` [m]."""
    return -smooth_min(-first, -second, width)


def tapered_tube(points: Floats, start: Floats, end: Floats, radii: list[tuple[float, float]]) -> Floats:
    """A round limb from `start` to `end` with ball ends; `radii` are (share of the length, radius [m])."""
    axis = end - start
    offset = points - start
    along = np.clip(offset @ axis / (axis @ axis), 0.0, 1.0)
    shares, values = np.array(radii).T
    return np.linalg.norm(offset - along[:, None] * axis, axis=1) - smooth_table(along, shares, values)


def smooth_table(x: Floats, knots: Floats, values: Floats) -> Floats:
    """Cubic interpolation without a kink at the knots (Catmull-Rom slopes), constant beyond the ends."""
    slopes = np.zeros_like(values)
    slopes[1:-1] = (values[2:] - values[:-2]) / (knots[2:] - knots[:-2])
    x = np.clip(x, knots[0], knots[-1])
    i = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    h = knots[i + 1] - knots[i]
    t = (x - knots[i]) / h
    return (
        (1.0 + 2.0 * t) * (1.0 - t) ** 2 * values[i]
        + t * (1.0 - t) ** 2 * h * slopes[i]
        + t**2 * (3.0 - 2.0 * t) * values[i + 1]
        + t**2 * (t - 1.0) * h * slopes[i + 1]
    )


def loft(points: Floats, table: Floats) -> Floats:
    """A trunk of upright slices, each an oval of a slightly boxy kind; without ends.

    Args:
        points: [m], shape (n, 3).
        table: rows of height, half width, depth in front of and behind the middle line, z of the middle line [m].
    """
    x, y, z = points.T
    width, front, back, middle = (smooth_table(y, table[:, 0], table[:, k]) for k in range(1, 5))
    depth = np.where(z > middle, front, back)
    radius = (np.abs(x / width) ** 2.3 + np.abs((z - middle) / depth) ** 2.3) ** (1.0 / 2.3)
    return (radius - 1.0) * np.minimum(width, 0.5 * (front + back))


def ellipsoid(points: Floats, centre: Floats, axes: Floats, rotation: Floats | None = None) -> Floats:
    """An ellipsoid of half axes `axes` [m]; the rows of `rotation`, if given, are their directions."""
    local = points - centre
    if rotation is not None:
        local = local @ rotation.T
    scaled = local / axes
    length = np.linalg.norm(scaled, axis=1)
    slope = np.linalg.norm(scaled / axes, axis=1)
    return length * (length - 1.0) / np.maximum(slope, 1e-9)


def field_gradient(field: Field, points: Floats, step: float = 1e-4) -> Floats:
    """Gradient of a field by differences over the corners of a tetrahedron [-], shape (n, 3)."""
    corners = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    values = field((points[None] + step * corners[:, None]).reshape(-1, 3)).reshape(4, len(points))
    return values.T @ corners / (4.0 * step)


def project(field: Field, points: Floats, steps: int = 3) -> Floats:
    """The points moved onto the zero set along the gradient (Newton's method)."""
    for _ in range(steps):
        gradient = field_gradient(field, points)
        square = np.maximum((gradient**2).sum(axis=1), 1e-6)
        points = points - (field(points) / square)[:, None] * gradient
    return points


def surface_mesh(field: Field, low: Floats, high: Floats, spacing: float) -> tuple[Floats, Faces]:
    """Mesh the zero set inside a box by marching tetrahedra: closed and manifold whatever the shape.

    Args:
        field: the solid.
        low, high: corners of a box that holds the solid [m], shape (3,).
        spacing: side of a cell of the grid [m]; edges come out at about half of it.

    Returns:
        vertices [m], shape (n, 3), on the surface; faces, counter-clockwise from outside, shape (m, 3).
    """
    # The grid is turned by an odd angle: a surface along a grid plane would be cut into slivers.
    turn = Rotation.from_euler("xyz", [31.0, 23.0, 17.0], degrees=True)
    turned = turn.apply(np.array(list(product(*zip(low, high, strict=True)))))
    start = turned.min(axis=0) - 2.0 * spacing
    shape = np.ceil((turned.max(axis=0) + 2.0 * spacing - start) / spacing).astype(int) + 1
    vertices, faces = _zero_set(_grid_values(field, turn, start, shape, spacing, (low, high)))
    vertices = turn.inv().apply(start + spacing * vertices)
    return project(field, vertices, 1), faces


def _grid_values(
    field: Field, turn: Rotation, start: Floats, shape: NDArray[np.int64], spacing: float, box: tuple[Floats, Floats]
) -> Floats:
    """Field at the nodes of a turned grid; nodes outside the box count as outside the solid.

    Most nodes are far from the surface: a grid of every fourth node finds those that are not.
    """
    coarse = shape // 4 + 2
    nodes = np.stack(np.meshgrid(*(4 * np.arange(n) for n in coarse), indexing="ij"), axis=-1)
    rough = field(turn.inv().apply((start + spacing * nodes).reshape(-1, 3))).reshape(tuple(coarse))
    rough = rough.repeat(4, axis=0).repeat(4, axis=1).repeat(4, axis=2)[2:, 2:, 2:][tuple(slice(n) for n in shape)]
    near = np.argwhere(np.abs(rough) < 6.0 * spacing)
    points = turn.inv().apply(start + spacing * near)
    boxed = ((points > box[0]) & (points < box[1])).all(axis=1)
    values = np.where(rough < 0.0, -spacing, spacing)
    values[tuple(near.T)] = spacing
    values[tuple(near[boxed].T)] = field(points[boxed])
    return values


def _zero_set(values: Floats) -> tuple[Floats, Faces]:
    """Vertices, in cells, and triangles of the zero set of a grid of values: six tetrahedra to a cell."""
    shape = np.array(values.shape)
    stride = np.array([shape[1] * shape[2], shape[2], 1])
    flat = values.ravel()
    # A value of zero would put several vertices on one node.
    flat = np.where(np.abs(flat) < 1e-6, 1e-6, flat)
    inside = (flat < 0.0).reshape(values.shape)
    corners = np.array(list(product((0, 1), repeat=3)))
    held = sum(
        inside[tuple(slice(c, shape[k] - 1 + c) for k, c in enumerate(corner))].astype(int) for corner in corners
    )
    cells = np.argwhere((held > 0) & (held < 8)) @ stride
    tetrahedra = [cells[:, None] + np.cumsum([0, *stride[list(order)]]) for order in permutations(range(3))]
    nodes = np.concatenate(tetrahedra)
    # Corners inside the solid first; then the number of them tells which edges the surface crosses.
    nodes = np.take_along_axis(nodes, np.argsort(flat[nodes] >= 0.0, axis=1, kind="stable"), axis=1)
    count = (flat[nodes] < 0.0).sum(axis=1)
    cuts = []
    for number, triangles in _CUTS.items():
        cuts += [nodes[count == number][:, triangle] for triangle in triangles]
    ends = np.concatenate(cuts)  # (triangles, 3 corners, 2 ends): inside, outside
    keys, index = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    a, b = (np.stack(np.unravel_index(keys[:, k], values.shape), axis=1).astype(float) for k in range(2))
    va, vb = flat[keys[:, 0]], flat[keys[:, 1]]
    vertices = a + (va / (va - vb))[:, None] * (b - a)

    # Triangles face away from their inner ends.
    faces = index.reshape(-1, 3)
    p = vertices[faces]
    outward = (b[faces] - a[faces]).sum(axis=1)
    wrong = (np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) * outward).sum(axis=1) < 0.0
    return vertices, np.where(wrong[:, None], faces[:, ::-1], faces).astype(np.int32)


# Corners of the triangles that cut a tetrahedron with 1, 2 or 3 corners inside, as (inner, outer) ends of its edges.
_CUTS = {
    1: [[(0, 1), (0, 2), (0, 3)]],
    2: [[(0, 2), (0, 3), (1, 3)], [(0, 2), (1, 3), (1, 2)]],
    3: [[(0, 3), (1, 3), (2, 3)]],
}


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
        vertices = relax(field, vertices, edges_of_polygons(faces), 3, np.arange(len(vertices)) < held)
    return vertices, faces


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
    edges = edges_of_polygons(faces)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    graph = sparse.csr_matrix((lengths, tuple(edges.T)), shape=(len(vertices), len(vertices)))
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weight = np.bincount(faces.ravel(), np.repeat(area, 3), len(vertices))
    fixed = np.zeros(0, dtype=np.int64) if anchors is None else np.asarray(anchors, dtype=np.int64)
    rim, rim_label = _rim(vertices, faces, fixed)
    free = np.setdiff1d(np.arange(len(vertices)), rim)
    chosen = np.random.default_rng(seed).choice(
        free, count - len(fixed), replace=False, p=weight[free] / weight[free].sum()
    )
    sites = np.concatenate([fixed, chosen])
    for step in range(rounds + 1):
        _, _, nearest = csgraph.dijkstra(graph, directed=False, indices=sites, min_only=True, return_predecessors=True)
        position = np.zeros(len(vertices), dtype=np.int64)
        position[sites] = np.arange(count)
        label = position[nearest]
        label[rim] = rim_label
        if step == rounds:
            break
        mass = np.bincount(label, weight, count)
        centre = (
            np.stack([np.bincount(label, weight * vertices[:, k], count) for k in range(3)], axis=1) / mass[:, None]
        )
        gap = np.linalg.norm(vertices - centre[label], axis=1)
        order = np.lexsort((gap, label))
        first = np.searchsorted(label[order], np.arange(count))
        sites[len(fixed) :] = order[first][len(fixed) :]
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


def edges_of_polygons(polygons: NDArray[np.integer]) -> NDArray[np.int64]:
    """Edges of triangles or quads, each once, shape (edges, 2)."""
    sides = polygons.shape[1]
    edges = np.concatenate([polygons[:, [k, (k + 1) % sides]] for k in range(sides)])
    return np.unique(np.sort(edges, axis=1).astype(np.int64), axis=0)


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
    """Take out inner vertices with three or four neighbours: their triangles can only be poor ones."""
    faces, n = faces.copy(), len(vertices)
    valence = np.bincount(faces.ravel(), minlength=n)
    around: list[list[int]] = [[] for _ in range(n)]
    for face, corners in enumerate(faces):
        for corner in corners:
            around[corner].append(face)
    edges = {tuple(edge) for edge in edges_of_polygons(faces)}
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
