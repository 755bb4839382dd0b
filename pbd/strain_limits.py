"""Edges that contact may not draw out: the last word where limbs pinch cloth and push its vertices apart."""

from pbd.constraints import tether_correction
from pbd.contact import height_over, substep_start
from pbd.engine import ti
from pbd.geometry import vec3, vec4, xyz

__all__ = ["LONGEST", "near_limits", "solve_strain_limits"]

LONGEST = 1.5  # greatest length of an edge over its rest length [-]
DRAWN_BACK = 3.0  # what starts a substep longer comes back no faster: a correction is also a velocity [m/s]
NEAR = 0.8  # part of their greatest length from which edges are near it [-]


@ti.func
def near_limits(position: ti.template(), shift: ti.template(), limits: ti.template()) -> ti.i32:
    """Whether any edge is near its greatest length; rows of ``limits``: its ends, and that length [m]."""
    found = 0
    for c in range(limits.shape[0]):
        i, j = int(limits[c][0]), int(limits[c][1])
        offset = (xyz(position[j]) - xyz(position[i])) + (xyz(shift[j]) - xyz(shift[i]))
        if offset.dot(offset) > (NEAR * limits[c][2]) ** 2:
            found = 1
    return found


@ti.func
def solve_strain_limits(
    position: ti.template(),
    velocity: ti.template(),
    shift: ti.template(),
    gained: ti.template(),
    limits: ti.template(),
    passes: ti.i32,
    h: ti.f32,
    t: ti.f32,
    nearest: ti.template(),
    touched: ti.template(),
):
    """Shorten edges that are longer than they may be (Provot 1995, "Deformation constraints"), in some passes at most.

    They go along the surface of the body, not under it; but what is held takes its neighbours along.
    """
    pulled = 1
    for _ in range(passes):
        if pulled > 0:
            pulled = 0
            for c in range(limits.shape[0]):
                i, j = int(limits[c][0]), int(limits[c][1])
                p, q = position[i], position[j]
                u, v = xyz(shift[i]), xyz(shift[j])
                offset = (xyz(q) - xyz(p)) + (v - u)
                if offset.dot(offset) > limits[c][2] * limits[c][2]:
                    before = (xyz(q) - xyz(p)) + (
                        substep_start(velocity, gained, j, h) - substep_start(velocity, gained, i, h)
                    )
                    most = ti.max(limits[c][2], before.norm() - h * DRAWN_BACK)
                    move = tether_correction(offset, most) / ti.max(p[3] + q[3], 1e-20)
                    free = p[3] * q[3] == 0.0
                    shift[i] = vec4(u + along_body(i, free, -p[3] * move, t, position, shift, nearest, touched))
                    shift[j] = vec4(v + along_body(j, free, q[3] * move, t, position, shift, nearest, touched))
                    pulled = 1


@ti.func
def along_body(
    i: ti.i32,
    free,
    move: vec3,
    t: ti.f32,
    position: ti.template(),
    shift: ti.template(),
    nearest: ti.template(),
    touched: ti.template(),
) -> vec3:
    """A move of vertex i, less what of it would go under the surface of the body unless it is free to."""
    allowed = move
    if not free and nearest[i] >= 0:
        normal = xyz(touched[i, 2])
        height = height_over(xyz(position[i]), i, i, i, t, shift, touched)
        allowed -= ti.min(ti.max(height, 0.0) + move.dot(normal), 0.0) * normal
    return allowed
