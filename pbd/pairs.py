"""Pairs of cloth features: what keeps them apart, and what brings back a vertex that is through a face."""

from pbd.constraints import contact_correction
from pbd.contact import substep_start
from pbd.engine import ti
from pbd.geometry import closest_on_triangle, vec3, vec4, xyz

__all__ = ["PULL", "corners_of", "meet", "solve_pairs"]

PULL = 2.0  # kind of a pair whose vertex is to come back through the face
READY = 0.001  # a pair that may come nearer than this beyond its thickness until the next look is solved till then [m]
FAR_GAP = 1.0  # gap of a pair that is not in contact, whatever its distance [m]


@ti.func
def closest_on_segments(along_a: vec3, along_b: vec3, offset: vec3):
    """Places in [0, 1] of the closest points of two segments (Ericson 2005, "Real-Time Collision Detection", 5.1.9).

    Args:
        along_a, along_b: from their starts to their ends [m].
        offset: start of a less start of b [m].
    """
    a, e, f = along_a.dot(along_a), along_b.dot(along_b), along_b.dot(offset)
    b, c = along_a.dot(along_b), along_a.dot(offset)
    size = a * e - b * b
    s = 0.5
    if size > 1e-6 * a * e:
        s = ti.math.clamp((b * f - c * e) / size, 0.0, 1.0)
    t = (b * s + f) / ti.max(e, 1e-30)
    if t < 0.0:
        t = 0.0
        s = ti.math.clamp(-c / ti.max(a, 1e-30), 0.0, 1.0)
    elif t > 1.0:
        t = 1.0
        s = ti.math.clamp((b - c) / ti.max(a, 1e-30), 0.0, 1.0)
    return s, t


@ti.func
def meet(q, x1: vec3, x2: vec3, x3: vec3):
    """Closest points of a pair whose first vertex is the origin: shares of its vertices, direction across both
    features (zero where the closest points lie on a rim) and offset of the first feature from the second [m].

    The first feature's shares sum to one, the second's to minus one.
    """
    shares = ti.math.vec4(1.0, 0.0, 0.0, 0.0)
    across = vec3(0.0)
    if q[1] >= 0:
        w = closest_on_triangle(vec3(0.0), x1, x2, x3)
        shares = ti.math.vec4(1.0, -w[0], -w[1], -w[2])
        if w.min() > 0.0:
            across = (x2 - x1).cross(x3 - x1)
    else:
        s, t = closest_on_segments(x1, x3 - x2, -x2)
        shares = ti.math.vec4(1.0 - s, s, t - 1.0, -t)
        if s > 0.0 and s < 1.0 and t > 0.0 and t < 1.0:
            across = x1.cross(x3 - x2)
            if across.dot(across) < 0.01 * x1.dot(x1) * (x3 - x2).dot(x3 - x2):  # nearly parallel
                across = vec3(0.0)
    size = across.norm()
    if size > 0.0:
        across /= size
    return shares, across, shares[1] * x1 + shares[2] * x2 + shares[3] * x3


@ti.func
def corners_of(q):
    """Vertices of a pair (v, f0, f1, f2) or, with the mark of edges taken off, (a0, a1, b0, b1)."""
    k = q
    if q[1] < 0:
        k[1] = -q[1] - 1
    return k


@ti.func
def apart(q, x1: vec3, x2: vec3, x3: vec3, remembered: vec3, kind):
    """Shares, normal and gap [m] of a pair whose first vertex is the origin, from its last normal.

    ``kind`` is the second row of its data.
    """
    normal, gap = remembered, FAR_GAP
    may_turn = kind[0] >= 0.0 and kind[1] == 0.0
    shares, across, offset = meet(q, x1, x2, x3)
    if across.dot(across) > 0.0:
        if across.dot(normal) < 0.0:
            across = -across
        normal = across
        gap = offset.dot(normal)
    else:
        size = offset.norm()
        if size > 1e-9:
            facing = offset.dot(normal)
            if facing > 0.0:
                gap = size
            if facing > 0.0 or may_turn:  # beyond a rim what is not through may go around, but for layers
                normal = offset / size
    return shares, normal, gap


@ti.func
def solve_pairs(
    position: ti.template(),
    velocity: ti.template(),
    shift: ti.template(),
    gained: ti.template(),
    pairs: ti.template(),
    data: ti.template(),
    ready: ti.template(),
    looked_at: ti.i32,
    looks_share: ti.f32,
    friction: ti.f32,
    h: ti.f32,
):
    """Keep the features of pairs apart: of all where ``looked_at``, else of those that were near at the last look.

    Rows of ``data``: normal and thickness; gap, kind (1 for two layers that know their sides, ``PULL``, else 0), how
    far its features go against each other in the frame [m]. A pull has the weights of a point of the face in the place
    of the normal, and last the side of the face that its vertex belongs to, 1 or -1. ``ready`` holds how many pairs
    there are, how many of them are near, and which. A look is good for ``looks_share`` of the frame.
    """
    looks = ready[0] if looked_at else ready[1]
    if looked_at:
        ready[1] = 0
    for r in range(looks):
        c = r
        if not looked_at:
            c = ready[2 + r]
        q = pairs[c]
        k = corners_of(q)
        v0, v1, v2, v3 = k[0], k[1], k[2], k[3]
        p0, p1, p2, p3 = position[v0], position[v1], position[v2], position[v3]
        u0, u1, u2, u3 = xyz(shift[v0]), xyz(shift[v1]), xyz(shift[v2]), xyz(shift[v3])
        x1 = (xyz(p1) - xyz(p0)) + (u1 - u0)
        x2 = (xyz(p2) - xyz(p0)) + (u2 - u0)
        x3 = (xyz(p3) - xyz(p0)) + (u3 - u0)
        thickness = data[c, 0][3]
        shares, normal, gap = ti.math.vec4(1.0, 0.0, 0.0, 0.0), vec3(0.0), FAR_GAP
        held_by = friction
        if data[c, 1][1] == PULL:
            weights = xyz(data[c, 0])
            shares = ti.math.vec4(1.0, -weights[0], -weights[1], -weights[2])
            normal = data[c, 1][3] * (x2 - x1).cross(x3 - x1)
            normal /= ti.max(normal.norm(), 1e-20)
            gap = -(weights[0] * x1 + weights[1] * x2 + weights[2] * x3).dot(normal)
            held_by = 0.0
        else:
            shares, normal, gap = apart(q, x1, x2, x3, xyz(data[c, 0]), data[c, 1])
            data[c, 0] = vec4(normal, thickness)
        if gap < FAR_GAP:
            data[c, 1][0] = gap
        if looked_at and gap < thickness + READY + looks_share * data[c, 1][2]:
            ready[2 + ready[1]] = c
            ready[1] += 1
        if gap < thickness:
            give = (
                shares[0] * shares[0] * p0[3]
                + shares[1] * shares[1] * p1[3]
                + shares[2] * shares[2] * p2[3]
                + shares[3] * shares[3] * p3[3]
            )
            if give > 0.0:
                slip = (
                    shares[0] * (u0 - substep_start(velocity, gained, v0, h))
                    + shares[1] * (u1 - substep_start(velocity, gained, v1, h))
                    + shares[2] * (u2 - substep_start(velocity, gained, v2, h))
                    + shares[3] * (u3 - substep_start(velocity, gained, v3, h))
                )
                move = contact_correction(gap - thickness, normal, slip, held_by, h)
                # What is through comes back without speed: the rest would go on when it is out.
                back = vec3(0.0)
                if gap < 0.0:
                    back = normal * ti.max(move.dot(normal) + ti.min(slip.dot(normal), 0.0), 0.0) / give
                move /= give
                for a in ti.static(range(4)):
                    share = position[k[a]][3] * shares[a]
                    shift[k[a]] = vec4(xyz(shift[k[a]]) + share * move)
                    gained[k[a]] = gained[k[a]] - vec4(share / h * back)
