"""Clips in files of their own: what the joints of a character do, and which files are refused for it."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from assets.animation import clip_on
from assets.character import Animation, Character, Clip
from assets.loading import load_animation, load_character
from pbd.errors import InputError
from tests.assets.files import Glb, bar_glb, bend_glb, turn_z
from tests.refusals import refuses

NAMES = ("root", "tip")


@pytest.fixture
def bar(tmp_path: Path) -> Character:
    return load_character(bar_glb().write(tmp_path / "bar.glb"))


def animation(glb: Glb, folder: Path) -> Animation:
    found = load_animation(glb.write(folder / "bend.glb"), NAMES)
    assert found is not None
    return found


def below(glb: Glb, joint: int, name: str, **entries: object) -> int:
    """Put one more node below a node; its index."""
    glb.json["nodes"].append({"name": name, **entries})
    glb.json["nodes"][joint].setdefault("children", []).append(len(glb.json["nodes"]) - 1)
    return len(glb.json["nodes"]) - 1


def above(glb: Glb, name: str, **entries: object) -> int:
    """Put one more node above the root; its index."""
    glb.json["nodes"].append({"name": name, "children": [0], **entries})
    glb.json["scenes"][0]["nodes"] = [len(glb.json["nodes"]) - 1, 2]
    return len(glb.json["nodes"]) - 1


def joints(character: Character, clip: Clip) -> np.ndarray:
    """Joints in the world, shape (f, joints, 4, 4)."""
    frames = zip(clip.translation, clip.rotation, clip.scale, strict=True)
    return np.array([character.joint_transforms(*frame) for frame in frames])


def same(first: Clip, second: Clip) -> None:
    assert first.rate == second.rate
    for part in ("translation", "rotation", "scale"):
        np.testing.assert_allclose(getattr(first, part), getattr(second, part), atol=1e-6)


def test_a_clip_without_a_mesh_is_the_clip_with_one(tmp_path: Path, bar: Character) -> None:
    same(clip_on(bar, animation(bend_glb(), tmp_path), "bend"), bar.clip("bend"))


@pytest.mark.parametrize("change", ["a skin", "no clip"])
def test_other_files_are_no_animation(tmp_path: Path, change: str) -> None:
    glb = bar_glb() if change == "a skin" else bend_glb()
    if change == "no clip":
        del glb.json["animations"]
    assert load_animation(glb.write(tmp_path / "bend.glb"), NAMES) is None


def test_joints_go_in_the_world_where_they_go_in_the_file(tmp_path: Path, bar: Character) -> None:
    glb = bend_glb()
    armature = above(glb, "armature", rotation=turn_z(90))
    glb.clip("slide", (armature, "translation", [0.0, 1.0], [[0, 0, 0], [0, 0, 3]], "LINEAR"))
    clip = clip_on(bar, animation(glb, tmp_path), "slide")
    np.testing.assert_allclose(
        joints(bar, clip)[:, :, :3, 3], [[[0, 0, 0], [-1, 0, 0]], [[0, 0, 3], [-1, 0, 3]]], atol=1e-6
    )


@pytest.mark.parametrize("scales", [(100.0, 100.0), (1.0, 100.0), (100.0, 1.0)])
def test_the_units_of_skeletons_do_not_matter(tmp_path: Path, scales: tuple[float, float]) -> None:
    glb, bend = bar_glb(scales[0]), bend_glb(scales[1])
    for one, scale in zip((glb, bend), scales, strict=True):
        above(one, "armature", scale=[1.0 / scale] * 3)
    bar = load_character(glb.write(tmp_path / "bar.glb"))
    same(clip_on(bar, animation(bend, tmp_path), "bend"), bar.clip("bend"))


def test_a_clip_may_scale_the_body(tmp_path: Path, bar: Character) -> None:
    glb = bend_glb()
    glb.clip("grow", (0, "scale", [0.0, 1.0], [[1.2] * 3, [1.8] * 3], "LINEAR"))
    clip = clip_on(bar, animation(glb, tmp_path), "grow")
    np.testing.assert_allclose(clip.scale[:, 0], [[1.2] * 3, [1.8] * 3], atol=1e-6)


def test_nodes_in_between_carry_the_joints_below(tmp_path: Path, bar: Character) -> None:
    glb = bend_glb()
    glb.json["nodes"][0]["children"] = []
    middle = below(glb, 0, "middle", translation=[0.0, 1.0, 0.0], children=[1])
    del glb.json["nodes"][1]["translation"]
    glb.clip("turn", (middle, "rotation", [0.0, 1.0], [[0, 0, 0, 1], turn_z(90)], "LINEAR"))
    clip = clip_on(bar, animation(glb, tmp_path), "turn")
    np.testing.assert_allclose(clip.rotation[:, 1], [[0, 0, 0, 1], turn_z(90)], atol=1e-6)
    np.testing.assert_allclose(clip.translation[:, 1], [[0, 1, 0]] * 2, atol=1e-6)


def longer(folder: Path) -> Character:
    """The bar with one more joint, 0.5 m above its tip, on which the uppermost vertices hang."""
    glb = bar_glb()
    skin, attributes = glb.json["skins"][0], glb.json["meshes"][0]["primitives"][0]["attributes"]
    skin["joints"].append(below(glb, 1, "end", translation=[0.0, 0.5, 0.0]))
    inverse = np.tile(np.eye(4), (3, 1, 1))
    inverse[1:, 1, 3] = [-1.0, -1.5]
    skin["inverseBindMatrices"] = glb.accessor(inverse.swapaxes(1, 2))
    attributes["JOINTS_0"] = glb.accessor([[0, 1, 0, 0]] * 8 + [[0, 2, 0, 0]] * 2, "uint8")
    return load_character(glb.write(folder / "longer.glb"))


def test_a_joint_that_the_file_lacks_follows_the_one_that_it_hangs_on(tmp_path: Path) -> None:
    bar = longer(tmp_path)
    clip = clip_on(bar, animation(bend_glb(), tmp_path), "bend")
    np.testing.assert_allclose(clip.translation[:, 2], [[0, 0.5, 0]] * 3, atol=1e-6)
    np.testing.assert_allclose(joints(bar, clip)[2, 2, :3, 3], [-0.5, 1.0, 0.0], atol=1e-6)


def renamed(glb: Glb, joint: int, name: str) -> None:
    glb.json["nodes"][joint]["name"] = name


REFUSED: dict[str, tuple[Callable[[Glb], object], str]] = {
    "all names": (lambda g: (renamed(g, 0, "rig:root"), renamed(g, 1, "rig:tip")),
                  "joints: clips of another skeleton than bar: names of joints differ (received 'rig:tip', expected "),
    "one name": (lambda g: renamed(g, 1, "tip_1"),
                 "names of joints differ (received 'tip_1', expected tip)"),
    "same name": (lambda g: below(g, 1, "root"), "joints: two joints of one name (received 'root')"),
    "longer bone": (lambda g: g.json["nodes"][1].update(translation=[0.0, 1.2, 0.0]),
                    "joint tip: clips of another skeleton than bar: a joint lies elsewhere "
                    "(received '0.2 m from where it is against root in the bind pose', expected at most 0.01 m)"),
    "unit": (lambda g: above(g, "armature", scale=[100.0] * 3),
             "joint tip: clips of another skeleton than bar: a joint lies elsewhere (received '99 m from where it is"),
    "flat": (lambda g: g.json["nodes"][0].update(scale=[1.0, 1.0, 0.0]), "joint tip: a transform that flattens space"),
    "values": (lambda g: g.clip("bend", (0, "translation", [0, 1], [[0, 0, 0], [0, np.nan, 0]], "LINEAR")),
               "clip bend, channel 0 (translation of root), key 1: values that are not finite"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused(tmp_path: Path, bar: Character, case: str) -> None:
    change, message = REFUSED[case]
    glb = bend_glb()
    change(glb)
    if case == "values":
        del glb.json["animations"][0]
    assert "bend.glb" in refuses(re.escape(message), lambda: clip_on(bar, animation(glb, tmp_path), "bend"))


def test_an_unknown_clip_is_refused_with_those_that_exist(tmp_path: Path, bar: Character) -> None:
    with pytest.raises(InputError, match=r"bend\.glb: clip: no such clip \(received 'jump', expected one of bend\)"):
        clip_on(bar, animation(bend_glb(), tmp_path), "jump")


def test_a_joint_in_between_of_another_name_is_refused(tmp_path: Path) -> None:
    bar, glb = longer(tmp_path), bend_glb()
    renamed(glb, 1, "middle")
    below(glb, 1, "end", translation=[0.0, 0.5, 0.0])
    found = load_animation(glb.write(tmp_path / "bend.glb"), bar.joint_names)
    assert found is not None
    refuses(r"names of joints differ \(received 'middle', expected tip\)", clip_on, bar, found, "bend")


def test_a_joint_that_moves_against_its_parent_may_leave_the_bind_pose(tmp_path: Path, bar: Character) -> None:
    glb = bend_glb()
    glb.clip("stretch", (1, "translation", [0.0, 1.0], [[0, 1.1, 0], [0, 1.4, 0]], "LINEAR"))
    clip = clip_on(bar, animation(glb, tmp_path), "stretch")
    np.testing.assert_allclose(clip.translation[:, 1, 1], [1.1, 1.4], atol=1e-6)


def test_hips_of_a_held_pose_may_lie_elsewhere(tmp_path: Path) -> None:
    glb = bar_glb()
    pelvis_up = replace(load_character(glb.write(tmp_path / "bar.glb")), joint_indices=np.ones((10, 4), np.int32))
    bend = bend_glb()
    bend.clip("sit", (1, "translation", [0.0, 1.0], [[0, 0.4, 0]] * 2, "LINEAR"))
    clip = clip_on(pelvis_up, animation(bend, tmp_path), "sit")
    np.testing.assert_allclose(clip.translation[:, 1, 1], 0.4, atol=1e-6)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255), length=st.integers(1, 4))
def test_a_damaged_file_is_put_on_or_refused(
    tmp_path: Path, bar: Character, place: float, value: int, length: int
) -> None:
    data = bytearray(bend_glb().bytes())
    start = int(place * len(data))
    data[start : start + length] = bytes([value]) * length
    (tmp_path / "damaged.glb").write_bytes(data)
    try:
        found = load_animation(tmp_path / "damaged.glb", NAMES)
        clips = [] if found is None else [clip_on(bar, found, name) for name in found.clips]
    except InputError as error:
        assert "damaged.glb" in str(error)
    else:
        assert all(np.isfinite(clip.translation).all() for clip in clips)
