"""Blender's cloth modifier, dressed: body and held vertices are played from point caches."""

# pyright: reportMissingImports=false
from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from precompute.rivals.dressing import Dressing

__all__ = ["start_blender"]


def start_blender(
    dressing: Dressing,
    folder: Path,
    *,
    steps: int,
    collision: int = 2,
    stretch: float = 1.0,
    bend: float = 1.0,
    mass: float = 0.3,
    friction: float = 4.0,
) -> tuple[Callable[[int], None], Callable[[], np.ndarray]]:
    """A garment in Blender, which takes no pattern: it starts in its rest shape.

    A key for the rest shape is without effect behind a modifier that plays the held vertices from a file.

    Args:
        dressing: the garment and its body.
        folder: for the caches.
        steps: of a frame, Blender's quality.
        collision: passes of contact in a step, Blender's quality of collision.
        stretch: stiffness of tension, compression and shear [Blender's unit].
        bend: stiffness of bending [Blender's unit].
        mass: of a vertex, with which Blender's stiffness goes [kg].
        friction: of the body [Blender's unit, 0 to 80].

    Returns:
        what plays a frame of a number, and what gives the vertices [m], shape (n, 3).
    """
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    world, fabric = bpy.context.scene, dressing.fabric
    world.render.fps, world.gravity = round(1.0 / dressing.dt), (0.0, -9.81, 0.0)
    world.render.threads_mode, world.render.threads = "FIXED", 1
    world.frame_start, world.frame_end = 1, dressing.frame_count + 1

    def item_of(name: str, frames: np.ndarray, faces: np.ndarray):
        shape = bpy.data.meshes.new(name)
        shape.from_pydata(frames[0].tolist(), [], faces.tolist())
        item = bpy.data.objects.new(name, shape)
        world.collection.objects.link(item)
        path = folder / f"{name}.pc2"
        with path.open("wb") as file:
            header = (b"POINTCACHE2\0", 1, frames.shape[1], 0.0, 1.0, len(frames))
            file.write(struct.pack("<12siiffi", *header))
            file.write(np.ascontiguousarray(frames, np.float32).data)
        cache = item.modifiers.new("motion", "MESH_CACHE")
        cache.cache_format, cache.filepath = "PC2", str(path)
        cache.frame_start, cache.forward_axis, cache.up_axis = 1.0, "POS_Y", "POS_Z"
        return item

    body = item_of("body", dressing.body, dressing.body_faces)
    body.modifiers.new("collision", "COLLISION")
    body.collision.thickness_outer = max(fabric["thickness"], 0.001)
    body.collision.cloth_friction = friction
    moved = np.repeat(dressing.rest[None], dressing.frame_count + 1, axis=0)
    moved[:, dressing.held] = dressing.targets
    item = item_of("cloth", moved, dressing.faces)
    item.vertex_groups.new(name="held").add(dressing.held.tolist(), 1.0, "REPLACE")
    cloth = item.modifiers.new("cloth", "CLOTH")
    cloth.point_cache.frame_end = dressing.frame_count + 1
    contact, settings = cloth.collision_settings, cloth.settings
    contact.use_collision, contact.collision_quality, contact.distance_min = True, collision, fabric["thickness"]
    contact.use_self_collision = dressing.self_collision
    contact.self_distance_min, contact.self_friction = fabric["thickness"], fabric["friction"]
    settings.quality, settings.mass, settings.vertex_group_mass = steps, mass, "held"
    settings.tension_stiffness = settings.compression_stiffness = settings.shear_stiffness = stretch
    settings.bending_stiffness = bend
    settings.air_damping = settings.bending_damping = 0.01
    settings.tension_damping = settings.compression_damping = settings.shear_damping = 0.1
    world.frame_set(1)

    def vertices() -> np.ndarray:
        data = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices
        found = np.zeros(3 * len(data), np.float32)
        data.foreach_get("co", found)
        return found.reshape(-1, 3).astype(float)

    return lambda frame: world.frame_set(frame + 1), vertices
