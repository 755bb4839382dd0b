"""Characters and clips as data: what they refuse, and the kinematics of their joints."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.character import Character, Clip, with_clips
from assets.loading import load_character
from tests.assets.files import bar_glb, turn_z
from tests.data import data_path
from tests.refusals import refuses


@pytest.fixture
def bar(tmp_path: Path) -> Character:
    return load_character(bar_glb().write(tmp_path / "bar.glb"))


def test_joints_follow_their_parents() -> None:
    joints = 5
    unit = np.tile([0.0, 0.0, 0.0, 1.0], (joints, 1))
    local = (np.tile([0.0, 1.0, 0.0], (joints, 1)), unit, np.ones((joints, 3)))
    root = np.diag([2.0, 2.0, 2.0, 1.0])
    bind = np.tile(np.eye(4), (joints, 1, 1))
    heights = [2.0, 4.0, 4.0, 6.0, 2.0]
    bind[:, :3, :3] *= 2.0
    bind[:, 1, 3] = heights
    tree = Character(
        name="tree",
        vertices=np.eye(3),
        faces=np.array([[0, 1, 2]], dtype=np.int32),
        joint_names=tuple("abcde"),
        joint_parents=np.array([-1, 0, 0, 1, -1], dtype=np.int32),
        joint_indices=np.zeros((3, 4), dtype=np.int32),
        joint_weights=np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (3, 1)),
        rest_local=local,
        inverse_bind=np.linalg.inv(bind),
        root_transform=root,
    )
    np.testing.assert_allclose(tree.joint_transforms(*local)[:, 1, 3], heights)
    rotation = unit.copy()
    rotation[0] = turn_z(90)
    turned = tree.joint_transforms(local[0], rotation, local[2])[:, :3, 3]
    np.testing.assert_allclose(turned, [[0, 2, 0], [-2, 2, 0], [-2, 2, 0], [-4, 2, 0], [0, 2, 0]], atol=1e-12)


def test_an_unknown_clip_is_refused_with_those_that_exist(bar: Character) -> None:
    refuses(r"character bar: no such clip \(received 'jump', expected one of bend\)", bar.clip, "jump")


def changed(**changes: Callable[[Character], object]) -> Callable[[Character], Character]:
    return lambda bar: replace(bar, **{name: make(bar) for name, make in changes.items()})


def row(array: np.ndarray, index: int, value: object) -> np.ndarray:
    array = array.copy()
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed(vertices=lambda b: row(b.vertices, 3, np.nan)), "vertices, row 3: values that are not finite"),
        (changed(vertices=lambda b: b.vertices[:, :2]), "vertices: bad shape (received (10, 2), expected (10, 3))"),
        (changed(faces=lambda b: row(b.faces, 5, 10)), "face 5: a face with a vertex that does not exist"),
        (changed(joint_parents=lambda b: np.array([1, -1])), "joint root: joints out of order"),
        (changed(joint_indices=lambda b: row(b.joint_indices, 4, 2)), "vertex 4: a joint that does not exist"),
        (changed(joint_weights=lambda b: b.joint_weights * 0.9), "vertex 0: skin weights that do not sum to one"),
        (changed(joint_weights=lambda b: row(b.joint_weights, 2, [2, -1, 0, 0])), "vertex 2: skin weights"),
        (changed(inverse_bind=lambda b: row(b.inverse_bind, 1, np.eye(4))), "joint tip: the bind pose and the inverse"),
        (changed(root_transform=lambda b: np.diag([1.0, 2, 1, 1])), "a root transform that shears or scales unevenly"),
        (changed(clips=lambda b: {"x": one_joint_clip()}), "clip x: a clip for another skeleton"),
    ],
)
def test_bad_data_is_refused(bar: Character, change: Callable[[Character], Character], message: str) -> None:
    assert "character bar" in refuses(re.escape(message), change, bar)


def one_joint_clip(**changes: object) -> Clip:
    entries = {
        "name": "x",
        "rate": 30.0,
        "translation": np.zeros((2, 1, 3)),
        "rotation": np.tile([0.0, 0.0, 0.0, 1.0], (2, 1, 1)),
        "scale": np.ones((2, 1, 3)),
    }
    return Clip(**(entries | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rate": 0.0}, "clip x: bad rate"),
        ({"rotation": np.tile([0.0, 0.0, 0.0, 2.0], (2, 1, 1))}, "clip x, frame 0, joint 0: a rotation"),
        ({"translation": np.full((2, 1, 3), np.inf)}, "clip x, translation, frame 0: values that are not finite"),
        ({"scale": np.ones((3, 1, 3))}, "clip x, scale: bad shape"),
        ({"translation": np.zeros((0, 1, 3))}, "clip x, translation: bad shape"),
    ],
)
def test_a_bad_clip_is_refused(changes: dict[str, object], message: str) -> None:
    refuses(re.escape(message), one_joint_clip, **changes)


def test_clips_of_two_files_come_together(bar: Character, tmp_path: Path) -> None:
    glb = bar_glb()
    glb.json["animations"][0]["name"] = "wave"
    both = with_clips(bar, load_character(glb.write(tmp_path / "other.glb")))
    assert list(both.clips) == ["bend", "wave"]
    assert list(bar.clips) == ["bend"]


def test_clips_of_another_body_are_refused(bar: Character, tmp_path: Path) -> None:
    def other(**changes: object) -> Character:
        return replace(bar, name="other", **changes)  # type: ignore[arg-type]

    shift = np.eye(4)
    shift[0, 3] = 0.1
    cases = {
        "joints differ in tail, tip": other(joint_names=("root", "tail"), clips={}),
        "character other, vertices: clips of another mesh": other(
            vertices=bar.vertices[:4],
            faces=bar.faces[:1],
            joint_indices=bar.joint_indices[:4],
            joint_weights=bar.joint_weights[:4],
        ),
        "joint root: clips of another bind pose": other(
            root_transform=shift, inverse_bind=bar.inverse_bind @ np.linalg.inv(shift)
        ),
        "clips of the same name in both files (received 'bend')": other(),
    }
    for message, character in cases.items():
        refuses(re.escape(message), with_clips, bar, character)


def test_the_woman_takes_the_clips_of_both_files() -> None:
    first = load_character(data_path("characters/mh_female_bandai_NC.glb"))
    both = with_clips(first, load_character(data_path("characters/mh_female_cmu_rokoko.glb")))
    clips = "dance_rokoko", "jump_turn_cmu_01_01", "jumping_jacks_cmu", "run_bandai", "walk_bandai"
    assert sorted(both.clips) == list(clips)
    man = load_character(data_path("characters/quaternius_mannequin_44clips.glb"))
    refuses("clips of another skeleton than mh_female_bandai_NC", with_clips, first, man)
