"""The schedule: one kernel a frame, all substeps inside, one colour of constraints after the other.

An order that sweeps the mesh from one end to the other is unstable. Constraints of one colour share no vertex.
"""

from pbd.contact.corrections import cushioned
from pbd.contact.pairs import pulled, solve_pairs
from pbd.contact.response import (
    collide_fields,
    collide_primitives,
    height_over,
    keep_contact,
    push_out,
    sample_point,
    slid_off,
    substep_start,
    touch_body,
)
from pbd.contact.strain_limits import near_limits, solve_strain_limits
from pbd.engine import ti
from pbd.geometry import FAR, vec3, vec4, xyz
from pbd.xpbd.constraint_passes import solve_bending, solve_limits, solve_membrane, solve_stitches, solve_tethers
from pbd.xpbd.constraints import drag_velocity
from pbd.xpbd.multigrid_cycle import restrict, solve_levels
from pbd.xpbd.stiff_bending import solve_stiff_bending

__all__ = ["advance_garment"]

# A contact nearer than this is tested in every substep, even if nothing seems to move [m].
MIN_ACTIVE_DISTANCE = 0.01
# Faces around a vertex whose area is below this part of the squares of their sides are squeezed to lines [-].
MIN_AREA_SHARE = 1e-4
MIN_SIDES_SQUARED = 1e-12  # added to the sides of the faces at a vertex, squared: loose points have no face at all [m2]
# At most, over the strain limits. Shortening one edge lengthens the next: 8 passes leave a waistband 2.5 % too long, 32
# leave 2.2 %, 100 leave 2.0 %. Where cloth collides with itself there are as many before as after it.
LIMIT_PASSES = 32
LAST_GAP = (
    0.3  # share of the thickness that the cloth keeps from itself where the body leaves no room for all of it [-]
)
STITCH_PASSES = 4  # over the stitches, of which several may meet in one vertex
# In a frame positions are whole multiples of 1 m / GRID_STEPS: exact in float32 up to 16 m.
GRID_STEPS = 2.0**20


@ti.func
def advance_garment(
    step: ti.template(),
    cloth: ti.template(),
    constraints: ti.template(),
    body: ti.template(),
    obstacles: ti.template(),
    contact: ti.template(),
    multigrid: ti.template(),
    pairs: ti.template(),
):
    """Advance a garment by the substeps of a frame.

    Per substep: prediction, held vertices, bending of stiff cloth, coarser levels, membrane, bending, stitches,
    tethers, limits, contact with the body, strain limits and contact of the cloth with itself, with primitives and
    fields, velocities.

    Digits are kept in three places. A vertex stands at ``position`` (on a grid) plus a small ``position_delta`` that
    takes the corrections. The velocity takes (delta - predicted delta)/h, the sum of the corrections, instead of a
    difference of world positions. The velocity that a vertex gains over the frame is summed apart, in
    ``velocity_delta``.

    Over 60 lines: half of them are this description and the arguments.

    Args:
        step: :class:`pbd.xpbd.views.StepView`.
        cloth, constraints, body, obstacles, contact, multigrid, pairs: views of :mod:`pbd.xpbd.views` as well.
    """
    # A sample nearer than this may touch the body before all are tested again.
    active_distance = ti.max(
        MIN_ACTIVE_DISTANCE, step.thickness + contact.max_approach[0] * ti.min(1.0, step.refresh * step.share)
    )
    list_samples(cloth, contact)
    update_normals(cloth, constraints)
    begin_frame(cloth, step)
    stretched = 0  # whether any edge is near its limit
    for substep in range(step.begin, step.end + 1):
        t = (substep + 1) * step.share
        if obstacles.primitives.shape[0] > 0 and substep > step.begin:
            collide_with_primitives(cloth, t - step.share, obstacles, step)
        if obstacles.fields.shape[0] > 0 and substep > step.begin:
            collide_fields(cloth, t - step.share, obstacles, step)
        predict(cloth, substep, step)
        if substep < step.end:
            move_held(cloth, t, step)
            if ti.static(constraints.stiff):
                solve_stiff_bending(cloth, constraints, constraints.bending_factor, multigrid.patch_centers, step.h)
            if ti.static(multigrid.used):
                if step.levels > 0:
                    restrict(cloth, multigrid, step)
                    solve_levels(cloth.position.shape[0], multigrid, step)
                    move_with_patches(cloth, multigrid)
            solve_constraints(cloth, constraints, multigrid, t, step)
            tests_all = substep % step.refresh == 0
            for k in range(contact.sample_colors.shape[0] - 1):
                collide_with_body(cloth, body, contact, k, t, tests_all, substep == 0, active_distance, step)
            if ti.static(pairs.used):
                stretched = collide_with_itself(cloth, constraints, contact, pairs, t, tests_all, stretched, step)
            else:
                hold_bands(cloth, constraints, contact, t, step)
    end_frame(cloth, contact)


@ti.func
def list_samples(cloth: ti.template(), contact: ti.template()):
    """List the samples of each colour that have a body vertex near them, see :class:`pbd.xpbd.views.ContactWork`."""
    for k in range(contact.sample_colors.shape[0] - 1):
        begin, near_count = contact.sample_colors[k], 0
        for c in range(begin, contact.sample_colors[k + 1]):
            i, j = contact.samples[c][0], contact.samples[c][1]
            if contact.nearest[c] >= 0 and cloth.position[i][3] + cloth.position[j][3] > 0.0:
                contact.active_samples[begin + near_count] = c
                near_count += 1
        contact.active_counts[k] = ti.Vector([near_count, 0])


@ti.func
def update_normals(cloth: ti.template(), constraints: ti.template()):
    """Unit vertex normals and areas [m2]; the area is below 0 where faces are squeezed to lines and have no normal."""
    count = cloth.position.shape[0]
    for i in range(count):
        cloth.normals[i] = ti.math.vec4(0.0)
    for k in range(constraints.block_colors.shape[0] - 1):
        first, last = constraints.block_colors[k], constraints.block_colors[k + 1]
        for b in range(first, last):
            begin, size = constraints.triangle_blocks[b][0], constraints.triangle_blocks[b][1]
            for c in range(begin, begin + size):
                f = constraints.triangles[c]
                x0 = xyz(cloth.position[f[0]])
                side_1, side_2 = xyz(cloth.position[f[1]]) - x0, xyz(cloth.position[f[2]]) - x0
                n = vec4(side_1.cross(side_2), side_1.dot(side_1) + side_2.dot(side_2) + MIN_SIDES_SQUARED)
                for a in ti.static(range(3)):
                    cloth.normals[f[a]] = cloth.normals[f[a]] + n
    for i in range(count):
        n = xyz(cloth.normals[i])
        size = n.norm()
        has_normal = size >= MIN_AREA_SHARE * cloth.normals[i][3]
        cloth.normals[i] = vec4(n / ti.max(size, 1e-20), ti.select(has_normal, size / 6.0, -1.0))


@ti.func
def own_direction(i: ti.i32) -> vec3:
    """A direction of vertex i's own: points spread over the unit ball's surface in a spiral (Vogel 1979)."""
    height = 0.618033989 * i
    height = 2.0 * (height - ti.floor(height)) - 1.0
    across = ti.sqrt(1.0 - height * height)
    return vec3(across * ti.cos(2.39996323 * i), height, across * ti.sin(2.39996323 * i))


@ti.func
def begin_frame(cloth: ti.template(), step: ti.template()):
    """Put vertices on the grid, their deltas to the start, the pressure into ``normals``, and move held vertices."""
    count, held_count = cloth.position.shape[0], cloth.held.shape[0]
    for i in range(count):
        p = xyz(cloth.position[i])
        if cloth.normals[i][3] < 0.0 and cloth.position[i][3] > 0.0:
            p += 0.5 * step.thickness * own_direction(i)  # cloth squeezed to a line has no direction in which to open
        x = ti.floor(p * GRID_STEPS + 0.5) / GRID_STEPS
        cloth.position[i] = vec4(x, cloth.position[i][3])
        cloth.position_delta[i] = vec4(p - x)
        cloth.velocity_delta[i] = ti.math.vec4(0.0)
        acceleration = 0.0  # by pressure, along the normal [m/s2]
        if cloth.pressure.shape[0] > 0:
            acceleration = cloth.pressure[i] * cloth.position[i][3] * ti.max(cloth.normals[i][3], 0.0)
        cloth.normals[i][3] = acceleration
    for c in range(held_count):
        motion = cloth.target_end[c] - cloth.target_start[c]
        cloth.velocity[cloth.held[c]] = motion * (step.inverse_h * step.share)


@ti.func
def collide_with_primitives(cloth: ti.template(), t: ti.f32, obstacles: ti.template(), step: ti.template()):
    """Put vertices out of planes, spheres and capsules; t in [0, 1] of the frame."""
    count = cloth.position.shape[0]
    for i in range(count):
        if cloth.position[i][3] > 0.0:
            u = xyz(cloth.position_delta[i])
            slip = u - substep_start(cloth, i, step.h)
            u += collide_primitives(xyz(cloth.position[i]), u, slip, t, obstacles.primitives, step)
            cloth.position_delta[i] = vec4(u)


@ti.func
def predict(cloth: ti.template(), substep: ti.i32, step: ti.template()):
    """Take the velocity from the last substep's corrections, and predict where this one would bring the vertices."""
    count = cloth.position.shape[0]
    for i in range(count):
        if cloth.position[i][3] > 0.0:
            u, gain = xyz(cloth.position_delta[i]), xyz(cloth.velocity_delta[i])
            if substep > step.begin:
                gain += step.inverse_h * u
            if substep < step.end:
                n = xyz(cloth.normals[i])
                gain += step.h * step.gravity
                if cloth.pressure.shape[0] > 0:
                    gain += (step.h * cloth.normals[i][3]) * n
                v = cloth.velocity[i] + gain
                dragged = drag_velocity(v - xyz(cloth.air[i]), n, step.h * cloth.air[i][3])
                u += step.h * (v + dragged)
                # Whole steps of the grid go to the position, the rest to the delta: nothing is rounded away.
                whole = ti.floor(u * GRID_STEPS + 0.5) / GRID_STEPS
                cloth.position[i] = cloth.position[i] + vec4(whole)
                u -= whole
                gain += dragged - step.inverse_h * u
            cloth.position_delta[i] = vec4(u)
            cloth.velocity_delta[i] = vec4(gain)


@ti.func
def move_held(cloth: ti.template(), t: ti.f32, step: ti.template()):
    """Put held vertices where their targets are at t in [0, 1] of the frame."""
    for c in range(cloth.held.shape[0]):
        i, start = cloth.held[c], cloth.target_start[c]
        u = (start - xyz(cloth.position[i])) + t * (cloth.target_end[c] - start)
        cloth.position_delta[i] = vec4(u)
        cloth.velocity_delta[i] = vec4(-step.inverse_h * u)


@ti.func
def move_with_patches(cloth: ti.template(), multigrid: ti.template()):
    """Add the corrections of the finest level of patches to their vertices."""
    count = cloth.position.shape[0]
    for i in range(count):
        if cloth.position[i][3] > 0.0:
            a = multigrid.parent[i]
            correction = xyz(multigrid.displacement[a]) - xyz(multigrid.predicted_displacement[a])
            cloth.position_delta[i] = vec4(xyz(cloth.position_delta[i]) + correction)


@ti.func
def solve_constraints(
    cloth: ti.template(),
    constraints: ti.template(),
    multigrid: ti.template(),
    t: ti.f32,
    step: ti.template(),
):
    """One pass over membrane, bending, tethers and limits, several over the stitches; t in [0, 1] of the frame."""
    for k in range(constraints.block_colors.shape[0] - 1):
        first, last = constraints.block_colors[k], constraints.block_colors[k + 1]
        solve_membrane(
            cloth, constraints, multigrid, step.levels, step.inverse_h2, step.compression_compliance_scale, first, last
        )  # fmt: skip
    if ti.static(not constraints.stiff):  # else solved after the prediction
        for k in range(constraints.hinge_colors.shape[0] - 1):
            first, last = constraints.hinge_colors[k], constraints.hinge_colors[k + 1]
            solve_bending(cloth, constraints, step.inverse_h2, first, last)
    for _ in range(STITCH_PASSES):
        solve_stitches(cloth, constraints, t)
    solve_tethers(cloth, constraints)
    solve_limits(cloth, constraints.limits, t, step.inverse_h2)


@ti.func
def collide_with_body(
    cloth: ti.template(),
    body: ti.template(),
    contact: ti.template(),
    k: ti.i32,
    t: ti.f32,
    tests_all: ti.i32,
    is_first: ti.i32,
    active_distance: ti.f32,
    step: ti.template(),
):
    """Put the samples of colour k that touch the body out of it; t in [0, 1] of the frame.

    In the first substep every sample that has left the face of the last frame finds where it touches. Where
    ``tests_all``, all samples are tested: those nearer than ``active_distance`` [m] are active until the next time, and
    find again where they touch if they have slid off it. In between, only the active samples are tested.
    """
    half, region = contact.samples.shape[0], contact.sample_colors[k]
    tested = contact.active_counts[k][0] if tests_all else contact.active_counts[k][1]
    begin = region if tests_all else half + region
    active_count = 0
    for s in range(begin, begin + tested):
        c = contact.active_samples[s]
        i, j = contact.samples[c][0], contact.samples[c][1]
        x = sample_point(i, j, cloth, step.smooth_surface)
        if tests_all:
            u = 0.5 * (xyz(cloth.position_delta[i]) + xyz(cloth.position_delta[j]))
            again = is_first
            if is_first:
                again = not keep_contact(x + u, c, t, active_distance, body, contact)
            else:
                moved = xyz(contact.contact_points[c, 0]) + t * xyz(contact.contact_points[c, 1])
                offset, normal = (x - moved) + u, xyz(contact.contact_points[c, 2])
                again = offset.dot(normal) < active_distance and slid_off(offset, normal)
            if again:
                touch_body(x + u, c, t, step.thickness, body, contact)
        height = height_over(x, c, i, j, t, cloth, contact.contact_points)
        if tests_all and height < active_distance:
            contact.active_samples[half + region + active_count] = c
            active_count += 1
        if height < step.thickness:
            gap = cushioned(height - step.thickness, step.thickness, step.cushion * step.h * step.h)
            push_out(c, i, j, gap, step.friction, step, cloth, contact.contact_points)
    if tests_all:
        contact.active_counts[k][1] = active_count


@ti.func
def collide_with_itself(
    cloth: ti.template(),
    constraints: ti.template(),
    contact: ti.template(),
    pairs: ti.template(),
    t: ti.f32,
    tests_all: ti.i32,
    stretched: ti.i32,
    step: ti.template(),
) -> ti.i32:
    """Keep the cloth from going through itself; t in [0, 1] of the frame.

    This comes after the body, whose outside is known however deep cloth is in it: cloth that the body pinches must not
    go through itself, nor be drawn out between limbs that push it apart. Cloth that this puts under the body's surface
    comes out again.

    Returns:
        whether any edge was near its strain limit at the last test; ``stretched`` is the answer of the test before.
    """
    limits = ti.static(constraints.strain_limits)
    work = ti.static(constraints.limit_work)
    near = stretched
    if tests_all:
        near = near_limits(cloth, limits)
    solve_strain_limits(cloth, contact, limits, work, near * LIMIT_PASSES, step.h, t)
    for last in range(ti.select(pulled(pairs), 1, 2)):  # cloth that is through itself goes no faster than the pulls
        share = ti.select(last == 0, 1.0, LAST_GAP)
        solve_pairs(cloth, pairs, tests_all and last == 0, step.refresh * step.share, share, step.friction, step.h)
        if last == 0:
            for k in range(contact.sample_colors.shape[0] - 1):
                return_to_surface(cloth, contact, k, t, step)
    solve_strain_limits(cloth, contact, limits, work, near * LIMIT_PASSES, step.h, t)
    return near


@ti.func
def hold_bands(
    cloth: ti.template(), constraints: ti.template(), contact: ti.template(), t: ti.f32, step: ti.template()
):
    """Let waistbands hold where the cloth does not collide with itself; t in [0, 1] of the frame."""
    if constraints.strain_limits.shape[0] > 0:
        solve_strain_limits(cloth, contact, constraints.strain_limits, constraints.limit_work, LIMIT_PASSES, step.h, t)


@ti.func
def return_to_surface(cloth: ti.template(), contact: ti.template(), k: ti.i32, t: ti.f32, step: ti.template()):
    """Put active samples of colour k that are under the body's surface back to it, without friction."""
    begin = contact.samples.shape[0] + contact.sample_colors[k]
    for s in range(begin, begin + contact.active_counts[k][1]):
        c = contact.active_samples[s]
        i, j = contact.samples[c][0], contact.samples[c][1]
        height = height_over(sample_point(i, j, cloth, step.smooth_surface), c, i, j, t, cloth, contact.contact_points)
        if height < 0.0:
            push_out(c, i, j, height, 0.0, step, cloth, contact.contact_points)


@ti.func
def end_frame(cloth: ti.template(), contact: ti.template()):
    """Put the deltas into positions and velocities, and write the distances to the body."""
    for i in range(cloth.position.shape[0]):
        cloth.position[i] = cloth.position[i] + vec4(xyz(cloth.position_delta[i]))
        contact.contact_distance[i] = FAR
        if cloth.position[i][3] > 0.0:
            cloth.velocity[i] = cloth.velocity[i] + xyz(cloth.velocity_delta[i])
        if contact.nearest[i] >= 0 and cloth.position[i][3] > 0.0:
            moved = xyz(contact.contact_points[i, 0]) + xyz(contact.contact_points[i, 1])
            height = (xyz(cloth.position[i]) - moved).dot(xyz(contact.contact_points[i, 2]))
            contact.contact_distance[i] = ti.math.clamp(height, -FAR, FAR)
