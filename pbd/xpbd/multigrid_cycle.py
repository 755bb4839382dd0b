"""Coarser levels in one substep: they carry tension over long distances in few passes.

The centres of the patches of all levels are computed from the finest up (restriction). Then each level is solved, from
the coarsest down, and its corrections are added to the next finer one (prolongation).
"""

from pbd.contact.response import substep_start
from pbd.engine import ti
from pbd.geometry import larger, vec3, vec4, xyz
from pbd.model import BLOCK
from pbd.xpbd.constraints import spring_multiplier

__all__ = ["prolong", "restrict", "solve_levels", "solve_springs"]


# Springs of all levels together change the speed of their ends against each other by no more than this in a substep
# [m/s]: otherwise patches would throw cloth far away that held vertices pull.
MAX_SPEED_CHANGE = 30.0
LENGTH_TOLERANCE = 1e-6  # springs pull beyond their length and this: positions in float32 are no more exact [m]


@ti.func
def restrict(cloth: ti.template(), multigrid: ti.template(), step: ti.template()):
    """Centres of mass of the patches of all levels at the start of a substep, and their predicted displacements [m].

    The fourth column of ``displacement``, the inverse mass, stays.
    """
    count = cloth.position.shape[0]
    for level in range(step.levels):
        first, last = multigrid.level_starts[level], multigrid.level_starts[level + 1]
        for a in range(first, last):
            center, displacement = vec3(0.0), vec3(0.0)
            for q in range(multigrid.children[a], multigrid.children[a + 1]):
                i = multigrid.children[q]
                if level == 0:
                    start = substep_start(cloth, i, step.h)
                    center += multigrid.mass_share[i] * (xyz(cloth.position[i]) + start)
                    displacement += multigrid.mass_share[i] * (xyz(cloth.position_delta[i]) - start)
                else:
                    center += multigrid.mass_share[i] * xyz(multigrid.patch_centers[i - count])
                    displacement += multigrid.mass_share[i] * xyz(multigrid.displacement[i - count])
            multigrid.patch_centers[a] = vec4(center)
            multigrid.displacement[a] = vec4(displacement, multigrid.displacement[a][3])


@ti.func
def solve_springs(multigrid: ti.template(), begin: ti.i32, end: ti.i32):
    """One pass over the springs ``begin`` to ``end``, which is left out, of one colour.

    Springs are read, solved and written in blocks, as in :func:`pbd.xpbd.constraint_passes.solve_membrane`.
    """
    x, y, z = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    changes = ti.Vector([0.0] * BLOCK)
    for b in range((end - begin + BLOCK - 1) // BLOCK):
        first = begin + b * BLOCK
        size = ti.min(BLOCK, end - first)
        for a in range(size):
            spring = multigrid.springs[first + a]
            if spring[0] < 0:  # never; see there
                break
            offset = multigrid.displacement[spring[0]] - multigrid.displacement[spring[1]]
            x[a], y[a], z[a] = offset[0], offset[1], offset[2]
        for a in range(BLOCK):  # the springs beyond the block's size come to nothing
            c = first + a
            direction = vec3(
                multigrid.spring_workspace[0, c], multigrid.spring_workspace[1, c], multigrid.spring_workspace[2, c]
            )
            old = multigrid.spring_workspace[7, c]
            offset = multigrid.spring_workspace[3, c] * direction + vec3(x[a], y[a], z[a])
            change = spring_multiplier(
                offset,
                direction,
                multigrid.spring_workspace[4, c],
                multigrid.spring_workspace[5, c],
                multigrid.spring_workspace[6, c],
                old,
            )
            change = larger(old + change, multigrid.spring_workspace[8, c]) - old
            changes[a], x[a], y[a], z[a] = change, change * direction[0], change * direction[1], change * direction[2]
        for a in range(size):
            c, change = first + a, changes[a]
            if change != 0.0:
                move = vec4(vec3(x[a], y[a], z[a]))
                i, j = multigrid.springs[c][0], multigrid.springs[c][1]
                p, q = multigrid.displacement[i], multigrid.displacement[j]
                multigrid.spring_workspace[7, c] = multigrid.spring_workspace[7, c] + change
                multigrid.displacement[i] = p + p[3] * move
                multigrid.displacement[j] = q - q[3] * move


@ti.func
def solve_levels(vertex_count: ti.i32, multigrid: ti.template(), step: ti.template()):
    """Correct the displacements of patches, from coarse to fine, until no spring is longer than the fabric lets it be.

    Multipliers of springs are multipliers of the fabric. The mean stress that the coarser levels bear in a patch is a
    strain (``coarse_strain``) that the finer ones need not take out, so that the stiffness stays the fabric's own.
    """
    last = multigrid.level_starts[step.levels]
    for a in range(last):
        multigrid.predicted_displacement[a] = multigrid.displacement[a]
        multigrid.coarse_strain[a] = ti.math.vec4(0.0)
    for down in range(step.levels):
        level = step.levels - 1 - down
        if down > 0:
            prolong(vertex_count, level, multigrid)
        prepare_springs(level, multigrid, step)
        for _ in range(step.sweeps):
            for k in range(multigrid.color_starts[level], multigrid.color_starts[level + 1]):
                begin, end = multigrid.spring_colors[k], multigrid.spring_colors[k + 1]
                solve_springs(multigrid, begin, end)
        add_strain(level, multigrid, step)


@ti.func
def prolong(vertex_count: ti.i32, level: ti.i32, multigrid: ti.template()):
    """Add the corrections of the next coarser level to a level of patches."""
    first, last = multigrid.level_starts[level], multigrid.level_starts[level + 1]
    for a in range(first, last):
        above = multigrid.parent[vertex_count + a]
        p = multigrid.displacement[a]
        if p[3] > 0.0:
            correction = xyz(multigrid.displacement[above]) - xyz(multigrid.predicted_displacement[above])
            multigrid.displacement[a] = vec4(xyz(p) + correction, p[3])
        multigrid.coarse_strain[a] = multigrid.coarse_strain[above]


@ti.func
def prepare_springs(level: ti.i32, multigrid: ti.template(), step: ti.template()):
    """Fill the workspace of the springs of a level, see :class:`pbd.xpbd.views.MultigridArrays`."""
    inverse_h2 = 1.0 / (step.h * step.h)
    begin = multigrid.spring_colors[multigrid.color_starts[level]]
    end = multigrid.spring_colors[multigrid.color_starts[level + 1]]
    for c in range(begin, end):
        i, j = multigrid.springs[c][0], multigrid.springs[c][1]
        e = 0.5 * (multigrid.coarse_strain[i] + multigrid.coarse_strain[j])
        offset = xyz(multigrid.patch_centers[i]) - xyz(multigrid.patch_centers[j])
        distance = ti.max(offset.norm(), 1e-20)
        direction = offset / distance
        total = multigrid.displacement[i][3] + multigrid.displacement[j][3]
        rest, compliance = multigrid.spring_data[c, 0][0], multigrid.spring_data[c, 0][1]
        for axis in ti.static(range(3)):
            multigrid.spring_workspace[axis, c] = direction[axis]
        multigrid.spring_workspace[3, c] = distance
        multigrid.spring_workspace[4, c] = LENGTH_TOLERANCE + rest * (
            1.0 + xyz(e).dot(xyz(multigrid.spring_data[c, 1]))
        )
        multigrid.spring_workspace[5, c] = compliance * inverse_h2
        multigrid.spring_workspace[6, c] = total
        multigrid.spring_workspace[7, c] = 0.0
        multigrid.spring_workspace[8, c] = -MAX_SPEED_CHANGE * step.h / (step.levels * total)


@ti.func
def add_strain(level: ti.i32, multigrid: ti.template(), step: ti.template()):
    """Add the strain that the springs of a level bear to the patches at their ends."""
    inverse_h2 = 1.0 / (step.h * step.h)
    for k in range(multigrid.color_starts[level], multigrid.color_starts[level + 1]):
        begin, end = multigrid.spring_colors[k], multigrid.spring_colors[k + 1]
        for c in range(begin, end):
            i, j = multigrid.springs[c][0], multigrid.springs[c][1]
            strain = -multigrid.spring_workspace[7, c] * inverse_h2 * xyz(multigrid.spring_data[c, 2])
            share_i, share_j = multigrid.spring_shares[c, 0], multigrid.spring_shares[c, 1]
            multigrid.coarse_strain[i] = multigrid.coarse_strain[i] + vec4(share_i * strain)
            multigrid.coarse_strain[j] = multigrid.coarse_strain[j] + vec4(share_j * strain)
