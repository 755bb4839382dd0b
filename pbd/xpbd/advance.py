"""The kernel of one garment: the schedule behind the one flat list of its arrays.

Taichi takes at most 64 arguments, so that numbers come in two of them. The kernel makes the views of
:mod:`pbd.xpbd.views` from its arguments and hands these on.
"""

from collections.abc import Callable
from functools import cache

from pbd.contact.body_surface import BodySurface
from pbd.engine import ti
from pbd.geometry import Float1, Float2, Int1, Int2, Int3, Int4, Vec2, Vec3, Vec4, Vec4Rows
from pbd.xpbd.schedule import advance_garment
from pbd.xpbd.views import (
    ClothArrays,
    ConstraintArrays,
    ContactWork,
    MultigridArrays,
    ObstacleArrays,
    PairArrays,
    ParameterVector,
    StepView,
)

__all__ = ["advance_kernel"]


@cache
def advance_kernel(with_multigrid: bool, with_pairs: bool, rubs: bool, stiff: bool) -> Callable[..., None]:
    """The kernel that advances a garment by a frame.

    Over 60 lines and over 12 arguments: it is the one place that lists all arrays of a step.

    Args:
        with_multigrid, with_pairs: whether coarser levels and pairs are used. Both take long to compile.
        rubs: whether shear has internal friction.
        stiff: whether the bending of stiff cloth is solved by a factor.
    """

    @ti.kernel
    def advance(
        position: Vec4,
        velocity: Vec3,
        position_delta: Vec4,
        velocity_delta: Vec4,
        normals: Vec4,
        air: Vec4,
        pressure: Float1,
        held: Int1,
        target_start: Vec3,
        target_end: Vec3,
        triangles: Int3,
        triangle_blocks: Int2,
        block_colors: Int1,
        triangle_data: Float2,
        hinges: Int4,
        hinge_colors: Int1,
        hinge_data: Vec4Rows,
        bending_factor: Vec2,
        stitches: Int3,
        stitch_data: Vec4,
        tethers: Int2,
        tether_lengths: Float1,
        limits: Vec4Rows,
        strain_limits: Vec4,
        limit_work: Int1,
        body_start: Vec3,
        body_end: Vec3,
        ring_start: Int1,
        ring: Int1,
        fan_start: Int1,
        fan: Int2,
        body_normals: Vec3,
        primitives: Float2,
        fields: Float2,
        field_values: Float1,
        samples: Int2,
        sample_colors: Int1,
        nearest: Int1,
        contact_faces: Int4,
        contact_weights: Vec2,
        contact_points: Vec4Rows,
        active_samples: Int1,
        active_counts: Int2,
        contact_distance: Float1,
        max_approach: Float1,
        parent: Int1,
        mass_share: Float1,
        displacement: Vec4,
        patch_centers: Vec4,
        predicted_displacement: Vec4,
        coarse_strain: Vec4,
        level_starts: Int1,
        children: Int1,
        springs: Int2,
        spring_colors: Int1,
        color_starts: Int1,
        spring_data: Vec4Rows,
        spring_shares: Float2,
        spring_workspace: Float2,
        pairs: Int4,
        pair_data: Vec4Rows,
        ready_pairs: Int1,
        steps: Int1,
        parameters: ParameterVector,
    ):
        ti.loop_config(serialize=True)
        for _ in range(1):
            advance_garment(
                StepView(steps, parameters),
                ClothArrays(
                    position, velocity, position_delta, velocity_delta, normals, air, pressure,
                    held, target_start, target_end,
                ),
                ConstraintArrays(
                    triangles, triangle_blocks, block_colors, triangle_data, hinges, hinge_colors, hinge_data,
                    stitches, stitch_data, tethers, tether_lengths, limits, strain_limits, limit_work,
                    bending_factor, rubs, stiff,
                ),
                BodySurface(body_start, body_end, ring_start, ring, fan_start, fan, body_normals),
                ObstacleArrays(primitives, fields, field_values),
                ContactWork(
                    samples, sample_colors, nearest, contact_faces, contact_weights, contact_points, active_samples,
                    active_counts, contact_distance, max_approach,
                ),
                MultigridArrays(
                    with_multigrid, parent, mass_share, displacement, patch_centers, predicted_displacement,
                    coarse_strain, level_starts, children, springs, spring_colors, color_starts,
                    spring_data, spring_shares, spring_workspace,
                ),
                PairArrays(with_pairs, pairs, pair_data, ready_pairs),
            )  # fmt: skip

    return advance
