"""Where a vertex of the fine cloth goes that has not its clearance from the body, and what it lifts around it."""

from pbd.engine import ti
from pbd.geometry import descend, vec3, vec4, xyz
from wrinkles.covered_body import MAX_HEIGHT, edge_towards, has_more_edges, height_over
from wrinkles.opposite_parts import BETWEEN, NEAR, opposed

__all__ = ["GAP_SHARE", "MAX_LIFT", "MIN_LIFT", "SLOPE", "lift_around", "out_of_body", "state_around"]

MAX_COVERED = 0.04  # a part further away than this is not covered by the cloth if another part is right at it [m]
GAP_SHARE = 0.3  # of the gap between two parts that the cloth keeps from each, if that is less than its clearance [-]
# So high over the tangent plane of a body vertex, and no further aside, cloth is clear of the body unless it is hollow
# with a radius below 3 cm [m].
CLEAR_HEIGHT, CLEAR_WIDTH = 0.012, 0.015
MIN_KEPT = 0.0003  # kept from the part that the cloth covers where there is no gap [m]
# Cloth that a small part of the body lifts stands over it like a tent: the vertices around are lifted, too, less by
# this share of the distance [-]. Where nothing is lifted further than the first height there is no tent, and none is
# higher than the second [m].
SLOPE = 0.15
MIN_LIFT, MAX_LIFT = 0.001, 0.008


@ti.func
def lift_around(
    fine: ti.template(), starts: ti.template(), ring: ti.template(), lifts: ti.template(), queue: ti.template(),
    count: ti.i32,
):  # fmt: skip
    """Lift what lies around vertices that the body has lifted; see ``SLOPE``.

    Args:
        fine: where vertices are after they left the body [m].
        starts, ring: neighbours of each vertex.
        lifts: direction and height by which each vertex is lifted [m].
        queue: vertices whose neighbours are looked at, in this order.
        count: of them at first.
    """
    place, last = 0, count
    while place < last:
        i = queue[place]
        place += 1
        up, height = xyz(lifts[i]), lifts[i][3]
        for r in range(starts[i], starts[i + 1]):
            j = ring[r]
            lift = height - SLOPE * (fine[j] - fine[i]).norm()
            if lift > lifts[j][3] + SLOPE * MIN_LIFT and last < queue.shape[0]:
                fine[j] += (lift - lifts[j][3]) * up
                lifts[j] = vec4(up, lift)
                queue[last] = j
                last += 1


@ti.func
def state_around(i: ti.i32, covered: ti.template()) -> ti.i32:
    """What the coarse vertices around free vertex i say of it together, see ``covered.state``."""
    around = covered.leading[i]
    return covered.state[around[0]] | covered.state[around[1]] | covered.state[around[2]]


@ti.func
def out_of_body(i: ti.i32, start: vec3, state: ti.i32, covered: ti.template()) -> vec3:
    """Where free vertex i goes from ``start`` [m] so that it keeps its clearance from the body.

    First from the part of the body that the cloth covers, then from a part opposite to it, where there is one.

    Args:
        i, start, covered: see above; ``covered``: view of the body.
        state: see :func:`state_around`.
    """
    p = start
    if state & NEAR == 0:
        covered.nearest[i] = -1
        covered.nearest[i + covered.leading.shape[0]] = -1
    elif state > NEAR or not _is_clear(p, covered.nearest[i], covered):
        body, normals = ti.static(covered.surface.body_start, covered.surface.body_normals)
        normal, other_normal, home, outwards = vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0)
        gap, other_gap, kept, other_kept = MAX_HEIGHT, MAX_HEIGHT, 0.0, 0.0
        for part in range(ti.select(state >= BETWEEN, 2, 1)):
            slot = i + part * covered.leading.shape[0]
            best, edge = covered.nearest[slot], -1
            # Between two parts a vertex that stayed with the one that it was at would end inside the other.
            if best < 0 or state > NEAR:
                best = _seed(i, part, p, home, outwards, covered)
            if best >= 0:
                best, edge = _walk(p, best, covered)
            if part == 1 and best >= 0:
                if not opposed(home, outwards, body[best], normals[best]):
                    best = -1
            covered.nearest[slot] = best
            if best < 0:
                break
            n, h, c = height_over(p, best, edge, covered)
            if part == 0:
                home, outwards = body[best], normals[best]
                normal, gap, kept = n, h, c
            else:
                other_normal, other_gap, other_kept = n, h, c
        if other_gap < MAX_HEIGHT:
            # Between two parts the cloth keeps a share of the gap from both, and MIN_KEPT from its own where they
            # overlap. If it were pushed out of one after the other, it would zigzag and end inside one of them.
            between = gap + other_gap
            kept = ti.min(kept, ti.max(GAP_SHARE * ti.abs(between), MIN_KEPT))
            other_kept = ti.min(other_kept, ti.max(GAP_SHARE * between, MIN_KEPT))
            if other_gap < other_kept and gap > kept:
                d = ti.min(other_kept - other_gap, gap - kept) * other_normal
                p += d
                gap += d.dot(normal)
        if gap < kept:
            p += (kept - gap) * normal
    return p


@ti.func
def _is_clear(p: vec3, vertex: ti.i32, covered: ti.template()) -> bool:
    """Whether p [m] is so high over a body vertex that nothing around that reaches it; -1 stands for no vertex."""
    clear = False
    if vertex >= 0:
        offset = p - covered.surface.body_start[vertex]
        height = offset.dot(covered.surface.body_normals[vertex])
        clear = height > CLEAR_HEIGHT and offset.dot(offset) - height * height < CLEAR_WIDTH * CLEAR_WIDTH
    return clear


@ti.func
def _walk(p: vec3, start: ti.i32, covered: ti.template()):
    """Body vertex to which a walk from ``start`` to ever nearer ones leads, and the edge there that is nearest to p.

    The vertex that it reaches depends on other passes only by its start.
    """
    best = start
    is_nearest, edge = edge_towards(p - covered.surface.body_start[best], best, covered)
    if not is_nearest or has_more_edges(best, covered):
        best = descend(p, best, 0.0, covered.surface)
        is_nearest, edge = edge_towards(p - covered.surface.body_start[best], best, covered)
    return best, edge


@ti.func
def _seed(i: ti.i32, part: ti.i32, p: vec3, home: vec3, outwards: vec3, covered: ti.template()) -> ti.i32:
    """Body vertex from which the search for free vertex ``i`` at ``p`` [m] starts; -1 for none.

    It lies on the part that the cloth covers (0) or on the opposite one (1). Another part does not
    come near unseen: the coarse vertices around would have found it.

    Args:
        part: 0 or 1, see above; ``covered``: view of the body.
        home, outwards: place of the body that it covers [m] and normal there, of use for the opposite part only.
    """
    frames = ti.static(covered.frames)
    way = outwards
    if part == 0:
        coarse = covered.leading[i][0]
        way = covered.facing * vec3(frames[coarse, 6], frames[coarse, 7], frames[coarse, 8])
    return _start(i, part, covered.nearest[i + part * covered.leading.shape[0]], p, home, way, covered)


@ti.func
def _start(
    i: ti.i32, part: ti.i32, last: ti.i32, p: vec3, home: vec3, outwards: vec3, covered: ti.template()
) -> ti.i32:
    """Body vertex from which the search for free vertex ``i`` at ``p`` [m] starts; -1 for none.

    It is the nearest of those where the coarse vertices around this one are near the body, and where it was itself.

    Args:
        part, covered: as for :func:`_seed`.
        last: where it was near the body last, -1 for nowhere.
        home, outwards: place of the body that it covers [m] and normal there; before they are known, the cloth's.
    """
    body, normals = ti.static(covered.surface.body_start, covered.surface.body_normals)
    best = -1
    distance = 1e30
    for c in ti.static(range(7)):
        seed = last
        if ti.static(c < 3):
            seed = covered.coarse_nearest[covered.leading[i][c]]
        elif ti.static(c < 6):
            seed = -1
            if part == 1:
                seed = covered.across[covered.leading[i][c - 3]]
        if seed >= 0 and seed != best:
            offset = body[seed] - p
            away = offset.dot(offset)
            # The covered part looks the way the cloth does. Another part will do if there is no such part near: it
            # strikes the cloth from its other side.
            if part == 0 and normals[seed].dot(outwards) < 0.0:
                away += MAX_COVERED * MAX_COVERED
            if part == 1 and not opposed(home, outwards, body[seed], normals[seed]):
                away = 1e30
            if away < distance:
                distance = away
                best = seed
    return best
