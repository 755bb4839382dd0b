"""Contact in a substep: with the faces of a body, with primitives and with distance fields."""

from pbd.constraints import contact_correction, cushioned
from pbd.engine import ti
from pbd.geometry import between, closest_in_fan, descend, vec3, vec4, xyz

__all__ = [
    "collide_fields",
    "collide_primitives",
    "height_over",
    "push_out",
    "sample_point",
    "slid_off",
    "substep_start",
    "touch_body",
]

KEPT = 0.0015  # a touched point is kept while the cloth slides less than this along the surface [m] ...
KEPT_SHARE = 0.1  # ... or less than this share of its height over it [-]


@ti.func
def substep_start(velocity: ti.template(), gained: ti.template(), i: ti.i32, h: ti.f32):
    """Shift of vertex i at the start of the substep [m]; see :func:`pbd.schedule.advance_garment`."""
    return -h * (velocity[i] + xyz(gained[i]))


@ti.func
def touch_body(
    p: vec3,
    i: ti.i32,
    t: ti.f32,
    nearest: ti.template(),
    body_0: ti.template(),
    body_1: ti.template(),
    ring_start: ti.template(),
    ring: ti.template(),
    fan_start: ti.template(),
    fan: ti.template(),
    normals: ti.template(),
    touched: ti.template(),
):
    """Find where sample i touches, for all of the frame.

    Rows of ``touched``: the point at the frame's start with the distance to it, its motion over the frame, the normal.
    """
    b = descend(p, nearest[i], t, body_0, body_1, ring_start, ring)
    nearest[i] = b  # not what the hops below come to: on slivers that is far away
    others, weights, distance = ti.Vector([b, b]), vec3(0.0), 1e30
    candidate = b
    hops = 0
    while hops < 8:
        next_others, next_weights, next_distance = closest_in_fan(p, candidate, t, body_0, body_1, fan_start, fan)
        hops += 1
        if next_distance < distance:
            b, others, weights, distance = candidate, next_others, next_weights, next_distance
            # On the rim of the fan the closest face may lie beyond it.
            candidate = others[0]
            if weights[2] > weights[1]:
                candidate = others[1]
            if weights[0] > 0.0:
                hops = 8
        else:
            hops = 8
    start = weights[0] * body_0[b] + weights[1] * body_0[others[0]] + weights[2] * body_0[others[1]]
    end = weights[0] * body_1[b] + weights[1] * body_1[others[0]] + weights[2] * body_1[others[1]]
    normal = vec3(0.0)
    if weights.min() > 0.0:  # inside a face, its own normal knows the side, however sharp the body's edges
        x0 = between(b, t, body_0, body_1)
        normal = (between(others[0], t, body_0, body_1) - x0).cross(between(others[1], t, body_0, body_1) - x0)
    else:
        normal = weights[0] * normals[b] + weights[1] * normals[others[0]] + weights[2] * normals[others[1]]
    normal /= ti.max(normal.norm(), 1e-20)
    # The smooth normal decides the side; the exact direction to the surface, where there is one, is the contact's.
    offset = p - (start + t * (end - start))
    size = offset.norm()
    if size > 1e-4:
        exact = offset / size
        along = exact.dot(normal)
        if along > 0.5:
            normal = exact
        elif along < -0.5:
            normal = -exact
    touched[i, 0] = vec4(start, 0.0)
    touched[i, 1] = vec4(end - start, 0.0)
    touched[i, 2] = vec4(normal, 0.0)


@ti.func
def bulge(edge: vec3, normal: vec3, other_normal: vec3) -> vec3:
    """From the middle of an edge to the smooth surface over it (Vlachos et al. 2001, "Curved PN triangles") [m]."""
    return 0.0625 * edge.dot(other_normal - normal) * (normal + other_normal)


@ti.func
def sample_point(i: ti.i32, j: ti.i32, position: ti.template(), normals: ti.template(), smooth: ti.f32) -> vec3:
    """Where the cloth is between two vertices, or at one that is both, before their shift [m]."""
    x, y = xyz(position[i]), xyz(position[j])
    middle = 0.5 * (x + y)
    if smooth > 0.0:
        middle += bulge(y - x, xyz(normals[i]), xyz(normals[j]))
    return middle


@ti.func
def height_over(
    x: vec3, c: ti.i32, i: ti.i32, j: ti.i32, t: ti.f32, shift: ti.template(), touched: ti.template()
) -> ti.f32:
    """Height of sample c, which stands at x plus the mean shift of its two vertices, over what it touched [m]."""
    u = 0.5 * (xyz(shift[i]) + xyz(shift[j]))
    return ((x - (xyz(touched[c, 0]) + t * xyz(touched[c, 1]))) + u).dot(xyz(touched[c, 2]))


@ti.func
def push_out(
    c: ti.i32,
    i: ti.i32,
    j: ti.i32,
    gap: ti.f32,
    friction: ti.f32,
    dt_share: ti.f32,
    h: ti.f32,
    position: ti.template(),
    velocity: ti.template(),
    shift: ti.template(),
    gained: ti.template(),
    touched: ti.template(),
):
    """Close the gap [m] of sample c to what it touched."""
    p, q = position[i], position[j]
    u, v = xyz(shift[i]), xyz(shift[j])
    slip = 0.5 * (u + v) - 0.5 * (substep_start(velocity, gained, i, h) + substep_start(velocity, gained, j, h))
    slip -= dt_share * xyz(touched[c, 1])
    m = contact_correction(gap, xyz(touched[c, 2]), slip, friction, h)
    m *= 0.5 / (0.25 * (p[3] + q[3]))
    # A vertex is a sample with both ends the same: half and half make the whole.
    shift[i] = vec4(u + p[3] * m)
    if i != j:
        shift[j] = vec4(v + q[3] * m)


@ti.func
def slid_off(offset: vec3, normal: vec3):
    """Whether a sample at ``offset`` [m] from the point that it touched may touch elsewhere by now."""
    height = offset.dot(normal)
    along = offset - height * normal
    kept = ti.max(KEPT, KEPT_SHARE * ti.abs(height))
    return along.dot(along) > kept * kept


@ti.func
def collide_primitives(
    p: vec3,
    u: vec3,
    slip: vec3,
    t: ti.f32,
    dt_share: ti.f32,
    primitives: ti.template(),
    contact_law: ti.math.vec4,
    h: ti.f32,
):
    """Correction by planes (0), spheres (1), capsules (2); rows: kind, radius, a0, b0, a1, b1 (start, end)."""
    total, thickness = vec3(0.0), contact_law[0]
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
        gap = cushioned(gap, thickness, contact_law[2] * h * h)
        total += contact_correction(gap, normal, slip + total - carried, contact_law[1], h)
    return total


@ti.func
def collide_fields(
    team: ti.template(),
    position: ti.template(),
    velocity: ti.template(),
    shift: ti.template(),
    gained: ti.template(),
    t: ti.f32,
    dt_share: ti.f32,
    fields: ti.template(),
    values: ti.template(),
    contact_law: ti.math.vec4,
    h: ti.f32,
):
    """Put a worker's vertices out of distance fields, one field after the other; rows as in pbd.distance_field."""
    thickness, first = contact_law[0], 0
    for c in range(fields.shape[0]):
        size = ti.Vector([int(fields[c, 0]), int(fields[c, 1]), int(fields[c, 2])])
        spacing, corner = fields[c, 3], row3(fields, c, 4)
        way, spin = row3(fields, c, 19), row3(fields, c, 22)
        angle = spin.norm()
        axis = spin / ti.max(angle, 1e-20)
        centre = row3(fields, c, 16) + (t - 1.0) * way
        x = turned(row3(fields, c, 7), axis, (t - 1.0) * angle)
        y = turned(row3(fields, c, 10), axis, (t - 1.0) * angle)
        z = turned(row3(fields, c, 13), axis, (t - 1.0) * angle)
        for i in range(team.begin(0, position.shape[0]), team.end(0, position.shape[0])):
            if position[i][3] > 0.0:
                u = xyz(shift[i])
                offset = (xyz(position[i]) - centre) + u
                place = (vec3(offset.dot(x), offset.dot(y), offset.dot(z)) - corner) / spacing
                if place.min() >= 0.0 and (size - 1.0 - place).min() >= 0.0:
                    found = interpolated(values, first, size, place)
                    if found[3] < thickness:
                        normal = found[0] * x + found[1] * y + found[2] * z
                        steepness = normal.norm()
                        normal = normal / steepness if steepness > 1e-6 * spacing else vec3(0.0, 1.0, 0.0)
                        foot = offset - found[3] * normal
                        carried = dt_share * way + (foot - turned(foot, axis, -dt_share * angle))
                        slip = u - substep_start(velocity, gained, i, h)
                        gap = cushioned(found[3] - thickness, thickness, contact_law[2] * h * h)
                        u += contact_correction(gap, normal, slip - carried, contact_law[1], h)
                        shift[i] = vec4(u)
        first += size[0] * size[1] * size[2]


@ti.func
def row3(rows: ti.template(), c: ti.i32, begin: ti.i32) -> vec3:
    """Three numbers of a row."""
    return vec3(rows[c, begin], rows[c, begin + 1], rows[c, begin + 2])


@ti.func
def turned(r: vec3, axis: vec3, angle: ti.f32) -> vec3:
    """R turned about a unit axis through the origin (Rodrigues); exactly r for no angle."""
    across, half = axis.cross(r), ti.sin(0.5 * angle)
    return r + (ti.sin(angle) * across + 2.0 * half * half * axis.cross(across))


@ti.func
def interpolated(values: ti.template(), first: ti.i32, size, place: vec3):
    """Gradient times the spacing, and value [m], of the trilinear interpolant at a place within the grid.

    ``size``: grid points along each axis; ``place``: in spacings from the first of them, whose value is at ``first``.
    """
    cell = ti.math.clamp(int(ti.floor(place)), 0, size - 2)  # whatever the place is, what is read exists
    f = place - cell
    corners = ti.Vector([0.0] * 8)
    for k in ti.static(range(8)):
        a, b, d = cell[0] + k // 4, cell[1] + k // 2 % 2, cell[2] + k % 2
        corners[k] = values[first + (a * size[1] + b) * size[2] + d]
    rise = ti.Vector([0.0] * 4)  # along the last axis, on the four edges of the cell
    level = ti.Vector([0.0] * 4)
    for k in ti.static(range(4)):
        rise[k] = corners[2 * k + 1] - corners[2 * k]
        level[k] = corners[2 * k] + f[2] * rise[k]
    low, high = level[0] + f[1] * (level[1] - level[0]), level[2] + f[1] * (level[3] - level[2])
    rise_low, rise_high = rise[0] + f[1] * (rise[1] - rise[0]), rise[2] + f[1] * (rise[3] - rise[2])
    steep_low, steep_high = level[1] - level[0], level[3] - level[2]
    return ti.math.vec4(
        high - low,
        steep_low + f[0] * (steep_high - steep_low),
        rise_low + f[0] * (rise_high - rise_low),
        low + f[0] * (high - low),
    )
