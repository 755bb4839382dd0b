"""Closed surfaces from signed functions: blends of simple shapes, and a mesher.

A *field* maps points [m], shape (n, 3), to values [m], shape (n,), negative inside. It only has to be close to a
distance near its zero set: every step that needs the surface itself walks there by Newton's method.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

__all__ = [
    "Faces",
    "Field",
    "Floats",
    "ellipsoid",
    "field_gradient",
    "loft",
    "project",
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
    """Mesh the zero set inside a box by marching tetrahedra: closed and manifold for any shape.

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
    # Corners inside the solid come first; their number then decides which edges the surface crosses.
    nodes = np.take_along_axis(nodes, np.argsort(flat[nodes] >= 0.0, axis=1, kind="stable"), axis=1)
    count = (flat[nodes] < 0.0).sum(axis=1)
    cuts = []
    for number, triangles in _TETRAHEDRON_CUTS.items():
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
_TETRAHEDRON_CUTS = {
    1: [[(0, 1), (0, 2), (0, 3)]],
    2: [[(0, 2), (0, 3), (1, 3)], [(0, 2), (1, 3), (1, 2)]],
    3: [[(0, 3), (1, 3), (2, 3)]],
}
