"""Pairs of cloth features: what keeps them apart, and what brings back a vertex that is through a face."""

from pbd.contact.corrections import contact_correction
from pbd.contact.response import substep_start
from pbd.engine import ti
from pbd.geometry import closest_on_triangle, vec3, vec4, xyz

__all__ = ["PULL", "closest_on_segments", "closest_points", "corners_of", "pulled", "solve_pairs"]

PULL = 2.0  # kind of a pair whose vertex is to come back through the face
# A pair that may come nearer than this beyond its thickness until the next test is solved in every substep [m].
READY_DISTANCE = 0.001
FAR_GAP = 1.0  # gap of a pair that is not in contact, at any distance [m]
# A vertex moves at most by so many times the gap that is closed [-]. A free vertex with a small share, beside vertices
# that are held, would be flung away as by the short arm of a lever. Where all are free and of one mass, none moves by
# more than three quarters of the gap.
MAX_LEVER = 4.0


@ti.func
def closest_on_segments(along_a, along_b, offset):
    """Places in [0, 1] of the closest points of two segments (Ericson 2005, "Real-Time Collision Detection", 5.1.9).

    For float32 and float64.

    Args:
        along_a, along_b: from their starts to their ends [m].
        offset: start of a less start of b [m].
    """
    a, e, f = along_a.dot(along_a), along_b.dot(along_b), along_b.dot(offset)
    b, c = along_a.dot(along_b), along_a.dot(offset)
    size = a * e - b * b
    s = 0.0 * a + 0.5  # of the arguments' own type
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
def closest_points(q, x1: vec3, x2: vec3, x3: vec3):
    """Closest points of the two features of a pair whose first vertex is the origin.

    Returns:
        shares of its vertices (the first feature's sum to one, the second's to minus one), unit direction across both
        features (zero where the closest points lie on a rim), offset of the first feature from the second [m].
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
    """Shares, normal and gap [m] of a pair whose first vertex is the origin.

    Args:
        q, x1, x2, x3: the pair, and its other vertices [m].
        remembered: its last normal.
        kind: the second row of its data.
    """
    normal, gap = remembered, FAR_GAP
    may_turn = kind[0] >= 0.0 and kind[1] == 0.0
    shares, across, offset = closest_points(q, x1, x2, x3)
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
            if facing > 0.0 or may_turn:  # beyond a rim, a feature that is not through may go around; layers may not
                normal = offset / size
    return shares, normal, gap


@ti.func
def pulled(pairs: ti.template()):
    """Whether any vertex is pulled back through a face: pulls come last."""
    count = pairs.ready_pairs[0]
    return count > 0 and pairs.pair_data[ti.max(count - 1, 0), 1][1] == PULL


@ti.func
def solve_pairs(
    cloth: ti.template(),
    pairs: ti.template(),
    tests_all: ti.i32,
    test_share: ti.f32,
    kept_share: ti.f32,
    friction: ti.f32,
    h: ti.f32,
):
    """Keep the features of pairs apart: of all pairs if ``tests_all``, else of those that were near at the last test.

    Rows of ``pair_data``: normal and thickness; gap, kind (1 for two layers that know their sides, ``PULL``, else 0),
    how far its features go against each other in the frame [m]. A pull has the weights of a point of the face in the
    place of the normal, and last the side of the face that its vertex belongs to, 1 or -1. ``ready_pairs`` holds how
    many pairs there are, how many of them are near, and which.

    Args:
        cloth: view of the garment; ``pairs``: its :class:`pbd.xpbd.views.PairArrays`.
        test_share: for how much of the frame a test is good [-].
        kept_share: of their thickness that pairs keep [-]; what a pass with less than 1 finds is not remembered.
        friction: Coulomb coefficient [-].
        h: substep [s].
    """
    tested = pairs.ready_pairs[0] if tests_all else pairs.ready_pairs[1]
    if tests_all:
        pairs.ready_pairs[1] = 0
    for r in range(tested):
        c = r
        if not tests_all:
            c = pairs.ready_pairs[2 + r]
        q = pairs.pairs[c]
        k = corners_of(q)
        i0, i1, i2, i3 = k[0], k[1], k[2], k[3]
        p0, u0 = cloth.position[i0], xyz(cloth.position_delta[i0])
        x1 = (xyz(cloth.position[i1]) - xyz(p0)) + (xyz(cloth.position_delta[i1]) - u0)
        x2 = (xyz(cloth.position[i2]) - xyz(p0)) + (xyz(cloth.position_delta[i2]) - u0)
        x3 = (xyz(cloth.position[i3]) - xyz(p0)) + (xyz(cloth.position_delta[i3]) - u0)
        thickness = pairs.pair_data[c, 0][3]
        shares, normal, gap = ti.math.vec4(1.0, 0.0, 0.0, 0.0), vec3(0.0), FAR_GAP
        pair_friction = friction
        if pairs.pair_data[c, 1][1] == PULL:
            weights = xyz(pairs.pair_data[c, 0])
            shares = ti.math.vec4(1.0, -weights[0], -weights[1], -weights[2])
            normal = pairs.pair_data[c, 1][3] * (x2 - x1).cross(x3 - x1)
            normal /= ti.max(normal.norm(), 1e-20)
            gap = -(weights[0] * x1 + weights[1] * x2 + weights[2] * x3).dot(normal)
            pair_friction = 0.0
        else:
            shares, normal, gap = apart(q, x1, x2, x3, xyz(pairs.pair_data[c, 0]), pairs.pair_data[c, 1])
            if kept_share == 1.0:
                pairs.pair_data[c, 0] = vec4(normal, thickness)
        if gap < FAR_GAP and kept_share == 1.0:
            pairs.pair_data[c, 1][0] = gap
        if tests_all and gap < thickness + READY_DISTANCE + test_share * pairs.pair_data[c, 1][2]:
            pairs.ready_pairs[2 + pairs.ready_pairs[1]] = c
            pairs.ready_pairs[1] += 1
        if gap < kept_share * thickness:
            push_apart(k, shares, normal, gap, kept_share * thickness, pair_friction, cloth, h)


@ti.func
def push_apart(
    k, shares, normal: vec3, gap: ti.f32, thickness: ti.f32, friction: ti.f32, cloth: ti.template(), h: ti.f32
):
    """Bring the features of a pair of vertices ``k`` to their thickness; for shares see :func:`closest_points`."""
    i0, i1, i2, i3 = k[0], k[1], k[2], k[3]
    w = ti.math.vec4(cloth.position[i0][3], cloth.position[i1][3], cloth.position[i2][3], cloth.position[i3][3])
    effective_inverse_mass = (
        shares[0] * shares[0] * w[0]
        + shares[1] * shares[1] * w[1]
        + shares[2] * shares[2] * w[2]
        + shares[3] * shares[3] * w[3]
    )
    mobility = ti.abs(shares) * w
    effective_inverse_mass = ti.max(effective_inverse_mass, mobility.max() / MAX_LEVER)
    if effective_inverse_mass > 0.0:
        slip = (
            shares[0] * (xyz(cloth.position_delta[i0]) - substep_start(cloth, i0, h))
            + shares[1] * (xyz(cloth.position_delta[i1]) - substep_start(cloth, i1, h))
            + shares[2] * (xyz(cloth.position_delta[i2]) - substep_start(cloth, i2, h))
            + shares[3] * (xyz(cloth.position_delta[i3]) - substep_start(cloth, i3, h))
        )
        move = contact_correction(gap - thickness, normal, slip, friction, h)
        # A feature that is through comes back without speed: it would go on with it when it is out.
        back = vec3(0.0)
        if gap < 0.0:
            back = normal * ti.max(move.dot(normal) + ti.min(slip.dot(normal), 0.0), 0.0) / effective_inverse_mass
        move /= effective_inverse_mass
        give(i0, w[0] * shares[0], move, back, cloth, h)
        give(i1, w[1] * shares[1], move, back, cloth, h)
        give(i2, w[2] * shares[2], move, back, cloth, h)
        give(i3, w[3] * shares[3], move, back, cloth, h)


@ti.func
def give(i: ti.i32, share: ti.f32, move: vec3, back: vec3, cloth: ti.template(), h: ti.f32):
    """Give vertex i its share of a pair's move [m], and take that of the speed with which it came back."""
    cloth.position_delta[i] = vec4(xyz(cloth.position_delta[i]) + share * move)
    cloth.velocity_delta[i] = cloth.velocity_delta[i] - vec4(share / h * back)
