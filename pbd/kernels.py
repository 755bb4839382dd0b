"""The serial, fused schedule: one kernel a frame, all substeps inside.

Everything runs in one loop on one thread, in a fixed order, so results do not depend on the thread count. Constraints
come sorted by colour: an order that sweeps the mesh from one end to the other is unstable.
"""

from pbd.constraints import (
    contact_correction,
    drag_velocity,
    hinge_multiplier,
    membrane_multipliers,
    tether_correction,
)
from pbd.engine import ti

__all__ = ["FAR", "MAX_CELLS", "advance", "body_normals", "find_nearest"]

vec3 = ti.math.vec3
Vec4 = ti.types.ndarray(dtype=ti.math.vec4, ndim=1)
Vec3 = ti.types.ndarray(dtype=ti.math.vec3, ndim=1)
Int4 = ti.types.ndarray(dtype=ti.types.vector(4, ti.i32), ndim=1)
Int3 = ti.types.ndarray(dtype=ti.types.vector(3, ti.i32), ndim=1)
Int2 = ti.types.ndarray(dtype=ti.types.vector(2, ti.i32), ndim=1)
Int1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
Float1 = ti.types.ndarray(dtype=ti.f32, ndim=1)
Float2 = ti.types.ndarray(dtype=ti.f32, ndim=2)

FAR = 0.03  # bodies are looked for up to this distance from the cloth [m]
NEAR = 0.01  # nearer than this, a contact is looked at in every substep, even if nothing seems to move [m]
FINEST = 2.0**20  # inside a frame positions are whole multiples of 1 m / FINEST: exact in float32 up to 16 m
GRID_SIDE = 48
MAX_CELLS = GRID_SIDE**3


@ti.func
def xyz(p):
    return vec3(p[0], p[1], p[2])


@ti.func
def vec4(u: vec3):
    return ti.math.vec4(u[0], u[1], u[2], 0.0)


@ti.func
def closest_on_triangle(p: vec3, a: vec3, b: vec3, c: vec3) -> vec3:
    """Barycentric coordinates of the point of a triangle closest to p (Ericson 2005, section 5.1.5)."""
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = ab.dot(ap), ac.dot(ap)
    bp, cp = p - b, p - c
    d3, d4 = ab.dot(bp), ac.dot(bp)
    d5, d6 = ab.dot(cp), ac.dot(cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    result = vec3(1.0, 0.0, 0.0)
    if d1 <= 0.0 and d2 <= 0.0:
        result = vec3(1.0, 0.0, 0.0)
    elif d3 >= 0.0 and d4 <= d3:
        result = vec3(0.0, 1.0, 0.0)
    elif d6 >= 0.0 and d5 <= d6:
        result = vec3(0.0, 0.0, 1.0)
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        result = vec3(1.0 - t, t, 0.0)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        result = vec3(1.0 - t, 0.0, t)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        result = vec3(0.0, 1.0 - t, t)
    else:
        s = 1.0 / ti.max(va + vb + vc, 1e-30)
        result = vec3(va * s, vb * s, vc * s)
    return result


@ti.func
def descend(
    p: vec3,
    start: ti.i32,
    t: ti.f32,
    body_0: ti.template(),
    body_1: ti.template(),
    ring_start: ti.template(),
    ring: ti.template(),
) -> ti.i32:
    """Body vertex reached from ``start`` by walking to nearer neighbours; t in [0, 1] of the frame."""
    best = start
    offset = body_0[best] + t * (body_1[best] - body_0[best]) - p
    distance = offset.dot(offset)
    moved = True
    steps = 0
    while moved and steps < 16:
        moved = False
        steps += 1
        here = best
        for q in range(ring_start[here], ring_start[here + 1]):
            other = ring[q]
            offset = body_0[other] + t * (body_1[other] - body_0[other]) - p
            candidate = offset.dot(offset)
            if candidate < distance:
                distance = candidate
                best = other
                moved = True
    return best


@ti.kernel
def body_normals(vertices: Vec3, faces: Int3, normals: Vec3):
    """Unit vertex normals of a body, weighted by area."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(normals.shape[0]):
            normals[i] = vec3(0.0)
        for c in range(faces.shape[0]):
            f = faces[c]
            x0 = vertices[f[0]]
            n = (vertices[f[1]] - x0).cross(vertices[f[2]] - x0)
            for a in ti.static(range(3)):
                normals[f[a]] += n
        for i in range(normals.shape[0]):
            normals[i] /= ti.max(normals[i].norm(), 1e-20)


@ti.func
def body_point(face, weights: vec3, t: ti.f32, body_0: ti.template(), body_1: ti.template()) -> vec3:
    """Point of a body face at t in [0, 1] of the frame."""
    p = vec3(0.0)
    for a in ti.static(range(3)):
        b = face[a]
        p += weights[a] * (body_0[b] + t * (body_1[b] - body_0[b]))
    return p


@ti.func
def heaviest(corners, weights: vec3) -> ti.i32:
    best = corners[0]
    if weights[1] > weights[0] and weights[1] >= weights[2]:
        best = corners[1]
    elif weights[2] > weights[0]:
        best = corners[2]
    return best


@ti.func
def probed(
    b: ti.i32, t: ti.f32, body_0: ti.template(), body_1: ti.template(), probes: ti.template(), weights: ti.template()
) -> vec3:
    """Body vertex b, or beyond the vertices a probe, at t in [0, 1] of the frame."""
    x = vec3(0.0)
    if b < body_0.shape[0]:
        x = body_0[b] + t * (body_1[b] - body_0[b])
    else:
        x = body_point(probes[b - body_0.shape[0]], weights[b - body_0.shape[0]], t, body_0, body_1)
    return x


@ti.func
def search(
    position: ti.template(),
    velocity: ti.template(),
    dt: ti.f32,
    t: ti.f32,
    nearest: ti.template(),
    body_0: ti.template(),
    body_1: ti.template(),
    ring_start: ti.template(),
    ring: ti.template(),
    probes: ti.template(),
    weights: ti.template(),
    cell_start: ti.template(),
    cell_items: ti.template(),
):
    """Nearest body vertices at t in [0, 1] of the frame; after its start, for cloth vertices that have none yet.

    A uniform grid over the cloth's box, filled by counting sort. Cells are at least FAR wide, so that 27 of them hold
    everything within FAR. Body vertices in no face are passed over.
    """
    low = vec3(1e30)
    high = vec3(-1e30)
    for i in range(position.shape[0]):
        p = xyz(position[i]) + t * dt * velocity[i]
        low = ti.min(low, p)
        high = ti.max(high, p)
    low -= FAR
    high += FAR
    size = high - low
    cell = ti.max(FAR, size.max() / GRID_SIDE * 1.0001)
    nx = ti.min(int(size[0] / cell) + 1, GRID_SIDE)
    ny = ti.min(int(size[1] / cell) + 1, GRID_SIDE)
    nz = ti.min(int(size[2] / cell) + 1, GRID_SIDE)
    for c in range(nx * ny * nz + 1):
        cell_start[c] = 0
    count = body_0.shape[0] + probes.shape[0]
    for b in range(count):
        q = (probed(b, t, body_0, body_1, probes, weights) - low) / cell
        in_face = b >= body_0.shape[0] or ring_start[b] < ring_start[b + 1]
        if in_face and q.min() >= 0.0 and q[0] < nx and q[1] < ny and q[2] < nz:
            cell_start[(int(q[0]) * ny + int(q[1])) * nz + int(q[2]) + 1] += 1
    for c in range(nx * ny * nz):
        cell_start[c + 1] += cell_start[c]
    total = cell_start[nx * ny * nz]
    # Filled from the back, cell c starts at cell_start[c + 1] in the end.
    for r in range(count):
        b = count - 1 - r
        q = (probed(b, t, body_0, body_1, probes, weights) - low) / cell
        in_face = b >= body_0.shape[0] or ring_start[b] < ring_start[b + 1]
        if in_face and q.min() >= 0.0 and q[0] < nx and q[1] < ny and q[2] < nz:
            c = (int(q[0]) * ny + int(q[1])) * nz + int(q[2]) + 1
            cell_start[c] -= 1
            cell_items[cell_start[c]] = b
    cell_start[nx * ny * nz + 1] = total

    for i in range(position.shape[0]):
        p = xyz(position[i]) + t * dt * velocity[i]
        best = -1
        distance = FAR * FAR
        if nearest[i] >= 0 and t == 0.0:
            followed = descend(p, nearest[i], 0.0, body_0, body_1, ring_start, ring)
            offset = body_0[followed] - p
            nearest[i] = -1
            if offset.dot(offset) < 4.0 * FAR * FAR:
                best = followed
                distance = ti.min(distance, offset.dot(offset))
        if nearest[i] < 0:
            q = (p - low) / cell
            qx, qy, qz = int(q[0]), int(q[1]), int(q[2])
            for ix in range(ti.max(qx - 1, 0), ti.min(qx + 2, nx)):
                for iy in range(ti.max(qy - 1, 0), ti.min(qy + 2, ny)):
                    # Cells along z lie next to one another: one run of items.
                    row = (ix * ny + iy) * nz + 1
                    first = cell_start[row + ti.max(qz - 1, 0)]
                    last = cell_start[row + ti.min(qz + 2, nz)]
                    for s in range(first, last):
                        b = cell_items[s]
                        offset = probed(b, t, body_0, body_1, probes, weights) - p
                        candidate = offset.dot(offset)
                        if candidate < distance:
                            distance = candidate
                            best = b
            if best >= body_0.shape[0]:
                probe = best - body_0.shape[0]
                best = heaviest(probes[probe], weights[probe])
            nearest[i] = best


@ti.kernel
def find_nearest(
    position: Vec4,
    velocity: Vec3,
    samples: Int2,
    nearest: Int1,
    body_0: Vec3,
    body_1: Vec3,
    ring_start: Int1,
    ring: Int1,
    probes: Int3,
    weights: Vec3,
    cell_start: Int1,
    cell_items: Int1,
    dt: ti.f32,
    passes: ti.i32,
):
    """For every contact sample the nearest body vertex within FAR, or the one that it had, followed; else -1.

    Searched at the start of the frame and, where body or cloth move far in it, at later times on the cloth's present
    course. Large body faces are found by probes, points spread over them, which stand for their heaviest corner.

    The first samples are the vertices themselves; the others stand in the middle of long edges and search from what
    the ends of their edge found.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        for k in range(passes):
            t = k / ti.max(passes - 1.0, 1.0)
            search(
                position, velocity, dt, t, nearest, body_0, body_1,
                ring_start, ring, probes, weights, cell_start, cell_items,
            )  # fmt: skip
        for c in range(position.shape[0], samples.shape[0]):
            p = 0.5 * (xyz(position[samples[c][0]]) + xyz(position[samples[c][1]]))
            best = -1
            distance = 1e30
            for a in ti.static(range(3)):
                start = nearest[c]
                reach = 4.0 * FAR * FAR  # of the vertex that it had; what an end found is near enough
                if ti.static(a < 2):
                    start = nearest[samples[c][a]]
                    reach = 1e30
                if start >= 0:
                    found = descend(p, start, 0.0, body_0, body_1, ring_start, ring)
                    offset = body_0[found] - p
                    if offset.dot(offset) < ti.min(distance, reach):
                        distance = offset.dot(offset)
                        best = found
            nearest[c] = best


@ti.func
def solve_membrane(
    position: ti.template(),
    shift: ti.template(),
    triangles: ti.template(),
    data: ti.template(),
    inverse_h2: ti.f32,
    squeeze: ti.f32,
):
    for c in range(triangles.shape[0]):
        i, j, k = triangles[c][0], triangles[c][1], triangles[c][2]
        p0, p1, p2 = position[i], position[j], position[k]
        u0, u1, u2 = xyz(shift[i]), xyz(shift[j]), xyz(shift[k])
        b00, b01, b10, b11 = data[c, 0], data[c, 1], data[c, 2], data[c, 3]
        g = membrane_multipliers(
            (xyz(p1) - xyz(p0)) + (u1 - u0),
            (xyz(p2) - xyz(p0)) + (u2 - u0),
            ti.math.vec4(b00, b01, b10, b11),
            vec3(data[c, 4], data[c, 5], data[c, 6]),
            ti.math.vec4(data[c, 7], data[c, 8], data[c, 9], data[c, 10]) * inverse_h2,
            data[c, 11],
            squeeze,
        )
        gu, gv = vec3(g[0, 0], g[1, 0], g[2, 0]), vec3(g[0, 1], g[1, 1], g[2, 1])
        shift[i] = vec4(u0 - p0[3] * ((b00 + b10) * gu + (b01 + b11) * gv))
        shift[j] = vec4(u1 + p1[3] * (b00 * gu + b01 * gv))
        shift[k] = vec4(u2 + p2[3] * (b10 * gu + b11 * gv))


@ti.func
def solve_bending(
    position: ti.template(), shift: ti.template(), hinges: ti.template(), data: ti.template(), inverse_h2: ti.f32
):
    for c in range(hinges.shape[0]):
        q = hinges[c]
        p0, p1, p2, p3 = position[q[0]], position[q[1]], position[q[2]], position[q[3]]
        u0, u1, u2, u3 = xyz(shift[q[0]]), xyz(shift[q[1]]), xyz(shift[q[2]]), xyz(shift[q[3]])
        rows = ti.math.vec4(data[c, 0], data[c, 1], data[c, 2], data[c, 3])
        x0 = xyz(p0)
        multiplier = hinge_multiplier(
            (xyz(p1) - x0) + (u1 - u0),
            (xyz(p2) - x0) + (u2 - u0),
            (xyz(p3) - x0) + (u3 - u0),
            rows,
            1.0 / (data[c, 4] + data[c, 5] * inverse_h2),
        )
        shift[q[0]] = vec4(u0 + p0[3] * rows[0] * multiplier)
        shift[q[1]] = vec4(u1 + p1[3] * rows[1] * multiplier)
        shift[q[2]] = vec4(u2 + p2[3] * rows[2] * multiplier)
        shift[q[3]] = vec4(u3 + p3[3] * rows[3] * multiplier)


@ti.func
def surface_normals(position: ti.template(), triangles: ti.template(), scratch: ti.template()):
    """Unit vertex normals into columns 3..5 of scratch."""
    for i in range(position.shape[0]):
        for a in ti.static(range(3)):
            scratch[i, 3 + a] = 0.0
    for c in range(triangles.shape[0]):
        i, j, k = triangles[c][0], triangles[c][1], triangles[c][2]
        x0 = xyz(position[i])
        n = (xyz(position[j]) - x0).cross(xyz(position[k]) - x0)
        for a in ti.static(range(3)):
            scratch[i, 3 + a] += n[a]
            scratch[j, 3 + a] += n[a]
            scratch[k, 3 + a] += n[a]
    for i in range(position.shape[0]):
        n = vec3(scratch[i, 3], scratch[i, 4], scratch[i, 5])
        n /= ti.max(n.norm(), 1e-20)
        for a in ti.static(range(3)):
            scratch[i, 3 + a] = n[a]


@ti.func
def body_motion(face, weights: vec3, body_0: ti.template(), body_1: ti.template()) -> vec3:
    """Motion of a point of a body face over the frame [m]."""
    d = vec3(0.0)
    for a in ti.static(range(3)):
        b = face[a]
        d += weights[a] * (body_1[b] - body_0[b])
    return d


@ti.func
def touch_body(
    p: vec3,
    i: ti.i32,
    t: ti.f32,
    nearest: ti.template(),
    body_0: ti.template(),
    body_1: ti.template(),
    faces: ti.template(),
    ring_start: ti.template(),
    ring: ti.template(),
    fan_start: ti.template(),
    fan: ti.template(),
    normals: ti.template(),
    touch: ti.template(),
):
    """Find again where sample i touches: weights (columns 0..2), body face (3) and normal (4..6) of ``touch``."""
    b = descend(p, nearest[i], t, body_0, body_1, ring_start, ring)
    nearest[i] = b
    best_distance = 1e30
    best_face = -1
    best_weights = vec3(0.0)
    searching = True
    hops = 0
    while searching and hops < 8:
        searching = False
        hops += 1
        for q in range(fan_start[b], fan_start[b + 1]):
            f = faces[fan[q]]
            x0 = body_0[f[0]] + t * (body_1[f[0]] - body_0[f[0]])
            x1 = body_0[f[1]] + t * (body_1[f[1]] - body_0[f[1]])
            x2 = body_0[f[2]] + t * (body_1[f[2]] - body_0[f[2]])
            weights = closest_on_triangle(p, x0, x1, x2)
            offset = weights[0] * x0 + weights[1] * x1 + weights[2] * x2 - p
            distance = offset.dot(offset)
            if distance < best_distance:
                best_distance = distance
                best_face = fan[q]
                best_weights = weights
                # On the rim of the fan: the closest face may lie beyond it.
                at_rim = True
                for a in ti.static(range(3)):
                    if f[a] == b and weights[a] > 0.0:
                        at_rim = False
                searching = at_rim
        if searching:
            b = heaviest(faces[best_face], best_weights)
    f = faces[best_face]
    normal = best_weights[0] * normals[f[0]] + best_weights[1] * normals[f[1]] + best_weights[2] * normals[f[2]]
    if best_weights.min() > 0.0:  # inside a face, its own normal knows the side, however sharp the body's edges
        x0 = body_0[f[0]] + t * (body_1[f[0]] - body_0[f[0]])
        x1 = body_0[f[1]] + t * (body_1[f[1]] - body_0[f[1]])
        x2 = body_0[f[2]] + t * (body_1[f[2]] - body_0[f[2]])
        normal = (x1 - x0).cross(x2 - x0)
    normal /= ti.max(normal.norm(), 1e-20)
    # The smooth normal decides the side; the exact direction to the surface, where there is one, is the contact's.
    offset = p - body_point(f, best_weights, t, body_0, body_1)
    size = offset.norm()
    if size > 1e-4:
        exact = offset / size
        along = exact.dot(normal)
        if along > 0.5:
            normal = exact
        elif along < -0.5:
            normal = -exact
    touch[i, 3] = ti.cast(best_face, ti.f32)
    for a in ti.static(range(3)):
        touch[i, a] = best_weights[a]
        touch[i, 4 + a] = normal[a]


@ti.func
def settle(position: ti.template(), shift: ti.template(), i: ti.i32, u: vec3):
    """Move vertex i by u [m]: whole steps go to the position, the rest to the shift; nothing is rounded away."""
    whole = ti.floor(u * FINEST + 0.5) / FINEST
    position[i] += ti.math.vec4(whole[0], whole[1], whole[2], 0.0)
    shift[i] = vec4(u - whole)


@ti.func
def substep_start(velocity: ti.template(), scratch: ti.template(), i: ti.i32, h: ti.f32) -> vec3:
    """Shift of vertex i at the start of the substep [m]."""
    v = velocity[i] + vec3(scratch[i, 6], scratch[i, 7], scratch[i, 8])
    return vec3(scratch[i, 0], scratch[i, 1], scratch[i, 2]) - h * v


@ti.func
def collide_primitives(
    p: vec3,
    u: vec3,
    slip: vec3,
    t: ti.f32,
    dt_share: ti.f32,
    primitives: ti.template(),
    thickness: ti.f32,
    friction: ti.f32,
    h: ti.f32,
):
    """Correction by planes (0), spheres (1), capsules (2); rows: kind, radius, a0, b0, a1, b1 (start, end)."""
    total = vec3(0.0)
    for c in range(primitives.shape[0]):
        kind = int(primitives[c, 0])
        a0 = vec3(primitives[c, 2], primitives[c, 3], primitives[c, 4])
        b0 = vec3(primitives[c, 5], primitives[c, 6], primitives[c, 7])
        da = vec3(primitives[c, 8], primitives[c, 9], primitives[c, 10]) - a0
        db = vec3(primitives[c, 11], primitives[c, 12], primitives[c, 13]) - b0
        a, b = a0 + t * da, b0 + t * db
        here = p + (u + total)
        normal = b
        gap = ((p - a) + (u + total)).dot(b) - thickness
        carried = da * dt_share  # motion of the touched point over the substep
        if kind > 0:
            centre = a
            if kind == 2:
                axis = b - a
                share = ti.math.clamp((here - a).dot(axis) / ti.max(axis.dot(axis), 1e-20), 0.0, 1.0)
                centre = a + share * axis
                carried = (da + share * (db - da)) * dt_share
            offset = (p - centre) + (u + total)
            size = offset.norm()
            normal = vec3(0.0, 1.0, 0.0)
            if size > 1e-9:
                normal = offset / size
            gap = size - primitives[c, 1] - thickness
        total += contact_correction(gap, normal, slip + total - carried, friction, h)
    return total


@ti.kernel
def advance(
    position: Vec4,
    velocity: Vec3,
    shift: Vec4,
    scratch: Float2,
    touch: Float2,
    samples: Int2,
    triangles: Int3,
    triangle_data: Float2,
    hinges: Int4,
    hinge_data: Float2,
    tethers: Int2,
    tether_lengths: Float1,
    held: Int1,
    target_0: Vec3,
    target_1: Vec3,
    drag: Float1,
    primitives: Float2,
    nearest: Int1,
    contact: Vec4,
    body_0: Vec3,
    body_1: Vec3,
    body_normals: Vec3,
    body_faces: Int3,
    ring_start: Int1,
    ring: Int1,
    fan_start: Int1,
    fan: Int1,
    substeps: ti.i32,
    h: ti.f32,
    gravity: vec3,
    wind: vec3,
    squeeze: ti.f32,
    thickness: ti.f32,
    friction: ti.f32,
    refresh: ti.i32,
    awake: ti.f32,
):
    """Advance a garment by ``substeps`` steps of h [s].

    Per substep: predict, held vertices, membrane, bending, tethers, contact, velocities. Digits are kept in three
    places: a vertex stands at ``position`` (on a grid) plus a small ``shift`` that takes the corrections; velocity
    takes (shift - predicted shift)/h, the sum of the corrections, instead of a difference of world positions; and what
    it gains over the frame is summed apart. ``scratch`` holds predicted shifts (0..2), normals (3..5), gains (6..8).

    Every ``refresh`` substeps all contact samples are looked at, and those nearer to the body than ``awake`` [m] find
    again where they touch; in between, only these are looked at.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        inverse_h = 1.0 / h
        inverse_h2 = inverse_h * inverse_h
        count = position.shape[0]
        share = 1.0 / substeps
        surface_normals(position, triangles, scratch)
        for i in range(count):
            p = xyz(position[i])
            x = ti.floor(p * FINEST + 0.5) / FINEST
            position[i] = ti.math.vec4(x[0], x[1], x[2], position[i][3])
            shift[i] = vec4(p - x)
            for a in ti.static(range(3)):
                scratch[i, 6 + a] = 0.0
        for c in range(held.shape[0]):
            velocity[held[c]] = (target_1[c] - target_0[c]) * (inverse_h * share)
        for step in range(substeps):
            t = (step + 1) * share
            for i in range(count):
                u = xyz(shift[i])
                if position[i][3] > 0.0:
                    gained = h * gravity
                    v = velocity[i] + (vec3(scratch[i, 6], scratch[i, 7], scratch[i, 8]) + gained)
                    normal = vec3(scratch[i, 3], scratch[i, 4], scratch[i, 5])
                    dragged = drag_velocity(v - wind, normal, h * drag[i])
                    gained += dragged
                    u += h * (v + dragged)
                    for a in ti.static(range(3)):
                        scratch[i, 6 + a] += gained[a]
                settle(position, shift, i, u)
                for a in ti.static(range(3)):
                    scratch[i, a] = shift[i][a]
            for c in range(held.shape[0]):
                i = held[c]
                u = (target_0[c] - xyz(position[i])) + t * (target_1[c] - target_0[c])
                for a in ti.static(range(3)):
                    scratch[i, a] = u[a]
                    scratch[i, 6 + a] = 0.0
                shift[i] = vec4(u)

            solve_membrane(position, shift, triangles, triangle_data, inverse_h2, squeeze)
            solve_bending(position, shift, hinges, hinge_data, inverse_h2)
            for c in range(tethers.shape[0]):
                i, j = tethers[c][0], tethers[c][1]
                u = xyz(shift[i])
                offset = (xyz(position[i]) - xyz(position[j])) + (u - xyz(shift[j]))
                shift[i] = vec4(u + tether_correction(offset, tether_lengths[c]))

            for c in range(samples.shape[0]):
                i, j = samples[c][0], samples[c][1]
                p, q = position[i], position[j]
                weight = 0.25 * (p[3] + q[3])
                looked_at = step % refresh == 0
                if nearest[c] >= 0 and weight > 0.0 and (looked_at or touch[c, 7] < awake):
                    x = 0.5 * (xyz(p) + xyz(q))
                    u = 0.5 * (xyz(shift[i]) + xyz(shift[j]))
                    if looked_at and (step == 0 or touch[c, 7] < awake):
                        touch_body(
                            x + u, c, t, nearest, body_0, body_1, body_faces,
                            ring_start, ring, fan_start, fan, body_normals, touch,
                        )  # fmt: skip
                    face = body_faces[int(touch[c, 3])]
                    weights = vec3(touch[c, 0], touch[c, 1], touch[c, 2])
                    normal = vec3(touch[c, 4], touch[c, 5], touch[c, 6])
                    surface = body_point(face, weights, t, body_0, body_1)
                    distance = ((x - surface) + u).dot(normal)
                    touch[c, 7] = distance
                    if distance < thickness:
                        slip = u - 0.5 * (
                            substep_start(velocity, scratch, i, h) + substep_start(velocity, scratch, j, h)
                        )
                        slip -= share * body_motion(face, weights, body_0, body_1)
                        m = contact_correction(distance - thickness, normal, slip, friction, h)
                        m *= 0.5 / weight
                        # A vertex is a sample with both ends the same: half and half make the whole.
                        shift[i] = vec4(xyz(shift[i]) + p[3] * m)
                        if i != j:
                            shift[j] = vec4(xyz(shift[j]) + q[3] * m)
            for i in range(count):
                u = xyz(shift[i])
                if position[i][3] > 0.0:
                    slip = u - substep_start(velocity, scratch, i, h)
                    u += collide_primitives(xyz(position[i]), u, slip, t, share, primitives, thickness, friction, h)
                    for a in ti.static(range(3)):
                        scratch[i, 6 + a] += (u[a] - scratch[i, a]) * inverse_h
                shift[i] = vec4(u)
        for i in range(count):
            u = xyz(shift[i])
            position[i] += ti.math.vec4(u[0], u[1], u[2], 0.0)
            velocity[i] += vec3(scratch[i, 6], scratch[i, 7], scratch[i, 8])
        for i in range(count):
            contact[i] = ti.math.vec4(FAR, 0.0, 0.0, 0.0)
            if nearest[i] >= 0 and position[i][3] > 0.0:
                face = body_faces[int(touch[i, 3])]
                weights = vec3(touch[i, 0], touch[i, 1], touch[i, 2])
                normal = vec3(touch[i, 4], touch[i, 5], touch[i, 6])
                surface = body_point(face, weights, 1.0, body_0, body_1)
                carried = body_motion(face, weights, body_0, body_1) * (inverse_h * share)
                slip = velocity[i] - carried
                slip -= slip.dot(normal) * normal
                distance = ti.math.clamp((xyz(position[i]) - surface).dot(normal), -FAR, FAR)
                contact[i] = ti.math.vec4(distance, slip[0], slip[1], slip[2])
