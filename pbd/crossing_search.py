"""Kernels that find the crossings of a cloth: pairs of faces with boxes that overlap, and edges that go through faces.

Boxes are put into the cells of a grid, which is hashed (Teschner et al. 2003, "Optimized spatial hashing for collision
detection of deformable objects").
"""

import numpy as np

from pbd.engine import ti
from pbd.geometry import Double3, Int1, Int2, Int3, Vec3, Vec4, vec3

__all__ = ["find_crossings", "find_fan_crossings", "list_pairs", "note_crossings", "owned_features"]

CELL_EXTENTS = 1.5  # size of a cell over the mean of the boxes' longest sides [-]
LEVEL = 0.5  # least cosine between the normals around a vertex and their mean with which no two faces cross [-]
ROUNDING = 1e-6  # boxes so little apart count as overlapping [m]
MAX_CELLS = 8  # that a box may reach along an axis: cells are larger where one is very large


@ti.func
def goes_through(b, x1, x2, x3):
    """Whether the segment from the origin to b goes through a triangle.

    It does if its ends lie on different sides of the triangle's plane and its line passes inside the three sides. A
    segment that only touches a side, or lies in the plane, does not. For float32 and float64.
    """
    normal = (x2 - x1).cross(x3 - x1)
    sides = -x1.dot(normal) * (b - x1).dot(normal) < 0.0
    v1, v2, v3 = b.dot(x1.cross(x2)), b.dot(x2.cross(x3)), b.dot(x3.cross(x1))
    return sides and ((v1 > 0.0 and v2 > 0.0 and v3 > 0.0) or (v1 < 0.0 and v2 < 0.0 and v3 < 0.0))


@ti.func
def point(position: ti.template(), i: ti.i32):
    """Position of a vertex in the type that the array has [m]."""
    p = position[i]
    return ti.Vector([p[0], p[1], p[2]])


@ti.func
def note_crossings(
    f: ti.i32,
    g: ti.i32,
    position: ti.template(),
    faces: ti.template(),
    edges: ti.template(),
    owned: ti.template(),
    crossed: ti.template(),
):
    """Add the own sides of either of two faces that go through the other, if there is room for crossings at all."""
    if crossed.shape[0] > 1:
        for n in range(6):
            one, two, side = f, g, n
            if n >= 3:
                one, two, side = g, f, n - 3
            e, t = edges[3 * one + side], faces[two]
            shared = e[0] == t[0] or e[0] == t[1] or e[0] == t[2] or e[1] == t[0] or e[1] == t[1] or e[1] == t[2]
            if (owned[one] >> (3 + side)) & 1 and not shared:
                a = point(position, e[0])
                if goes_through(
                    point(position, e[1]) - a,
                    point(position, t[0]) - a,
                    point(position, t[1]) - a,
                    point(position, t[2]) - a,
                ):
                    count = crossed[0][0] + 1
                    crossed[0] = ti.Vector([count, 0, 0])
                    if count < crossed.shape[0]:
                        crossed[count] = ti.Vector([e[0], e[1], two])


def owned_features(faces: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Bits of the corners and sides that belong to each face, shape (m,).

    Each feature belongs to the first face that has it, so that no pair is found twice (Curtis, Tamstorf, Manocha 2008).

    Args:
        faces, sides: numbers of the corners and of the edges of each face, int, shapes (m, 3).
    """
    owned = np.zeros(len(faces), np.int32)
    for bit, features in ((0, faces), (3, sides)):
        _, first = np.unique(features.ravel(), return_index=True)
        np.bitwise_or.at(owned, first // 3, 1 << (bit + first % 3))
    return owned


@ti.kernel
def list_pairs(
    start: Double3,
    end: Double3,
    faces: Int3,
    chosen: Int1,
    margin: ti.f32,
    low: Vec3,
    high: Vec3,
    cells: Int3,
    heads: Int1,
    entries: Int3,
    pairs: Int2,
    counts: Int1,
):
    """List the pairs of chosen faces whose boxes over a motion overlap.

    Args:
        start, end: of the motion of each vertex [m]; ``margin``: by which each box is larger [m].
        faces, chosen: corners of all faces, and numbers of those that count.
        low, high, cells: workspace, a row for each face.
        heads, entries: workspace: of each hash its first entry; the face, the cell and the next entry of each entry.
        pairs: receives them; ``counts``: receives how many there are, and how many entries there would be.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        per_cell = fill_boxes(start, end, faces, chosen, margin, low, high)
        for r in range(heads.shape[0]):
            heads[r] = -1
        counts[0], counts[1] = 0, 0
        for c in range(chosen.shape[0]):
            first, last = ti.floor(low[c] * per_cell, ti.i32), ti.floor(high[c] * per_cell, ti.i32)
            cells[c] = first
            low_c, high_c = low[c], high[c]
            for x in range(first[0], last[0] + 1):
                for y in range(first[1], last[1] + 1):
                    for z in range(first[2], last[2] + 1):
                        key = (x & 1023) | (y & 1023) << 10 | (z & 1023) << 20
                        place = (x * 73856093 ^ y * 19349663 ^ z * 83492791) & (heads.shape[0] - 1)
                        entry = heads[place]
                        while entry >= 0:
                            d = entries[entry][0]
                            if entries[entry][1] == key and near_boxes(low_c, high_c, low[d], high[d]):
                                own = ti.max(first, cells[d])
                                # Of the cells that both have in common, the pair is noted in the lowest.
                                if own[0] == x and own[1] == y and own[2] == z:
                                    if counts[0] < pairs.shape[0]:
                                        pairs[counts[0]] = ti.Vector([chosen[d], chosen[c]])
                                    counts[0] += 1
                            entry = entries[entry][2]
                        if counts[1] < entries.shape[0]:
                            entries[counts[1]] = ti.Vector([c, key, heads[place]])
                            heads[place] = counts[1]
                        counts[1] += 1


@ti.func
def fill_boxes(
    start: ti.template(),
    end: ti.template(),
    faces: ti.template(),
    chosen: ti.template(),
    margin: ti.f32,
    low: ti.template(),
    high: ti.template(),
) -> ti.f32:
    """Fill the boxes of :func:`list_pairs`; returns one over the size of a cell [1/m]."""
    longest, total = 0.0, 0.0
    for c in range(chosen.shape[0]):
        f = faces[chosen[c]]
        least, most = ti.min(start[f[0]], end[f[0]]), ti.max(start[f[0]], end[f[0]])
        for k in ti.static((1, 2)):
            least = ti.min(least, ti.min(start[f[k]], end[f[k]]))
            most = ti.max(most, ti.max(start[f[k]], end[f[k]]))
        low[c], high[c] = least - margin, most + margin
        extent = (high[c] - low[c]).max()
        longest = ti.max(longest, extent)
        total += extent
    return 1.0 / ti.max(CELL_EXTENTS * total / chosen.shape[0], longest / MAX_CELLS)


@ti.func
def near_boxes(low_a: vec3, high_a: vec3, low_b: vec3, high_b: vec3):
    """Whether two boxes overlap. Their corners are rounded to float32, so that they overlap a little sooner."""
    apart = ti.max(ti.max(low_a - high_b, low_b - high_a), vec3(0.0))
    return apart.max() <= ROUNDING


@ti.func
def common(f, g):
    """How many corners two faces have in common."""
    count = 0
    for k in ti.static(range(3)):
        count += ti.select(f[k] == g[0] or f[k] == g[1] or f[k] == g[2], 1, 0)
    return count


@ti.kernel
def find_crossings(position: Double3, faces: Int3, edges: Int2, owned: Int1, pairs: Int2, count: ti.i32, crossed: Int3):
    """Find the edges that go through faces, of the first ``count`` pairs of faces; ``crossed``: as of Untangling."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        crossed[0] = ti.Vector([0, 0, 0])
        for r in range(count):
            f, g = pairs[r][0], pairs[r][1]
            if common(faces[f], faces[g]) < 2 and not (aside(f, g, position, faces) or aside(g, f, position, faces)):
                note_crossings(f, g, position, faces, edges, owned, crossed)


@ti.func
def aside(f: ti.i32, g: ti.i32, position: ti.template(), faces: ti.template()):
    """Whether face g lies on one side of the plane of face f."""
    origin = position[faces[f][0]]
    normal = (position[faces[f][1]] - origin).cross(position[faces[f][2]] - origin)
    a, b, c = (
        (position[faces[g][0]] - origin).dot(normal),
        (position[faces[g][1]] - origin).dot(normal),
        (position[faces[g][2]] - origin).dot(normal),
    )
    return (a >= 0.0 and b >= 0.0 and c >= 0.0) or (a <= 0.0 and b <= 0.0 and c <= 0.0)


@ti.kernel
def find_fan_crossings(
    position: Vec4,
    faces: Int3,
    edges: Int2,
    owned: Int1,
    fan_start: Int1,
    fan: Int1,
    branching: Int1,
    normals: Vec3,
    crossed: Int3,
):
    """Find the edges that go through faces with which their own face has one vertex in common.

    Faces around a vertex whose normals are all within 60 degrees of their mean do not cross: seen along the mean they
    lie beside one another. ``branching`` says where that is not so, because more than one sheet has the vertex.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        crossed[0] = ti.Vector([0, 0, 0])
        for f in range(faces.shape[0]):
            c = faces[f]
            a = point(position, c[0])
            n = (point(position, c[1]) - a).cross(point(position, c[2]) - a)
            normals[f] = n / ti.max(n.norm(), 1e-20)
        for i in range(position.shape[0]):
            mean = vec3(0.0)
            for r in range(fan_start[i], fan_start[i + 1]):
                mean += normals[fan[r]]
            folded, size = branching[i] != 0, mean.norm()
            for r in range(fan_start[i], fan_start[i + 1]):
                folded = folded or normals[fan[r]].dot(mean) < LEVEL * size
            if folded:
                for r in range(fan_start[i], fan_start[i + 1]):
                    for s in range(r + 1, fan_start[i + 1]):
                        if common(faces[fan[r]], faces[fan[s]]) == 1:
                            note_crossings(fan[r], fan[s], position, faces, edges, owned, crossed)
