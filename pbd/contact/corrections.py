"""Constraint functions of contact and of limits: pure, by value, composed by the schedules in ``pbd.xpbd.schedule``."""

from pbd.engine import ti

__all__ = ["PUSH_OUT", "contact_correction", "cushioned", "limit_correction", "tether_correction"]

vec3 = ti.math.vec3
PUSH_OUT = 0.5  # a vertex that starts a substep inside a body comes out no faster than this against it [m/s]


@ti.func
def tether_correction(offset: vec3, length: ti.f32):
    """Long-range attachment (Kim, Chentanez, Mueller 2012): correction [m] of an offset [m] beyond its length [m]."""
    distance = offset.norm()
    correction = vec3(0.0)
    if distance > length:
        correction = offset * (length / distance - 1.0)
    return correction


@ti.func
def limit_correction(offset: vec3, normal: vec3, law: ti.math.vec4, inverse_h2: ti.f32, inverse_mass: ti.f32):
    """Soft and hard limits of a vertex about its target, the point to which the body carries it.

    A spring draws it there (XPBD, its multiplier from zero), a sphere keeps it near, a wall keeps it from going deep.

    Args:
        offset: from the target [m].
        normal: of the garment there, unit.
        law: maximum distance [m], depth of the wall under the target [m], compliance of the spring [m/N]; nothing
            below zero is there.
        inverse_h2: [1/s2].
        inverse_mass: [1/kg].

    Returns:
        Correction of the position [m].
    """
    x = offset
    if law[2] >= 0.0:
        x *= 1.0 - inverse_mass / ti.max(inverse_mass + law[2] * inverse_h2, 1e-20)
    if law[0] >= 0.0:
        x *= ti.min(1.0, law[0] / ti.max(x.norm(), 1e-20))
    if law[1] >= 0.0:
        x += ti.max(0.0, -law[1] - x.dot(normal)) * normal
    return ti.select(inverse_mass > 0.0, x - offset, vec3(0.0))


@ti.func
def contact_correction(gap: ti.f32, normal: vec3, slip: vec3, friction: ti.f32, h: ti.f32):
    """Contact by position with Coulomb friction (Mueller et al. 2007; Macklin et al. 2014, eq. 24).

    Motion into the collider is cancelled completely. Depth that was there before is removed at ``PUSH_OUT``: a
    correction is also a velocity, and a correction of the whole depth in one substep would throw the vertex out.

    Args:
        gap: signed distance to the collider less the thickness [m]; negative is contact.
        normal: outward, unit.
        slip: motion against the collider over the substep, before this correction [m].
        friction: Coulomb coefficient [-].
        h: substep [s].

    Returns:
        Correction of the position [m]. Sticks (cancels the whole tangential slip) inside the cone.
    """
    correction = vec3(0.0)
    if gap < 0.0:
        along = slip.dot(normal)
        depth = ti.min(-gap, ti.max(h * PUSH_OUT - along, 0.0))
        correction = depth * normal
        tangential = slip - along * normal
        size = tangential.norm()
        limit = depth * friction
        if size > limit:
            correction -= tangential * (limit / size)
        else:
            correction -= tangential
    return correction


@ti.func
def cushioned(gap: ti.f32, thickness: ti.f32, scaled_compliance: ti.f32):
    """The gap that remains to be closed where the cloth gives way by van Wyk's law, P = p_c ((T0/T)^3 - 1).

    An implicit step of the vertex against the law. The correction c leaves the depth r = -gap - c. The pressure at that
    depth must cause the correction: c = (h^2/rho_A) P(r). Newton's method solves this equation.

    Args:
        gap: signed distance to the collider less the thickness without pressure [m].
        thickness: T0 [m].
        scaled_compliance: h^2 p_c / rho_A [m]; 0 for cloth that does not give way.

    Returns:
        The gap that a correction has to close [m].
    """
    left = gap
    if scaled_compliance > 0.0 and gap < 0.0:
        # In y = (T0/T)^3: y - 1 + (T0/g) (1 - y^(-1/3)) = depth/g, g the scaled compliance.
        y = 1.0 - gap / scaled_compliance
        for _ in range(8):
            root = ti.pow(y, -1.0 / 3.0)
            off = scaled_compliance * (y - 1.0) + thickness * (1.0 - root) + gap
            y = ti.max(y - off / (scaled_compliance + thickness * root / (3.0 * y)), 1.0)
        left = -scaled_compliance * (y - 1.0)
    return left
