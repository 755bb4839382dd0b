"""Clip motion: where it starts, how it blends, and what it plays."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.character import Character, Clip
from assets.loading import load_character
from assets.motion import ClipMotion, part_of
from assets.skinning import skin_vertices
from assets.transform import slerp
from pbd.errors import InputError
from tests.assets.files import Glb, bar_glb, turn_z
from tests.data import data_path
from tests.refusals import refuses

HALF = float(np.sqrt(0.5))


@pytest.fixture
def bar(tmp_path: Path) -> Character:
    """The bar with a clip that starts at (5, 0.2, -3), turned by 90 degrees about Y, and walks along X at 2 m/s."""
    glb: Glb = bar_glb()
    places = [[5.0, 0.2, -3.0], [6.0, 0.2, -3.0], [7.0, 0.2, -3.0]]
    glb.clip(
        "walk",
        (0, "translation", [0.0, 0.5, 1.0], places, "LINEAR"),
        (0, "rotation", [0.0, 0.5, 1.0], [[0, HALF, 0, HALF]] * 3, "LINEAR"),
        (1, "rotation", [0.0, 0.5, 1.0], [turn_z(60), turn_z(0), turn_z(60)], "LINEAR"),
    )
    return load_character(glb.write(tmp_path / "bar.glb"))


def test_it_starts_in_the_bind_pose_where_the_clip_starts(bar: Character) -> None:
    start = skin_vertices(bar, ClipMotion(bar, bar.clip("walk")).pose(0.0))
    x, y, z = bar.vertices.T
    # Turned by 90 degrees about Y (x becomes -z) and moved level: the clip's own height comes with the blend.
    np.testing.assert_allclose(start, np.stack([z + 5.0, y, -x - 3.0], axis=1), atol=1e-6)


def test_it_neither_travels_nor_spins_while_it_blends(bar: Character) -> None:
    motion = ClipMotion(bar, bar.clip("walk"), blend=1.0)
    heights = []
    for t in np.linspace(0.0, 1.0, 11):
        root = motion.pose(t)[0]
        np.testing.assert_allclose(root[[0, 2], 3], [5.0, -3.0], atol=1e-6)
        np.testing.assert_allclose(root[:, :3], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-6)
        heights.append(root[1, 3])
    s = np.linspace(0.0, 1.0, 11)
    np.testing.assert_allclose(heights, 0.2 * (3.0 * s**2 - 2.0 * s**3), atol=1e-6)


def test_the_clip_plays_after_the_blend(bar: Character) -> None:
    clip = bar.clip("walk")
    motion = ClipMotion(bar, clip, blend=0.5, speed=2.0)
    assert (motion.name, motion.duration) == ("walk", pytest.approx(1.0))
    for t, frame in ((0.5, 0), (0.75, 1), (1.0, 2)):
        expected = bar.pose_from_local(clip.translation[frame], clip.rotation[frame], clip.scale[frame])
        np.testing.assert_allclose(motion.pose(t), expected, atol=1e-12)
    between = slerp(clip.rotation[0], clip.rotation[1], 0.5)
    half = bar.pose_from_local(clip.translation[:2].mean(axis=0), between, clip.scale[0])
    np.testing.assert_allclose(motion.pose(0.625), half, atol=1e-12)


def test_a_clip_by_its_name_is_clamped_and_starts_in_itself_without_a_blend(bar: Character) -> None:
    clip = bar.clip("walk")
    by_name, motion = ClipMotion(bar, "walk"), ClipMotion(bar, clip)
    assert np.array_equal(by_name.pose(1.3), motion.pose(1.3))
    refuses("no such clip", ClipMotion, bar, "run")
    assert np.array_equal(motion.pose(-3.0), motion.pose(0.0))
    assert np.array_equal(motion.pose(99.0), motion.pose(motion.duration))
    expected = bar.pose_from_local(clip.translation[0], clip.rotation[0], clip.scale[0])
    np.testing.assert_allclose(ClipMotion(bar, clip, blend=0.0).pose(0.0), expected, atol=1e-12)


def test_a_clip_of_one_frame_is_held(bar: Character) -> None:
    clip = bar.clip("walk")
    still = Clip("still", 30.0, clip.translation[:1], clip.rotation[:1], clip.scale[:1])
    motion = ClipMotion(bar, still, loop=True)
    assert motion.duration == 1.0
    assert np.array_equal(motion.pose(1.0), motion.pose(7.3))


def test_a_part_of_a_clip_has_its_frames(bar: Character) -> None:
    clip = bar.clip("walk")
    last, rate = len(clip.translation) - 1, clip.rate
    assert np.array_equal(part_of(clip, 0.0, None).translation, clip.translation)
    part = part_of(clip, 1.0 / rate, last / rate)
    assert np.array_equal(part.rotation, clip.rotation[1:]) and part.duration == pytest.approx((last - 1) / rate)
    refuses(r"clip walk: no such part.*two frames", part_of, clip, last / rate, None)


def test_a_loop_goes_round_and_a_journey_is_refused(bar: Character) -> None:
    clip = bar.clip("walk")
    refuses(re.escape("clip walk, joint root: a clip that does not end as it starts"), ClipMotion, bar, clip, loop=True)
    closed = replace(clip, translation=np.repeat(clip.translation[:1], 3, axis=0))
    motion = ClipMotion(bar, closed, loop=True)
    for t in (1.0, 1.3, 1.9):
        np.testing.assert_allclose(motion.pose(t + 4 * closed.duration), motion.pose(t), atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"blend": -1.0}, "clip walk: bad blend"),
        ({"speed": 0.0}, "clip walk: bad speed"),
        ({"speed": np.nan}, "bad speed"),
    ],
)
def test_bad_options_are_refused(options: dict[str, float], message: str, bar: Character) -> None:
    with pytest.raises(InputError, match=message):
        ClipMotion(bar, bar.clip("walk"), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("file", "clip", "hips"),
    [
        ("mh_female_bandai_NC", "walk_bandai", "Hips"),
        ("mh_female_cmu_rokoko", "jump_turn_cmu_01_01", "Hips"),
        ("quaternius_mannequin_44clips", "Crouch_Fwd_Loop", "DEF-hips"),  # its root stands on the floor
        ("arcsim_female_dance_NC", "dance_paused", "part05"),  # sixteen parts side by side
    ],
)
def test_real_bodies_start_upright_and_stay_in_place(file: str, clip: str, hips: str) -> None:
    body = load_character(data_path(f"characters/{file}.glb"))
    motion = ClipMotion(body, body.clip(clip))
    start = motion.pose(0.0)
    assert np.abs(start - start[0]).max() < 1e-6  # one rigid motion of the whole bind pose,
    np.testing.assert_allclose(start[0, 1], [0.0, 1.0, 0.0, 0.0], atol=1e-6)  # level and at its own height
    joint = body.joint_names.index(hips)
    place = body.joint_transforms(*body.rest_local)[joint, :3, 3]
    path = np.array([motion.pose(t)[joint] @ [*place, 1.0] for t in np.linspace(0.0, 1.0, 9)])
    assert np.ptp(path[:, [0, 2]], axis=0).max() < 1e-6
