"""Baked files, read back with nothing but the format's own rules."""

from __future__ import annotations

import importlib.util
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

from pbd.errors import InputError
from runtime.bake import bake_glb, bake_obj, bake_pc2
from wrinkles.metrics import vertex_normals

DTYPES = {5122: np.dtype("<i2"), 5125: np.dtype("<u4"), 5126: np.dtype("<f4")}
WIDTHS = {"SCALAR": 1, "VEC3": 3}


def waving_sheet(frame_count: int = 12, side: int = 9, turn_deg: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    """A sheet that waves, turns by ``turn_deg`` a frame and travels: faces (m, 3), frames float32 (f, n, 3)."""
    u, v = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.3, 0.3, side), np.linspace(0.4, 1.0, side)))
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + side], 1),
            np.stack([corner + 1, corner + side + 1, corner + side], 1),
        ]
    )
    frames = np.zeros((frame_count, side * side, 3), np.float32)
    for k in range(frame_count):
        angle = math.radians(turn_deg) * k
        depth = 0.05 * np.sin(20 * u + 0.7 * k)
        frames[k, :, 0] = u * math.cos(angle) + depth * math.sin(angle) + 0.8 * k
        frames[k, :, 1] = v
        frames[k, :, 2] = -u * math.sin(angle) + depth * math.cos(angle) - 0.3 * k
    return faces, frames


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
        return np.maximum(raw / 32767.0, -1.0) if raw.dtype == np.int16 else raw.astype(np.float64)

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

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """World positions and unit normals at a time."""
        times, weights = self.sampler("weights")
        weight = np.array([np.interp(time, times, column) for column in weights.T])
        times, translation = self.sampler("translation")
        moved = np.array([np.interp(time, times, column) for column in translation.T])
        normals = self.attribute("NORMAL", weight)
        positions = self.attribute("POSITION", weight) * np.array(self.node.scale) + moved
        return positions, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def angles_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(2.0 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2.0, 0.0, 1.0)))


def test_every_frame_and_what_lies_between_play_back(tmp_path):
    faces, frames = waving_sheet()
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0)
    read = Read(tmp_path / "a.glb")
    normals = vertex_normals(frames, faces)
    assert np.array_equal(read.faces, faces)
    turned = []
    for k in range(len(frames)):
        positions, directions = read.at(k / 30.0)
        assert np.abs(positions - frames[k]).max() < 2e-5  # half a step of 1 m / 32767, and float32
        turned.append(angles_deg(directions, normals[k]))
    assert np.mean(turned) < 0.02 and np.max(turned) < 0.5
    for k in (0, 4, 10):
        between = 0.25 * frames[k].astype(float) + 0.75 * frames[k + 1]
        assert np.abs(read.at((k + 0.75) / 30.0)[0] - between).max() < 3e-5


def test_normals_that_turn_right_round_are_kept(tmp_path):
    vertices = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]], np.float32)
    faces = np.array([[0, 1, 2], [3, 5, 4]])
    rng = np.random.default_rng(5)
    normals = np.stack([vertices, -vertices, vertices[::-1], *rng.normal(size=(20, 6, 3))])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    bake_glb(tmp_path / "a.glb", faces, np.repeat(vertices[None], len(normals), axis=0), 10.0, normals=normals)
    read = Read(tmp_path / "a.glb")
    assert max(angles_deg(read.at(k / 10.0)[1], normals[k]).max() for k in range(len(normals))) < 0.5


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


def test_the_buffer_obeys_the_format(tmp_path):
    faces, frames = waving_sheet()
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0, body_faces=faces, body_frames=frames[::3], body_rate_hz=10.0)
    content = (tmp_path / "a.glb").read_bytes()
    magic, version, length = struct.unpack("<4sII", content[:12])
    assert (magic, version, length) == (b"glTF", 2, len(content))
    read = Read(tmp_path / "a.glb")
    document = read.document
    assert document.extensionsRequired == document.extensionsUsed == ["KHR_mesh_quantization"]
    end = 0
    for view in document.bufferViews:
        assert view.byteOffset % 4 == 0 and view.byteOffset >= end
        assert view.byteStride is None or view.byteStride % 4 == 0
        end = view.byteOffset + view.byteLength
    assert end == document.buffers[0].byteLength <= len(read.blob) < end + 4
    for index, accessor in enumerate(document.accessors):
        view = document.bufferViews[accessor.bufferView]
        raw = read.raw(index)
        last = (accessor.count - 1) * (view.byteStride or raw.strides[0]) + raw.shape[1] * raw.itemsize
        assert accessor.byteOffset + last <= view.byteLength
        assert accessor.normalized == (raw.dtype == np.int16)
        if accessor.min:
            assert (accessor.min, accessor.max) == (raw.min(axis=0).tolist(), raw.max(axis=0).tolist())
    for mesh in document.meshes:
        primitive = mesh.primitives[0]
        targets = [target["POSITION"] for target in primitive.targets]
        assert len(mesh.weights) == len(mesh.extras["targetNames"]) == len(targets)
        assert all(document.accessors[index].min for index in [primitive.attributes.POSITION, *targets])
        base = read.values(primitive.attributes.NORMAL)
        assert np.abs(np.linalg.norm(base, axis=1) - 1.0).max() < 0.0067


@pytest.mark.parametrize(("name", "count", "step"), [("garment", 12, 1 / 30), ("body", 4, 1 / 10)])
def test_samplers_have_a_key_a_frame_and_a_weight_a_target(tmp_path, name, count, step):
    faces, frames = waving_sheet()
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0, body_faces=faces, body_frames=frames[::3], body_rate_hz=10.0)
    times, weights = Read(tmp_path / "a.glb", name).sampler("weights")
    np.testing.assert_allclose(times, step * np.arange(count), rtol=1e-6)
    assert np.array_equal(weights, np.eye(count)[:, 1:])


def test_a_frame_costs_sixteen_bytes_a_vertex(tmp_path):
    faces, frames = waving_sheet(frame_count=40, side=30)
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0)
    assert (tmp_path / "a.glb").stat().st_size < 1.15 * 16 * frames.shape[0] * frames.shape[1]


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
        ({"body_faces": np.array([[0, 1, 2]])}, "body_frames"),
        ({"body_faces": np.array([[0, 1, 9]]), "body_frames": np.zeros((2, 4, 3))}, "body_faces.*0 to 3"),
    ],
)
def test_bad_input_is_named_and_leaves_the_old_file(tmp_path, change, message):
    faces, frames = waving_sheet()
    path = tmp_path / "a.glb"
    path.write_bytes(b"old")
    with pytest.raises(InputError, match=message):
        bake_glb(path, **({"garment_faces": faces, "garment_frames": frames, "rate_hz": 30.0} | change))
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


def test_an_obj_sequence_has_a_file_a_frame(tmp_path):
    faces, frames = waving_sheet(frame_count=3)
    files = bake_obj(tmp_path / "sheet.obj", faces, frames)
    assert [file.name for file in files] == ["sheet_0000.obj", "sheet_0001.obj", "sheet_0002.obj"]
    assert sorted(tmp_path.iterdir()) == files
    for file, vertices in zip(files, frames, strict=True):
        mesh: Any = trimesh.load_mesh(file, process=False)
        assert np.array_equal(mesh.faces, faces)
        np.testing.assert_allclose(mesh.vertices, vertices, atol=1e-6)


BLENDER = """
import json, sys
import bpy
import numpy as np

folder, frames = sys.argv[1], np.load(sys.argv[1] + "/frames.npy")
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 30

def vertices(item):
    # Blender's z is up; its importers turn the project's y up.
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    local = np.zeros(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", local)
    matrix = np.array(evaluated.matrix_world)
    world = local.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return np.stack([world[:, 0], world[:, 2], -world[:, 1]], axis=1)

def worst(item, times):
    errors = []
    for time in times:
        scene.frame_set(int(time), subframe=time % 1)
        low = int(time)
        high = min(low + 1, len(frames) - 1)
        truth = (1 - time % 1) * frames[low] + (time % 1) * frames[high]
        errors.append(float(np.abs(vertices(item) - truth).max()))
    return max(errors)

bpy.ops.import_scene.gltf(filepath=folder + "/a.glb")
glb = worst(bpy.data.objects["garment"], [*range(len(frames)), 3.5, 7.25])
bpy.ops.wm.obj_import(filepath=folder + "/a.obj", forward_axis="NEGATIVE_Z", up_axis="Y")
item = bpy.context.selected_objects[0]
modifier = item.modifiers.new("cache", "MESH_CACHE")
modifier.cache_format, modifier.filepath = "PC2", folder + "/a.pc2"
modifier.frame_start = 0
pc2 = worst(item, range(len(frames)))
print("RESULT", json.dumps({"glb": glb, "pc2": pc2}))
"""


@pytest.mark.proof
def test_blender_plays_what_was_baked(tmp_path):
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("Blender is not installed as a module: pip install bpy")
    faces, frames = waving_sheet(side=20)
    np.save(tmp_path / "frames.npy", frames)
    bake_glb(tmp_path / "a.glb", faces, frames, 30.0)
    bake_pc2(tmp_path / "a.pc2", faces, frames)
    # A process of its own: Blender brings its own LLVM.
    result = subprocess.run([sys.executable, "-c", BLENDER, str(tmp_path)], capture_output=True, text=True, timeout=300)
    lines = [line for line in result.stdout.splitlines() if line.startswith("RESULT ")]
    assert lines, result.stderr
    errors = json.loads(lines[0].removeprefix("RESULT "))
    assert errors["glb"] < 2e-5
    assert errors["pc2"] < 1e-6
