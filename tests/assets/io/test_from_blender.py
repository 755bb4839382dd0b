"""Files that Blender writes, read here; and captured motion that Blender reads too."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from assets.io.bvh import read_bvh
from assets.io.sequence import load_sequence
from assets.loading import load_character
from assets.skinning import skin_vertices
from tests.blender import POSED_VERTICES, require_blender
from tests.data import data_path

FRAMES = 13  # of the action, 24 a second

SCRIPT = (
    POSED_VERTICES
    + f"FRAMES = {FRAMES}"
    + """
import sys

folder, capture = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps, scene.frame_start, scene.frame_end = 24, 1, FRAMES

def over_time(item):
    frames = []
    for number in range(1, FRAMES + 1):
        scene.frame_set(number)
        frames.append(posed_vertices(item))
    return np.array(frames)

# A bar of quads, 2 m high, on two bones, the upper of which bends and the lower of which travels.
armature = bpy.data.objects.new("rig", bpy.data.armatures.new("rig"))
scene.collection.objects.link(armature)
bpy.context.view_layer.objects.active = armature
bpy.ops.object.mode_set(mode="EDIT")
lower = armature.data.edit_bones.new("lower")
lower.head, lower.tail = (0, 0, 0), (0, 0, 1)
upper = armature.data.edit_bones.new("upper.L")
upper.head, upper.tail, upper.parent = (0, 0, 1), (0, 0, 2), lower
bpy.ops.object.mode_set(mode="OBJECT")
heights = np.repeat(np.linspace(0, 2, 9), 2)
points = [(0.2 * (-1) ** k, 0.03 * k, z) for k, z in enumerate(heights)]
faces = [(2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2) for k in range(8)]
mesh = bpy.data.meshes.new("bar")
mesh.from_pydata(points, [], faces)
bar = bpy.data.objects.new("bar", mesh)
scene.collection.objects.link(bar)
bar.parent = armature
for name, share in (("lower", np.clip(1.5 - heights, 0, 1)), ("upper.L", np.clip(heights - 0.5, 0, 1))):
    group = bar.vertex_groups.new(name=name)
    for vertex, weight in enumerate(share):
        if weight > 0:
            group.add([vertex], float(weight), "REPLACE")
bar.modifiers.new("skin", "ARMATURE").object = armature
for bone in armature.pose.bones:
    bone.rotation_mode = "XYZ"
for number in range(1, FRAMES + 1):
    armature.pose.bones["upper.L"].rotation_euler = (0.1 * number, 0.02 * number, 0)
    armature.pose.bones["lower"].location = (0.05 * number, 0, 0.01 * number)
    armature.pose.bones["upper.L"].keyframe_insert("rotation_euler", frame=number)
    armature.pose.bones["lower"].keyframe_insert("location", frame=number)
np.save(folder + "/bar.npy", over_time(bar))
bpy.ops.wm.usd_export(filepath=folder + "/bar.usdc", export_animation=True, export_armatures=True)

# The same as points over time: a modifier moves them.
bpy.data.objects.remove(bar)
bpy.data.objects.remove(armature)
grid = bpy.data.meshes.new("grid")
side = 6
grid.from_pydata([(x / 5, y / 5, 1) for y in range(side) for x in range(side)], [],
                 [(r + c, r + c + 1, r + c + 7, r + c + 6) for r in range(0, 30, 6) for c in range(5)])
sheet = bpy.data.objects.new("sheet", grid)
sheet.location = (0.3, 0.2, 0.1)
scene.collection.objects.link(sheet)
wave = sheet.modifiers.new("wave", "WAVE")
wave.height, wave.width, wave.narrowness = 0.1, 0.3, 3.0
np.save(folder + "/sheet.npy", over_time(sheet))
bpy.ops.wm.usd_export(filepath=folder + "/sheet.usdc", export_animation=True)

# Captured motion as Blender's importer reads it.
bpy.ops.import_anim.bvh(filepath=capture, axis_forward="-Z", axis_up="Y", use_fps_scale=False, rotate_mode="NATIVE")
rig = bpy.context.object
found = []
for number in range(1, FRAMES + 1):
    scene.frame_set(number)
    heads = np.array([rig.matrix_world @ bone.head for bone in rig.pose.bones])
    found.append(np.stack([heads[:, 0], heads[:, 2], -heads[:, 1]], axis=1))
np.savez(folder + "/capture.npz", names=[bone.name for bone in rig.pose.bones], positions=np.array(found))
print("DONE")
"""
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    require_blender()
    path = tmp_path_factory.mktemp("blender")
    capture = data_path("mocap/cmu_01_01_jumps_turn.bvh")
    # A process of its own: Blender brings its own LLVM.
    command = [sys.executable, "-c", SCRIPT, str(path), str(capture)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert "DONE" in result.stdout, result.stderr
    return path


@pytest.mark.proof
def test_a_character_that_blender_wrote(folder: Path) -> None:
    truth, character = np.load(folder / "bar.npy"), load_character(folder / "bar.usdc")
    assert character.joint_count == 2 and len(character.clips) == 1
    (clip,) = character.clips.values()
    assert (clip.frame_count, round(clip.rate)) == (FRAMES, 24)
    for frame in range(FRAMES):
        pose = character.pose_from_local(clip.translation[frame], clip.rotation[frame], clip.scale[frame])
        assert np.abs(skin_vertices(character, pose) - truth[frame]).max() < 2e-5


@pytest.mark.proof
def test_points_over_time_that_blender_wrote(folder: Path) -> None:
    truth, sequence = np.load(folder / "sheet.npy"), load_sequence(folder / "sheet.usdc")
    assert np.ptp(truth[:, :, 1], axis=0).max() > 0.02
    assert sequence.dt == pytest.approx(1 / 24)
    np.testing.assert_allclose(sequence.vertices, truth, atol=1e-6)


@pytest.mark.proof
def test_captured_motion_as_blender_reads_it(folder: Path) -> None:
    """Blender makes bones of joints: those of a length are compared."""
    motion = read_bvh(data_path("mocap/cmu_01_01_jumps_turn.bvh"))
    with np.load(folder / "capture.npz") as file:
        names, positions = file["names"].tolist(), file["positions"]
    here = [motion.joint_names.index(name) for name in names]
    assert len(names) > 20
    np.testing.assert_allclose(positions, motion.positions[: len(positions)][:, here], atol=2e-4)
