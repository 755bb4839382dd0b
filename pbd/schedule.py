"""The schedule: one kernel a frame, all substeps inside, a colour of constraints after the other.

An order that sweeps the mesh from one end to the other is unstable. Constraints of one colour share no vertex, so that
several workers may share them (:mod:`pbd.team`); the default is one, who never waits.
"""

from pbd.constraints import (
    bent_hinge,
    cushioned,
    drag_velocity,
    hinge_multiplier,
    limit_correction,
    membrane_multipliers,
    stitch_multiplier,
    tether_correction,
)
from pbd.contact import (
    collide_fields,
    collide_primitives,
    height_over,
    push_out,
    sample_point,
    slid_off,
    substep_start,
    touch_body,
)
from pbd.engine import ti
from pbd.geometry import FAR, vec3, vec4, xyz
from pbd.levels import gather_patches, solve_patches
from pbd.model import BLOCK
from pbd.pairs import solve_pairs
from pbd.strain_limits import near_limits, solve_strain_limits

__all__ = ["advance_garment"]

NEAR = 0.01  # nearer than this, a contact is looked at in every substep, even if nothing seems to move [m]
SQUEEZED = 1e-4  # area of faces over the squares of their sides, below which they are lines [-]
NOTHING = 1e-12  # sides of a face at a point, squared, where loose points have no face at all [m2]
LIMITING = 8  # most passes over the edges before contact of the cloth with itself, and as many after it
STITCHING = 4  # passes over the stitches, of which several may meet in one vertex
FINEST = 2.0**20  # inside a frame positions are whole multiples of 1 m / FINEST: exact in float32 up to 16 m


@ti.func
def solve_membrane(
    position: ti.template(),
    shift: ti.template(),
    triangles: ti.template(),
    blocks: ti.template(),
    data: ti.template(),
    inverse_h2: ti.f32,
    squeeze: ti.f32,
    parent: ti.template(),
    borne: ti.template(),
    levels: ti.i32,
    first: ti.i32,
    last: ti.i32,
):
    """One pass over the triangles of blocks ``first`` to ``last``, which is left out; each block is of one colour.

    A block is read, solved and written in turn. What is solved lies in local arrays that nothing else can point to, so
    that the compiler solves eight triangles at once: a third of the time. They are read one at a time: gathers, which
    the compiler would take, cost twice as much; it leaves a loop that it cannot count.
    """
    x1, y1, z1 = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    x2, y2, z2 = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    e1, e2, e3 = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    for b in range(first, last):
        begin, size = blocks[b][0], blocks[b][1]
        for a in range(size):
            f = triangles[begin + a]
            if f[0] < 0:  # never; see above
                break
            x0, u0 = position[f[0]], shift[f[0]]
            side_1 = (position[f[1]] - x0) + (shift[f[1]] - u0)
            side_2 = (position[f[2]] - x0) + (shift[f[2]] - u0)
            x1[a], y1[a], z1[a] = side_1[0], side_1[1], side_1[2]
            x2[a], y2[a], z2[a] = side_2[0], side_2[1], side_2[2]
            if levels > 0:
                e = borne[parent[f[0]]]
                e1[a], e2[a], e3[a] = e[0], e[1], e[2]
        for a in range(BLOCK):  # those beyond the block's size come to nothing
            c = begin + a
            g = membrane_multipliers(
                vec3(x1[a], y1[a], z1[a]),
                vec3(x2[a], y2[a], z2[a]),
                ti.math.vec4(data[0, c], data[1, c], data[2, c], data[3, c]),
                vec3(data[4, c], data[5, c], data[6, c]),
                inverse_h2 * ti.math.vec4(data[8, c], data[9, c], data[10, c], data[11, c]),
                data[7, c],
                squeeze,
                vec3(e1[a], e2[a], e3[a]),
            )
            gu, gv = vec3(g[0, 0], g[1, 0], g[2, 0]), vec3(g[0, 1], g[1, 1], g[2, 1])
            m1, m2 = data[0, c] * gu + data[1, c] * gv, data[2, c] * gu + data[3, c] * gv
            x1[a], y1[a], z1[a] = m1[0], m1[1], m1[2]
            x2[a], y2[a], z2[a] = m2[0], m2[1], m2[2]
        for a in range(size):
            f = triangles[begin + a]
            m1, m2 = ti.math.vec4(x1[a], y1[a], z1[a], 0.0), ti.math.vec4(x2[a], y2[a], z2[a], 0.0)
            shift[f[0]] = shift[f[0]] - position[f[0]][3] * (m1 + m2)
            shift[f[1]] = shift[f[1]] + position[f[1]][3] * m1
            shift[f[2]] = shift[f[2]] + position[f[2]][3] * m2


@ti.func
def solve_bending(
    position: ti.template(),
    shift: ti.template(),
    hinges: ti.template(),
    data: ti.template(),
    inverse_h2: ti.f32,
    begin: ti.i32,
    end: ti.i32,
):
    for c in range(begin, end):
        q = hinges[c]
        p0, p1, p2, p3 = position[q[0]], position[q[1]], position[q[2]], position[q[3]]
        u0, u1, u2, u3 = xyz(shift[q[0]]), xyz(shift[q[1]]), xyz(shift[q[2]]), xyz(shift[q[3]])
        rows, give = data[c, 0], data[c, 1]
        x0, inverse_sum = xyz(p0), 1.0 / (give[0] + give[1] * inverse_h2)
        d1, d2, d3 = (xyz(p1) - x0) + (u1 - u0), (xyz(p2) - x0) + (u2 - u0), (xyz(p3) - x0) + (u3 - u0)
        multiplier = hinge_multiplier(d1, d2, d3, rows, inverse_sum)
        if give[2] != 0.0:
            multiplier, along, across = bent_hinge(d1, d2, d3, rows, give[2], inverse_sum)
            u0, u1, u2, u3 = u0 - p0[3] * along, u1 + p1[3] * along, u2 + p2[3] * across, u3 - p3[3] * across
        shift[q[0]] = vec4(u0 + p0[3] * rows[0] * multiplier)
        shift[q[1]] = vec4(u1 + p1[3] * rows[1] * multiplier)
        shift[q[2]] = vec4(u2 + p2[3] * rows[2] * multiplier)
        shift[q[3]] = vec4(u3 + p3[3] * rows[3] * multiplier)


@ti.func
def solve_stitches(position: ti.template(), shift: ti.template(), stitches: ti.template(), weights: ti.template()):
    for c in range(stitches.shape[0]):
        s, w = stitches[c], weights[c]
        v, a, b = position[s[0]], position[s[1]], position[s[2]]
        uv, ua, ub = xyz(shift[s[0]]), xyz(shift[s[1]]), xyz(shift[s[2]])
        to_a, to_b = (xyz(a) - xyz(v)) + (ua - uv), (xyz(b) - xyz(v)) + (ub - uv)
        multiplier = stitch_multiplier(to_a, to_b, w, v[3], a[3], b[3])
        shift[s[0]] = vec4(uv + v[3] * multiplier)
        shift[s[1]] = vec4(ua - a[3] * (1.0 - w) * multiplier)
        shift[s[2]] = vec4(ub - b[3] * w * multiplier)


@ti.func
def cloth_normals(
    team: ti.template(),
    position: ti.template(),
    triangles: ti.template(),
    blocks: ti.template(),
    colors: ti.template(),
    normals: ti.template(),
):
    """Unit vertex normals and areas [m2]; the area is below 0 where faces are squeezed to lines and have no normal."""
    count = position.shape[0]
    for i in range(team.begin(0, count), team.end(0, count)):
        normals[i] = ti.math.vec4(0.0)
    team.meet()
    for k in range(colors.shape[0] - 1):
        for b in range(team.begin(colors[k], colors[k + 1]), team.end(colors[k], colors[k + 1])):
            for c in range(blocks[b][0], blocks[b][0] + blocks[b][1]):
                f = triangles[c]
                x0 = xyz(position[f[0]])
                side_1, side_2 = xyz(position[f[1]]) - x0, xyz(position[f[2]]) - x0
                n = vec4(side_1.cross(side_2), side_1.dot(side_1) + side_2.dot(side_2) + NOTHING)
                for a in ti.static(range(3)):
                    normals[f[a]] = normals[f[a]] + n
        team.meet()
    for i in range(team.begin(0, count), team.end(0, count)):
        n = xyz(normals[i])
        size = n.norm()
        normals[i] = vec4(n / ti.max(size, 1e-20), ti.select(size >= SQUEEZED * normals[i][3], size / 6.0, -1.0))


@ti.func
def sideways(i: ti.i32) -> vec3:
    """A direction of vertex i's own: points spread over the unit ball's surface in a spiral (Vogel 1979)."""
    height = 0.618033989 * i
    height = 2.0 * (height - ti.floor(height)) - 1.0
    across = ti.sqrt(1.0 - height * height)
    return vec3(across * ti.cos(2.39996323 * i), height, across * ti.sin(2.39996323 * i))


@ti.func
def advance_garment(
    team: ti.template(),
    with_patches: ti.template(),
    with_pairs: ti.template(),
    position: ti.template(),
    velocity: ti.template(),
    shift: ti.template(),
    normals: ti.template(),
    gained: ti.template(),
    touched: ti.template(),
    awake: ti.template(),
    samples: ti.template(),
    sample_colors: ti.template(),
    listed: ti.template(),
    triangles: ti.template(),
    triangle_blocks: ti.template(),
    block_colors: ti.template(),
    triangle_data: ti.template(),
    hinges: ti.template(),
    hinge_colors: ti.template(),
    hinge_data: ti.template(),
    stitches: ti.template(),
    stitch_weights: ti.template(),
    tethers: ti.template(),
    tether_lengths: ti.template(),
    held: ti.template(),
    target_0: ti.template(),
    target_1: ti.template(),
    limits: ti.template(),
    air: ti.template(),
    pressure: ti.template(),
    primitives: ti.template(),
    fields: ti.template(),
    field_values: ti.template(),
    nearest: ti.template(),
    contact: ti.template(),
    body_0: ti.template(),
    body_1: ti.template(),
    body_normals: ti.template(),
    ring_start: ti.template(),
    ring: ti.template(),
    fan_start: ti.template(),
    fan: ti.template(),
    parent: ti.template(),
    part: ti.template(),
    ways: ti.template(),
    places: ti.template(),
    first_ways: ti.template(),
    borne: ti.template(),
    starts: ti.template(),
    children: ti.template(),
    child_starts: ti.template(),
    links: ti.template(),
    link_colors: ti.template(),
    color_starts: ti.template(),
    link_data: ti.template(),
    link_shares: ti.template(),
    link_room: ti.template(),
    way: ti.template(),
    pairs: ti.template(),
    pair_data: ti.template(),
    ready: ti.template(),
    strain_limits: ti.template(),
    steps: ti.template(),
    h: ti.f32,
    gravity: vec3,
    squeeze: ti.f32,
    contact_law: ti.math.vec4,
):
    """Advance a garment by steps of h [s].

    ``steps``: the first, the one after the last, how many the frame has; how many between two looks at all contacts;
    levels and passes over them. ``contact_law``: thickness [m], coefficient of friction, the pressure of the law by
    which the thickness gives over the areal density [m/s2], and above 0 where contact is with the smooth surface.

    ``air``: velocity of the air at each vertex [m/s] and its drag over the mass [1/m]. ``limits``: place at the frame's
    start and the vertex, motion of the place, normal there, law of :func:`pbd.constraints.limit_correction`.

    Per substep: predict, held vertices, patches from coarse to fine, membrane, bending, stitches, tethers, limits,
    contact with the body, strain limits and contact of the cloth with itself, with primitives, velocities. Digits are
    kept in three places: a vertex stands at ``position`` (on a grid) plus a small ``shift`` that takes the corrections;
    velocity takes (shift - predicted shift)/h, the sum of the corrections, instead of a difference of world positions;
    and what it gains over the frame is summed apart, in ``gained``: less the predicted shift/h while the substep lasts,
    so that the vertex started it at -h (velocity + gained).

    In the first substep every contact sample finds where it touches. Every ``refresh`` substeps all are looked at:
    those nearer to the body than ``waking`` [m] are awake until the next time, and find again where they touch if
    they have slid off it. In between only these are looked at.

    Constraints of one colour share no vertex, and every sum has one order, so that the result does not depend on how
    many work on it.
    """
    inverse_h = 1.0 / h
    inverse_h2 = inverse_h * inverse_h
    count, thickness, friction = position.shape[0], contact_law[0], contact_law[1]
    substeps, refresh, levels, sweeps = steps[2], steps[3], steps[4], steps[5]
    share = 1.0 / substeps
    # Whatever is nearer than this may touch before all are looked at again.
    waking = ti.max(NEAR, thickness + way[0] * ti.min(1.0, refresh * share))
    # The samples of each colour that a worker has begin, in ``awake``, with those that have a body near them;
    # half the array further on are those of them that are awake.
    half = samples.shape[0]
    for k in range(sample_colors.shape[0] - 1):
        begin = team.begin(sample_colors[k], sample_colors[k + 1])
        near_count = 0
        for c in range(begin, team.end(sample_colors[k], sample_colors[k + 1])):
            if nearest[c] >= 0 and position[samples[c][0]][3] + position[samples[c][1]][3] > 0.0:
                awake[begin + near_count] = c
                near_count += 1
        listed[team.row(k)] = ti.Vector([near_count, 0])
    cloth_normals(team, position, triangles, triangle_blocks, block_colors, normals)
    for i in range(team.begin(0, count), team.end(0, count)):
        p = xyz(position[i])
        if normals[i][3] < 0.0 and position[i][3] > 0.0:
            p += 0.5 * thickness * sideways(i)  # cloth squeezed to a line knows no way to open
        x = ti.floor(p * FINEST + 0.5) / FINEST
        position[i] = vec4(x, position[i][3])
        shift[i] = vec4(p - x)
        gained[i] = ti.math.vec4(0.0)
        pushed = 0.0  # by pressure, along the normal [m/s2]
        if pressure.shape[0] > 0:
            pushed = pressure[i] * position[i][3] * ti.max(normals[i][3], 0.0)
        normals[i][3] = pushed
    for c in range(team.begin(0, held.shape[0]), team.end(0, held.shape[0])):
        velocity[held[c]] = (target_1[c] - target_0[c]) * (inverse_h * share)
    team.meet()
    stretched = 0  # whether any edge is near its limit
    for step in range(steps[0], steps[1] + 1):
        t = (step + 1) * share
        if primitives.shape[0] > 0 and step > steps[0]:
            for i in range(team.begin(0, count), team.end(0, count)):
                if position[i][3] > 0.0:
                    u = xyz(shift[i])
                    slip = u - substep_start(velocity, gained, i, h)
                    u += collide_primitives(xyz(position[i]), u, slip, t - share, share, primitives, contact_law, h)
                    shift[i] = vec4(u)
        if fields.shape[0] > 0 and step > steps[0]:
            collide_fields(
                team, position, velocity, shift, gained, t - share, share, fields, field_values, contact_law, h
            )
        for i in range(team.begin(0, count), team.end(0, count)):
            if position[i][3] > 0.0:
                u, gain = xyz(shift[i]), xyz(gained[i])
                if step > steps[0]:
                    gain += inverse_h * u
                if step < steps[1]:
                    n = xyz(normals[i])
                    gain += h * gravity
                    if pressure.shape[0] > 0:
                        gain += (h * normals[i][3]) * n
                    v = velocity[i] + gain
                    dragged = drag_velocity(v - xyz(air[i]), n, h * air[i][3])
                    u += h * (v + dragged)
                    # Whole steps of the grid go to the position, the rest to the shift: nothing is rounded away.
                    whole = ti.floor(u * FINEST + 0.5) / FINEST
                    position[i] = position[i] + vec4(whole)
                    u -= whole
                    gain += dragged - inverse_h * u
                shift[i] = vec4(u)
                gained[i] = vec4(gain)
        team.meet()
        if step < steps[1]:
            for c in range(team.begin(0, held.shape[0]), team.end(0, held.shape[0])):
                i = held[c]
                u = (target_0[c] - xyz(position[i])) + t * (target_1[c] - target_0[c])
                shift[i] = vec4(u)
                gained[i] = vec4(-inverse_h * u)
            team.meet()

            if ti.static(with_patches):
                if levels > 0:
                    gather_patches(
                        team, position, shift, velocity, gained, h, part, places, ways, starts, children, child_starts,
                        levels,
                    )  # fmt: skip
                    solve_patches(
                        team, count, parent, places, ways, first_ways, borne, starts, links, link_colors,
                        color_starts, link_data, link_shares, link_room, levels, sweeps, h,
                    )  # fmt: skip
                    for i in range(team.begin(0, count), team.end(0, count)):
                        if position[i][3] > 0.0:
                            a = parent[i]
                            shift[i] = vec4(xyz(shift[i]) + (xyz(ways[a]) - xyz(first_ways[a])))
                    team.meet()
            for k in range(block_colors.shape[0] - 1):
                solve_membrane(
                    position, shift, triangles, triangle_blocks, triangle_data, inverse_h2, squeeze, parent, borne,
                    levels,
                    team.begin(block_colors[k], block_colors[k + 1]),
                    team.end(block_colors[k], block_colors[k + 1]),
                )  # fmt: skip
                team.meet()
            for k in range(hinge_colors.shape[0] - 1):
                solve_bending(
                    position, shift, hinges, hinge_data, inverse_h2,
                    team.begin(hinge_colors[k], hinge_colors[k + 1]),
                    team.end(hinge_colors[k], hinge_colors[k + 1]),
                )  # fmt: skip
                team.meet()
            if team.first():  # they are few
                for _ in range(STITCHING):
                    solve_stitches(position, shift, stitches, stitch_weights)
            team.meet()
            for c in range(team.begin(0, tethers.shape[0]), team.end(0, tethers.shape[0])):
                i, j = tethers[c][0], tethers[c][1]
                u = xyz(shift[i])
                offset = (xyz(position[i]) - xyz(position[j])) + (u - xyz(shift[j]))
                shift[i] = vec4(u + tether_correction(offset, tether_lengths[c]))
            team.meet()
            for c in range(team.begin(0, limits.shape[0]), team.end(0, limits.shape[0])):
                i = int(limits[c, 0][3])
                u = xyz(shift[i])
                offset = (xyz(position[i]) - xyz(limits[c, 0])) + (u - t * xyz(limits[c, 1]))
                correction = limit_correction(offset, xyz(limits[c, 2]), limits[c, 3], inverse_h2, position[i][3])
                shift[i] = vec4(u + correction)
            team.meet()

            looked_at = step % refresh == 0
            for k in range(sample_colors.shape[0] - 1):
                region = team.begin(sample_colors[k], sample_colors[k + 1])
                row = team.row(k)
                looks = listed[row][0] if looked_at else listed[row][1]
                begin = region if looked_at else half + region
                awake_count = 0
                for s in range(begin, begin + looks):
                    c = awake[s]
                    i, j = samples[c][0], samples[c][1]
                    x = sample_point(i, j, position, normals, contact_law[3])
                    if looked_at:
                        u = 0.5 * (xyz(shift[i]) + xyz(shift[j]))
                        again = step == 0
                        if not again:
                            offset = (x - (xyz(touched[c, 0]) + t * xyz(touched[c, 1]))) + u
                            normal = xyz(touched[c, 2])
                            again = offset.dot(normal) < waking and slid_off(offset, normal)
                        if again:
                            touch_body(
                                x + u, c, t, nearest, body_0, body_1,
                                ring_start, ring, fan_start, fan, body_normals, touched,
                            )  # fmt: skip
                    height = height_over(x, c, i, j, t, shift, touched)
                    if looked_at and height < waking:
                        awake[half + region + awake_count] = c
                        awake_count += 1
                    if height < thickness:
                        gap = cushioned(height - thickness, thickness, contact_law[2] * h * h)
                        push_out(c, i, j, gap, friction, share, h, position, velocity, shift, gained, touched)
                if looked_at:
                    listed[row][1] = awake_count
                team.meet()
            if ti.static(with_pairs):
                # After the body, whose outside is known however deep: cloth that it pinches must not go through itself,
                # nor be drawn out between limbs that push it apart. What that takes under the surface comes out again.
                if team.first():
                    if looked_at:
                        stretched = near_limits(position, shift, strain_limits)
                    solve_strain_limits(
                        position, velocity, shift, gained, strain_limits, stretched * LIMITING, h, t, nearest, touched,
                    )  # fmt: skip
                    solve_pairs(
                        position, velocity, shift, gained, pairs, pair_data, ready,
                        looked_at, refresh * share, friction, h,
                    )  # fmt: skip
                team.meet()
                for k in range(sample_colors.shape[0] - 1):
                    begin = half + team.begin(sample_colors[k], sample_colors[k + 1])
                    for s in range(begin, begin + listed[team.row(k)][1]):
                        c = awake[s]
                        i, j = samples[c][0], samples[c][1]
                        x = sample_point(i, j, position, normals, contact_law[3])
                        height = height_over(x, c, i, j, t, shift, touched)
                        if height < 0.0:
                            push_out(c, i, j, height, 0.0, share, h, position, velocity, shift, gained, touched)
                    team.meet()
                if team.first():
                    solve_strain_limits(
                        position, velocity, shift, gained, strain_limits, stretched * LIMITING, h, t, nearest, touched,
                    )  # fmt: skip
                team.meet()
    for i in range(team.begin(0, count), team.end(0, count)):
        position[i] = position[i] + vec4(xyz(shift[i]))
        contact[i] = FAR
        if position[i][3] > 0.0:
            velocity[i] = velocity[i] + xyz(gained[i])
        if nearest[i] >= 0 and position[i][3] > 0.0:
            away = xyz(position[i]) - (xyz(touched[i, 0]) + xyz(touched[i, 1]))
            contact[i] = ti.math.clamp(away.dot(xyz(touched[i, 2])), -FAR, FAR)
