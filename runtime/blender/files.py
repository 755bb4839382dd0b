"""Between Blender's objects and gube's files: body and garment out, scene file, result in.

Blender's Z is up; files have Y up: (x, y, z) becomes (x, z, -y).
"""

from __future__ import annotations

import json
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np

CLIP = "Animation"  # name that Blender's exporter gives to the armature's own action
LEARNED_SHARE = 0.7  # of the action that is learned from; the rest is held out


@contextmanager
def rest_pose(armature: Any):
    """The armature in its rest pose, as long as the block runs."""
    before = armature.data.pose_position
    armature.data.pose_position = "REST"
    bpy.context.view_layer.update()
    try:
        yield
    finally:
        armature.data.pose_position = before
        bpy.context.view_layer.update()


def bodies(armature: Any, garment: Any) -> list[Any]:
    """Meshes that the armature moves, without the garment."""
    return [
        item
        for item in bpy.context.scene.objects
        if item.type == "MESH"
        and item != garment
        and any(one.type == "ARMATURE" and one.object == armature for one in item.modifiers)
    ]


def triangles(items: list[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in the world, Z up, shape (n, 3), and triangles, shape (m, 3), of objects as they are shown."""
    places, faces, count = [], [], 0
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for item in items:
        evaluated = item.evaluated_get(depsgraph)
        mesh = evaluated.to_mesh()
        mesh.calc_loop_triangles()
        local = np.zeros(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", local)
        corners = np.zeros(3 * len(mesh.loop_triangles), np.int32)
        mesh.loop_triangles.foreach_get("vertices", corners)
        matrix = np.array(evaluated.matrix_world)
        places.append(local.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
        faces.append(corners.reshape(-1, 3) + count)
        count += len(mesh.vertices)
        evaluated.to_mesh_clear()
    return np.concatenate(places), np.concatenate(faces)


def depths(points: np.ndarray, items: list[Any]) -> np.ndarray:
    """How deep points in the world lie under the nearest surface of some objects, 0 outside [m], shape (n,)."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    nearest = np.full(len(points), np.inf)
    signed = np.zeros(len(points))
    for item in items:
        evaluated = item.evaluated_get(depsgraph)
        matrix = np.array(evaluated.matrix_world)
        back = np.linalg.inv(matrix)
        for index, point in enumerate(points):
            local = back[:3, :3] @ point + back[:3, 3]
            found, place, normal, _ = evaluated.closest_point_on_mesh(local)
            if not found:
                continue
            away = matrix[:3, :3] @ (local - np.array(place))
            distance = float(np.linalg.norm(away))
            if distance < nearest[index]:
                nearest[index] = distance
                signed[index] = distance if away @ (matrix[:3, :3] @ np.array(normal)) < 0.0 else 0.0
    return signed


def write_scene(folder: Path, armature: Any, garment: Any, fabric: str, attach: str) -> Path:
    """Write the body with its action (.glb), the garment in the rest pose (.obj) and the scene (.toml).

    Returns:
        path of the scene file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with rest_pose(armature):
        _write_obj(folder / "garment.obj", garment)
    _write_body(folder / "body.glb", armature, bodies(armature, garment))
    action = armature.animation_data.action
    first, last = action.frame_range
    seconds = (last - first) / frame_rate()
    split = round(LEARNED_SHARE * seconds, 2)
    clip = f'file = "body.glb"\nclip = "{CLIP}"\n'
    text = (
        f'[[garment]]\nname = {json.dumps(garment.name, ensure_ascii=False)}\nmesh = "garment.obj"\n'
        f'fabric = "{fabric}"\nattach = "{attach}"\n\n[character]\n{clip}\n'
        f"[[training.clips]]\n{clip}end = {split}\n\n[[training.held_out]]\n{clip}start = {split}\n"
    )
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def frame_rate() -> float:
    """Frames a second of the Blender scene."""
    render = bpy.context.scene.render
    return render.fps / render.fps_base


def _write_obj(path: Path, garment: Any) -> None:
    """The garment's own polygons with their active texture coordinates, in the world, Y up."""
    evaluated = garment.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    matrix = np.array(evaluated.matrix_world)
    lines = []
    for vertex in mesh.vertices:
        x, y, z = matrix[:3, :3] @ np.array(vertex.co) + matrix[:3, 3]
        lines.append(f"v {x:.6f} {z:.6f} {-y:.6f}")
    layer = mesh.uv_layers.active
    lines += [] if layer is None else ["vt {:.9g} {:.9g}".format(*corner.uv) for corner in layer.data]
    for face in mesh.polygons:
        corners = [f"{vertex + 1}" for vertex in face.vertices]
        if layer is not None:
            corners = [f"{corner}/{loop + 1}" for corner, loop in zip(corners, face.loop_indices, strict=True)]
        lines.append("f " + " ".join(corners))
    evaluated.to_mesh_clear()
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_body(path: Path, armature: Any, items: list[Any]) -> None:
    for item in bpy.context.view_layer.objects:
        item.select_set(item == armature or item in items)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.export_scene.gltf(
        filepath=str(path),
        export_format="GLB",
        use_selection=True,
        export_animation_mode="ACTIVE_ACTIONS",
        export_materials="NONE",
        export_morph=False,
    )


def show_result(folder: Path, armature: Any, garment: Any) -> Any:
    """Load the fine garment that `gube bake` wrote, with its point cache, and hide the one that it replaces.

    Returns:
        the new object, which a Mesh Cache modifier moves.
    """
    name = f"{garment.name} (gube)"
    old = bpy.data.objects.get(name)
    if old is not None:
        bpy.data.objects.remove(old)
    bpy.ops.wm.obj_import(filepath=str(folder / "result.obj"), forward_axis="NEGATIVE_Z", up_axis="Y")
    shown = bpy.context.selected_objects[0]
    shown.name = name
    for face in shown.data.polygons:
        face.use_smooth = True
    modifier = shown.modifiers.new("gube", "MESH_CACHE")
    modifier.cache_format, modifier.filepath = "PC2", str(folder / "result.pc2")
    modifier.frame_start = armature.animation_data.action.frame_range[0]
    garment.hide_set(True)
    garment.hide_render = True
    return shown
