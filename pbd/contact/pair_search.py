"""Pairs of cloth features that may touch in a frame, and edges that go through faces, found in a tree of boxes.

The first search of a frame is of all patches. A later one is of the faces that have a stale vertex alone: one that is
by now further from where the search that last looked at it expected it than half of the slack that pairs have. No pair
is missed where both features are nearer than that to where they were expected.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

from pbd.contact.blocks import (
    CORNERS,
    DISPLACEMENTS,
    HIGH,
    LANES,
    LOW,
    NORMAL,
    Blocks,
    facing,
    features,
    overlapping,
    put,
    sides,
    take,
)  # fmt: skip
from pbd.contact.pairs import closest_points, corners_of
from pbd.contact.untangling import note_crossings
from pbd.engine import ti
from pbd.geometry import Byte2, Float1, Int1, Int2, Int3, Int4, Vec3, Vec4, Vec4Rows, vec3, vec4, xyz
from pbd.taichi_internals import in_kernel

__all__ = ["find_pairs", "turning_kernel"]

SLACK = 0.003  # pairs are kept up to this distance beyond thickness and expected motion [m]
MIN_COSINE = 0.5  # of the angle between the normals of two layers that face the same way [-]
EDGE_SHARE = 0.5  # of the thickness, at which edges repel: vertices keep the sheets apart, edges from crossing [-]
ROUNDING = 1e-5  # boxes of features may be so much further apart in the world than seen from one of them [m]
# Places that are nearer along the cloth cannot touch in a fold that is round and keeps the thickness inside. If they
# were kept apart, they would resist compression and bending: the more, the finer the mesh is [thickness].
NEAR_ALONG_CLOTH = 0.5 * 3.14159265
SLACK_ALONG_CLOTH = 0.001  # of places that are a little further along the cloth: they move alike [m]
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
    longest: Any
    _data_oriented = True


@in_kernel
@dataclass(eq=False)
class BoxTree:
    """The faces in their tree of boxes; a view, see :mod:`pbd.xpbd.views`.

    Faces lie in patches, patches in groups, of eight at most.

    Attributes:
        faces: vertices of the faces, in the order of the tree; ``edges``: the ends of the three sides of each face.
        owned: of each face, bits of the corners and of the sides that belong to it.
        patch_start, group_start: offsets of the patches in the faces, and of the groups in the patches.
        nodes: of the tree over the groups, in preorder: the next node that is not below this one, its last group, its
            group if it is a leaf, else -1.
        neighbour_start, neighbours: of each patch those, itself too, that it has a vertex in common with, ascending.
        common: for each neighbour and each face of the patch, bits of the neighbour's faces that share a vertex.
        boxes: low and high corner of each node [m], vec3.
        patch_boxes, face_blocks: see :mod:`pbd.contact.blocks`.
        cones: axis of the normals of each patch, and cosine of the greatest angle to it, vec4.
        near_groups: workspace.
        stale_patches, stale_faces: of each group and patch bits of its patches and faces that have a stale vertex.
    """

    faces: Any
    owned: Any
    edges: Any
    patch_start: Any
    group_start: Any
    nodes: Any
    neighbour_start: Any
    neighbours: Any
    common: Any
    boxes: Any
    patch_boxes: Any
    face_blocks: Any
    cones: Any
    near_groups: Any
    stale_patches: Any
    stale_faces: Any
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
def overlap(low_a: vec3, high_a: vec3, low_b: vec3, high_b: vec3):
    """Whether two boxes overlap."""
    return (ti.max(low_a, low_b) <= ti.min(high_a, high_b)).all()


@ti.func
def lowest(bits: ti.i32) -> ti.i32:
    """Position of the lowest bit that is set."""
    return 31 - ti.math.clz(bits & -bits)


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
    kept = cloth.thickness
    low, high = ti.min(vec3(0.0), c0), ti.max(vec3(0.0), c0)
    other_low = ti.min(ti.min(x2, x3), ti.min(x2 + c2, x3 + c3))
    other_high = ti.max(ti.max(x2, x3), ti.max(x2 + c2, x3 + c3))
    if q[1] < 0:
        kept *= EDGE_SHARE
        low, high = ti.min(low, ti.min(x1, x1 + c1)), ti.max(high, ti.max(x1, x1 + c1))
    else:
        other_low, other_high = ti.min(other_low, ti.min(x1, x1 + c1)), ti.max(other_high, ti.max(x1, x1 + c1))
    reach = kept + SLACK
    shares, across, offset = ti.math.vec4(0.0), vec3(0.0), vec3(0.0)
    size, displacement = 1e30, 0.0
    at_rest = 1e30
    may_touch = overlap(low - reach, high + reach, other_low, other_high)
    if may_touch:
        rest_distance, along_cloth = distance_at_rest(q, k, cloth)
        at_rest = rest_distance
        if same_garment and along_cloth:
            may_touch = at_rest > NEAR_ALONG_CLOTH * cloth.thickness
            reach = kept + SLACK_ALONG_CLOTH
    if may_touch:
        shares, across, offset = closest_points(q, x1, x2, x3)
        displacement = (shares[0] * c0 + shares[1] * c1 + shares[2] * c2 + shares[3] * c3).norm()
        size = offset.norm()
    outwards = vec3(0.0)
    if layers != 0:
        knows_sides, direction = layer_side(q, k, layers, shares, offset, size, cloth)
        outwards = direction
        if not knows_sides:
            layers = 0
    close = size < reach + displacement
    old = -1
    if close and layers == 0:
        old = old_pair(q, k, cloth, buffers)
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
    while old >= 0 and not (buffers.old_pairs[old] == q).all():
        old = buffers.chain[cloth.position.shape[0] + old]
    # Edges that seem so far through one another have gone around each other: the search for crossings would have found
    # them and they would have been pulled back.
    if old >= 0 and q[1] < 0 and buffers.old_normals[old][3] < -cloth.thickness:
        old = -1
    return old


@ti.func
def distance_at_rest(q, k, cloth: ti.template()):
    """Distance of two features at rest [m], 1e30 if they are far apart; and whether they are as near along the cloth.

    The distance along the cloth is at least the difference of the distances to any landmark.
    """
    distance, along_cloth = 1e30, 1e30
    y0 = cloth.rest[k[0]]
    if (cloth.rest[k[2]] - y0).norm() < 2.0 * (cloth.thickness + SLACK) + 2.0 * cloth.longest:
        shares, _across, offset = closest_points(q, cloth.rest[k[1]] - y0, cloth.rest[k[2]] - y0, cloth.rest[k[3]] - y0)
        distance, along_cloth = offset.norm(), 0.0
        for row in ti.static(range(2)):
            difference = ti.math.vec4(0.0)
            for corner in ti.static(range(4)):
                difference += shares[corner] * cloth.landmarks[k[corner], row]
            along_cloth = ti.max(along_cloth, ti.abs(difference).max())
    return distance, along_cloth < 2.0 * (cloth.thickness + SLACK)


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
        """Start the pairs found with the sides that vertices on the wrong side have now; see :func:`find_pairs`.

        Those of vertices that are ``damped`` receive the displacements that their velocities have now.
        """
        ti.loop_config(serialize=True)
        for _ in range(1):
            none = vec3(0.0)
            cloth = MovingCloth(
                position, none, none, none, rest, landmarks, layer, wrong_side, none, none, none, thickness, longest
            )
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


@ti.func
def flat(one, two):
    """Whether two patches that share a vertex cannot touch: all normals in their cones (axis, cosine) look one way."""
    sine_1, sine_2 = ti.sqrt(ti.max(1.0 - one[3] * one[3], 0.0)), ti.sqrt(ti.max(1.0 - two[3] * two[3], 0.0))
    narrow = one[3] > 0.0 and two[3] > 0.0 and one[3] * two[3] > sine_1 * sine_2
    return narrow and xyz(one).dot(xyz(two)) > sine_1 * two[3] + one[3] * sine_2


@ti.func
def feature_pair(f: ti.i32, g: ti.i32, n: ti.i32, faces: ti.template(), edges: ti.template()):
    """The n-th of the 15 pairs of features of two faces: their vertices, or -1 at first if they share one."""
    q = ti.Vector([-1, 0, 0, 0])
    if n < 6:
        one, two, corner = f, g, n
        if n >= 3:
            one, two, corner = g, f, n - 3
        v, t = faces[one][corner], faces[two]
        if v != t[0] and v != t[1] and v != t[2]:
            q = ti.Vector([v, t[0], t[1], t[2]])
    else:
        e, d = edges[3 * f + (n - 6) // 3], edges[3 * g + (n - 6) % 3]
        if e[0] != d[0] and e[0] != d[1] and e[1] != d[0] and e[1] != d[1]:
            q = ti.Vector([e[0], -e[1] - 1, d[0], d[1]])
    return q


@ti.func
def owned_pairs(f: ti.i32, g: ti.i32) -> ti.i32:
    """Bits of the pairs, of the 15 pairs of features of two faces, that belong to them, from the faces' own bits."""
    bits = (f & 7) | (g & 7) << 3
    for s in ti.static(range(3)):
        if (f >> (3 + s)) & 1:
            bits |= (g >> 3) << (6 + 3 * s)
    return bits


@ti.kernel
def find_pairs(
    position: Vec4,
    velocity: Vec3,
    displacement: Vec3,
    normals: Vec4,
    rest: Vec3,
    landmarks: Vec4Rows,
    layer: Int1,
    wrong_side: Int1,
    faces: Int3,
    owned: Int1,
    edges: Int2,
    patch_start: Int1,
    group_start: Int1,
    nodes: Int3,
    neighbour_start: Int1,
    neighbours: Int1,
    common: Byte2,
    boxes: Vec3,
    patch_boxes: Blocks,
    face_blocks: Blocks,
    cones: Vec4,
    near_groups: Int1,
    stale_patches: Int1,
    stale_faces: Int1,
    seen_position: Vec3,
    seen_velocity: Vec3,
    stale: Int1,
    old_pairs: Int4,
    old_normals: Vec4,
    chain: Int1,
    pairs: Int4,
    pair_data: Vec4Rows,
    pair_faces: Int2,
    ready_pairs: Int1,
    crossed: Int3,
    max_displacement: Float1,
    anew: ti.i32,
    elapsed: ti.f32,
    dt: ti.f32,
    share: ti.f32,
    thickness: ti.f32,
    longest: ti.f32,
):
    """Find the pairs that may touch in the next ``dt`` [s]; ``ready_pairs[0]`` receives how many there are.

    All are found if ``anew``. Else those found before are kept, except those of stale faces, which are found again;
    ``elapsed`` [s] is the time since the frame's start, ``share`` the part left of what the last search looked ahead
    to. The other arguments are those of :class:`MovingCloth`, :class:`BoxTree` and :class:`PairBuffers`; over 12,
    because a kernel takes arrays one by one.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        search_pairs(
            anew,
            elapsed,
            dt,
            share,
            MovingCloth(
                position, velocity, displacement, normals, rest, landmarks, layer, wrong_side, seen_position,
                seen_velocity, stale, thickness, longest,
            ),
            BoxTree(
                faces, owned, edges, patch_start, group_start, nodes, neighbour_start, neighbours, common, boxes,
                patch_boxes, face_blocks, cones, near_groups, stale_patches, stale_faces,
            ),
            PairBuffers(
                old_pairs, old_normals, chain, pairs, pair_data, pair_faces, ready_pairs, crossed, max_displacement
            ),
        )  # fmt: skip


@ti.func
def search_pairs(
    anew: ti.i32,
    elapsed: ti.f32,
    dt: ti.f32,
    share: ti.f32,
    cloth: ti.template(),
    tree: ti.template(),
    buffers: ti.template(),
):
    """See :func:`find_pairs`."""
    margin = 0.5 * (cloth.thickness + SLACK)
    layers = expect_motion(dt, cloth, buffers)
    find_stale(anew, elapsed, cloth, tree, buffers)
    for group in range(tree.group_start.shape[0] - 1):
        tree.stale_patches[group] = 0
        for patch in range(tree.group_start[group], tree.group_start[group + 1]):
            update_patch(group, patch, margin, layers, cloth, tree)
    update_nodes(tree)
    if layers > 0:
        for i in range(cloth.position.shape[0]):
            cloth.normals[i] /= ti.max(cloth.normals[i].norm(), 1e-20)
    buffers.crossed[0] = ti.Vector([0, 0, 0])
    keep_pairs(anew, share, tree, buffers)
    leaf = 0  # of the group; leaves come in the order of the groups
    for group in range(tree.group_start.shape[0] - 1):
        while tree.nodes[leaf][2] < 0:
            leaf += 1
        stale = tree.stale_patches[group]
        near_count = 0
        if stale != 0:
            near_count = list_near_groups(ti.select(anew != 0, group, 0), group, leaf, tree)
        leaf += 1
        while stale != 0:
            patch = tree.group_start[group] + lowest(stale)
            stale &= stale - 1
            search_patch(group, patch, near_count, margin, cloth, tree, buffers)


@ti.func
def expect_motion(dt: ti.f32, cloth: ti.template(), buffers: ti.template()) -> ti.i32:
    """Fill the displacements of the frame and the chains of old pairs; returns the number of the outermost layer."""
    count = cloth.position.shape[0]
    mean = vec3(0.0)
    for i in range(count):
        mean += cloth.velocity[i]
    mean /= count
    for i in range(count):
        cloth.displacement[i] = dt * (cloth.velocity[i] - mean)
        cloth.normals[i] = ti.math.vec4(0.0)
        buffers.chain[i] = -1
    for r in range(buffers.old_pairs.shape[0]):
        i = buffers.old_pairs[r][0]
        buffers.chain[count + r] = buffers.chain[i]
        buffers.chain[i] = r
    layers = 0
    for i in range(count):
        layers = ti.max(layers, cloth.layer[i])
    return layers


@ti.func
def find_stale(anew: ti.i32, elapsed: ti.f32, cloth: ti.template(), tree: ti.template(), buffers: ti.template()):
    """Find the vertices that have left their expected motion against the cloth's mean; all, if anew.

    Those on the wrong side are stale too where crossings are looked for.
    """
    count = cloth.position.shape[0]
    mean = vec3(0.0)
    if anew == 0:
        for i in range(count):
            mean += xyz(cloth.position[i]) - cloth.seen_position[i] - elapsed * cloth.seen_velocity[i]
        mean /= count
    # The curve along which cloth goes through itself is to be found again as a whole.
    for r in range(1, ti.min(buffers.crossed[0][0] + 1, buffers.crossed.shape[0])):
        row = buffers.crossed[r]
        cloth.wrong_side[row[0]] = 1
        cloth.wrong_side[row[1]] = 1
        for k in ti.static(range(3)):
            cloth.wrong_side[tree.faces[row[2]][k]] = 1
    for i in range(count):
        x, v = xyz(cloth.position[i]), cloth.velocity[i]
        left = x - cloth.seen_position[i] - elapsed * cloth.seen_velocity[i] - mean
        stale = anew != 0 or left.dot(left) > 0.25 * SLACK * SLACK
        if buffers.crossed.shape[0] > 1:
            stale = stale or cloth.wrong_side[i] == 1
            cloth.wrong_side[i] = 0
        cloth.stale[i] = ti.select(stale, 1, 0)
        if stale:
            cloth.seen_position[i], cloth.seen_velocity[i] = x - elapsed * v - mean, v


@ti.func
def keep_pairs(anew: ti.i32, share: ti.f32, tree: ti.template(), buffers: ti.template()):
    """Keep the pairs found before, in their order, except those of stale faces and pulls; none, if anew."""
    found = ti.select(anew != 0, 0, buffers.ready_pairs[0])
    count, furthest = 0, 0.0
    for c in range(found):
        owners = buffers.pair_faces[c]
        if owners[0] >= 0:
            one = tree.stale_faces[owners[0] // LANES] >> owners[0] % LANES
            other = tree.stale_faces[owners[1] // LANES] >> owners[1] % LANES
            if (one | other) & 1 == 0:
                buffers.pairs[count], buffers.pair_faces[count] = buffers.pairs[c], owners
                buffers.pair_data[count, 0], buffers.pair_data[count, 1] = (
                    buffers.pair_data[c, 0],
                    buffers.pair_data[c, 1],
                )
                buffers.pair_data[count, 1][2] *= share
                furthest = ti.max(furthest, buffers.pair_data[count, 1][2])
                count += 1
    buffers.ready_pairs[0], buffers.ready_pairs[1] = count, 0
    buffers.max_displacement[0] = furthest


@ti.func
def update_patch(
    group: ti.i32, patch: ti.i32, margin: ti.f32, layers: ti.i32, cloth: ti.template(), tree: ti.template()
):
    """Boxes of a patch and its faces over the motion of a frame, ``margin`` [m] larger, and the cone of its normals."""
    low, high, axis = vec3(1e30), vec3(-1e30), vec3(0.0)
    stale_faces = 0
    for f in range(tree.patch_start[patch], tree.patch_start[patch + 1]):
        lane = f - tree.patch_start[patch]
        face_low, face_high, stale = vec3(1e30), vec3(-1e30), 0
        for k in ti.static(range(3)):
            x, displacement = xyz(cloth.position[tree.faces[f][k]]), cloth.displacement[tree.faces[f][k]]
            stale |= cloth.stale[tree.faces[f][k]]
            face_low = ti.min(face_low, ti.min(x, x + displacement))
            face_high = ti.max(face_high, ti.max(x, x + displacement))
            put(tree.face_blocks, patch, CORNERS + 3 * k, lane, x)
            put(tree.face_blocks, patch, DISPLACEMENTS + 3 * k, lane, displacement)
        stale_faces |= stale << lane
        x = xyz(cloth.position[tree.faces[f][0]])
        side_1, side_2 = xyz(cloth.position[tree.faces[f][1]]) - x, xyz(cloth.position[tree.faces[f][2]]) - x
        normal = side_1.cross(side_2)
        if layers > 0:
            for k in ti.static(range(3)):
                cloth.normals[tree.faces[f][k]] += vec4(normal)
        normal /= ti.max(normal.norm(), 1e-20)
        axis += normal
        put(tree.face_blocks, patch, NORMAL, lane, normal)
        put(tree.face_blocks, patch, LOW, lane, face_low - margin)
        put(tree.face_blocks, patch, HIGH, lane, face_high + margin)
        low, high = ti.min(low, face_low - margin), ti.max(high, face_high + margin)
    axis /= ti.max(axis.norm(), 1e-20)
    cosine = 1.0
    for lane in range(tree.patch_start[patch + 1] - tree.patch_start[patch]):
        cosine = ti.min(cosine, axis.dot(take(tree.face_blocks, patch, NORMAL, lane)))
    tree.cones[patch] = vec4(axis, cosine)
    tree.stale_faces[patch] = stale_faces
    tree.stale_patches[group] |= ti.select(stale_faces != 0, 1, 0) << (patch - tree.group_start[group])
    put(tree.patch_boxes, group, LOW, patch - tree.group_start[group], low)
    put(tree.patch_boxes, group, HIGH, patch - tree.group_start[group], high)


@ti.func
def update_nodes(tree: ti.template()):
    """Boxes of the nodes, from the boxes of the patches."""
    for r in range(tree.nodes.shape[0]):
        node = tree.nodes.shape[0] - 1 - r
        group = tree.nodes[node][2]
        low, high = vec3(1e30), vec3(-1e30)
        if group >= 0:
            for lane in range(tree.group_start[group + 1] - tree.group_start[group]):
                low = ti.min(low, take(tree.patch_boxes, group, LOW, lane))
                high = ti.max(high, take(tree.patch_boxes, group, HIGH, lane))
        else:
            one, other = node + 1, tree.nodes[node + 1][0]
            low = ti.min(tree.boxes[2 * one], tree.boxes[2 * other])
            high = ti.max(tree.boxes[2 * one + 1], tree.boxes[2 * other + 1])
        tree.boxes[2 * node], tree.boxes[2 * node + 1] = low, high


@ti.func
def list_near_groups(first: ti.i32, group: ti.i32, leaf: ti.i32, tree: ti.template()) -> ti.i32:
    """Put the groups near a group, from a first one on, into ``near_groups``; returns how many; ``leaf``: its own."""
    near_count = 0
    low, high = tree.boxes[2 * leaf], tree.boxes[2 * leaf + 1]
    node = 0
    while node < tree.nodes.shape[0]:
        entry = tree.nodes[node]
        if entry[1] < first or not overlap(low, high, tree.boxes[2 * node], tree.boxes[2 * node + 1]):
            node = entry[0]
        else:
            node += 1
            if entry[2] >= 0:
                tree.near_groups[near_count] = entry[2]
                near_count += 1
    return near_count


@ti.func
def search_patch(
    group: ti.i32,
    patch: ti.i32,
    near_count: ti.i32,
    margin: ti.f32,
    cloth: ti.template(),
    tree: ti.template(),
    buffers: ti.template(),
):
    """Find the pairs of a stale patch with itself, and with others of the groups near its own.

    These are the stale ones after it and all that are not stale.
    """
    low = take(tree.patch_boxes, group, LOW, patch - tree.group_start[group])
    high = take(tree.patch_boxes, group, HIGH, patch - tree.group_start[group])
    neighbour, last_neighbour = tree.neighbour_start[patch], tree.neighbour_start[patch + 1]
    for r in range(near_count):
        others = overlapping(tree.patch_boxes, tree.near_groups[r], low, high)
        later = -1
        if tree.near_groups[r] == group:
            later = -1 << (patch - tree.group_start[group])
        elif tree.near_groups[r] < group:
            later = 0
        others &= later | ~tree.stale_patches[tree.near_groups[r]]
        while others != 0:
            other_lane = lowest(others)
            others &= others - 1
            other = tree.group_start[tree.near_groups[r]] + other_lane
            while neighbour < last_neighbour and tree.neighbours[neighbour] < other:
                neighbour += 1
            joined = neighbour < last_neighbour and tree.neighbours[neighbour] == other
            if joined and flat(tree.cones[patch], tree.cones[other]):
                continue
            other_low = take(tree.patch_boxes, tree.near_groups[r], LOW, other_lane)
            other_high = take(tree.patch_boxes, tree.near_groups[r], HIGH, other_lane)
            faces = overlapping(tree.face_blocks, patch, other_low, other_high)
            while faces != 0:
                lane = lowest(faces)
                faces &= faces - 1
                search_face(patch, lane, other, neighbour, joined, margin, cloth, tree, buffers)


@ti.func
def search_face(
    patch: ti.i32,
    lane: ti.i32,
    other: ti.i32,
    neighbour: ti.i32,
    joined,
    margin: ti.f32,
    cloth: ti.template(),
    tree: ti.template(),
    buffers: ti.template(),
):
    """Find the pairs of one face of a patch with the faces of another patch, where either is stale.

    Args:
        patch, lane: of the one face.
        other: the other patch.
        neighbour: its index in ``neighbours`` if ``joined``, that is if both patches share a vertex.
        margin: by which boxes are larger than the faces' motion [m].
    """
    low, high = take(tree.face_blocks, patch, LOW, lane), take(tree.face_blocks, patch, HIGH, lane)
    seconds = overlapping(tree.face_blocks, other, low, high)
    if other == patch:
        seconds &= -2 << lane
    if (tree.stale_faces[patch] >> lane) & 1 == 0:
        seconds &= tree.stale_faces[other]
    # Faces with a common corner that face the same way cannot touch.
    shared = 0
    if joined:
        shared = seconds & ti.cast(tree.common[neighbour, lane], ti.i32)
    if shared != 0:
        seconds &= ~(shared & facing(tree.face_blocks, other, take(tree.face_blocks, patch, NORMAL, lane)))
    uncut = 0
    if seconds != 0:
        beside, uncut_now = sides(tree.face_blocks, patch, lane, other, 2.0 * margin)
        uncut = uncut_now
        seconds &= ~beside
    if seconds != 0:
        f = tree.patch_start[patch] + lane
        near = features(
            tree.face_blocks, patch, lane, other,
            margin + ROUNDING, EDGE_SHARE * cloth.thickness + SLACK + ROUNDING,
        )  # fmt: skip
        while seconds != 0:
            second = lowest(seconds)
            seconds &= seconds - 1
            g = tree.patch_start[other] + second
            if (uncut >> second) & 1 == 0:
                note_crossings(f, g, cloth.position, tree.faces, tree.edges, tree.owned, buffers.crossed)
            bits = near[second] & owned_pairs(tree.owned[f], tree.owned[g])
            while bits != 0:
                q = feature_pair(f, g, lowest(bits), tree.faces, tree.edges)
                bits &= bits - 1
                if q[0] >= 0:
                    take_pair(q, ti.Vector([patch * LANES + lane, other * LANES + second]), cloth, buffers)
