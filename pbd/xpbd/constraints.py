"""Constraint functions: small, pure, written once and composed by the schedules in ``pbd.xpbd.schedule``.

Each takes positions and inverse masses by value and returns the corrections. Multipliers start every substep at
zero (one pass a substep: "Small steps in physics simulation", Macklin et al. 2019), so that the compliance
term of XPBD (Macklin, Mueller, Chentanez 2016, eq. 18) keeps material stiffness independent of the step.
"""

from pbd.engine import ti
from pbd.fabric import MAX_STIFFENING_STRAIN
from pbd.geometry import larger

__all__ = [
    "FRICTION_STIFFNESS",
    "bent_hinge",
    "drag_velocity",
    "hinge_multiplier",
    "hinge_normal",
    "membrane_multipliers",
    "rubbing_hinge",
    "rubbing_shear",
    "spring_multiplier",
    "stiffened",
    "stitch_multiplier",
]

vec3 = ti.math.vec3
mat3x2 = ti.types.matrix(3, 2, ti.f32)
MIN_LENGTH_RATIO = 0.05  # a warp or weft compressed below this keeps its direction but not its slope [-]
MIN_DETERMINANT = 1e-6  # of a triangle's system, over the product of its diagonal [-]
# The shear acts as if warp and weft met at no sharper angle than 51 deg. Where they lie along each other, the true
# slope of the cosine is zero, and the correction would be without bounds.
MIN_SQUARED_SINE = 0.6  # of that angle

STRAIN_STEPS = 4  # of Newton's method for the strain at which a triangle comes to rest

FRICTION_STIFFNESS = 3.0  # of an element of internal friction, of a hinge or of shear, over the elastic stiffness [-]
# A hinge is nearly closed when (x_j - x_i) x (x_k - x_l) is no longer than this times its edge squared [-].
MIN_OPENING = 0.1
NO_OPENING = 1e-18  # of a hinge whose vertices are all in one point, which has no direction [m2]


@ti.func
def membrane_multipliers(
    side_1: vec3,
    side_2: vec3,
    inverse_flat,
    gram,
    compliance,
    unit,
    compression_compliance_scale,
    coarse_strain,
    slips_at: ti.f32,
    plastic: ti.f32,
    rubs: ti.template(),
):
    """Orthotropic plane-stress membrane of one triangle: three constraints solved together.

    Over 60 lines: one system of equations, whose parts have no meaning alone.

    The strains are those of Baraff and Witkin 1998 in engineering form: |w_u| - 1, |w_v| - 1 and the cosine between
    w_u and w_v, with [w_u w_v] = [x1-x0, x2-x0] Dm^-1. To first order they are e11, e22 and 2 e12, so that the energy
    A/2 e^T D e is linear elasticity; turning the triangle leaves them as they are. The 3 by 3 system
    (J M^-1 J^T + alpha/h^2) lambda = -C couples warp and weft exactly as the compliance alpha = D^-1/A says.

    Args:
        side_1, side_2: x1 - x0 and x2 - x0 [m].
        inverse_flat: Dm^-1 [1/m] as (b00, b01, b10, b11).
        gram: sums over the corners of w b b^T, times ``unit`` [-]: (uu, uv, vv).
        compliance: alpha/h^2, times ``unit`` [-], as (11, 12, 22, shear).
        unit: scale of the system [kg m2] that keeps its determinant in float32's range however fine the mesh.
        compression_compliance_scale: factor on the compliance of a warp or weft that is compressed [-].
        coarse_strain: strain that the coarser levels bear already, by the same compliance [-]: (uu, vv, uv).
        slips_at, plastic, rubs: internal friction of the shear, see :func:`rubbing_shear`; without ``rubs``, which is
            known while a kernel is compiled, there is none.

    Returns:
        3 by 2 matrix with columns g_u, g_v: corner 1 moves by w1 (b00 g_u + b01 g_v), corner 2 by
        w2 (b10 g_u + b11 g_v), corner 0 by -w0 ((b00 + b10) g_u + (b01 + b11) g_v). And ``plastic`` after it.
    """
    wu = side_1 * inverse_flat[0] + side_2 * inverse_flat[2]
    wv = side_1 * inverse_flat[1] + side_2 * inverse_flat[3]
    length_u = larger(wu.norm(), MIN_LENGTH_RATIO)
    length_v = larger(wv.norm(), MIN_LENGTH_RATIO)
    inverse_u, inverse_v = 1.0 / length_u, 1.0 / length_v
    nu, nv = wu * inverse_u, wv * inverse_v
    cu, cv, cs = length_u - 1.0, length_v - 1.0, nu.dot(nv)
    au, av = compliance[0], compliance[2]
    if cu < 0.0:
        au *= compression_compliance_scale
    if cv < 0.0:
        av *= compression_compliance_scale
    cu, cv, cs_left = cu - coarse_strain[0], cv - coarse_strain[1], cs - coarse_strain[2]
    rest = larger(1.0 - cs * cs, 0.0)
    # Directions of the shear constraint; each stands at right angles to its own axis.
    tu, tv = (nv - cs * nu) * inverse_u, (nu - cs * nv) * inverse_v
    a00 = gram[0] + au
    a11 = gram[2] + av
    a01 = gram[1] * cs + compliance[1]
    a02 = gram[1] * rest * inverse_v
    a12 = gram[1] * rest * inverse_u
    own = gram[0] * inverse_u * inverse_u + gram[2] * inverse_v * inverse_v
    # Where warp and weft lie along each other and a sliver's own rows do, too, float32 leaves nothing or less.
    turned = larger(own - 2.0 * gram[1] * cs * inverse_u * inverse_v, MIN_DETERMINANT * own)
    a22 = larger(rest, MIN_SQUARED_SINE) * turned + compliance[3]
    c02, c12, c22 = a01 * a12 - a02 * a11, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    kept = plastic
    if ti.static(rubs):
        at_rest, softer, kept = rubbing_shear(
            c02 * cu + c12 * cv + c22 * cs_left,
            larger(a02 * c02 + a12 * c12 + a22 * c22, MIN_DETERMINANT * a00 * a11 * a22),
            c22,
            compliance[3],
            coarse_strain[2],
            slips_at,
            plastic,
        )
        cs_left -= at_rest
        a22 += softer
    # Symmetric 3 by 3 solve by cofactors; the matrix is positive definite.
    c00, c01, c11 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a00 * a22 - a02 * a02
    # In float32 the determinant of a sliver may come to nothing or less.
    scale = -unit / larger(a00 * c00 + a01 * c01 + a02 * c02, MIN_DETERMINANT * a00 * a11 * a22)
    lu = scale * (c00 * cu + c01 * cv + c02 * cs_left)
    lv = scale * (c01 * cu + c11 * cv + c12 * cs_left)
    ls = scale * (c02 * cu + c12 * cv + c22 * cs_left)
    gu, gv = lu * nu + ls * tu, lv * nv + ls * tv
    return mat3x2([[gu[0], gv[0]], [gu[1], gv[1]], [gu[2], gv[2]]]), kept


@ti.func
def rubbing_shear(
    product: ti.f32,
    determinant: ti.f32,
    minor: ti.f32,
    compliance: ti.f32,
    coarse: ti.f32,
    slips_at: ti.f32,
    plastic: ti.f32,
):
    """Internal friction of shear: an elastoplastic element beside the elastic one, as in :func:`rubbing_hinge`.

    The shear's own multiplier is -(product)/(determinant) by Cramer's rule, and both are linear in its compliance and
    in the strain at which it rests. So the element's force at the end of the substep is known before the system is
    solved, and the system is solved once. There is no branch, so that triangles are solved together.

    Args:
        product: of the strains with the shear's column of cofactors, for the elastic shear alone.
        determinant: of the system, for the elastic shear alone.
        minor: c22, the shear's own cofactor.
        compliance: of the shear, as in the system.
        coarse: shear that the coarser levels bear already [-].
        slips_at: shear at which the elastic shear alone would bear the force at which the element slips [-].
        plastic: shear at which the element is without force [-].

    Returns:
        Change of the shear at rest [-] and of the compliance, which make of the elastic shear one that does the same in
        this substep; and the element's ``plastic`` after it.
    """
    rest = FRICTION_STIFFNESS / (1.0 + FRICTION_STIFFNESS) * (plastic - coarse)
    softer = compliance / (1.0 + FRICTION_STIFFNESS) - compliance
    stuck = larger(determinant + minor * softer, MIN_DETERMINANT * determinant)
    after = coarse + rest + (compliance + softer) * (product - minor * rest) / stuck
    slips = ti.abs(after - plastic) * FRICTION_STIFFNESS > slips_at
    slipping = ti.select(after > plastic, slips_at, -slips_at)
    slid = coarse - slipping + compliance * (product + minor * slipping) / determinant
    kept = slid - slipping / FRICTION_STIFFNESS
    return ti.select(slips, -slipping, rest), ti.select(slips, 0.0, softer), ti.select(slips, kept, plastic)


@ti.func
def stiffening_ratio(
    strain: ti.f32, mobility: ti.f32, compliance: ti.f32, borne: ti.f32, first: ti.f32, second: ti.f32
):
    """What stiffening adds to the tension of an axis at the end of a substep, over E h times the strain [-].

    The tension is E h (c + s(c)) with s of :func:`pbd.fabric.stiffening_stress`. Newton's method finds the strain c at
    which the triangle comes to rest if nothing else moves it: c + (g/alpha) (c + s(c) - e) = strain. Taken at the
    predicted strain instead, the tension would be too great, the more so the longer the substep.

    Args:
        strain: predicted [-].
        mobility, compliance: g and alpha/h^2 of the axis, both times ``unit`` [-].
        borne: e, strain that the coarser levels bear already [-].
        first, second: (a, b) of the axis [-].
    """
    share = mobility / compliance
    c = larger(strain, 0.0)
    for _ in ti.static(range(STRAIN_STEPS)):
        m = ti.min(c, MAX_STIFFENING_STRAIN)
        slope = m * (2.0 * first + 3.0 * second * m)
        stress = m * m * (first + second * m) + slope * (c - m)
        c = larger(c - (c - strain + share * (c + stress - borne)) / (1.0 + share * (1.0 + slope)), 0.0)
    m = ti.min(c, MAX_STIFFENING_STRAIN)
    return (m * m * (first + second * m) + m * (2.0 * first + 3.0 * second * m) * (c - m)) / larger(c, 1e-12)


@ti.func
def stiffened(side_1: vec3, side_2: vec3, inverse_flat, gram, compliance, law, coarse_strain):
    """Compliance of a triangle whose warp and weft are stiffer the more they are stretched, by their secants.

    With E1 h f1 and E2 h f2 added to the diagonal of D, the compliance is (D + F)^-1. The strain that the coarser
    levels bear stands for a tension; the stiffened triangle bears it at (D + F)^-1 D times that strain.

    Args:
        side_1, side_2, inverse_flat, gram, compliance, coarse_strain: as for :func:`membrane_multipliers`.
        law: (a, b) of the warp and of the weft [-], see :meth:`pbd.Fabric.stiffening`.

    Returns:
        compliance and coarse_strain of the stiffened triangle; the same bits where neither axis stays stretched.
    """
    cu = (side_1 * inverse_flat[0] + side_2 * inverse_flat[2]).norm() - 1.0
    cv = (side_1 * inverse_flat[1] + side_2 * inverse_flat[3]).norm() - 1.0
    au, auv, av = compliance[0], compliance[1], compliance[2]
    fu = stiffening_ratio(cu, gram[0], au, coarse_strain[0], law[0], law[1])
    fv = stiffening_ratio(cv, gram[2], av, coarse_strain[1], law[2], law[3])
    # D11 = q/alpha11 and D22 = q/alpha22, with 1/q = 1 - nu12 nu21; E1 h = 1/alpha11.
    coupling = auv * auv / (au * av)
    q = 1.0 / (1.0 - coupling)
    scale = 1.0 / ((q + fu) * (q + fv) - coupling * q * q)
    nu, nv, nuv = au * (q + fv) * scale, av * (q + fu) * scale, auv * q * scale
    eu, ev = coarse_strain[0], coarse_strain[1]
    su, sv = fu * eu / au, fv * ev / av  # F e
    changed = ti.abs(fu) + ti.abs(fv) > 0.0
    return (
        ti.math.vec4(
            ti.select(changed, nu, au), ti.select(changed, nuv, auv), ti.select(changed, nv, av), compliance[3]
        ),
        vec3(eu - nu * su - nuv * sv, ev - nuv * su - nv * sv, coarse_strain[2]),
    )


@ti.func
def spring_multiplier(
    offset: vec3, direction: vec3, length: ti.f32, scaled_compliance: ti.f32, total: ti.f32, multiplier: ti.f32
):
    """Change of the multiplier of a spring that only pulls.

    The force acts along ``direction``, that of the substep's start. If it acted along the direction at the end, a
    swing would lose the part h omega^2 of its speed a second. Along the direction at the start it loses nothing
    (Ryckaert, Ciccotti, Berendsen 1977).

    Args:
        offset: between its ends [m].
        direction: of the force, unit.
        length: at which it begins to pull [m].
        scaled_compliance: alpha/h^2 [1/kg].
        total: inverse mass of both ends [1/kg].
        multiplier: so far, at most 0 [kg m].
    """
    distance = offset.norm()
    # Where the ends have turned far against each other within a substep, the force hardly changes the distance.
    effective_inverse_mass = total * larger(direction.dot(offset), 0.3 * distance) + scaled_compliance * distance
    change = -distance * (distance - length + scaled_compliance * multiplier) / larger(effective_inverse_mass, 1e-20)
    return ti.select(multiplier + change < 0.0, multiplier + change, 0.0) - multiplier


@ti.func
def hinge_multiplier(d1, d2, d3, rows, inverse_sum: ti.f32):
    """Quadratic hinge, energy |K x|^2 / (2 alpha): multiplier of the vector constraint K x = 0.

    Args:
        d1, d2, d3: x_j - x_i, x_k - x_i, x_l - x_i [m], vec3 or vec4; the row sums to zero, so x_i itself drops out
            (and with it the loss of digits far from the origin).
        rows: (K_i, K_j, K_k, K_l).
        inverse_sum: 1 / (sum w K^2 + alpha/h^2).

    Returns:
        lambda; vertex a moves by w_a K_a lambda.
    """
    return -(rows[1] * d1 + rows[2] * d2 + rows[3] * d3) * inverse_sum


@ti.func
def hinge_normal(d1: vec3, across: vec3):
    """Direction n of a hinge's bend, and lengths [m2]: unit along (x_j - x_i) x (x_k - x_l), shorter if nearly closed.

    Args:
        d1, across: x_j - x_i and x_k - x_l [m].

    Returns:
        n, the length of the product, and the least length with which n is of unit length.
    """
    normal = d1.cross(across)
    length, least = normal.norm(), ti.max(MIN_OPENING * d1.dot(d1), NO_OPENING)
    return normal / ti.max(length, least), length, least


@ti.func
def bent_hinge(
    d1: vec3, across: vec3, bent: vec3, normal: vec3, length: ti.f32, least: ti.f32, rest: ti.f32, inverse_sum: ti.f32
):
    """Quadratic hinge that rests bent: energy |K x - c n|^2 / (2 alpha), n unit along (x_j - x_i) x (x_k - x_l).

    The turning of n counts, so that forces turn nothing: momentum and angular momentum are kept. Where the hinge is
    nearly closed, and its n undetermined, c fades.

    Args:
        d1, across: x_j - x_i and x_k - x_l [m].
        bent: K x [m].
        normal, length, least: see :func:`hinge_normal`.
        rest: c, see :func:`pbd.bending.bends_of` [m].
        inverse_sum: as for :func:`hinge_multiplier`.

    Returns:
        lambda, and vectors p and q: vertices i, j, k, l move by w (K lambda - p), w (K lambda + p), w (K lambda + q)
        and w (K lambda - q).
    """
    multiplier = -(bent - rest * normal) * inverse_sum
    turning = multiplier
    if length > least:
        turning -= normal * normal.dot(multiplier)
    turning *= rest / ti.max(length, least)
    return multiplier, turning.cross(across), d1.cross(turning)


@ti.func
def rubbing_hinge(bend: ti.f32, law, plastic: ti.f32, inverse_h2: ti.f32):
    """Internal friction of a hinge: an elastoplastic element beside the elastic one (Miguel et al. 2013).

    The element is :data:`FRICTION_STIFFNESS` times as stiff as the elastic hinge and slips at a force of its own. The
    step is implicit: where the element would slip at the end of the substep, its force is the one at which it slips.

    Args:
        bend: n . K x before the correction [m].
        law: sum of w K^2 [1/kg], compliance [m/N], bend at rest [m], and the bend by which the elastic hinge alone
            would bear the force at which the element slips [m].
        plastic: bend at which the element is without force [m].
        inverse_h2: [1/s2].

    Returns:
        bend at rest and inverse_sum of the elastic hinge that does the same in this substep, see :func:`bent_hinge`;
        and the element's ``plastic`` after it.
    """
    stuck = 1.0 / (law[0] + law[1] * inverse_h2 / (1.0 + FRICTION_STIFFNESS))
    rest = (law[2] + FRICTION_STIFFNESS * plastic) / (1.0 + FRICTION_STIFFNESS)
    inverse_sum, kept = stuck, plastic
    off = bend - law[0] * stuck * (bend - rest) - plastic
    if ti.abs(off) * FRICTION_STIFFNESS > law[3]:
        slipping = ti.select(off > 0.0, law[3], -law[3])
        inverse_sum = 1.0 / (law[0] + law[1] * inverse_h2)
        rest = law[2] - slipping
        kept = bend - law[0] * inverse_sum * (bend - rest) - slipping / FRICTION_STIFFNESS
    return rest, inverse_sum, kept


@ti.func
def stitch_multiplier(to_a: vec3, to_b: vec3, w: ti.f32, inverse_v: ti.f32, inverse_a: ti.f32, inverse_b: ti.f32):
    """Stitch of a vertex to a point of an edge: multiplier of x_v - (1 - w) x_a - w x_b = 0, without compliance.

    Args:
        to_a, to_b: x_a - x_v and x_b - x_v [m].
        w: position on the edge, 0 at a and 1 at b.
        inverse_v, inverse_a, inverse_b: inverse masses [1/kg], not all zero where the weights are not.

    Returns:
        lambda as vec3; v moves by w_v lambda, a by -w_a (1 - w) lambda, b by -w_b w lambda.
    """
    u = 1.0 - w
    return (u * to_a + w * to_b) / ti.max(inverse_v + u * u * inverse_a + w * w * inverse_b, 1e-20)


@ti.func
def drag_velocity(velocity: vec3, normal: vec3, factor: ti.f32):
    """Air drag of a surface along its normal, stable at any step: v_n' = v_n / (1 + factor |v_n|).

    Args:
        velocity: against the air [m/s].
        normal: unit.
        factor: h rho_air C_d A / (2 m) [s/m].

    Returns:
        Change of velocity [m/s].
    """
    along = velocity.dot(normal)
    share = factor * ti.abs(along)
    return -normal * (along * share / (1.0 + share))
