"""The outer surface of a body of many shells: a skin with eyes, hair and clothes, or a figure of jointed parts.

Each shell is closed over its holes and counts as a solid; the outer surface of all solids together is meshed anew.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from assets.weld import group_rows
from pbd.mesh import edges_of

__all__ = ["count_shells", "join_seams", "open_share", "outer_surface"]

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]
Ints = NDArray[np.int64]

SPACING = 1.0 / 180.0  # of the grid over the longest side of the box around the body [-]: about a centimetre
SEAM = 2e-5  # vertices so near each other are one, in files with rounded numbers [m]
_BESIDE = 1.37e-6  # rays run so far beside the grid's lines, so that they hit no vertex or edge of a tidy mesh [m]
_CELLS = 2_000_000  # pairs of triangle and ray that are looked at together


def join_seams(vertices: Floats, faces: Faces) -> tuple[Floats, Faces]:
    """Make one vertex of those that are within 0.02 mm of each other; faces that lose a corner go.

    Args:
        vertices: [m], shape (n, 3).
        faces: shape (m, 3).
    """
    group = _groups(cKDTree(vertices).query_pairs(SEAM, output_type="ndarray"), len(vertices))
    first, index = group_rows(group[:, None])
    faces = index[faces].astype(np.int32)
    return vertices[first], faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]


def open_share(faces: Faces) -> float:
    """Part of the edges that does not lie between two faces [-]."""
    edges, side_edge = edges_of(faces)
    return float(np.mean(np.bincount(side_edge.ravel(), minlength=len(edges)) != 2))


def count_shells(faces: Faces) -> int:
    """Number of parts of a mesh that share no vertex."""
    return len(np.unique(_shell_of_face(faces)))


def outer_surface(vertices: Floats, faces: Faces) -> tuple[Floats, Faces]:
    """The surface around all shells together, meshed anew with edges of about a 180th of its longest side.

    A point is inside if a shell, closed over its holes, winds around it, or if it is in a hollow of such solids. Thin
    sheets such as cards of hair have no inside and vanish. The surface runs through the points where the grid's lines
    leave the solids (surface nets, Gibson 1998). The grid has nodes on the plane x = 0, so that legs that nearly touch
    there stay apart.

    Args:
        vertices: in the body's frame [m], shape (n, 3).
        faces: shape (m, 3), each shell wound in one sense.

    Returns:
        vertices [m], shape (k, 3), and faces, counter-clockwise seen from outside, shape (l, 3).
    """
    vertices, faces = _solids(vertices, faces)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    step = SPACING * float((high - low).max())
    base = low * [0.0, 1.0, 1.0]
    first = np.floor((low - base) / step) - 1.0
    count = (np.ceil((high - base) / step) - first).astype(np.int64) + 2
    solid, crossings = np.zeros(tuple(count), bool), []
    places = (vertices - base) / step - first  # in steps of the grid
    for axis in range(3):
        column, height, sign = _ray_hits(places, faces, axis, count, _BESIDE / step)
        number, width = np.prod(np.delete(count, axis)), count[axis]
        cell = column * width + np.clip(np.floor(height).astype(np.int64), 0, width - 1)
        hits = np.bincount(cell, minlength=number * width)
        share = np.bincount(cell, weights=height - np.floor(height), minlength=number * width) / np.maximum(hits, 1)
        share[hits == 0] = 0.5
        shape = (*np.delete(count, axis), width)
        crossings.append(np.moveaxis(share.reshape(shape), 2, axis))
        if axis == 2:
            turns = np.bincount(cell, weights=sign, minlength=number * width).reshape(shape)
            inside = np.cumsum(turns, axis=2)
            solid[:, :, 1:] = np.moveaxis(inside, 2, axis)[:, :, :-1] > 0.5
    hollow = np.asarray(label(~solid)[0])
    solid = hollow != hollow[0, 0, 0]
    nets, quads = _surface_nets(solid, crossings)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    return (nets + first) * step + base, triangles


def _shell_of_face(faces: Faces) -> NDArray[np.int32]:
    return _groups(edges_of(faces)[0], int(faces.max()) + 1)[faces[:, 0]]


def _groups(pairs: NDArray[np.integer], count: int) -> NDArray[np.int32]:
    """For each of a number of points, the group of those that pairs join, shape (count,)."""
    joined = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(count, count))
    return connected_components(joined, directed=False)[1]


def _solids(vertices: Floats, faces: Faces) -> tuple[Floats, Faces]:
    """Every shell closed over its holes, by triangles to the middle of each hole, and wound to the outside."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2).astype(np.int64)
    count = len(vertices)
    keys, which = np.unique(ends.min(axis=1) * count + ends.max(axis=1), return_inverse=True)
    # How often an edge is run through upwards more than downwards: nought inside of a shell.
    net = np.bincount(which, weights=np.where(ends[:, 0] < ends[:, 1], 1.0, -1.0)).round().astype(np.int64)
    rim = np.repeat(np.stack([keys // count, keys % count], axis=1), np.abs(net), axis=0)
    turned = np.repeat(net > 0, np.abs(net))
    rim[turned] = rim[turned][:, ::-1]
    if len(rim):
        used, local = np.unique(rim, return_inverse=True)
        local = local.reshape(-1, 2)
        loop = _groups(local, len(used))
        middles = np.stack([np.bincount(loop, weights=vertices[used, k]) for k in range(3)], axis=1)
        middles /= np.bincount(loop)[:, None]
        caps = np.column_stack([rim, count + loop[local[:, 0]]])
        vertices, faces = np.concatenate([vertices, middles]), np.concatenate([faces, caps]).astype(np.int32)
    shell = _shell_of_face(faces)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volume = np.bincount(shell, weights=np.einsum("fa,fa->f", a, np.cross(b, c)))
    inverted = volume[shell] < 0.0
    faces = faces.copy()
    faces[inverted] = faces[inverted][:, ::-1]
    return vertices, faces


def _ray_hits(
    places: Floats, faces: Faces, axis: int, count: Ints, beside: float
) -> tuple[Ints, Floats, NDArray[np.float64]]:
    """Where lines of a grid along an axis pass through triangles.

    Args:
        places: vertices in steps of the grid, shape (n, 3).
        faces: shape (m, 3).
        axis: 0, 1 or 2.
        count: nodes along each axis, shape (3,).
        beside: distance of the rays from the grid's lines, in steps [-].

    Returns:
        column of each hit, row by row over the other two axes; its height in steps; 1 where the ray enters, -1 where it
        leaves: shape (k,) each.
    """
    others = [k for k in range(3) if k != axis]
    corners = places[faces]
    flat = corners[:, :, others] - beside * np.array([1.0, 0.7])
    low = np.maximum(np.ceil(flat.min(axis=1)).astype(np.int64), 0)
    high = np.minimum(np.floor(flat.max(axis=1)).astype(np.int64), count[others] - 1)
    size = np.maximum(high - low + 1, 0)
    number = size.prod(axis=1)
    columns, heights, signs = [np.zeros(0, np.int64)], [np.zeros(0)], [np.zeros(0)]
    chosen = np.flatnonzero(number)
    parts = np.split(chosen, np.flatnonzero(np.diff(np.cumsum(number[chosen]) // _CELLS)) + 1)
    for part in parts:
        if not len(part):
            continue
        face = np.repeat(part, number[part])
        place = np.arange(len(face)) - np.repeat(np.cumsum(number[part]) - number[part], number[part])
        u = low[face, 0] + place // size[face, 1]
        v = low[face, 1] + place % size[face, 1]
        triangle = flat[face] - np.stack([u, v], axis=1)[:, None, :]
        after = np.roll(triangle, -1, axis=1)
        # Twice the areas towards the opposite edges: all of one sign inside.
        parts_of = triangle[:, :, 0] * after[:, :, 1] - triangle[:, :, 1] * after[:, :, 0]
        hit = (parts_of > 0.0).all(axis=1) | (parts_of < 0.0).all(axis=1)
        face, u, v, parts_of = face[hit], u[hit], v[hit], parts_of[hit]
        weights = np.roll(parts_of, -1, axis=1) / parts_of.sum(axis=1, keepdims=True)
        heights.append(np.einsum("kc,kc->k", weights, corners[face][:, :, axis]))
        columns.append(u * count[others[1]] + v)
        upwards = parts_of.sum(axis=1) > 0.0  # of the face's normal, for the cyclic order of the axes
        signs.append(np.where(upwards == (axis != 1), -1.0, 1.0))
    return np.concatenate(columns), np.concatenate(heights), np.concatenate(signs)


def _surface_nets(solid: NDArray[np.bool_], crossings: list[Floats]) -> tuple[Floats, Ints]:
    """The surface between solid and empty nodes.

    Args:
        solid: by node.
        crossings: for each axis, how far from a node to the next the surface lies [-], by node.

    Returns:
        vertices in steps of the grid, shape (k, 3), and their quadrilaterals, counter-clockwise seen from outside.
    """
    shape = np.array(solid.shape)
    cells = tuple(shape - 1)
    total, hits = np.zeros((*cells, 3)), np.zeros(cells, np.int64)
    edges = []
    for axis in range(3):
        here = np.moveaxis(solid, axis, 0)
        index = np.argwhere(np.moveaxis(here[:-1] != here[1:], 0, axis))
        place = index.astype(float)
        place[:, axis] += crossings[axis][tuple(index.T)]
        edges.append((index, solid[tuple(index.T)]))
        others = [k for k in range(3) if k != axis]
        for near in ((0, 0), (0, 1), (1, 1), (1, 0)):
            cell = index.copy()
            cell[:, others] -= near
            np.add.at(total, tuple(cell.T), place)
            np.add.at(hits, tuple(cell.T), 1)
    number = np.cumsum(hits.ravel() > 0).reshape(cells) - 1
    quads = []
    for axis, (index, leaving) in enumerate(edges):
        others = [(axis + 1) % 3, (axis + 2) % 3]
        around = []
        for near in ((1, 1), (0, 1), (0, 0), (1, 0)):
            cell = index.copy()
            cell[:, others] -= near
            around.append(number[tuple(cell.T)])
        quad = np.stack(around, axis=1)
        quads.append(np.where(leaving[:, None], quad, quad[:, ::-1]))
    used = hits > 0
    return total[used] / hits[used][:, None], np.concatenate(quads)
