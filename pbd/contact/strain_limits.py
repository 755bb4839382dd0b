"""Edges that contact may not draw out: the last word where limbs pinch cloth and push its vertices apart."""

from pbd.contact.response import height_over, substep_start
from pbd.engine import ti
from pbd.geometry import vec3, vec4, xyz
from pbd.xpbd.constraints import tether_correction

__all__ = ["MAX_STRETCH", "near_limits", "solve_strain_limits"]

MAX_STRETCH = 1.5  # greatest length of an edge over its rest length [-]
MAX_RETURN_SPEED = 3.0  # of an edge that starts a substep too long: a correction is also a velocity [m/s]
NEAR_SHARE = 0.8  # share of their greatest length from which edges are near it [-]


@ti.func
def near_limits(cloth: ti.template(), limits: ti.template()) -> ti.i32:
    """Whether any edge is near its greatest length; rows of ``limits``: its ends, and that length [m]."""
    found = 0
    for c in range(limits.shape[0]):
        i, j = int(limits[c][0]), int(limits[c][1])
        offset = (xyz(cloth.position[j]) - xyz(cloth.position[i])) + (
            xyz(cloth.position_delta[j]) - xyz(cloth.position_delta[i])
        )
        if offset.dot(offset) > (NEAR_SHARE * limits[c][2]) ** 2:
            found = 1
    return found


@ti.func
def solve_strain_limits(
    cloth: ti.template(), contact: ti.template(), limits: ti.template(), passes: ti.i32, h: ti.f32, t: ti.f32
):
    """Shorten edges that are longer than they may be (Provot 1995, "Deformation constraints").

    Edges slide along the surface of the body and do not go under it. Only beside a held vertex they may.

    Args:
        cloth, contact: views of the garment.
        limits: rows of the ends of an edge and its greatest length [m].
        passes: at most so many; fewer once no edge is too long.
        h: substep [s].
        t: time in the frame, in [0, 1].
    """
    pulled = 1
    for _ in range(passes):
        if pulled > 0:
            pulled = 0
            for c in range(limits.shape[0]):
                i, j = int(limits[c][0]), int(limits[c][1])
                p, q = cloth.position[i], cloth.position[j]
                u, v = xyz(cloth.position_delta[i]), xyz(cloth.position_delta[j])
                offset = (xyz(q) - xyz(p)) + (v - u)
                if offset.dot(offset) > limits[c][2] * limits[c][2]:
                    before = (xyz(q) - xyz(p)) + (substep_start(cloth, j, h) - substep_start(cloth, i, h))
                    longest = ti.max(limits[c][2], before.norm() - h * MAX_RETURN_SPEED)
                    move = tether_correction(offset, longest) / ti.max(p[3] + q[3], 1e-20)
                    free = p[3] * q[3] == 0.0
                    cloth.position_delta[i] = vec4(u + along_body(i, free, -p[3] * move, t, cloth, contact))
                    cloth.position_delta[j] = vec4(v + along_body(j, free, q[3] * move, t, cloth, contact))
                    pulled = 1


@ti.func
def along_body(i: ti.i32, free, move: vec3, t: ti.f32, cloth: ti.template(), contact: ti.template()) -> vec3:
    """A move of vertex i [m], less the part of it that would go under the body's surface unless it is free to."""
    allowed = move
    if not free and contact.nearest[i] >= 0:
        normal = xyz(contact.contact_points[i, 2])
        height = height_over(xyz(cloth.position[i]), i, i, i, t, cloth, contact.contact_points)
        allowed -= ti.min(ti.max(height, 0.0) + move.dot(normal), 0.0) * normal
    return allowed
