"""Contact in a substep: with the faces of a body, with primitives and with distance fields."""

from pbd.contact.corrections import contact_correction, cushioned
from pbd.engine import ti
from pbd.geometry import between, closest_in_fan, closest_on_triangle, descend, vec3, vec4, xyz

__all__ = [
    "collide_fields",
    "collide_primitives",
    "height_over",
    "keep_contact",
    "push_out",
    "sample_point",
    "slid_off",
    "substep_start",
    "touch_body",
]

# A contact point is kept while the cloth slides along the surface less than this [m], ...
# On ridges of the body the planes of two faces cross: cloth that may slide further past them goes to and fro for ever.
MAX_SLIDE = 0.0002
MAX_SLIDE_SHARE = 0.02  # ... or less than this share of its height over the point [-]

MAX_TOUCH_DISTANCE = 1.5  # cloth that is nearer to the body than this touches it [thicknesses]
FACING = -0.2  # cosine of their normals under which two sides of the body face one another, as those of an armpit do


@ti.func
def substep_start(cloth: ti.template(), i: ti.i32, h: ti.f32):
    """Position delta of vertex i at the start of the substep [m]; see :class:`pbd.xpbd.views.ClothArrays`."""
    return -h * (cloth.velocity[i] + xyz(cloth.velocity_delta[i]))


@ti.func
def keep_contact(p: vec3, c: ti.i32, t: ti.f32, active_distance: ti.f32, body: ti.template(), contact: ti.template()):
    """Let sample c, which is at p [m], touch the face that it touched in the last frame, if that is right still.

    It is, while the nearest body vertex is the same and the closest point of the face lies inside it. Where the body is
    further than ``active_distance`` [m], the point that was touched is good enough while the sample slides little.

    Returns:
        whether the sample has kept its face; where it touches the body is then known for all of the frame.
    """
    kept = False
    face = contact.contact_faces[c]
    if face[0] >= 0 and face[0] == contact.nearest[c]:
        others = ti.Vector([face[2], face[3]])
        second, third = contact.contact_weights[c][0], contact.contact_weights[c][1]
        start, end, normal = surface_point(face[1], others, vec3(1.0 - second - third, second, third), t, body)
        offset = p - (start + t * (end - start))
        kept = offset.dot(normal) > active_distance and not slid_off(offset, normal)
        if not kept:
            x0, x1, x2 = between(face[1], t, body), between(face[2], t, body), between(face[3], t, body)
            weights = closest_on_triangle(p, x0, x1, x2)
            kept = weights.min() > 0.0
            if kept:
                contact.contact_weights[c] = ti.Vector([weights[1], weights[2]])
                start, end, normal = surface_point(face[1], others, weights, t, body)
        if kept:
            set_contact(c, start, end, normal, contact)
    return kept


@ti.func
def set_contact(c: ti.i32, start: vec3, end: vec3, normal: vec3, contact: ti.template()):
    """Store the point that sample c touches at the start and end of the frame [m], and the normal there."""
    contact.contact_points[c, 0] = vec4(start, 0.0)
    contact.contact_points[c, 1] = vec4(end - start, 0.0)
    contact.contact_points[c, 2] = vec4(normal, 0.0)


@ti.func
def surface_point(b: ti.i32, others, weights: vec3, t: ti.f32, body: ti.template()):
    """A point of a face with corner b and two others: where it starts and ends [m], and the unit normal at t there."""
    start = blended(body.body_start, b, others, weights)
    end = blended(body.body_end, b, others, weights)
    normal = vec3(0.0)
    if weights.min() > 0.0:  # inside a face, its own normal knows the side, however sharp the body's edges are
        x0 = between(b, t, body)
        normal = (between(others[0], t, body) - x0).cross(between(others[1], t, body) - x0)
    else:
        normal = blended(body.body_normals, b, others, weights)
    return start, end, normal / ti.max(normal.norm(), 1e-20)


@ti.func
def touch_body(p: vec3, c: ti.i32, t: ti.f32, thickness: ti.f32, body: ti.template(), contact: ti.template()):
    """Find where sample c, which is at p [m], touches the body, for all of the frame; t in [0, 1] of the frame.

    Where two sides of the body face one another over less than two thicknesses [m], no place is outside of both. Cloth
    between them stays with the side that it touches. If it took the nearer one, each would push it to the other, and
    it would tremble for ever and shake all the garment.
    """
    ends = contact.samples[c]
    seed, distance = -1, 1e30
    for start in range(ti.select(ends[0] == ends[1], 1, 3)):  # on slivers walks from several starts end apart
        first = contact.nearest[c]
        if start > 0:
            first = contact.nearest[ends[start - 1]]
        if first >= 0 and first != seed:
            found = descend(p, first, t, body)
            offset = between(found, t, body) - p
            if offset.dot(offset) < distance:
                seed, distance = found, offset.dot(offset)
    b, others, weights = closest_around(p, seed, t, body)
    start, end, normal = surface_point(b, others, weights, t, body)
    last = contact.contact_faces[c][0]
    if last >= 0 and last != seed:
        last = descend(p, last, t, body)
        last_b, last_others, last_weights = closest_around(p, last, t, body)
        last_start, last_end, last_normal = surface_point(last_b, last_others, last_weights, t, body)
        away = p - (last_start + t * (last_end - last_start))
        touched = away.dot(last_normal) > 0.0 and away.norm() < MAX_TOUCH_DISTANCE * thickness
        if touched and last_normal.dot(normal) < FACING:
            seed, b, others, weights = last, last_b, last_others, last_weights
            start, end, normal = last_start, last_end, last_normal
    contact.nearest[c] = seed  # not what the hops reached: on slivers that vertex is far away
    contact.contact_faces[c] = ti.Vector([seed, b, others[0], others[1]])
    contact.contact_weights[c] = ti.Vector([weights[1], weights[2]])
    # The smooth normal decides the side. The contact takes the exact direction to the surface where there is one.
    offset = p - (start + t * (end - start))
    size = offset.norm()
    if size > 1e-4:
        exact = offset / size
        along = exact.dot(normal)
        if along > 0.5:
            normal = exact
        elif along < -0.5:
            normal = -exact
    set_contact(c, start, end, normal, contact)


@ti.func
def blended(array: ti.template(), b: ti.i32, others, weights: vec3) -> vec3:
    """Values of an array at vertex b and two others, weighted."""
    return weights[0] * array[b] + weights[1] * array[others[0]] + weights[2] * array[others[1]]


@ti.func
def closest_around(p: vec3, start: ti.i32, t: ti.f32, body: ti.template()):
    """Closest point to p [m] of the faces around a body vertex, and around those beside them where these are nearer.

    Returns:
        a corner of the closest face, its other two corners, the weights of all three.
    """
    b, others, weights, distance = start, ti.Vector([start, start]), vec3(0.0), 1e30
    candidate = start
    hops = 0
    while hops < 8:
        next_others, next_weights, next_distance = closest_in_fan(p, candidate, t, body)
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
    return b, others, weights


@ti.func
def bulge(edge: vec3, normal: vec3, other_normal: vec3) -> vec3:
    """From the middle of an edge to the smooth surface over it (Vlachos et al. 2001, "Curved PN triangles") [m]."""
    return 0.0625 * edge.dot(other_normal - normal) * (normal + other_normal)


@ti.func
def sample_point(i: ti.i32, j: ti.i32, cloth: ti.template(), smooth_surface: ti.f32) -> vec3:
    """Where the cloth is between two vertices, or at one that is both, before their position delta [m]."""
    x, y = xyz(cloth.position[i]), xyz(cloth.position[j])
    middle = 0.5 * (x + y)
    if smooth_surface > 0.0:
        middle += bulge(y - x, xyz(cloth.normals[i]), xyz(cloth.normals[j]))
    return middle


@ti.func
def height_over(
    x: vec3, c: ti.i32, i: ti.i32, j: ti.i32, t: ti.f32, cloth: ti.template(), contact_points: ti.template()
) -> ti.f32:
    """Height of sample ``c`` of vertices ``i`` and ``j`` over the point that it touches [m].

    Args:
        x: where the sample is before the mean position delta of its vertices [m].
        t: in [0, 1] of the frame.
        cloth, contact_points: view of the garment, and the points that it touches.
    """
    u = 0.5 * (xyz(cloth.position_delta[i]) + xyz(cloth.position_delta[j]))
    return ((x - (xyz(contact_points[c, 0]) + t * xyz(contact_points[c, 1]))) + u).dot(xyz(contact_points[c, 2]))


@ti.func
def push_out(
    c: ti.i32,
    i: ti.i32,
    j: ti.i32,
    gap: ti.f32,
    friction: ti.f32,
    step: ti.template(),
    cloth: ti.template(),
    contact_points: ti.template(),
):
    """Close the gap [m] between sample c of vertices i and j and the point that it touches."""
    p, q = cloth.position[i], cloth.position[j]
    u, v = xyz(cloth.position_delta[i]), xyz(cloth.position_delta[j])
    slip = 0.5 * (u + v) - 0.5 * (substep_start(cloth, i, step.h) + substep_start(cloth, j, step.h))
    slip -= step.share * xyz(contact_points[c, 1])
    m = contact_correction(gap, xyz(contact_points[c, 2]), slip, friction, step.h)
    m *= 0.5 / (0.25 * (p[3] + q[3]))
    # A vertex is a sample with both ends the same: two halves make the whole.
    cloth.position_delta[i] = vec4(u + p[3] * m)
    if i != j:
        cloth.position_delta[j] = vec4(v + q[3] * m)


@ti.func
def slid_off(offset: vec3, normal: vec3):
    """Whether a sample at ``offset`` [m] from the point that it touches may touch another point by now."""
    height = offset.dot(normal)
    along = offset - height * normal
    kept = ti.max(MAX_SLIDE, MAX_SLIDE_SHARE * ti.abs(height))
    return along.dot(along) > kept * kept


@ti.func
def collide_primitives(p: vec3, u: vec3, slip: vec3, t: ti.f32, primitives: ti.template(), step: ti.template()):
    """Correction [m] of a vertex at p + u by planes (0), spheres (1) and capsules (2), one after the other.

    Rows of ``primitives``: kind, radius, a, b at the frame's start, a, b at its end; ``t`` in [0, 1] of the frame.
    """
    total, thickness = vec3(0.0), step.thickness
    for c in range(primitives.shape[0]):
        kind = int(primitives[c, 0])
        a0 = row3(primitives, c, 2)
        b0 = row3(primitives, c, 5)
        da = row3(primitives, c, 8) - a0
        db = row3(primitives, c, 11) - b0
        a, b = a0 + t * da, b0 + t * db
        here = p + (u + total)
        normal = b
        gap = ((p - a) + (u + total)).dot(b) - thickness
        carried = da * step.share  # motion of the touched point over the substep
        if kind > 0:
            centre = a
            if kind == 2:
                axis = b - a
                share = ti.math.clamp((here - a).dot(axis) / ti.max(axis.dot(axis), 1e-20), 0.0, 1.0)
                centre = a + share * axis
                carried = (da + share * (db - da)) * step.share
            offset = (p - centre) + (u + total)
            size = offset.norm()
            normal = vec3(0.0, 1.0, 0.0)
            if size > 1e-9:
                normal = offset / size
            gap = size - primitives[c, 1] - thickness
        gap = cushioned(gap, thickness, step.cushion * step.h * step.h)
        total += contact_correction(gap, normal, slip + total - carried, step.friction, step.h)
    return total


@ti.func
def collide_fields(cloth: ti.template(), t: ti.f32, obstacles: ti.template(), step: ti.template()):
    """Put vertices out of the fields (rows of :mod:`pbd.contact.distance_field`), one after the other."""
    first = 0
    for c in range(obstacles.fields.shape[0]):
        size = ti.Vector([int(obstacles.fields[c, 0]), int(obstacles.fields[c, 1]), int(obstacles.fields[c, 2])])
        spacing, corner = obstacles.fields[c, 3], row3(obstacles.fields, c, 4)
        motion, spin = row3(obstacles.fields, c, 19), row3(obstacles.fields, c, 22)
        angle = spin.norm()
        axis = spin / ti.max(angle, 1e-20)
        centre = row3(obstacles.fields, c, 16) + (t - 1.0) * motion
        x = turned(row3(obstacles.fields, c, 7), axis, (t - 1.0) * angle)
        y = turned(row3(obstacles.fields, c, 10), axis, (t - 1.0) * angle)
        z = turned(row3(obstacles.fields, c, 13), axis, (t - 1.0) * angle)
        for i in range(cloth.position.shape[0]):
            if cloth.position[i][3] > 0.0:
                u = xyz(cloth.position_delta[i])
                offset = (xyz(cloth.position[i]) - centre) + u
                place = (vec3(offset.dot(x), offset.dot(y), offset.dot(z)) - corner) / spacing
                if place.min() >= 0.0 and (size - 1.0 - place).min() >= 0.0:
                    found = interpolated(obstacles.field_values, first, size, place)
                    if found[3] < step.thickness:
                        normal = found[0] * x + found[1] * y + found[2] * z
                        steepness = normal.norm()
                        normal = normal / steepness if steepness > 1e-6 * spacing else vec3(0.0, 1.0, 0.0)
                        foot = offset - found[3] * normal
                        carried = step.share * motion + (foot - turned(foot, axis, -step.share * angle))
                        slip = u - substep_start(cloth, i, step.h)
                        gap = cushioned(found[3] - step.thickness, step.thickness, step.cushion * step.h * step.h)
                        u += contact_correction(gap, normal, slip - carried, step.friction, step.h)
                        cloth.position_delta[i] = vec4(u)
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
    cell = ti.math.clamp(int(ti.floor(place)), 0, size - 2)  # so that each place reads values that exist
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
