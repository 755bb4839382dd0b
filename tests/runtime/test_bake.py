"""Baked files, read back with nothing but the format's own rules."""

from __future__ import annotations

import json
import math
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
import trimesh

from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from assets.skinning import skin_vertices
from assets.transform import local_matrices, slerp
from runtime.export.animation_files import bake_glb, bake_mdd, bake_obj, bake_pc2, bake_usd
from runtime.export.glb import BYTES_A_VERTEX
from tests.blender import POSED_VERTICES, require_blender
from tests.refusals import refuses
from tests.runtime.baking import angles_deg, sheet_sequence, walking_mannequin, waving_sheet
from wrinkles.mesh_measures import vertex_normals

DTYPES = {
    5120: np.dtype("<i1"),
    5121: np.dtype("<u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
# Component types that KHR_mesh_quantization and the core allow for each attribute of a vertex.
ALLOWED = {"POSITION": {5120, 5121, 5122, 5123, 5126}, "NORMAL": {5120, 5122, 5126}, "JOINTS_0": {5121, 5123},
           "WEIGHTS_0": {5121, 5123, 5126}}  # fmt: skip
TARGET_ALLOWED = {"POSITION": {5120, 5122, 5126}, "NORMAL": {5120, 5122, 5126}}


class Read:
    """One mesh of a GLB file, played by glTF's rules."""

    def __init__(self, path: Path, name: str = "garment") -> None:
        self.document: Any = pygltflib.GLTF2().load(str(path))
        self.blob = self.document.binary_blob()
        self.index = next(k for k, node in enumerate(self.document.nodes) if node.name == name)
        self.node = self.document.nodes[self.index]
        self.mesh = self.document.meshes[self.node.mesh]
        self.primitive = self.mesh.primitives[0]
        self.faces = self.raw(self.primitive.indices).reshape(-1, 3)

    def raw(self, index: int) -> np.ndarray:
        """The numbers as stored, shape (count, width)."""
        accessor = self.document.accessors[index]
        view = self.document.bufferViews[accessor.bufferView]
        dtype, width = DTYPES[accessor.componentType], WIDTHS[accessor.type]
        stride = view.byteStride or dtype.itemsize * width
        start = view.byteOffset + accessor.byteOffset
        return np.ndarray((accessor.count, width), dtype, self.blob, start, (stride, dtype.itemsize))

    def values(self, index: int) -> np.ndarray:
        raw = self.raw(index)
        if not self.document.accessors[index].normalized:
            return raw.astype(np.float64)
        return np.maximum(raw / float(np.iinfo(raw.dtype).max), -1.0)

    def sampler(self, path: str) -> tuple[np.ndarray, np.ndarray]:
        """Key times [s] and their values, shape (keys, ...)."""
        animation = self.document.animations[0]
        channel = next(c for c in animation.channels if (c.target.node, c.target.path) == (self.index, path))
        sampler = animation.samplers[channel.sampler]
        assert sampler.interpolation == "LINEAR"
        times = self.values(sampler.input)[:, 0]
        return times, self.values(sampler.output).reshape(len(times), -1)

    def attribute(self, name: str, weights: np.ndarray) -> np.ndarray:
        total = self.values(getattr(self.primitive.attributes, name))
        for weight, target in zip(weights, self.primitive.targets, strict=True):
            if weight:
                total = total + weight * self.values(target[name])
        return total

    def skinned(self, key: int) -> np.ndarray:
        """World positions of a skinned mesh at one of its key times."""
        skin = self.document.skins[self.node.skin]
        inverse_bind = np.swapaxes(self.values(skin.inverseBindMatrices).reshape(-1, 4, 4), 1, 2)
        channels = self.document.animations[0].channels
        matrices = []
        for joint, inverse in zip(skin.joints, inverse_bind, strict=True):
            node = self.document.nodes[joint]
            moved = {"translation": node.translation, "rotation": node.rotation, "scale": node.scale}
            for channel in (c for c in channels if c.target.node == joint):
                sampler = self.document.animations[0].samplers[channel.sampler]
                moved[channel.target.path] = self.values(sampler.output)[key].tolist()
            matrices.append(
                local_matrices(*(np.array(moved[n]) for n in ("translation", "rotation", "scale"))) @ inverse
            )
        joints, weights = (self.raw(getattr(self.primitive.attributes, n)) for n in ("JOINTS_0", "WEIGHTS_0"))
        blended = np.einsum("nk,nkab->nab", weights, np.array(matrices)[joints])
        places = self.values(self.primitive.attributes.POSITION)
        return np.einsum("nab,nb->na", blended[:, :3, :3], places) + blended[:, :3, 3]

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """World positions and unit normals at a time."""
        times, weights = self.sampler("weights")
        weight = np.array([np.interp(time, times, column) for column in weights.T])
        times, translation = self.sampler("translation")
        moved = np.array([np.interp(time, times, column) for column in translation.T])
        times, rotation = self.sampler("rotation")
        key = min(int(np.searchsorted(times, time, side="right")) - 1, len(times) - 2)
        turned = slerp(rotation[key], rotation[key + 1], (time - times[key]) / (times[key + 1] - times[key]))
        placed = local_matrices(moved, turned, np.array(self.node.scale))
        normals = self.attribute("NORMAL", weight) @ placed[:3, :3].T
        positions = self.attribute("POSITION", weight) @ placed[:3, :3].T + moved
        return positions, normals / np.linalg.norm(normals, axis=1, keepdims=True)


@pytest.mark.parametrize("turn_deg", [0.0, 20.0])
def test_every_frame_and_what_lies_between_play_back(tmp_path, turn_deg):
    faces, frames = waving_sheet(turn_deg=turn_deg)
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0)
    read = Read(tmp_path / "a.glb")
    normals = vertex_normals(frames, faces)
    assert np.array_equal(read.faces, faces)
    turned = []
    for k in range(len(frames)):
        positions, directions = read.at(k / 30.0)
        assert np.abs(positions - frames[k]).max() < 3e-5  # half a step of 1 m / 32767 along each turned axis
        turned.append(angles_deg(directions, normals[k]))
    assert np.mean(turned) < 0.25 and np.max(turned) < 1.0  # half a step of 1 / 127 is 0.23 deg
    # Between two frames a sheet goes straight, but for its turn as a whole: that bulges out by its chord's sagitta.
    sagitta = 0.31 * (1.0 - math.cos(math.radians(turn_deg) / 2.0))
    for k in (0, 4, 10):
        between = 0.25 * frames[k].astype(float) + 0.75 * frames[k + 1]
        assert np.abs(read.at((k + 0.75) / 30.0)[0] - between).max() < 3e-4 + 1.3 * sagitta


def test_garments_of_an_outfit_are_meshes_of_their_own(tmp_path):
    faces, frames = waving_sheet()
    count = frames.shape[1]
    both = np.concatenate([frames, frames + np.float32([0.0, 0.1, 0.0])], axis=1)
    garments = {"shirt": np.arange(count), "body": np.arange(count, 2 * count)}
    all_faces = np.concatenate([faces, faces + count])
    bake_glb(tmp_path / "a.glb", all_faces, both, 30.0, garments=garments)
    for name, vertices in (("shirt", garments["shirt"]), ("body_garment", garments["body"])):
        read = Read(tmp_path / "a.glb", name)
        assert np.array_equal(read.faces, faces)
        assert np.abs(read.at(3 / 30.0)[0] - both[3][vertices]).max() < 3e-5
    assert len({str(one.pbrMetallicRoughness.baseColorFactor) for one in read.document.materials}) == 2


def test_normals_of_a_garment_that_turns_right_round_are_kept(tmp_path):
    faces, frames = waving_sheet(frame_count=24, turn_deg=45.0)
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0)
    read, normals = Read(tmp_path / "a.glb"), vertex_normals(frames, faces)
    assert max(angles_deg(read.at(k / 30.0)[1], normals[k]).max() for k in range(len(frames))) < 1.0


def test_normals_far_from_the_first_are_kept(tmp_path):
    """By up to 90 degrees; beyond, a normal is shortened to fit and loses digits."""
    faces, frames = waving_sheet(frame_count=9, turn_deg=0.0)
    frames[:] = frames[0]
    angle = np.radians(np.linspace(0.0, 90.0, 9))
    normals = np.stack([np.sin(angle), np.zeros(9), np.cos(angle)], axis=1)[:, None].repeat(frames.shape[1], axis=1)
    bake_glb(tmp_path / "a.glb", faces, frames, 10.0, normals=normals)
    read = Read(tmp_path / "a.glb")
    assert max(angles_deg(read.at(k / 10.0)[1], normals[k]).max() for k in range(9)) < 1.0


def test_a_mesh_that_moves_by_metres_keeps_its_relative_precision(tmp_path):
    faces, frames = waving_sheet(turn_deg=90.0)
    bake_glb(tmp_path / "a.glb", faces, 10.0 * frames, 30.0)
    read = Read(tmp_path / "a.glb")
    reach = 10.0 * 2 * 0.36
    assert 1.0 < read.node.scale[0] < reach
    assert max(np.abs(read.at(k / 30.0)[0] - 10.0 * frames[k]).max() for k in range(len(frames))) < reach / 32767


def test_travel_costs_no_precision(tmp_path):
    faces, frames = waving_sheet()
    far = frames.astype(np.float64) + np.linspace([0, 0, 0], [60.0, 0.0, -20.0], len(frames))[:, None]
    bake_glb(tmp_path / "a.glb", faces, far, 30.0)
    read = Read(tmp_path / "a.glb")
    assert max(np.abs(read.at(k / 30.0)[0] - far[k]).max() for k in range(len(far))) < 2.5e-5


def assert_obeys_the_format(path: Path) -> None:
    """What glTF 2.0 and KHR_mesh_quantization ask of a file's buffers, accessors, meshes and skins."""
    content = path.read_bytes()
    magic, version, length = struct.unpack("<4sII", content[:12])
    assert (magic, version, length) == (b"glTF", 2, len(content))
    read = Read(path)
    document = read.document
    assert document.extensionsRequired == document.extensionsUsed == ["KHR_mesh_quantization"]
    end = 0
    for view in document.bufferViews:
        assert view.byteOffset % 4 == 0 and view.byteOffset >= end
        assert view.byteStride is None or (view.byteStride % 4 == 0 and 4 <= view.byteStride <= 252)
        end = view.byteOffset + view.byteLength
    assert end == document.buffers[0].byteLength <= len(read.blob) < end + 4
    for index, accessor in enumerate(document.accessors):
        view = document.bufferViews[accessor.bufferView]
        raw = read.raw(index)
        last = (accessor.count - 1) * (view.byteStride or raw.strides[0]) + raw.shape[1] * raw.itemsize
        assert accessor.byteOffset + last <= view.byteLength
        assert not (accessor.normalized and raw.dtype.kind == "f")
        if accessor.min:
            assert (accessor.min, accessor.max) == (raw.min(axis=0).tolist(), raw.max(axis=0).tolist())
    for mesh in document.meshes:
        primitive = mesh.primitives[0]
        for attributes, allowed in (
            (vars(primitive.attributes), ALLOWED),
            *((t, TARGET_ALLOWED) for t in primitive.targets),
        ):
            for name, index in attributes.items():
                if index is not None:
                    accessor = document.accessors[index]
                    assert accessor.componentType in allowed[name]
                    integers = accessor.componentType != 5126
                    assert accessor.normalized == (integers and name != "JOINTS_0")
                    assert document.bufferViews[accessor.bufferView].target == 34962
        targets = [target["POSITION"] for target in primitive.targets]
        assert len(mesh.weights or []) == len(mesh.extras.get("targetNames", [])) == len(targets)
        assert all(document.accessors[index].min for index in [primitive.attributes.POSITION, *targets])
        base = read.values(primitive.attributes.NORMAL)
        assert np.abs(np.linalg.norm(base, axis=1) - 1.0).max() < 0.0067
    for skin in document.skins:
        assert document.accessors[skin.inverseBindMatrices].count == len(skin.joints) == len(set(skin.joints))
        assert document.nodes[skin.skeleton].children == skin.joints
        assert skin.skeleton in document.scenes[0].nodes
    for node in document.nodes:
        assert node.rotation is None or abs(np.linalg.norm(node.rotation) - 1.0) < 1e-5


def test_files_obey_the_format(tmp_path):
    faces, frames, sequence = sheet_sequence()
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0, body=sequence, poses=sequence.vertices)
    assert_obeys_the_format(tmp_path / "a.glb")
    character, poses = walking_mannequin()
    bake_glb(tmp_path / "b.glb", faces, frames, 30.0, body=character, poses=poses)
    assert_obeys_the_format(tmp_path / "b.glb")


@pytest.mark.parametrize("name", ["garment", "body"])
def test_samplers_have_a_key_a_frame_and_a_weight_a_target(tmp_path, name):
    faces, frames, sequence = sheet_sequence()
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0, body=sequence, poses=sequence.vertices)
    times, weights = Read(tmp_path / "a.glb", name).sampler("weights")
    np.testing.assert_allclose(times, np.arange(12) / 30.0, rtol=1e-6)
    assert np.array_equal(weights, np.eye(12))


def test_a_character_is_skinned_by_joints_that_move(tmp_path):
    faces, frames = waving_sheet()
    character, poses = walking_mannequin()
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0, body=character, poses=poses)
    read = Read(tmp_path / "a.glb", "body")
    assert np.array_equal(read.faces, character.faces)
    for key in (0, 5, 11):
        assert np.abs(read.skinned(key) - skin_vertices(character, poses[key])).max() < 2e-5


def test_rotations_do_not_jump_from_key_to_key(tmp_path):
    faces, frames = waving_sheet(120)
    character, _ = walking_mannequin()
    motion = ClipMotion(character, character.clip("twirl"))
    poses = np.array([motion.pose(1.0 + k / 30.0) for k in range(120)])
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0, body=character, poses=poses)
    read = Read(tmp_path / "a.glb", "body")
    rotations = [c for c in read.document.animations[0].channels if c.target.path == "rotation"]
    assert len(rotations) == 1 + character.joint_count  # the garment's own first
    for channel in rotations:
        keys = read.values(read.document.animations[0].samplers[channel.sampler].output)
        assert (np.einsum("ka,ka->k", keys[1:], keys[:-1]) > 0.0).all()


def test_a_frame_costs_twelve_bytes_a_vertex_and_little_for_the_body(tmp_path):
    faces, frames = waving_sheet(frame_count=40, side=30)
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0)
    alone = (tmp_path / "a.glb").stat().st_size
    targets = BYTES_A_VERTEX * frames.shape[0] * frames.shape[1]
    assert targets < alone < 1.2 * targets
    character, poses = walking_mannequin(40)
    bake_glb(tmp_path / "b.glb", faces, frames, 30.0, body=character, poses=poses)
    still = 56 * len(character.vertices) + 12 * len(character.faces)  # two vectors, weights, joints; faces
    moving = 40 * 28 * character.joint_count  # a vector and a quaternion
    assert (tmp_path / "b.glb").stat().st_size - alone < 1.25 * (still + moving)


def test_one_frame_is_a_still_mesh_that_other_readers_open(tmp_path):
    faces, frames = waving_sheet()
    for count in (1, 3):
        bake_glb(tmp_path / "a.glb", faces, frames[:count], 30.0)
        scene = trimesh.load_scene(tmp_path / "a.glb", process=False)
        mesh: Any = scene.to_geometry()
        assert np.array_equal(mesh.faces, faces)
        np.testing.assert_allclose(mesh.vertices, frames[0], atol=1e-6)
        assert len(Read(tmp_path / "a.glb").document.animations) == (count > 1)


def test_a_lone_vertex_gets_a_unit_normal(tmp_path):
    faces, frames = waving_sheet()
    frames = np.concatenate([frames, np.full((len(frames), 1, 3), 0.2, np.float32)], axis=1)
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0)
    assert np.isfinite(Read(tmp_path / "a.glb").at(0.1)[1]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"garment_frames": np.zeros((3, 81))}, "garment_frames.*shape"),
        ({"garment_frames": np.full((2, 81, 3), np.nan)}, "garment_frames.*not finite"),
        ({"garment_frames": np.zeros((2, 80, 3))}, "garment_faces.*0 to 79"),
        ({"garment_faces": np.zeros((0, 3), int)}, "garment_faces"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"normals": np.zeros((12, 80, 3))}, "normals"),
        ({"poses": np.zeros((12, 4, 3))}, "body"),
        ({"body": builtin_mannequin()}, "poses"),
        ({"body": builtin_mannequin(), "poses": np.zeros((3, 22, 3, 4))}, "poses.*3.*12"),
        ({"body": builtin_mannequin(), "poses": np.zeros((12, 2, 3, 4))}, "poses.*joints|poses.*3, 4"),
    ],
)
@pytest.mark.parametrize("bake", [bake_glb, bake_usd])
def test_bad_input_is_named_and_leaves_the_old_file(tmp_path, bake, change, message):
    faces, frames = waving_sheet()
    path = tmp_path / "a.glb"
    path.write_bytes(b"old")
    refuses(message, bake, path, **{"garment_faces": faces, "garment_frames": frames, "rate_hz": 30.0} | change)
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_a_point_cache_holds_every_frame_and_its_mesh(tmp_path):
    faces, frames = waving_sheet()
    bake_pc2(tmp_path / "sheet.pc2", faces, frames)
    content = (tmp_path / "sheet.pc2").read_bytes()
    sign, version, points, start, rate, samples = struct.unpack("<12siiffi", content[:32])
    assert (sign, version, points, start, rate, samples) == (
        b"POINTCACHE2\0",
        1,
        frames.shape[1],
        0.0,
        1.0,
        len(frames),
    )
    assert np.array_equal(np.frombuffer(content[32:], "<f4").reshape(frames.shape), frames)
    mesh: Any = trimesh.load_mesh(tmp_path / "sheet.obj", process=False)
    assert np.array_equal(mesh.faces, faces)
    np.testing.assert_allclose(mesh.vertices, frames[0], atol=1e-6)


def test_an_mdd_cache_holds_every_frame_with_its_time(tmp_path):
    faces, frames = waving_sheet()
    bake_mdd(tmp_path / "sheet.mdd", faces, frames, 25.0)
    content = (tmp_path / "sheet.mdd").read_bytes()
    assert struct.unpack(">ii", content[:8]) == frames.shape[:2]
    times = np.frombuffer(content, ">f4", len(frames), 8)
    np.testing.assert_allclose(times, np.arange(len(frames)) / 25.0, atol=1e-7)
    assert np.array_equal(np.frombuffer(content[8 + 4 * len(frames) :], ">f4").reshape(frames.shape), frames)
    mesh: Any = trimesh.load_mesh(tmp_path / "sheet.obj", process=False)
    assert np.array_equal(mesh.faces, faces)
    refuses("rate_hz", bake_mdd, tmp_path / "sheet.mdd", faces, frames, -1.0)
    assert (tmp_path / "sheet.mdd").read_bytes() == content


def test_an_obj_sequence_has_a_file_a_frame(tmp_path):
    faces, frames = waving_sheet(frame_count=3)
    files = bake_obj(tmp_path / "sheet.obj", faces, frames)
    assert [file.name for file in files] == ["sheet_0000.obj", "sheet_0001.obj", "sheet_0002.obj"]
    assert sorted(tmp_path.iterdir()) == files
    for file, vertices in zip(files, frames, strict=True):
        mesh: Any = trimesh.load_mesh(file, process=False)
        assert np.array_equal(mesh.faces, faces)
        np.testing.assert_allclose(mesh.vertices, vertices, atol=1e-6)


SCRIPT = (
    POSED_VERTICES
    + """
import json, sys

folder, frames = sys.argv[1], np.load(sys.argv[1] + "/frames.npy")
halfway = np.load(folder + "/between.npy")
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 30

def worst(item):
    errors = []
    for number, truth in enumerate(frames):
        scene.frame_set(number)
        errors.append(float(np.abs(posed_vertices(item) - truth).max()))
    return max(errors)

bpy.ops.import_scene.gltf(filepath=folder + "/a.glb")
glb = worst(bpy.data.objects["garment"])
scene.frame_set(7, subframe=0.25)
between = float(np.abs(posed_vertices(bpy.data.objects["garment"]) - halfway).max())
bpy.ops.wm.obj_import(filepath=folder + "/a.obj", forward_axis="NEGATIVE_Z", up_axis="Y")
item = bpy.context.selected_objects[0]
modifier = item.modifiers.new("cache", "MESH_CACHE")
modifier.cache_format, modifier.filepath = "PC2", folder + "/a.pc2"
modifier.frame_start = 0
pc2 = worst(item)
modifier.cache_format, modifier.filepath = "MDD", folder + "/a.mdd"
mdd = worst(item)
bpy.ops.wm.usd_import(filepath=folder + "/a.usdc")
usd = worst(bpy.data.objects["garment.001"])
print("RESULT", json.dumps({"glb": glb, "between": between, "pc2": pc2, "mdd": mdd, "usd": usd}))
"""
)


@pytest.mark.proof
def test_blender_plays_what_was_baked(tmp_path):
    require_blender()
    faces, frames = waving_sheet(side=20, turn_deg=5.0)
    np.save(tmp_path / "frames.npy", frames)
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0)
    np.save(tmp_path / "between.npy", Read(tmp_path / "a.glb").at(7.25 / 30.0)[0])
    bake_pc2(tmp_path / "a.pc2", faces, frames)
    bake_mdd(tmp_path / "a.mdd", faces, frames, 30.0)
    bake_usd(tmp_path / "a.usdc", faces, frames, 30.0)
    # A process of its own: Blender brings its own LLVM.
    result = subprocess.run([sys.executable, "-c", SCRIPT, str(tmp_path)], capture_output=True, text=True, timeout=300)
    lines = [line for line in result.stdout.splitlines() if line.startswith("RESULT ")]
    assert lines, result.stderr
    errors = json.loads(lines[0].removeprefix("RESULT "))
    assert max(errors["glb"], errors["between"]) < 3e-5
    assert max(errors["pc2"], errors["mdd"], errors["usd"]) < 1e-6
