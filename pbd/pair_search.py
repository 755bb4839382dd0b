"""Pairs of cloth features that may touch in a frame, and edges that go through faces, found in a tree of boxes."""

from pbd.engine import ti
from pbd.geometry import Float1, Float2, Int1, Int2, Int3, Int4, Vec3, Vec4, Vec4Rows, vec3, vec4, xyz
from pbd.pairs import corners_of, meet
from pbd.tangles import note_crossings

__all__ = ["PATCH", "find_pairs"]

PATCH = 8  # most faces of a patch
SLACK = 0.003  # pairs are kept up to this distance beyond thickness and expected motion [m]
ALIKE = 0.5  # cosine of the greatest angle between two layers that face the same way [-]
EDGES = 0.5  # part of the thickness at which edges repel: vertices keep the sheets apart, edges from crossing [-]
NEVER = -1.0  # thickness of a pair that is never in contact [m]
NOT_YET = 1e30  # in the place of a box


@ti.func
def overlap(low_a: vec3, high_a: vec3, low_b: vec3, high_b: vec3):
    return (ti.max(low_a, low_b) <= ti.min(high_a, high_b)).all()


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
def bound_faces(
    patch: ti.i32,
    margin: ti.f32,
    position: ti.template(),
    course: ti.template(),
    faces: ti.template(),
    patch_start: ti.template(),
    face_boxes: ti.template(),
):
    """Boxes of a patch's faces over the way of a frame, if it has none yet: those that it lacks overlap nothing."""
    if face_boxes[patch, 0] == NOT_YET:
        for a in range(PATCH):
            low, high = vec3(1e30), vec3(-1e30)
            if patch_start[patch] + a < patch_start[patch + 1]:
                f = patch_start[patch] + a
                for b in range(3):
                    x = xyz(position[faces[f][b]])
                    y = x + course[faces[f][b]]
                    low = ti.min(low, ti.min(x, y))
                    high = ti.max(high, ti.max(x, y))
                low, high = low - margin, high + margin
            for axis in ti.static(range(3)):
                face_boxes[patch, axis * PATCH + a] = low[axis]
                face_boxes[patch, (3 + axis) * PATCH + a] = high[axis]


@ti.func
def faces_within(patch: ti.i32, low: vec3, high: vec3, face_boxes: ti.template()) -> ti.i32:
    """Bits of those faces of a patch whose boxes overlap a given one; the compiler takes all of them at once."""
    bits = 0
    for a in range(PATCH):
        hit = (face_boxes[patch, a] <= high[0]) & (face_boxes[patch, 3 * PATCH + a] >= low[0])
        hit &= (face_boxes[patch, PATCH + a] <= high[1]) & (face_boxes[patch, 4 * PATCH + a] >= low[1])
        hit &= (face_boxes[patch, 2 * PATCH + a] <= high[2]) & (face_boxes[patch, 5 * PATCH + a] >= low[2])
        bits |= ti.select(hit, 1 << a, 0)
    return bits


@ti.func
def share_corner(f, g):
    """Whether two faces have a corner in common."""
    found = False
    for a in ti.static(range(3)):
        found = found or f[0] == g[a] or f[1] == g[a] or f[2] == g[a]
    return found


@ti.func
def beside(
    f: ti.i32,
    g: ti.i32,
    reach: ti.f32,
    position: ti.template(),
    course: ti.template(),
    faces: ti.template(),
    face_normals: ti.template(),
):
    """Whether face g stays more than ``reach`` [m] to one side of the plane of face f."""
    normal = face_normals[f]
    origin, drift = xyz(position[faces[f][0]]), course[faces[f][0]]
    low, high = 1e30, -1e30
    for a in ti.static(range(3)):
        k = faces[g][a]
        height = (xyz(position[k]) - origin).dot(normal)
        rise = (course[k] - drift).dot(normal)
        low = ti.min(low, height + ti.min(rise, 0.0))
        high = ti.max(high, height + ti.max(rise, 0.0))
    return low > reach or high < -reach


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
    patch_vertex_start: Int1,
    patch_vertices: Int1,
    owned: Int1,
    edges: Int2,
    patch_start: Int1,
    nodes: Int3,
    neighbour_start: Int1,
    neighbours: Int1,
    boxes: Vec3,
    face_boxes: Float2,
    face_normals: Vec3,
    cones: Vec4,
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

    More than the buffers take are counted and left out. ``nodes`` are those of the tree in preorder: where to go on
    behind the node, its last patch, its patch if it is a leaf or else -1. ``owned``: of each face, bits of the corners
    and of the sides that belong to it. ``edges``: the ends of the three sides of each face. ``longest``: side at rest.
    ``strayed``: vertices on the wrong side of their own garment. ``crossed`` receives how many
    edges go through faces, and those for which it has room: their ends, and the face.
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
        for patch in range(patch_start.shape[0] - 1):
            low, high, axis = vec3(1e30), vec3(-1e30), vec3(0.0)
            for r in range(patch_vertex_start[patch], patch_vertex_start[patch + 1]):
                i = patch_vertices[r]
                x = xyz(position[i])
                y = x + course[i]
                low = ti.min(low, ti.min(x, y))
                high = ti.max(high, ti.max(x, y))
            for f in range(patch_start[patch], patch_start[patch + 1]):
                a, b, c = faces[f][0], faces[f][1], faces[f][2]
                x = xyz(position[a])
                normal = (xyz(position[b]) - x).cross(xyz(position[c]) - x)
                if layers > 0:
                    normals[a] += vec4(normal)
                    normals[b] += vec4(normal)
                    normals[c] += vec4(normal)
                normal /= ti.max(normal.norm(), 1e-20)
                face_normals[f] = normal
                axis += normal
            axis /= ti.max(axis.norm(), 1e-20)
            least = 1.0
            for f in range(patch_start[patch], patch_start[patch + 1]):
                least = ti.min(least, axis.dot(face_normals[f]))
            cones[patch] = vec4(axis, least)
            boxes[2 * (nodes.shape[0] + patch)] = low - margin
            boxes[2 * (nodes.shape[0] + patch) + 1] = high + margin
            face_boxes[patch, 0] = NOT_YET
        for r in range(nodes.shape[0]):
            node = nodes.shape[0] - 1 - r
            patch = nodes[node][2]
            if patch >= 0:
                boxes[2 * node] = boxes[2 * (nodes.shape[0] + patch)]
                boxes[2 * node + 1] = boxes[2 * (nodes.shape[0] + patch) + 1]
            else:
                one, other = node + 1, nodes[node + 1][0]
                boxes[2 * node] = ti.min(boxes[2 * one], boxes[2 * other])
                boxes[2 * node + 1] = ti.max(boxes[2 * one + 1], boxes[2 * other + 1])
        if layers > 0:
            for i in range(count):
                normals[i] /= ti.max(normals[i].norm(), 1e-20)
        ready[0] = 0
        ready[1] = 0
        crossed[0] = ti.Vector([0, 0, 0])
        fastest[0] = 0.0
        for patch in range(patch_start.shape[0] - 1):
            low = boxes[2 * (nodes.shape[0] + patch)]
            high = boxes[2 * (nodes.shape[0] + patch) + 1]
            node = 0
            while node < nodes.shape[0]:
                entry = nodes[node]
                if entry[1] < patch or not overlap(low, high, boxes[2 * node], boxes[2 * node + 1]):
                    node = entry[0]
                else:
                    node += 1
                    other = entry[2]
                    if other >= 0:
                        near = other == patch
                        for r in range(neighbour_start[patch], neighbour_start[patch + 1]):
                            if neighbours[r] == other:
                                near = True
                        flat = False
                        if near:
                            one, two = cones[patch], cones[other]
                            sine_1 = ti.sqrt(ti.max(1.0 - one[3] * one[3], 0.0))
                            sine_2 = ti.sqrt(ti.max(1.0 - two[3] * two[3], 0.0))
                            spread = sine_1 * two[3] + one[3] * sine_2
                            narrow = one[3] > 0.0 and two[3] > 0.0 and one[3] * two[3] > sine_1 * sine_2
                            flat = narrow and xyz(one).dot(xyz(two)) > spread
                        if not flat:
                            bound_faces(patch, margin, position, course, faces, patch_start, face_boxes)
                            bound_faces(other, margin, position, course, faces, patch_start, face_boxes)
                            other_low = boxes[2 * (nodes.shape[0] + other)]
                            other_high = boxes[2 * (nodes.shape[0] + other) + 1]
                            for f in range(patch_start[patch], patch_start[patch + 1]):
                                face_low, face_high = vec3(0.0), vec3(0.0)
                                for axis in ti.static(range(3)):
                                    face_low[axis] = face_boxes[patch, axis * PATCH + f - patch_start[patch]]
                                    face_high[axis] = face_boxes[patch, (3 + axis) * PATCH + f - patch_start[patch]]
                                second = 0
                                if overlap(face_low, face_high, other_low, other_high):
                                    second = faces_within(other, face_low, face_high, face_boxes)
                                if other == patch:
                                    second &= -2 << (f - patch_start[patch])
                                while second != 0:
                                    g = patch_start[other] + 31 - ti.math.clz(second & -second)
                                    second &= second - 1
                                    meets = True
                                    if near and face_normals[f].dot(face_normals[g]) > 0.0:
                                        meets = not share_corner(faces[f], faces[g])
                                    if meets:
                                        meets = not beside(f, g, 2.0 * margin, position, course, faces, face_normals)
                                    if meets:
                                        meets = not beside(g, f, 2.0 * margin, position, course, faces, face_normals)
                                    if meets:
                                        note_crossings(f, g, position, faces, edges, owned, face_normals, crossed)
                                        bits = owned_pairs(owned[f], owned[g])
                                        while bits != 0:
                                            q = feature_pair(f, g, 31 - ti.math.clz(bits & -bits), faces, edges)
                                            bits &= bits - 1
                                            if q[0] >= 0:
                                                take_pair(
                                                    q, position, course, rest, layer, strayed, normals,
                                                    old_pairs, old_normals, chain, pairs, data, ready, fastest,
                                                    thickness, longest,
                                                )  # fmt: skip
