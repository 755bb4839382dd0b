"""Boxes and faces eight beside each other, so that the compiler tests all eight at once.

A block has each component of its eight lanes beside each other. All blocks have a box in every lane. Blocks of faces
also have a normal, corners and their displacements. A lane without a face has a box that overlaps nothing.
"""

import numpy as np

from pbd.engine import ti
from pbd.geometry import larger, vec3

__all__ = [
    "CORNERS", "DISPLACEMENTS", "HIGH", "LANES", "LOW", "NORMAL", "Blocks", "empty_blocks", "facing", "features",
    "overlapping", "put", "sides", "take",
]  # fmt: skip

LANES = 8
Blocks = ti.types.ndarray(dtype=ti.types.vector(LANES, ti.f32), ndim=2)
# First component of each vector: the box over the motion of a frame; the unit normal, three corners and their
# displacements over the frame [m].
LOW, HIGH, NORMAL, CORNERS, DISPLACEMENTS = 0, 3, 6, 9, 18
BOX, FACE = 6, 27  # components of a block of boxes, and of faces


def empty_blocks(count: int, of_faces: bool) -> np.ndarray:
    """Blocks whose lanes are all empty: float32, shape (count, 6 or 27, 8)."""
    blocks = np.zeros((count, FACE if of_faces else BOX, LANES), np.float32)
    blocks[:, LOW:HIGH], blocks[:, HIGH:BOX] = 1e30, -1e30
    return blocks


@ti.func
def take(blocks: ti.template(), block: ti.i32, component: ti.template(), lane: ti.i32) -> vec3:
    """The vector of a lane whose first component is given."""
    return vec3(blocks[block, component][lane], blocks[block, component + 1][lane], blocks[block, component + 2][lane])


@ti.func
def put(blocks: ti.template(), block: ti.i32, component: ti.template(), lane: ti.i32, u: vec3):
    """Store what :func:`take` reads."""
    for axis in ti.static(range(3)):
        blocks[block, component + axis][lane] = u[axis]


@ti.func
def smaller(a: vec3, b: vec3) -> vec3:
    """The smaller of each component: see :func:`pbd.xpbd.constraints.larger`."""
    return ti.select(a < b, a, b)


@ti.func
def greater(a: vec3, b: vec3) -> vec3:
    """The greater of each component."""
    return ti.select(a > b, a, b)


@ti.func
def gap(low_a: vec3, high_a: vec3, low_b: vec3, high_b: vec3) -> ti.f32:
    """How far two boxes lie apart along the axis along which they do most [m]; at most 0 if they overlap."""
    one, other = low_b - high_a, low_a - high_b
    return larger(larger(larger(one[0], other[0]), larger(one[1], other[1])), larger(one[2], other[2]))


@ti.func
def overlapping(blocks: ti.template(), block: ti.i32, low: vec3, high: vec3) -> ti.i32:
    """Bits of the lanes whose boxes overlap a given one.

    Shifted by one until the end: the compiler treats a bit of 1 in its own way, and then not all eight lanes at once.
    """
    bits = 0
    for a in range(LANES):
        near = gap(take(blocks, block, LOW, a), take(blocks, block, HIGH, a), low, high) <= 0.0
        bits |= ti.select(near, 2 << a, 0)
    return bits >> 1


@ti.func
def facing(blocks: ti.template(), block: ti.i32, normal: vec3) -> ti.i32:
    """Bits of the faces whose normals are less than 60 degrees from a given one; shifted as in :func:`overlapping`."""
    bits = 0
    for a in range(LANES):
        bits |= ti.select(normal.dot(take(blocks, block, NORMAL, a)) > 0.5, 2 << a, 0)
    return bits >> 1


@ti.func
def sides(blocks: ti.template(), own: ti.i32, lane: ti.i32, block: ti.i32, reach: ti.f32):
    """On which sides of each other's planes one face and all faces of a block lie.

    Returns:
        bits of the faces for which, in all of the frame, the one or the other stays more than ``reach`` [m] to one side
        of the other's plane; bits of the faces for which it lies on one side of that plane at the start.
    """
    beside, uncut = 0, 0
    normal, origin = take(blocks, own, NORMAL, lane), take(blocks, own, CORNERS, lane)
    drift = take(blocks, own, DISPLACEMENTS, lane)
    for a in range(LANES):
        other_normal, other_origin = take(blocks, block, NORMAL, a), take(blocks, block, CORNERS, a)
        other_drift = take(blocks, block, DISPLACEMENTS, a)
        for own_plane in ti.static((True, False)):
            low, high, lowest, highest = 1e30, -1e30, 1e30, -1e30
            for k in ti.static(range(3)):
                height, rise = 0.0, 0.0
                if ti.static(own_plane):
                    height = (take(blocks, block, CORNERS + 3 * k, a) - origin).dot(normal)
                    rise = (take(blocks, block, DISPLACEMENTS + 3 * k, a) - drift).dot(normal)
                else:
                    height = (take(blocks, own, CORNERS + 3 * k, lane) - other_origin).dot(other_normal)
                    rise = (take(blocks, own, DISPLACEMENTS + 3 * k, lane) - other_drift).dot(other_normal)
                low, high = ti.select(height < low, height, low), larger(height, high)
                end_low, end_high = height + ti.select(rise < 0.0, rise, 0.0), height + larger(rise, 0.0)
                lowest, highest = ti.select(end_low < lowest, end_low, lowest), larger(end_high, highest)
            beside |= ti.select((lowest > reach) | (highest < -reach), 1 << a, 0)
            uncut |= ti.select((low >= 0.0) | (high <= 0.0), 1 << a, 0)
    return beside, uncut


@ti.func
def corner_box(blocks: ti.template(), block: ti.i32, corner: ti.template(), lane: ti.i32):
    """Box of a corner of a face over its motion in a frame."""
    x = take(blocks, block, CORNERS + 3 * corner, lane)
    y = x + take(blocks, block, DISPLACEMENTS + 3 * corner, lane)
    return smaller(x, y), greater(x, y)


@ti.func
def features(blocks: ti.template(), own: ti.i32, lane: ti.i32, block: ti.i32, face_reach: ti.f32, edge_reach: ti.f32):
    """For each face of a block bits of those of its 15 pairs of features with one face whose boxes are near.

    Args:
        blocks: of faces.
        own: block of the one face, and ``lane``: its place there.
        block: of the others.
        face_reach: from a vertex to the box of a face, beyond its margin [m].
        edge_reach: between two edges [m].

    Returns:
        three bits for vertices of the one and face of the other, three for the others', nine for sides.
    """
    bits = ti.Vector([0] * LANES)
    own_low, own_high = take(blocks, own, LOW, lane), take(blocks, own, HIGH, lane)
    low_0, high_0 = corner_box(blocks, own, 0, lane)
    low_1, high_1 = corner_box(blocks, own, 1, lane)
    low_2, high_2 = corner_box(blocks, own, 2, lane)
    for a in range(LANES):
        face_low, face_high = take(blocks, block, LOW, a), take(blocks, block, HIGH, a)
        near = ti.select(gap(low_0, high_0, face_low, face_high) <= face_reach, 1, 0)
        near |= ti.select(gap(low_1, high_1, face_low, face_high) <= face_reach, 2, 0)
        near |= ti.select(gap(low_2, high_2, face_low, face_high) <= face_reach, 4, 0)
        for k in ti.static(range(3)):
            low, high = corner_box(blocks, block, k, a)
            end_low, end_high = corner_box(blocks, block, (k + 1) % 3, a)
            near |= ti.select(gap(low, high, own_low, own_high) <= face_reach, 8 << k, 0)
            low, high = smaller(low, end_low), greater(high, end_high)
            near |= ti.select(gap(smaller(low_0, low_1), greater(high_0, high_1), low, high) <= edge_reach, 64 << k, 0)
            near |= ti.select(gap(smaller(low_1, low_2), greater(high_1, high_2), low, high) <= edge_reach, 512 << k, 0)
            near |= ti.select(
                gap(smaller(low_2, low_0), greater(high_2, high_0), low, high) <= edge_reach, 4096 << k, 0
            )
        bits[a] = near
    return bits
