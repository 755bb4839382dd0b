"""Pairs of cloth features that may touch in a frame, and edges that go through faces, found in a tree of boxes."""

from pbd.blocks import CORNERS, HIGH, LOW, NORMAL, WAYS, Blocks, facing, features, put, sides, take, within
from pbd.engine import ti
from pbd.geometry import Byte2, Float1, Int1, Int2, Int3, Int4, Vec3, Vec4, Vec4Rows, vec3, vec4, xyz
from pbd.pairs import corners_of, meet
from pbd.tangles import note_crossings

__all__ = ["find_pairs"]

SLACK = 0.003  # pairs are kept up to this distance beyond thickness and expected motion [m]
ALIKE = 0.5  # cosine of the greatest angle between two layers that face the same way [-]
EDGES = 0.5  # part of the thickness at which edges repel: vertices keep the sheets apart, edges from crossing [-]
ROUNDING = 1e-5  # that boxes of features may be further apart where they are than seen from one of them [m]
NEVER = -1.0  # thickness of a pair that is never in contact [m]


@ti.func
def overlap(low_a: vec3, high_a: vec3, low_b: vec3, high_b: vec3):
    return (ti.max(low_a, low_b) <= ti.min(high_a, high_b)).all()


@ti.func
def lowest(bits: ti.i32) -> ti.i32:
    """Place of the lowest bit that is set."""
    return 31 - ti.math.clz(bits & -bits)


@ti.func
def take_pair(
    q,
    position: ti.template(),
    course: ti.template(),
    rest: ti.template(),
    layer: ti.template(),
    strayed: ti.template(),
    normals: ti.template(),
    old_pairs: ti.template(),
    old_normals: ti.template(),
    chain: ti.template(),
    pairs: ti.template(),
    data: ti.template(),
    ready: ti.template(),
    fastest: ti.template(),
    thickness: ti.f32,
    longest: ti.f32,
):
    """Keep a pair if its features may touch in this frame."""
    k = corners_of(q)
    x0 = xyz(position[k[0]])
    x1, x2, x3 = xyz(position[k[1]]) - x0, xyz(position[k[2]]) - x0, xyz(position[k[3]]) - x0
    c0, c1, c2, c3 = course[k[0]], course[k[1]], course[k[2]], course[k[3]]
    layers = layer[k[0]] - layer[k[3]]
    own = layers == 0
    kept = thickness
    low, high = ti.min(vec3(0.0), c0), ti.max(vec3(0.0), c0)
    other_low = ti.min(ti.min(x2, x3), ti.min(x2 + c2, x3 + c3))
    other_high = ti.max(ti.max(x2, x3), ti.max(x2 + c2, x3 + c3))
    if q[1] < 0:
        kept *= EDGES
        low, high = ti.min(low, ti.min(x1, x1 + c1)), ti.max(high, ti.max(x1, x1 + c1))
    else:
        other_low, other_high = ti.min(other_low, ti.min(x1, x1 + c1)), ti.max(other_high, ti.max(x1, x1 + c1))
    least = kept + SLACK
    shares, across, offset = ti.math.vec4(0.0), vec3(0.0), vec3(0.0)
    size, way = 1e30, 0.0
    if overlap(low - least, high + least, other_low, other_high):
        shares, across, offset = meet(q, x1, x2, x3)
        way = (shares[0] * c0 + shares[1] * c1 + shares[2] * c2 + shares[3] * c3).norm()
        size = offset.norm()
    # Layers that face the same way, and are not so far through each other that it must be another fold of them, know
    # their sides: outwards from the inner one.
    outwards = vec3(0.0)
    if layers != 0:
        first, second = shares[0] * xyz(normals[k[0]]), -shares[2] * xyz(normals[k[2]]) - shares[3] * xyz(normals[k[3]])
        if q[1] < 0:
            first += shares[1] * xyz(normals[k[1]])
        else:
            second -= shares[1] * xyz(normals[k[1]])
        outwards = second
        if layers < 0:
            outwards = -first
        if first.dot(second) < ALIKE or (outwards.dot(offset) < 0.0 and size > 2.0 * thickness):
            layers = 0
    close = size < least + way
    old = -1
    if close and layers == 0:
        old = chain[k[0]]
        while old >= 0 and not (old_pairs[old] == q).all():
            old = chain[position.shape[0] + old]
        # Edges that seem so far through one another have gone around: crossings would have been told and pulled back.
        if old >= 0 and q[1] < 0 and old_normals[old][3] < -thickness:
            old = -1
    if close:
        fastest[0] = ti.max(fastest[0], way)
        c = ready[0]
        ready[0] += 1
        if c < pairs.shape[0]:
            normal, gap = offset / ti.max(size, 1e-20), size
            y0 = rest[k[0]]
            if layers == 0:
                if (rest[k[2]] - y0).norm() < thickness + 2.0 * longest:
                    _shares, _across, rest_offset = meet(q, rest[k[1]] - y0, rest[k[2]] - y0, rest[k[3]] - y0)
                    kept = ti.min(kept, rest_offset.norm())
                if across.dot(across) > 0.0:
                    normal = across
                    if across.dot(offset) < 0.0:
                        normal = -across
                if old >= 0:
                    remembered = xyz(old_normals[old])
                    if across.dot(across) > 0.0:
                        if remembered.dot(normal) < 0.0:
                            normal = -normal
                    elif old_normals[old][3] < 0.0:
                        normal = remembered
                        gap = -size
                # What is remembered as through needs nobody to tell; else, where cloth has strayed, edges have no
                # right side, and vertices the other one.
                doubtful = own and (old < 0 or old_normals[ti.max(old, 0)][3] >= 0.0)
                if q[1] < 0 and doubtful and strayed[k[0]] + strayed[k[1]] + strayed[k[2]] + strayed[k[3]] > 0:
                    kept = NEVER
                elif q[1] >= 0 and doubtful and strayed[k[0]] == 1:
                    if normal.dot(offset) > 0.0:
                        normal = -normal
                    gap = -size
            else:
                normal = outwards / ti.max(outwards.norm(), 1e-20)
            pairs[c] = q
            data[c, 0] = vec4(normal, kept)
            data[c, 1] = ti.math.vec4(gap, 1.0 if layers != 0 else 0.0, way, 0.0)


@ti.func
def flat(one, two):
    """Whether two patches that hang together cannot touch: all their normals, in cones (axis, cosine), look one way."""
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
    """Bits of those of the 15 pairs of features of two faces that belong to them, from the faces' own bits."""
    bits = (f & 7) | (g & 7) << 3
    for s in ti.static(range(3)):
        if (f >> (3 + s)) & 1:
            bits |= (g >> 3) << (6 + 3 * s)
    return bits


@ti.kernel
def find_pairs(
    position: Vec4,
    velocity: Vec3,
    course: Vec3,
    normals: Vec4,
    rest: Vec3,
    layer: Int1,
    strayed: Int1,
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
    old_pairs: Int4,
    old_normals: Vec4,
    chain: Int1,
    pairs: Int4,
    data: Vec4Rows,
    ready: Int1,
    crossed: Int3,
    fastest: Float1,
    dt: ti.f32,
    thickness: ti.f32,
    longest: ti.f32,
):
    """Find the pairs that may touch in a frame of ``dt`` [s]; ``ready[0]`` receives how many there are.

    More than the buffers take are counted and left out. Faces lie in patches, patches in groups, of eight at most.
    ``nodes`` are those of the tree over the groups in preorder: where to go on behind the node, its last group, its
    group if it is a leaf or else -1. ``neighbours``: of each patch those, itself too, that it has a vertex in common
    with, ascending; ``common``: for each of its faces, bits of the neighbour's that have one in common with it.
    ``owned``: of each face, bits of the corners and of the sides that belong to it. ``edges``: the ends of the three
    sides of each face. ``longest``: side at rest. ``strayed``: vertices on the wrong side of their own garment.
    ``crossed`` receives how many edges go through faces, and those for which it has room: their ends, and the face.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        count = position.shape[0]
        mean = vec3(0.0)
        for i in range(count):
            mean += velocity[i]
        mean /= count
        for i in range(count):
            course[i] = dt * (velocity[i] - mean)
            normals[i] = ti.math.vec4(0.0)
            chain[i] = -1
        for r in range(old_pairs.shape[0]):
            i = old_pairs[r][0]
            chain[count + r] = chain[i]
            chain[i] = r
        layers = 0
        for i in range(count):
            layers = ti.max(layers, layer[i])
        margin = 0.5 * (thickness + SLACK)
        # Boxes over the way of a frame, half of the least distance larger, and cones of the patches' normals.
        for group in range(group_start.shape[0] - 1):
            for patch in range(group_start[group], group_start[group + 1]):
                low, high, axis = vec3(1e30), vec3(-1e30), vec3(0.0)
                for f in range(patch_start[patch], patch_start[patch + 1]):
                    lane = f - patch_start[patch]
                    face_low, face_high = vec3(1e30), vec3(-1e30)
                    for k in ti.static(range(3)):
                        x, way = xyz(position[faces[f][k]]), course[faces[f][k]]
                        face_low = ti.min(face_low, ti.min(x, x + way))
                        face_high = ti.max(face_high, ti.max(x, x + way))
                        put(face_blocks, patch, CORNERS + 3 * k, lane, x)
                        put(face_blocks, patch, WAYS + 3 * k, lane, way)
                    x = xyz(position[faces[f][0]])
                    normal = (xyz(position[faces[f][1]]) - x).cross(xyz(position[faces[f][2]]) - x)
                    if layers > 0:
                        for k in ti.static(range(3)):
                            normals[faces[f][k]] += vec4(normal)
                    normal /= ti.max(normal.norm(), 1e-20)
                    axis += normal
                    put(face_blocks, patch, NORMAL, lane, normal)
                    put(face_blocks, patch, LOW, lane, face_low - margin)
                    put(face_blocks, patch, HIGH, lane, face_high + margin)
                    low, high = ti.min(low, face_low - margin), ti.max(high, face_high + margin)
                axis /= ti.max(axis.norm(), 1e-20)
                least = 1.0
                for lane in range(patch_start[patch + 1] - patch_start[patch]):
                    least = ti.min(least, axis.dot(take(face_blocks, patch, NORMAL, lane)))
                cones[patch] = vec4(axis, least)
                put(patch_boxes, group, LOW, patch - group_start[group], low)
                put(patch_boxes, group, HIGH, patch - group_start[group], high)
        for r in range(nodes.shape[0]):
            node = nodes.shape[0] - 1 - r
            group = nodes[node][2]
            low, high = vec3(1e30), vec3(-1e30)
            if group >= 0:
                for lane in range(group_start[group + 1] - group_start[group]):
                    low = ti.min(low, take(patch_boxes, group, LOW, lane))
                    high = ti.max(high, take(patch_boxes, group, HIGH, lane))
            else:
                one, other = node + 1, nodes[node + 1][0]
                low, high = ti.min(boxes[2 * one], boxes[2 * other]), ti.max(boxes[2 * one + 1], boxes[2 * other + 1])
            boxes[2 * node], boxes[2 * node + 1] = low, high
        if layers > 0:
            for i in range(count):
                normals[i] /= ti.max(normals[i].norm(), 1e-20)
        ready[0] = 0
        ready[1] = 0
        crossed[0] = ti.Vector([0, 0, 0])
        fastest[0] = 0.0
        leaf = 0  # of the group; leaves come in the order of the groups
        for group in range(group_start.shape[0] - 1):
            while nodes[leaf][2] < 0:
                leaf += 1
            near_count = 0  # groups near it, from itself on
            low, high = boxes[2 * leaf], boxes[2 * leaf + 1]
            leaf += 1
            node = 0
            while node < nodes.shape[0]:
                entry = nodes[node]
                if entry[1] < group or not overlap(low, high, boxes[2 * node], boxes[2 * node + 1]):
                    node = entry[0]
                else:
                    node += 1
                    if entry[2] >= 0:
                        near_groups[near_count] = entry[2]
                        near_count += 1
            for patch in range(group_start[group], group_start[group + 1]):
                low = take(patch_boxes, group, LOW, patch - group_start[group])
                high = take(patch_boxes, group, HIGH, patch - group_start[group])
                neighbour, last_neighbour = neighbour_start[patch], neighbour_start[patch + 1]
                for r in range(near_count):
                    others = within(patch_boxes, near_groups[r], low, high)
                    if near_groups[r] == group:
                        others &= -1 << (patch - group_start[group])
                    while others != 0:
                        place = lowest(others)
                        others &= others - 1
                        other = group_start[near_groups[r]] + place
                        while neighbour < last_neighbour and neighbours[neighbour] < other:
                            neighbour += 1
                        joined = neighbour < last_neighbour and neighbours[neighbour] == other
                        if joined and flat(cones[patch], cones[other]):
                            continue
                        other_low = take(patch_boxes, near_groups[r], LOW, place)
                        other_high = take(patch_boxes, near_groups[r], HIGH, place)
                        firsts = within(face_blocks, patch, other_low, other_high)
                        while firsts != 0:
                            lane = lowest(firsts)
                            firsts &= firsts - 1
                            seconds = within(
                                face_blocks, other,
                                take(face_blocks, patch, LOW, lane), take(face_blocks, patch, HIGH, lane),
                            )  # fmt: skip
                            if other == patch:
                                seconds &= -2 << lane
                            # Faces with a common corner that face the same way cannot touch.
                            shared = 0
                            if joined:
                                shared = seconds & ti.cast(common[neighbour, lane], ti.i32)
                            if shared != 0:
                                seconds &= ~(
                                    shared & facing(face_blocks, other, take(face_blocks, patch, NORMAL, lane))
                                )
                            uncut = 0
                            if seconds != 0:
                                beside, uncut = sides(face_blocks, patch, lane, other, 2.0 * margin)
                                seconds &= ~beside
                            if seconds != 0:
                                f = patch_start[patch] + lane
                                near = features(
                                    face_blocks, patch, lane, other,
                                    margin + ROUNDING, EDGES * thickness + SLACK + ROUNDING,
                                )  # fmt: skip
                                while seconds != 0:
                                    second = lowest(seconds)
                                    seconds &= seconds - 1
                                    g = patch_start[other] + second
                                    if (uncut >> second) & 1 == 0:
                                        note_crossings(f, g, position, faces, edges, owned, crossed)
                                    bits = near[second] & owned_pairs(owned[f], owned[g])
                                    while bits != 0:
                                        q = feature_pair(f, g, lowest(bits), faces, edges)
                                        bits &= bits - 1
                                        if q[0] >= 0:
                                            take_pair(
                                                q, position, course, rest, layer, strayed, normals,
                                                old_pairs, old_normals, chain, pairs, data, ready, fastest,
                                                thickness, longest,
                                            )  # fmt: skip
