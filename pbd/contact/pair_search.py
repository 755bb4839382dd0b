"""Pairs of cloth features that may touch in a frame, and edges that go through faces, found in a tree of boxes.

The first search of a frame is of all patches. A later one is of the faces that have a stale vertex alone: one that is
by now further from where the search that last looked at it expected it than half of the slack that pairs have. No pair
is missed where both features are nearer than that to where they were expected.
"""

from pbd.contact.blocks import HIGH, LANES, LOW, NORMAL, Blocks, facing, features, overlapping, sides, take
from pbd.contact.box_tree import (
    BoxTree,
    first_from,
    flat,
    list_near_groups,
    lowest,
    update_cone,
    update_nodes,
    update_patch,
)
from pbd.contact.pair_sides import EDGE_SHARE, MovingCloth, PairBuffers, take_pair
from pbd.crossing_search import note_crossings
from pbd.engine import ti
from pbd.geometry import Byte2, Float1, Int1, Int2, Int3, Int4, Vec3, Vec4, Vec4Rows, vec3, xyz

__all__ = ["find_pairs"]

ROUNDING = 1e-5  # boxes of features may be so much further apart in the world than seen from one of them [m]


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
    nodes: Int4,
    neighbour_start: Int1,
    neighbours: Int1,
    common: Byte2,
    boxes: Vec3,
    patch_boxes: Blocks,
    face_blocks: Blocks,
    cones: Vec4,
    joined_start: Int1,
    joined: Int1,
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
    slack: ti.f32,
    longest: ti.f32,
    tangled: ti.i32,
    within: ti.i32,
    most: ti.i32,
):
    """Find the pairs that may touch in the next ``dt`` [s]; ``ready_pairs[0]`` receives how many there are.

    The search ends where it has found more than ``most``.

    All are found if ``anew``. Else those found before are kept, except those of stale faces, which are found again;
    ``elapsed`` [s] is the time since the frame's start, ``share`` the part left of what the last search looked ahead
    to; ``within`` says whether pairs of one layer are wanted. The other arguments are those of :class:`MovingCloth`,
    :class:`BoxTree` and :class:`PairBuffers`; over 12, because a kernel takes arrays one by one.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        search_pairs(
            anew,
            elapsed,
            dt,
            share,
            within,
            most,
            MovingCloth(
                position, velocity, displacement, normals, rest, landmarks, layer, wrong_side, seen_position,
                seen_velocity, stale, thickness, slack, longest, tangled,
            ),
            BoxTree(
                faces, owned, edges, patch_start, group_start, nodes, neighbour_start, neighbours, common, boxes,
                patch_boxes, face_blocks, cones, joined_start, joined, near_groups, stale_patches, stale_faces,
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
    within: ti.i32,
    most: ti.i32,
    cloth: ti.template(),
    tree: ti.template(),
    buffers: ti.template(),
):
    """See :func:`find_pairs`."""
    margin = 0.5 * (cloth.thickness + cloth.slack)
    layers = expect_motion(dt, cloth, buffers)
    find_stale(anew, elapsed, cloth, tree, buffers)
    for group in range(tree.group_start.shape[0] - 1):
        tree.stale_patches[group] = 0
        for patch in range(tree.group_start[group], tree.group_start[group + 1]):
            update_patch(group, patch, margin, layers, cloth, tree)
        update_cone(group, tree)
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
            near_count = list_near_groups(ti.select(anew != 0, group, 0), group, leaf, within, tree)
        leaf += 1
        while stale != 0 and buffers.ready_pairs[0] <= most:
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
        stale = anew != 0 or left.dot(left) > 0.25 * cloth.slack * cloth.slack
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
            neighbour = first_from(tree.neighbours, neighbour, last_neighbour, 2 * other)
            joined, hinged = False, 0
            if neighbour < last_neighbour:
                joined, hinged = tree.neighbours[neighbour] >> 1 == other, tree.neighbours[neighbour] & 1
            if joined and hinged != 0 and flat(tree.cones[patch], tree.cones[other]):
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
        cloth, tree, buffers: views of the garment, of its faces and of the pairs found.
    """
    low, high = take(tree.face_blocks, patch, LOW, lane), take(tree.face_blocks, patch, HIGH, lane)
    seconds = overlapping(tree.face_blocks, other, low, high)
    if other == patch:
        seconds &= -2 << lane
    if (tree.stale_faces[patch] >> lane) & 1 == 0:
        seconds &= tree.stale_faces[other]
    # Faces with a common corner that face nearly the same way do not touch. Up to a right angle they may cross.
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
            margin + ROUNDING, EDGE_SHARE * cloth.thickness + cloth.slack + ROUNDING,
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
