"""What was read of a file is read again where the file has changed."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from assets.io import file_cache
from assets.io.body_settings import MotionSettings
from assets.io.converted import write_garment
from assets.io.file_cache import kept_while_unchanged
from assets.io.scene import parse_scene
from assets.procedural.mannequin import builtin_mannequin
from pbd import DistanceField
from runtime.setup.garment_setup import colliders_of
from runtime.setup.scene_body import clip_of, load_body
from tests.assets.captures import write_bvh
from tests.assets.files import bar_glb, turn_z
from tests.wrinkles.meshes import icosphere


def test_a_file_is_read_once_until_its_size_or_its_time_changes(tmp_path: Path) -> None:
    path, reads = tmp_path / "a.txt", []

    @kept_while_unchanged
    def read(file: Path | str, word: int) -> str:
        reads.append(word)
        return Path(file).read_text()

    path.write_text("one")
    assert (read(path, 1), read(str(path), 1), reads) == ("one", "one", [1])
    path.write_text("three")  # another size
    assert (read(path, 1), read(path, 1), reads) == ("three", "three", [1, 1])
    path.write_text("seven")
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 10**6))  # the same size a millisecond later
    assert (read(path, 1), read(path, 2), reads) == ("seven", "seven", [1, 1, 1, 2])
    path.unlink()
    with pytest.raises(OSError):
        read(path, 1)


def test_the_oldest_results_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_cache, "_MOST_KEPT", 2)
    reads = []
    read = kept_while_unchanged(lambda number: reads.append(number) or number)
    for number in (1, 2, 3, 3, 2, 1):
        assert read(number) == number
    assert reads == [1, 2, 3, 1]


def test_a_character_that_is_exported_again_is_the_new_one(tmp_path: Path) -> None:
    path = bar_glb(1.0).write(tmp_path / "bar.glb")
    assert load_body(path) is load_body(path)
    assert np.ptp(load_body(path).vertices[:, 1]) == pytest.approx(2.0)
    bar_glb(0.75).write(path)
    assert np.ptp(load_body(path).vertices[:, 1]) == pytest.approx(1.5)


def test_a_character_whose_buffer_is_written_again_is_the_new_one(tmp_path: Path) -> None:
    path, heights = tmp_path / "bar.gltf", []
    for scale in (1.0, 0.75):
        glb = bar_glb(scale)
        glb.json["buffers"][0] |= {"uri": "a%20bar.bin", "byteLength": len(glb.data)}
        if not path.exists():
            path.write_text(json.dumps(glb.json))
        (tmp_path / "a bar.bin").write_bytes(glb.data)
        heights.append(np.ptp(load_body(path).vertices[:, 1]))
    assert load_body(path) is load_body(path)
    assert heights == pytest.approx([2.0, 1.5])


def test_a_usd_layer_below_another_counts(tmp_path: Path) -> None:
    path, reads = tmp_path / "top.usda", []
    path.write_text("#usda 1.0\n(\n    subLayers = [@./below.usda@]\n)\n")

    @kept_while_unchanged
    def read(file: Path) -> int:
        reads.append(file)
        return len(reads)

    below = tmp_path / "below.usda"
    for prims in ("", 'def "a" {}\n', 'def "a" {}\ndef "b" {}\n'):
        below.write_text(f"#usda 1.0\n{prims}")
        assert read(path) == read(path)
    assert len(reads) == 3


def test_files_that_are_read_in_a_way_of_their_own_refer_to_nothing(tmp_path: Path) -> None:
    """A binary glTF file that is called .gltf, and USD text with a byte order mark."""
    binary, marked = tmp_path / "bar.gltf", tmp_path / "marked.usda"
    bar_glb().write(binary)
    assert load_body(binary) is load_body(binary)
    marked.write_bytes(b"\xef\xbb\xbf#usda 1.0\n")
    read = kept_while_unchanged(lambda file: Path(file).stat().st_size)
    assert read(marked) == 13
    marked.write_bytes(b"\xef\xbb\xbf#usda 1.0\n\n")
    assert read(marked) == 14


def test_a_clip_that_is_exported_again_plays_on_the_body_that_is_there(tmp_path: Path) -> None:
    path = bar_glb().write(tmp_path / "bar.glb")
    body, motion = load_body(path), MotionSettings(file=path, clip="bend")
    glb = bar_glb()
    glb.json["animations"] = []
    glb.clip("bend", (1, "rotation", [0.0, 2.0], [turn_z(0), turn_z(30)], "LINEAR"))
    glb.write(path)
    assert body.clip("bend").duration == 1.0
    assert clip_of(body, motion).duration == 2.0


def test_a_captured_motion_that_is_written_again_is_the_new_one(tmp_path: Path) -> None:
    mannequin, path = builtin_mannequin(), tmp_path / "still.bvh"
    parents = [int(parent) for parent in mannequin.joint_parents]
    standing = np.tile(mannequin.joint_transforms(*mannequin.rest_local)[:, :3, 3], (9, 1, 1))
    motion = MotionSettings(file=path)
    for frames in (5, 9):
        write_bvh(path, mannequin.joint_names, parents, standing[:frames], 30.0)
        clip = clip_of(mannequin, motion)
        assert clip is clip_of(mannequin, motion)
        assert clip.frame_count == frames


def test_the_mesh_of_a_collider_that_is_written_again_is_the_new_one(tmp_path: Path) -> None:
    text = '[[garment]]\nname = "cloth"\nmesh = "builtin:skirt"\n[[collider]]\ntype = "field"\nmesh = "ball.obj"\n'
    depths = []
    for radius in (0.1, 0.25):
        write_garment(tmp_path / "ball.obj", *icosphere(1, radius), None, "ball")
        (field,) = colliders_of(parse_scene(text + "spacing = 0.05\n", tmp_path / "scene.toml"))
        assert isinstance(field, DistanceField)
        depths.append(float(field.values.min()))
    assert depths == pytest.approx([-0.1, -0.25], abs=0.06)  # grid points lie up to 43 mm off the middle
