"""The faces of a garment in a tree of boxes: patches of eight, groups of eight patches, and nodes over the groups."""

from dataclasses import dataclass
from typing import Any

from pbd.contact.blocks import CORNERS, DISPLACEMENTS, HIGH, LOW, NORMAL, put, take
from pbd.engine import ti
from pbd.geometry import vec3, vec4, xyz
from pbd.taichi_internals import in_kernel

__all__ = [
    "BoxTree",
    "first_from",
    "flat",
    "list_near_groups",
    "lowest",
    "overlap",
    "update_cone",
    "update_nodes",
    "update_patch",
]


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
            group if it is a leaf, else -1, and the layer of all of its faces, -1 if they are of several.
        neighbour_start, neighbours: of each patch those, itself too, that it has a vertex in common with, ascending:
            each number doubled, and one added if both are in one piece and have an edge in common.
        common: for each neighbour and each face of the patch, bits of the neighbour's faces that share a vertex.
        boxes: low and high corner of each node [m], vec3.
        patch_boxes, face_blocks: see :mod:`pbd.contact.blocks`.
        cones: axis of the normals of each patch, and cosine of the greatest angle to it, vec4; then of each group.
        joined_start, joined: of each group those, itself too, that it has an edge in common with, ascending.
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
    joined_start: Any
    joined: Any
    near_groups: Any
    stale_patches: Any
    stale_faces: Any
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
def flat(one, two):
    """Whether two groups that share an edge cannot touch: all normals in their cones (axis, cosine) look one way."""
    sine_1, sine_2 = ti.sqrt(ti.max(1.0 - one[3] * one[3], 0.0)), ti.sqrt(ti.max(1.0 - two[3] * two[3], 0.0))
    narrow = one[3] > 0.0 and two[3] > 0.0 and one[3] * two[3] > sine_1 * sine_2
    return narrow and xyz(one).dot(xyz(two)) > sine_1 * two[3] + one[3] * sine_2


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
def update_cone(group: ti.i32, tree: ti.template()):
    """The cone of the normals of a group, from those of its patches."""
    axis = vec3(0.0)
    for patch in range(tree.group_start[group], tree.group_start[group + 1]):
        axis += xyz(tree.cones[patch])
    axis /= ti.max(axis.norm(), 1e-20)
    cosine = 1.0
    for patch in range(tree.group_start[group], tree.group_start[group + 1]):
        cone = tree.cones[patch]
        between = ti.math.clamp(axis.dot(xyz(cone)), -1.0, 1.0)
        sine = ti.sqrt(1.0 - between * between) * ti.sqrt(ti.max(1.0 - cone[3] * cone[3], 0.0))
        # Of the sum of both angles, which are together less than half a turn where both cosines are above 0.
        cosine = ti.min(cosine, ti.select(ti.min(between, cone[3]) > 0.0, between * cone[3] - sine, -1.0))
    tree.cones[tree.patch_start.shape[0] - 1 + group] = vec4(axis, cosine)


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
def first_from(sorted_numbers: ti.template(), place: ti.i32, end: ti.i32, number: ti.i32) -> ti.i32:
    """The first place from ``place`` on of a number that is not less, ``end`` for none."""
    while place < end:
        if sorted_numbers[place] >= number:
            break
        place += 1
    return place


@ti.func
def list_near_groups(first: ti.i32, group: ti.i32, leaf: ti.i32, within: ti.i32, tree: ti.template()) -> ti.i32:
    """Put the groups near a group, from a first one on, into ``near_groups``; returns how many.

    Those that share an edge with it and cannot touch it are left out, and, unless ``within`` layers is searched, those
    of its layer. ``leaf``: its own node.
    """
    near_count = 0
    patches = tree.patch_start.shape[0] - 1
    joined, last_joined = tree.joined_start[group], tree.joined_start[group + 1]
    low, high = tree.boxes[2 * leaf], tree.boxes[2 * leaf + 1]
    node = 0
    left_out = ti.select(within != 0, -2, tree.nodes[leaf][3])
    while node < tree.nodes.shape[0]:
        entry = tree.nodes[node]
        passed = entry[1] < first or entry[3] == left_out
        if passed or not overlap(low, high, tree.boxes[2 * node], tree.boxes[2 * node + 1]):
            node = entry[0]
        else:
            node += 1
            if entry[2] >= 0:
                joined = first_from(tree.joined, joined, last_joined, entry[2])
                beside = False
                if joined < last_joined:
                    beside = tree.joined[joined] == entry[2]
                if not (beside and flat(tree.cones[patches + group], tree.cones[patches + entry[2]])):
                    tree.near_groups[near_count] = entry[2]
                    near_count += 1
    return near_count
