"""The kernel of a garment alone: the schedule on one worker, and the types of what it takes."""

from collections.abc import Callable
from functools import cache

from pbd.engine import ti
from pbd.geometry import Float1, Float2, Int1, Int2, Int3, Int4, Vec3, Vec4, Vec4Rows, vec3
from pbd.schedule import advance_garment
from pbd.team import Alone

__all__ = ["advance_kernel"]


@cache
def advance_kernel(with_patches: bool, with_pairs: bool = False) -> Callable[..., None]:
    """The kernel that advances a garment. Patches and pairs take long to compile, and are left out if not used."""

    @ti.kernel
    def advance(
        position: Vec4,
        velocity: Vec3,
        shift: Vec4,
        normals: Vec4,
        gained: Vec4,
        touched: Vec4Rows,
        awake: Int1,
        samples: Int2,
        sample_colors: Int1,
        listed: Int2,
        triangles: Int3,
        triangle_blocks: Int2,
        block_colors: Int1,
        triangle_data: Float2,
        hinges: Int4,
        hinge_colors: Int1,
        hinge_data: Vec4Rows,
        stitches: Int3,
        stitch_weights: Float1,
        tethers: Int2,
        tether_lengths: Float1,
        held: Int1,
        target_0: Vec3,
        target_1: Vec3,
        limits: Vec4Rows,
        air: Vec4,
        pressure: Float1,
        primitives: Float2,
        fields: Float2,
        field_values: Float1,
        nearest: Int1,
        contact: Float1,
        body_0: Vec3,
        body_1: Vec3,
        body_normals: Vec3,
        ring_start: Int1,
        ring: Int1,
        fan_start: Int1,
        fan: Int2,
        parent: Int1,
        part: Float1,
        ways: Vec4,
        places: Vec4,
        first_ways: Vec4,
        borne: Vec4,
        starts: Int1,
        children: Int1,
        child_starts: Int1,
        links: Int2,
        link_colors: Int1,
        color_starts: Int1,
        link_data: Vec4Rows,
        link_shares: Float2,
        link_room: Float2,
        way: Float1,
        pairs: Int4,
        pair_data: Vec4Rows,
        ready: Int1,
        strain_limits: Vec4,
        steps: Int1,
        h: ti.f32,
        gravity: vec3,
        squeeze: ti.f32,
        contact_law: ti.math.vec4,
    ):
        ti.loop_config(serialize=True)
        for _ in range(1):
            advance_garment(
                Alone(), with_patches, with_pairs,
                position, velocity, shift, normals, gained, touched, awake, samples, sample_colors,
                listed, triangles, triangle_blocks, block_colors, triangle_data, hinges, hinge_colors, hinge_data,
                stitches, stitch_weights, tethers, tether_lengths, held, target_0, target_1, limits, air, pressure,
                primitives, fields, field_values, nearest, contact, body_0, body_1, body_normals,
                ring_start, ring, fan_start, fan, parent, part, ways, places, first_ways, borne, starts, children,
                child_starts, links, link_colors, color_starts, link_data, link_shares, link_room, way, pairs,
                pair_data, ready, strain_limits, steps, h, gravity, squeeze, contact_law,
            )  # fmt: skip

    return advance
