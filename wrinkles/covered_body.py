"""The body under the cloth in relaxation: the face that is nearest to a fine vertex, and the height over it."""

from dataclasses import dataclass
from typing import Any

from pbd.contact.colliders import EDGES
from pbd.engine import ti
from pbd.geometry import closest_in_fan, larger, vec3
from pbd.taichi_internals import in_kernel

__all__ = ["MAX_HEIGHT", "CoveredBody", "edge_towards", "has_more_edges", "height_over"]

MAX_HEIGHT = 0.008  # fine vertices within this height over the tangent plane are near the body [m]
MAX_TESTED_EXCESS = 0.003  # near vertices no more than this over their clearance are tested against faces [m]
MAX_FACE_DISTANCE = 0.05  # to a face that may be near the cloth [m]


@in_kernel
@dataclass(eq=False)
class CoveredBody:
    """The body under the cloth in one pass; a view, see :mod:`pbd.xpbd.views`.

    Attributes:
        surface: :class:`pbd.contact.body_surface.BodySurface`, which stands still.
        clearance: kept from it at each of its vertices [m].
        nearest: body vertices where the last passes found each free vertex near the body, -1 for none: first on the
            part that it covers, for all of them, then on an opposite one.
        edge_ends, edge_sides: see :attr:`pbd.contact.colliders.Body.first_edges`.
        coarse_nearest, across, state: of the coarse vertices, see :class:`wrinkles.opposite_parts.TouchedBody`.
        leading: three coarse vertices around each free vertex.
        frames: of the coarse vertices, their normals from column 6 on.
        facing: 1 where the garment's faces look away from the body, -1 where they look at it.
    """

    surface: Any
    clearance: Any
    nearest: Any
    edge_ends: Any
    edge_sides: Any
    coarse_nearest: Any
    across: Any
    state: Any
    leading: Any
    frames: Any
    facing: Any
    _data_oriented = True


@ti.func
def edge_towards(offset: vec3, vertex: ti.i32, covered: ti.template()):
    """Look at the edges from a body vertex to its neighbours.

    Args:
        offset: from the body vertex to a place near it [m].
        vertex: the body vertex.
        covered: view of the covered body.

    Returns:
        whether no neighbour is nearer to the place than the vertex; the edge that comes nearest to the place, -1 if no
        edge comes nearer than the vertex. Edges are those of :attr:`pbd.contact.colliders.Body.first_edges`.
    """
    body, ends = ti.static(covered.surface.body_start, covered.edge_ends)
    best, nearer = 0, 0
    for k in range(EDGES):
        edge = body[ends[EDGES * vertex + k]] - body[vertex]
        along, squared = offset.dot(edge), edge.dot(edge)
        nearer |= ti.select(along + along > squared, 1, 0)
        # The squared distance to the edge is that to the vertex less this gain. Positive numbers are in the order of
        # their bits, and the largest of whole numbers is found without a branch.
        gain = larger(along, 0.0) * along / larger(squared, 1e-20)
        best = ti.max(best, (ti.bit_cast(gain, ti.i32) & -EDGES) | k)
    return nearer == 0, ti.select(best < EDGES, -1, EDGES * vertex + (best & (EDGES - 1)))


@ti.func
def has_more_edges(vertex: ti.i32, covered: ti.template()) -> bool:
    """Whether a body vertex has more neighbours than :func:`edge_towards` looks at."""
    return covered.surface.ring_start[vertex + 1] - covered.surface.ring_start[vertex] > EDGES


@ti.func
def height_over(p: vec3, vertex: ti.i32, edge: ti.i32, covered: ti.template()):
    """Normal of the body near one of its vertices, height of p [m] over it, and the clearance there [m].

    Near the body the nearer one of the two faces beside an edge counts, see :func:`edge_towards`; further away the
    tangent plane is enough.
    """
    body, normals, clearance = ti.static(covered.surface.body_start, covered.surface.body_normals, covered.clearance)
    offset = p - body[vertex]
    normal, height, kept = normals[vertex], offset.dot(normals[vertex]), 0.0
    if height < tested_height(vertex, covered):
        f, w = ti.Vector([vertex, vertex]), vec3(1.0, 0.0, 0.0)
        if has_more_edges(vertex, covered):
            f, w, _squared = closest_in_fan(p, vertex, 0.0, covered.surface)
        elif edge >= 0:
            first, second, other = covered.edge_ends[edge], covered.edge_sides[edge][0], covered.edge_sides[edge][1]
            along = body[first] - body[vertex]
            w, gain = weights_beside(offset, along, body[second] - body[vertex])
            other_w, other_gain = weights_beside(offset, along, body[other] - body[vertex])
            f = ti.Vector([first, ti.select(other_gain > gain, other, second)])
            w = ti.select(other_gain > gain, other_w, w)
        offset -= w[1] * (body[f[0]] - body[vertex]) + w[2] * (body[f[1]] - body[vertex])
        normal = w[0] * normals[vertex] + w[1] * normals[f[0]] + w[2] * normals[f[1]]
        normal /= ti.max(normal.norm(), 1e-20)
        kept = w[0] * clearance[vertex] + w[1] * clearance[f[0]] + w[2] * clearance[f[1]]
        height = offset.dot(normal)
        if offset.dot(offset) > MAX_FACE_DISTANCE * MAX_FACE_DISTANCE:
            height = MAX_HEIGHT
    return normal, height, kept


@ti.func
def tested_height(vertex: ti.i32, covered: ti.template()) -> ti.f32:
    """Cloth lower than this over the tangent plane of a body vertex is tested against the faces there [m]."""
    return ti.min(covered.clearance[vertex] + MAX_TESTED_EXCESS, MAX_HEIGHT)


@ti.func
def weights_beside(offset: vec3, edge: vec3, side: vec3):
    """Closest point of a triangle to a place whose nearest corner is the first.

    Args:
        offset: from that corner to the place [m].
        edge: to the second corner; it is nearer to the place than the ``side`` to the third corner [m].

    Returns:
        barycentric weights; by how much the place is nearer to that point than to the first corner, squared [m2].
    """
    a, b, c = edge.dot(edge), edge.dot(side), side.dot(side)
    d, e = offset.dot(edge), offset.dot(side)
    u, v, area = c * d - b * e, a * e - b * d, ti.max(a * c - b * b, 1e-20)
    over = ti.min(u, v) > 0.0
    # Beyond the third side the point is taken on that side, in the direction of the projection.
    scale = 1.0 / ti.max(u + v, area)
    u, v = ti.select(over, u * scale, d / a), ti.select(over, v * scale, 0.0)
    return vec3(1.0 - u - v, u, v), u * d + v * e
