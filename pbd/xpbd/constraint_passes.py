"""One pass over the constraints of each kind, or of one colour of them."""

from pbd.contact.corrections import limit_correction, tether_correction
from pbd.engine import ti
from pbd.geometry import vec3, vec4, xyz
from pbd.model import BLOCK
from pbd.taichi_internals import same
from pbd.xpbd.constraints import (
    bent_hinge,
    hinge_multiplier,
    hinge_normal,
    membrane_multipliers,
    rubbing_hinge,
    stiffened,
    stitch_multiplier,
)

__all__ = ["solve_bending", "solve_limits", "solve_membrane", "solve_stitches", "solve_tethers"]

STIFFENING_ROWS = 16  # of the data of triangles that stiffen, at least; others have 12, and both two more for friction


@ti.func
def offset(cloth: ti.template(), i: ti.i32, j: ti.i32):
    """From vertex i to vertex j [m], with a fourth component that means nothing.

    Where positions take the corrections themselves, ``position_delta`` is the same array.
    """
    between = cloth.position[j] - cloth.position[i]
    if ti.static(not same(cloth.position, cloth.position_delta)):
        between += cloth.position_delta[j] - cloth.position_delta[i]
    return between


@ti.func
def solve_membrane(
    cloth: ti.template(),
    constraints: ti.template(),
    multigrid: ti.template(),
    levels: ti.i32,
    inverse_h2: ti.f32,
    compression_compliance_scale: ti.f32,
    first: ti.i32,
    last: ti.i32,
):
    """One pass over the triangles of blocks ``first`` to ``last``, which is left out; each block is of one colour.

    A block is read, solved and written in turn. It is solved in local arrays that nothing else can point to, so that
    the compiler solves eight triangles at once: a third of the time. Triangles are read one at a time: the compiler
    would take gather instructions, which cost twice as much; it does not for a loop that it cannot count.

    Over 60 lines: the three loops share the local arrays, which a function could not hand on.

    Args:
        cloth, constraints, multigrid: views of the garment.
        levels: coarser levels that were solved before; 0 for none.
        inverse_h2: [1/s2].
        compression_compliance_scale: see :func:`pbd.xpbd.constraints.membrane_multipliers`.
    """
    x1, y1, z1 = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    x2, y2, z2 = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    e1, e2, e3 = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    plastic = ti.Vector([0.0] * BLOCK)
    for b in range(first, last):
        begin, size = constraints.triangle_blocks[b][0], constraints.triangle_blocks[b][1]
        for a in range(size):
            f = constraints.triangles[begin + a]
            i, j, k = f[0], f[1], f[2]
            if i < 0:  # never; see above
                break
            side_1, side_2 = offset(cloth, i, j), offset(cloth, i, k)
            x1[a], y1[a], z1[a] = side_1[0], side_1[1], side_1[2]
            x2[a], y2[a], z2[a] = side_2[0], side_2[1], side_2[2]
            if levels > 0:
                e = multigrid.coarse_strain[multigrid.parent[i]]
                e1[a], e2[a], e3[a] = e[0], e[1], e[2]
        # A kernel has the loop twice, so that fabrics that do not stiffen pay nothing.
        rows = constraints.triangle_data.shape[0]
        for stiffens in ti.static((False, True)):
            if stiffens == (rows >= STIFFENING_ROWS):
                for a in range(BLOCK):  # the triangles beyond the block's size come to nothing
                    c = begin + a
                    inverse_flat = row4(constraints.triangle_data, 0, c)
                    side_1, side_2 = vec3(x1[a], y1[a], z1[a]), vec3(x2[a], y2[a], z2[a])
                    gram = row3(constraints.triangle_data, 4, c)
                    compliance = inverse_h2 * row4(constraints.triangle_data, 8, c)
                    borne = vec3(e1[a], e2[a], e3[a])
                    if ti.static(stiffens):
                        law = row4(constraints.triangle_data, 12, c)
                        compliance, borne = stiffened(side_1, side_2, inverse_flat, gram, compliance, law, borne)
                    slips_at, kept = 0.0, 0.0
                    if ti.static(constraints.rubs):
                        slips_at = constraints.triangle_data[rows - 2, c]
                        kept = constraints.triangle_data[rows - 1, c]
                    g, kept = membrane_multipliers(
                        side_1,
                        side_2,
                        inverse_flat,
                        gram,
                        compliance,
                        constraints.triangle_data[7, c],
                        compression_compliance_scale,
                        borne,
                        slips_at,
                        kept,
                        constraints.rubs,
                    )
                    if ti.static(constraints.rubs):
                        plastic[a] = kept
                    gu, gv = vec3(g[0, 0], g[1, 0], g[2, 0]), vec3(g[0, 1], g[1, 1], g[2, 1])
                    m1 = inverse_flat[0] * gu + inverse_flat[1] * gv
                    m2 = inverse_flat[2] * gu + inverse_flat[3] * gv
                    x1[a], y1[a], z1[a] = m1[0], m1[1], m1[2]
                    x2[a], y2[a], z2[a] = m2[0], m2[1], m2[2]
        for a in range(size):
            f = constraints.triangles[begin + a]
            m1, m2 = ti.math.vec4(x1[a], y1[a], z1[a], 0.0), ti.math.vec4(x2[a], y2[a], z2[a], 0.0)
            i, j, k = f[0], f[1], f[2]
            cloth.position_delta[i] = cloth.position_delta[i] - cloth.position[i][3] * (m1 + m2)
            cloth.position_delta[j] = cloth.position_delta[j] + cloth.position[j][3] * m1
            cloth.position_delta[k] = cloth.position_delta[k] + cloth.position[k][3] * m2
            if ti.static(constraints.rubs):
                constraints.triangle_data[rows - 1, begin + a] = plastic[a]


@ti.func
def row3(data: ti.template(), first: ti.template(), c: ti.i32):
    """Three rows of a column, from the first on."""
    return vec3(data[first, c], data[first + 1, c], data[first + 2, c])


@ti.func
def row4(data: ti.template(), first: ti.template(), c: ti.i32):
    """Four rows of a column, from the first on."""
    return ti.math.vec4(data[first, c], data[first + 1, c], data[first + 2, c], data[first + 3, c])


@ti.func
def solve_bending(cloth: ti.template(), constraints: ti.template(), inverse_h2: ti.f32, begin: ti.i32, end: ti.i32):
    """One pass over the hinges ``begin`` to ``end``, which is left out, of one colour; ``inverse_h2`` [1/s2].

    Hinges that are flat at rest and do not rub are read, solved and written without a branch in between, so that the
    compiler takes all four components at once.
    """
    bent_count = 0
    for c in range(begin, end):
        q = constraints.hinges[c]
        law = constraints.hinge_data[c, 1]
        if law[2] == 0.0 and law[3] <= 0.0:
            i, j, k, m = q[0], q[1], q[2], q[3]
            p0, p1, p2, p3 = cloth.position[i], cloth.position[j], cloth.position[k], cloth.position[m]
            u0, u1 = cloth.position_delta[i], cloth.position_delta[j]
            u2, u3 = cloth.position_delta[k], cloth.position_delta[m]
            rows = constraints.hinge_data[c, 0]
            inverse_sum = 1.0 / (law[0] + law[1] * inverse_h2)
            d1, d2, d3 = offset(cloth, i, j), offset(cloth, i, k), offset(cloth, i, m)
            multiplier = hinge_multiplier(d1, d2, d3, rows, inverse_sum)
            cloth.position_delta[i] = u0 + p0[3] * rows[0] * multiplier
            cloth.position_delta[j] = u1 + p1[3] * rows[1] * multiplier
            cloth.position_delta[k] = u2 + p2[3] * rows[2] * multiplier
            cloth.position_delta[m] = u3 + p3[3] * rows[3] * multiplier
        else:
            bent_count += 1
    if bent_count > 0:
        for c in range(begin, end):
            law = constraints.hinge_data[c, 1]
            if law[2] != 0.0 or law[3] > 0.0:
                solve_bent_hinge(cloth, constraints, c, inverse_h2)


@ti.func
def solve_bent_hinge(cloth: ti.template(), constraints: ti.template(), c: ti.i32, inverse_h2: ti.f32):
    """Solve hinge c, which is bent at rest or rubs; ``inverse_h2`` [1/s2]."""
    q = constraints.hinges[c]
    i, j, k, m = q[0], q[1], q[2], q[3]
    p0, p1, p2, p3 = cloth.position[i], cloth.position[j], cloth.position[k], cloth.position[m]
    u0, u1 = cloth.position_delta[i], cloth.position_delta[j]
    u2, u3 = cloth.position_delta[k], cloth.position_delta[m]
    rows, law = constraints.hinge_data[c, 0], constraints.hinge_data[c, 1]
    inverse_sum = 1.0 / (law[0] + law[1] * inverse_h2)
    d1, d2, d3 = offset(cloth, i, j), offset(cloth, i, k), offset(cloth, i, m)
    bent = xyz(rows[1] * d1 + rows[2] * d2 + rows[3] * d3)
    normal, length, least = hinge_normal(xyz(d1), xyz(d2 - d3))
    rest = law[2]
    if law[3] > 0.0:  # a third row of data is there
        kept = constraints.hinge_data[c, 2][0]
        rest, inverse_sum, kept = rubbing_hinge(normal.dot(bent), law, kept, inverse_h2)
        constraints.hinge_data[c, 2][0] = kept
    bent, along, across = bent_hinge(xyz(d1), xyz(d2 - d3), bent, normal, length, least, rest, inverse_sum)
    multiplier = vec4(bent)
    cloth.position_delta[i] = (u0 - p0[3] * vec4(along)) + p0[3] * rows[0] * multiplier
    cloth.position_delta[j] = (u1 + p1[3] * vec4(along)) + p1[3] * rows[1] * multiplier
    cloth.position_delta[k] = (u2 + p2[3] * vec4(across)) + p2[3] * rows[2] * multiplier
    cloth.position_delta[m] = (u3 - p3[3] * vec4(across)) + p3[3] * rows[3] * multiplier


@ti.func
def solve_stitches(cloth: ti.template(), constraints: ti.template(), t: ti.f32):
    """One pass over all stitches, in order, because several stitches may meet in one vertex.

    A stitch that is still open holds its two points no further apart than that; t in [0, 1] of the frame.
    """
    for c in range(constraints.stitches.shape[0]):
        s, data = constraints.stitches[c], constraints.stitch_data[c]
        w, gap = data[0], data[1] + t * (data[2] - data[1])
        i, j, k = s[0], s[1], s[2]
        v, a, b = cloth.position[i], cloth.position[j], cloth.position[k]
        to_a, to_b = xyz(offset(cloth, i, j)), xyz(offset(cloth, i, k))
        multiplier = stitch_multiplier(to_a, to_b, w, v[3], a[3], b[3])
        if gap > 0.0:
            distance = ((1.0 - w) * to_a + w * to_b).norm()
            multiplier *= ti.max(0.0, 1.0 - gap / ti.max(distance, 1e-20))
        cloth.position_delta[i] = cloth.position_delta[i] + vec4(v[3] * multiplier)
        cloth.position_delta[j] = cloth.position_delta[j] - vec4(a[3] * (1.0 - w) * multiplier)
        cloth.position_delta[k] = cloth.position_delta[k] - vec4(b[3] * w * multiplier)


@ti.func
def solve_tethers(cloth: ti.template(), constraints: ti.template()):
    """Pull back the vertices that are further from their held vertex than their tether is long."""
    for c in range(constraints.tethers.shape[0]):
        i, j = constraints.tethers[c][0], constraints.tethers[c][1]
        away, length = xyz(offset(cloth, j, i)), constraints.tether_lengths[c]
        if away.dot(away) > length * length:
            cloth.position_delta[i] = cloth.position_delta[i] + vec4(tether_correction(away, length))


@ti.func
def solve_limits(cloth: ti.template(), limits: ti.template(), t: ti.f32, inverse_h2: ti.f32):
    """Keep limited vertices near the places to which the body carries them; t in [0, 1] of the frame."""
    for c in range(limits.shape[0]):
        i = int(limits[c, 0][3])
        u = xyz(cloth.position_delta[i])
        offset = (xyz(cloth.position[i]) - xyz(limits[c, 0])) + (u - t * xyz(limits[c, 1]))
        correction = limit_correction(offset, xyz(limits[c, 2]), limits[c, 3], inverse_h2, cloth.position[i][3])
        cloth.position_delta[i] = vec4(u + correction)
