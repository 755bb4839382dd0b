"""Pairs of cloth features as a search takes them: whether both may touch, and with which side and gap they start."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

from pbd.contact.box_tree import overlap
from pbd.contact.pairs import closest_points, corners_of
from pbd.engine import ti
from pbd.geometry import Float1, Int1, Int4, Vec3, Vec4, Vec4Rows, vec3, vec4, xyz
from pbd.taichi_internals import in_kernel

__all__ = ["DEEP_SLACK", "EDGE_SHARE", "SLACK", "MovingCloth", "PairBuffers", "take_pair", "turning_kernel"]

SLACK = 0.002  # pairs of one garment are kept up to this distance beyond thickness and expected motion [m], ...
DEEP_SLACK = 0.003  # ... and those of layers and of cloth that is through itself, which may be deeper in one another
MIN_COSINE = 0.5  # of the angle between the normals of two layers that face the same way [-]
EDGE_SHARE = 0.5  # of the thickness, at which edges repel: vertices keep the sheets apart, edges from crossing [-]
# Places that are nearer along the cloth cannot touch in a fold that is round and keeps the thickness inside. If they
# were kept apart, they would resist compression and bending: the more, the finer the mesh is [thickness].
NEAR_ALONG_CLOTH = 0.5 * 3.14159265
# Places that are a little further along the cloth move alike, and the cloth itself keeps them from coming as near in a
# frame as their velocities say. So they are pairs only if they are near now: within SLACK.
ALONG_CLOTH = 0.006  # distance along the cloth, beyond two thicknesses, up to which that is so [m]
NO_CONTACT = -1.0  # thickness of a pair that is never in contact [m]


@in_kernel
@dataclass(eq=False)
class MovingCloth:
    """The cloth in one search; a view, see :mod:`pbd.xpbd.views`.

    Attributes:
        position, velocity: [m], [m/s], vec4 and vec3.
        displacement: receives the expected displacement over the frame against the cloth's mean [m], vec3.
        normals: receives unit vertex normals if there are several layers, vec4.
        rest: positions at rest [m], vec3.
        landmarks: distances along the cloth at rest to landmarks [m], two rows of vec4.
        layer: number of the garment of each vertex.
        wrong_side: 1 for vertices on the wrong side of their own garment.
        seen_position, seen_velocity: of each vertex the motion that was expected when it was last stale: where it leads
            back to at the frame's start [m], and velocity [m/s], vec3.
        stale: 1 for vertices that have left this motion.
        thickness, longest: of the fabric, and of the sides of the faces at rest [m].
        slack: up to which pairs are kept beyond thickness and expected motion [m].
        tangled: 1 if cloth was on the wrong side at the last search; it is pulled back in any direction.
    """

    position: Any
    velocity: Any
    displacement: Any
    normals: Any
    rest: Any
    landmarks: Any
    layer: Any
    wrong_side: Any
    seen_position: Any
    seen_velocity: Any
    stale: Any
    thickness: Any
    slack: Any
    longest: Any
    tangled: Any
    _data_oriented = True


@in_kernel
@dataclass(eq=False)
class PairBuffers:
    """The pairs of the last frame that touched, and the results of a search; a view, see :mod:`pbd.xpbd.views`.

    Attributes:
        old_pairs, old_normals: of :class:`pbd.State`; ``chain``: of each vertex its first old pair, then of each old
            pair the next one of the same vertex, -1 for none.
        pairs, pair_data: as :func:`pbd.contact.pairs.solve_pairs` takes them.
        pair_faces: the two faces of each pair, eight times the patch and the place in it; -1 for a pull.
        ready_pairs: how many pairs were found first, also if the buffers do not take them all.
        crossed: how many edges go through faces; then as many as the buffer takes: their ends, and the face.
        max_displacement: greatest displacement of the features of a pair against each other in the frame [m].
    """

    old_pairs: Any
    old_normals: Any
    chain: Any
    pairs: Any
    pair_data: Any
    pair_faces: Any
    ready_pairs: Any
    crossed: Any
    max_displacement: Any
    _data_oriented = True


@ti.func
def take_pair(q, owners, cloth: ti.template(), buffers: ti.template()):
    """Keep a pair of two faces if its features may touch in this frame."""
    k = corners_of(q)
    x0 = xyz(cloth.position[k[0]])
    x1, x2, x3 = xyz(cloth.position[k[1]]) - x0, xyz(cloth.position[k[2]]) - x0, xyz(cloth.position[k[3]]) - x0
    c0, c1 = cloth.displacement[k[0]], cloth.displacement[k[1]]
    c2, c3 = cloth.displacement[k[2]], cloth.displacement[k[3]]
    layers = cloth.layer[k[0]] - cloth.layer[k[3]]
    same_garment = layers == 0
    edges = q[1] < 0
    kept = cloth.thickness * ti.select(edges, EDGE_SHARE, 1.0)
    reach = kept + cloth.slack
    may_touch = within_reach(edges, reach, x1, x2, x3, c0, c1, c2, c3, cloth.tangled)
    if may_touch and same_garment and surely_along_cloth(k, edges, cloth):
        reach = kept + SLACK
        none = vec3(0.0)
        may_touch = within_reach(edges, reach, x1, x2, x3, none, none, none, none, 0)
    shares, across, offset = ti.math.vec4(0.0), vec3(0.0), vec3(0.0)
    size, at_rest, displacement = 1e30, 1e30, 0.0
    close = False
    if may_touch:
        shares, across, offset = closest_points(q, x1, x2, x3)
        size = offset.norm()
        nearest = ti.min(size, end_gap(edges, offset / ti.max(size, 1e-20), x1, x2, x3, c0, c1, c2, c3))
        displacement = (shares[0] * c0 + shares[1] * c1 + shares[2] * c2 + shares[3] * c3).norm()
        if cloth.tangled != 0:
            nearest = size - displacement
        close = nearest < reach
        if close:
            rest_distance, along_cloth = distance_at_rest(q, k, cloth)
            at_rest = rest_distance
            if same_garment and along_cloth:
                close = at_rest > NEAR_ALONG_CLOTH * cloth.thickness and size < kept + SLACK
    outwards = vec3(0.0)
    if close and layers != 0:
        knows_sides, direction = layer_side(q, k, layers, shares, offset, size, cloth)
        outwards = direction
        if not knows_sides:
            layers = 0
    old = -1
    if close and layers == 0:
        old = old_pair(q, k, cloth, buffers)
        # Layers that went through each other and do not know their sides would hold one another there: they let go.
        close = same_garment or old < 0 or buffers.old_normals[ti.max(old, 0)][3] >= 0.0
    if close:
        buffers.max_displacement[0] = ti.max(buffers.max_displacement[0], displacement)
        c = buffers.ready_pairs[0]
        buffers.ready_pairs[0] += 1
        if c < buffers.pairs.shape[0]:
            normal, gap = offset / ti.max(size, 1e-20), size
            if layers == 0:
                kept = ti.min(kept, at_rest)
                normal, gap, kept = first_side(q, k, old, same_garment, across, offset, size, kept, cloth, buffers)
            else:
                normal = outwards / ti.max(outwards.norm(), 1e-20)
            buffers.pairs[c] = q
            buffers.pair_faces[c] = owners
            buffers.pair_data[c, 0] = vec4(normal, kept)
            buffers.pair_data[c, 1] = ti.math.vec4(gap, 1.0 if layers != 0 else 0.0, displacement, 0.0)


@ti.func
def within_reach(
    edges, reach: ti.f32, x1: vec3, x2: vec3, x3: vec3, c0: vec3, c1: vec3, c2: vec3, c3: vec3, any_way: ti.i32
):
    """Whether two features may come as near as ``reach`` [m]; for the other arguments see :func:`boxes_of`."""
    low, high, other_low, other_high = boxes_of(edges, x1, x2, x3, c0, c1, c2, c3, any_way)
    near = overlap(low - reach, high + reach, other_low, other_high)
    if near and any_way == 0:
        near = not stay_apart(edges, reach, x1, x2, x3, c0, c1, c2, c3)
    return near


@ti.func
def boxes_of(edges, x1: vec3, x2: vec3, x3: vec3, c0: vec3, c1: vec3, c2: vec3, c3: vec3, any_way: ti.i32):
    """Boxes of both features now; the second's is larger by its corners' motion against the first's.

    Args:
        edges, x1, x2, x3, c0, c1, c2, c3: see :func:`end_gap`.
        any_way: whether that motion may lead the other way too.
    """
    low, high = ti.min(vec3(0.0), ti.select(edges, x1, vec3(0.0))), ti.max(vec3(0.0), ti.select(edges, x1, vec3(0.0)))
    own_low, own_high = ti.min(c0, ti.select(edges, c1, c0)), ti.max(c0, ti.select(edges, c1, c0))
    other_low, other_high = ti.min(x2, x3), ti.max(x2, x3)
    least, most = ti.min(c2, c3), ti.max(c2, c3)
    other_low, other_high = ti.min(other_low, ti.select(edges, x2, x1)), ti.max(other_high, ti.select(edges, x2, x1))
    least, most = ti.min(least, ti.select(edges, c2, c1)), ti.max(most, ti.select(edges, c2, c1))
    least, most = ti.min(least - own_high, 0.0), ti.max(most - own_low, 0.0)
    if any_way != 0:
        most = ti.max(most, -least)
        least = -most
    other_low += least
    other_high += most
    return low, high, other_low, other_high


@ti.func
def surely_along_cloth(k, edges, cloth: ti.template()):
    """Whether :func:`distance_at_rest` finds two features near along the cloth, wherever their closest points are.

    Args:
        k: vertices of the pair.
        edges: whether its features are two edges, else a vertex and a face.
        cloth: :class:`MovingCloth`.
    """
    along = (cloth.rest[k[2]] - cloth.rest[k[0]]).norm() < 2.0 * (cloth.thickness + cloth.longest) + ALONG_CLOTH
    if along:
        for row in ti.static(range(2)):
            one, either = cloth.landmarks[k[0], row], cloth.landmarks[k[1], row]
            two, three = cloth.landmarks[k[2], row], cloth.landmarks[k[3], row]
            own, other = one, either
            if edges:
                own, other = either, two
            furthest = ti.max(
                ti.max(one, own) - ti.min(ti.min(two, three), other),
                ti.max(ti.max(two, three), other) - ti.min(one, own),
            )
            along = along and furthest.max() < 2.0 * cloth.thickness + ALONG_CLOTH
    return along


@ti.func
def stay_apart(edges, reach: ti.f32, x1: vec3, x2: vec3, x3: vec3, c0: vec3, c1: vec3, c2: vec3, c3: vec3):
    """Whether two features surely stay further apart than a reach [m]: a look that is cheaper than the closest points.

    It measures along the normal of the face, or across both edges. For the other arguments see :func:`end_gap`.
    """
    one, other = x2 - x1, x3 - x1
    if edges:
        one, other = x1, x3 - x2
    normal = one.cross(other)
    size = normal.dot(normal)
    height = -normal.dot(ti.select(edges, x2, x1))
    if height < 0.0:
        height, normal = -height, -normal
    least = ti.min(height, end_gap(edges, normal, x1, x2, x3, c0, c1, c2, c3))
    # Edges that are nearly parallel have no direction across.
    return least > 0.0 and least * least > reach * reach * size and size > 1e-6 * one.dot(one) * other.dot(other)


@ti.func
def end_gap(edges, normal: vec3, x1: vec3, x2: vec3, x3: vec3, c0: vec3, c1: vec3, c2: vec3, c3: vec3) -> ti.f32:
    """How far apart two features are at least after their displacements, if their corners go straight [m].

    A plane between both stays between them. Along its normal the least coordinate of the one less the greatest of the
    other is concave in time, so that over the displacements it is least at their start or at their end.

    Args:
        edges: whether the features are two edges, else a vertex and a face; the first vertex is the origin.
        normal: from the second feature to the first; unit, or the gap is so many times as large as its length.
        x1, x2, x3: the other vertices [m].
        c0, c1, c2, c3: the displacements of all four [m].
    """
    first, second = c0.dot(normal), (x1 + c1).dot(normal)
    other = ti.max((x2 + c2).dot(normal), (x3 + c3).dot(normal))
    if edges:
        first = ti.min(first, second)
    else:
        other = ti.max(other, second)
    return first - other


@ti.func
def layer_side(q, k, layers: ti.i32, shares, offset: vec3, size: ti.f32, cloth: ti.template()):
    """Whether two layers know their sides, and the direction outwards from the inner one.

    They do if they face the same way and are not so far through each other that it must be another fold of them.
    """
    first = shares[0] * xyz(cloth.normals[k[0]])
    second = -shares[2] * xyz(cloth.normals[k[2]]) - shares[3] * xyz(cloth.normals[k[3]])
    if q[1] < 0:
        first += shares[1] * xyz(cloth.normals[k[1]])
    else:
        second -= shares[1] * xyz(cloth.normals[k[1]])
    outwards = second
    if layers < 0:
        outwards = -first
    knows_sides = True
    if first.dot(second) < MIN_COSINE or (outwards.dot(offset) < 0.0 and size > 2.0 * cloth.thickness):
        knows_sides = False
    return knows_sides, outwards


@ti.func
def old_pair(q, k, cloth: ti.template(), buffers: ti.template()) -> ti.i32:
    """The same pair in the last frame, -1 for none."""
    old = buffers.chain[k[0]]
    while old >= 0:  # `and` works out both of its sides: an index that may be -1 is not looked up beside it
        if (buffers.old_pairs[old] == q).all():
            break
        old = buffers.chain[cloth.position.shape[0] + old]
    # Edges that seem so far through one another have gone around each other: the search for crossings would have found
    # them and they would have been pulled back.
    if old >= 0:
        if q[1] < 0 and buffers.old_normals[old][3] < -cloth.thickness:
            old = -1
    return old


@ti.func
def distance_at_rest(q, k, cloth: ti.template()):
    """Distance of two features at rest [m], 1e30 if they are far apart; and whether they are as near along the cloth.

    The distance along the cloth is at least the difference of the distances to any landmark.
    """
    distance, along_cloth = 1e30, 1e30
    y0 = cloth.rest[k[0]]
    if (cloth.rest[k[2]] - y0).norm() < 2.0 * (cloth.thickness + cloth.longest) + ALONG_CLOTH:
        shares, _across, offset = closest_points(q, cloth.rest[k[1]] - y0, cloth.rest[k[2]] - y0, cloth.rest[k[3]] - y0)
        distance, along_cloth = offset.norm(), 0.0
        for row in ti.static(range(2)):
            difference = ti.math.vec4(0.0)
            for corner in ti.static(range(4)):
                difference += shares[corner] * cloth.landmarks[k[corner], row]
            along_cloth = ti.max(along_cloth, ti.abs(difference).max())
    return distance, along_cloth < 2.0 * cloth.thickness + ALONG_CLOTH


@ti.func
def first_side(
    q,
    k,
    old: ti.i32,
    same_garment,
    across: vec3,
    offset: vec3,
    size: ti.f32,
    thickness: ti.f32,
    cloth: ti.template(),
    buffers: ti.template(),
):
    """Normal, gap and thickness [m] with which a pair starts into the frame where no layer says its side.

    Args:
        q, k: the pair, and its vertices.
        old: the same pair in the last frame, -1 for none.
        same_garment: whether both features are of one garment.
        across, offset, size: direction across both features, offset of the first from the second and its length [m].
        thickness: at which its features repel [m].
        cloth, buffers: views of the garment and of its pairs.
    """
    normal, gap, kept = offset / ti.max(size, 1e-20), size, thickness
    if across.dot(across) > 0.0:
        normal = across
        if across.dot(offset) < 0.0:
            normal = -across
    if old >= 0:
        remembered = xyz(buffers.old_normals[old])
        if across.dot(across) > 0.0:
            if remembered.dot(normal) < 0.0:
                normal = -normal
        elif buffers.old_normals[old][3] < 0.0:
            normal = remembered
            gap = -size
    # A pair that was through in the last frame knows its side. Any other may not, where cloth is on the wrong side:
    # there, edges have no right side, and vertices belong to the other one.
    doubtful = same_garment and (old < 0 or buffers.old_normals[ti.max(old, 0)][3] >= 0.0)
    wrong = ti.static(cloth.wrong_side)
    if q[1] < 0 and doubtful and wrong[k[0]] + wrong[k[1]] + wrong[k[2]] + wrong[k[3]] > 0:
        kept = NO_CONTACT
    elif q[1] >= 0 and doubtful and wrong[k[0]] == 1:
        if normal.dot(offset) > 0.0:
            normal = -normal
        gap = -size
    return normal, gap, kept


@cache
def turning_kernel() -> Callable[..., None]:
    """The kernel that turns pairs to the sides of vertices on the wrong side; made where it is needed first."""

    @ti.kernel
    def turn_sides(
        position: Vec4,
        velocity: Vec3,
        damped: Int1,
        rest: Vec3,
        landmarks: Vec4Rows,
        layer: Int1,
        wrong_side: Int1,
        old_pairs: Int4,
        old_normals: Vec4,
        chain: Int1,
        pairs: Int4,
        pair_data: Vec4Rows,
        ready_pairs: Int1,
        max_displacement: Float1,
        dt: ti.f32,
        thickness: ti.f32,
        longest: ti.f32,
    ):
        """Start the pairs found with the sides that vertices on the wrong side have now.

        Those of vertices that are ``damped`` receive the displacements that their velocities have now.
        """
        ti.loop_config(serialize=True)
        for _ in range(1):
            none = vec3(0.0)
            cloth = MovingCloth(
                position, none, none, none, rest, landmarks, layer, wrong_side, none, none, none, thickness, 0.0,
                longest, 0,
            )  # fmt: skip
            buffers = PairBuffers(old_pairs, old_normals, chain, pairs, pair_data, none, ready_pairs, none, none)
            furthest = 0.0
            for c in range(ready_pairs[0]):
                q = pairs[c]
                k = corners_of(q)
                if damped[k[0]] | damped[k[1]] | damped[k[2]] | damped[k[3]] != 0:
                    x0 = xyz(position[k[0]])
                    shares, across, offset = closest_points(
                        q, xyz(position[k[1]]) - x0, xyz(position[k[2]]) - x0, xyz(position[k[3]]) - x0
                    )
                    motion = shares[0] * velocity[k[0]] + shares[1] * velocity[k[1]]
                    motion += shares[2] * velocity[k[2]] + shares[3] * velocity[k[3]]
                    pair_data[c, 1][2] = dt * motion.norm()
                    wrong = wrong_side[k[0]] | wrong_side[k[1]] | wrong_side[k[2]] | wrong_side[k[3]]
                    if wrong != 0 and layer[k[0]] == layer[k[3]]:
                        at_rest, _along_cloth = distance_at_rest(q, k, cloth)
                        kept = ti.min(thickness * ti.select(q[1] < 0, EDGE_SHARE, 1.0), at_rest)
                        old = old_pair(q, k, cloth, buffers)
                        normal, gap, kept_now = first_side(
                            q, k, old, True, across, offset, offset.norm(), kept, cloth, buffers
                        )
                        pair_data[c, 0] = vec4(normal, kept_now)
                        pair_data[c, 1][0] = gap
                furthest = ti.max(furthest, pair_data[c, 1][2])
            max_displacement[0] = furthest

    return turn_sides
