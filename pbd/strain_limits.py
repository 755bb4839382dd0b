"""Edges that contact may not draw out: the last word where limbs pinch cloth and push its vertices apart."""

from pbd.constraints import tether_correction
from pbd.engine import ti
from pbd.geometry import vec3, vec4, xyz

__all__ = ["LONGEST", "list_stretched", "solve_strain_limits"]

LONGEST = 1.5  # greatest length of an edge over its rest length [-]
NEARLY = 0.8  # none is looked at before one has reached this part of its greatest length [-]


@ti.func
def list_stretched(position: ti.template(), shift: ti.template(), limits: ti.template()):
    """Number of edges that are longer than at rest, or none while all are far from their limit.

    Which they are stands last in the first rows of ``limits``, see :func:`solve_strain_limits`. Those between rest and
    limit count because they are next: what is taken from one goes to its neighbours.
    """
    count, near = 0, 0
    for c in range(limits.shape[0]):
        i, j, most = int(limits[c][0]), int(limits[c][1]), limits[c][2]
        offset = (xyz(position[j]) - xyz(position[i])) + (xyz(shift[j]) - xyz(shift[i]))
        square = offset.dot(offset)
        if square > (most / LONGEST) ** 2:
            limits[count][3] = c
            count += 1
        if square > (NEARLY * most) ** 2:
            near = 1
    return near * count


@ti.func
def solve_strain_limits(
    position: ti.template(),
    shift: ti.template(),
    limits: ti.template(),
    count: ti.i32,
    passes: ti.i32,
    t: ti.f32,
    nearest: ti.template(),
    touched: ti.template(),
):
    """Shorten listed edges that are longer than they may be (Provot 1995, "Deformation constraints").

    Rows of ``limits``: both ends, greatest length [m], and the number of a listed edge, of which there are ``count``.
    ``passes``: most passes over them. The rest as in :func:`pbd.contact.touch_body`.
    """
    pulled = 1
    for _ in range(passes):
        if pulled > 0:
            pulled = 0
            for c in range(count):
                limit = limits[int(limits[c][3])]
                i, j = int(limit[0]), int(limit[1])
                p, q = position[i], position[j]
                u, v = xyz(shift[i]), xyz(shift[j])
                offset = (xyz(q) - xyz(p)) + (v - u)
                if offset.dot(offset) > limit[2] * limit[2]:
                    move = tether_correction(offset, limit[2]) / ti.max(p[3] + q[3], 1e-20)
                    shift[i] = vec4(u + along_body(i, -p[3] * move, t, position, shift, nearest, touched))
                    shift[j] = vec4(v + along_body(j, q[3] * move, t, position, shift, nearest, touched))
                    pulled = 1


@ti.func
def along_body(
    i: ti.i32,
    move: vec3,
    t: ti.f32,
    position: ti.template(),
    shift: ti.template(),
    nearest: ti.template(),
    touched: ti.template(),
) -> vec3:
    """A move of vertex i, less what of it would go under the surface of the body."""
    allowed = move
    if nearest[i] >= 0:
        normal = xyz(touched[i, 2])
        height = ((xyz(position[i]) - (xyz(touched[i, 0]) + t * xyz(touched[i, 1]))) + xyz(shift[i])).dot(normal)
        allowed -= ti.min(ti.max(height, 0.0) + move.dot(normal), 0.0) * normal
    return allowed
