"""Procedural motion: possible for a human, the same on every rig, and rich enough to learn from."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from assets.character import Character
from assets.loading import load_character
from assets.procedural.exploration import exploration_clip, exploration_motion
from assets.procedural.mannequin import builtin_mannequin
from assets.skinning import skin_vertices
from assets.transform import decompose
from tests.data import data_path
from tests.refusals import refuses

DURATION = 14.0
UNREAL = {
    "Hips": "pelvis",
    "Spine": "spine_01",
    "Spine1": "spine_02",
    "Spine2": "spine_03",
    "Neck": "neck_01",
    "Head": "head",
}
UNREAL |= {
    word + part: f"{name}_{side}"
    for word, side in (("Left", "l"), ("Right", "r"))
    for part, name in (
        ("Shoulder", "clavicle"),
        ("Arm", "upperarm"),
        ("ForeArm", "lowerarm"),
        ("Hand", "hand"),
        ("UpLeg", "thigh"),
        ("Leg", "calf"),
        ("Foot", "foot"),
        ("ToeBase", "ball"),
    )
}
BLENDER = {
    name: f"DEF-{part.removesuffix('_l').removesuffix('_r')}.{part[-1].upper()}" if part[-2:] in ("_l", "_r") else part
    for name, part in UNREAL.items()
}
MIXAMO = {name: f"mixamorig:{name}" for name in UNREAL}


def rigged_anew(names: dict[str, str], seed: int | None, turn: float = 0.0) -> Character:
    """The mannequin with other names, joints whose axes lie at random, and turned to its left [rad]."""
    body = builtin_mannequin()
    rng = np.random.default_rng(seed)
    world = np.zeros((body.joint_count, 4, 4))
    for joint in range(body.joint_count):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0] if seed is not None else np.eye(3)
        world[joint, :3, :3] = axes * np.sign(np.linalg.det(axes))
        world[joint, :3, 3] = np.linalg.inv(body.inverse_bind[joint])[:3, 3]
        world[joint, 3, 3] = 1.0
    about = np.eye(4)
    about[:3, :3] = [[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]]
    world = about @ world
    local = np.array(
        [np.linalg.inv(world[p]) @ w if p >= 0 else w for p, w in zip(body.joint_parents, world, strict=True)]
    )
    return Character(
        name="rigged anew",
        vertices=body.vertices @ about[:3, :3].T,
        faces=body.faces,
        joint_names=tuple(names[name] for name in body.joint_names),
        joint_parents=body.joint_parents,
        joint_indices=body.joint_indices,
        joint_weights=body.joint_weights,
        rest_local=decompose(local),
        inverse_bind=np.linalg.inv(world),
        root_transform=np.eye(4),
    )


@functools.cache
def character(name: str) -> Character:
    if name == "mannequin":
        return builtin_mannequin()
    return load_character(data_path(f"characters/{name}.glb"))


@functools.cache
def skins(name: str, seed: int) -> np.ndarray:
    """Every fourth vertex at 20 Hz [m], shape (frames, vertices, 3)."""
    motion = exploration_motion(character(name), seed, DURATION)
    return np.array([skin_vertices(thinned(name), motion.pose(t)) for t in np.arange(0.0, DURATION, 0.05)])


def thinned(name: str) -> Character:
    """The character with every fourth vertex."""
    body = character(name)
    return replace(
        body,
        vertices=body.vertices[::4],
        faces=np.array([[0, 1, 2]], dtype=np.int32),
        joint_indices=body.joint_indices[::4],
        joint_weights=body.joint_weights[::4],
        texture=None,
    )


def joints(body: Character, seed: int, names: dict[str, str]) -> dict[str, np.ndarray]:
    """Places of some joints at 60 Hz [m], by our names for them."""
    clip = exploration_clip(body, seed, DURATION)
    world = [
        body.joint_transforms(*at)[:, :3, 3] for at in zip(clip.translation, clip.rotation, clip.scale, strict=True)
    ]
    return {name: np.array(world)[:, body.joint_names.index(other)] for name, other in names.items()}


OWN = {name: name for name in UNREAL}
CMU = {name: name for name in ("Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftArm", "LeftForeArm", "LeftHand")}
CMU |= {name.replace("Left", "Right"): name.replace("Left", "Right") for name in CMU}
RIGIFY = {
    name: BLENDER[name].replace("upperarm", "upper_arm").replace("lowerarm", "forearm").replace("calf", "shin")
    for name in CMU
}
RIGIFY["Hips"] = "DEF-hips"
BODIES = [("mannequin", OWN), ("mh_female_cmu_rokoko", CMU), ("quaternius_mannequin_44clips", RIGIFY)]


def test_same_seed_same_motion() -> None:
    body = builtin_mannequin()
    first, second, other = (exploration_clip(body, seed, 8.0) for seed in (3, 3, 4))
    assert np.array_equal(first.rotation, second.rotation) and np.array_equal(first.translation, second.translation)
    assert np.abs(first.rotation - other.rotation).max() > 0.1
    assert exploration_motion(body, 3, 8.0).name == "exploration_3"
    assert exploration_motion(body, 3, 8.0).duration == pytest.approx(8.0)


@pytest.mark.parametrize("name", [name for name, _ in BODIES])
def test_starts_in_the_bind_pose_and_travels(name: str) -> None:
    assert np.abs(skins(name, 0)[0] - thinned(name).vertices).max() < 1e-5
    assert np.linalg.norm(np.ptp(skins(name, 0).mean(axis=1), axis=0)[[0, 2]]) > 1.0


@pytest.mark.parametrize("name", [name for name, _ in BODIES])
@pytest.mark.parametrize("seed", [0, 2])
def test_feet_keep_to_the_floor_and_nothing_is_too_fast(name: str, seed: int) -> None:
    vertices = skins(name, seed)
    lowest = vertices[:, :, 1].min(axis=1) - vertices[0, :, 1].min()
    assert lowest.min() > -0.05
    assert lowest.max() < 0.05
    assert np.linalg.norm(np.diff(vertices, axis=0), axis=2).max() / 0.05 < 8.0


@pytest.mark.parametrize(("name", "names"), BODIES)
@pytest.mark.parametrize("seed", [1, 2])
def test_knees_bend_backwards_and_elbows_forwards(name: str, names: dict[str, str], seed: int) -> None:
    places = joints(character(name), seed, names)
    left = places["LeftUpLeg"] - places["RightUpLeg"]
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    for side in ("Left", "Right"):
        hip, knee, ankle = (places[side + part] for part in ("UpLeg", "Leg", "Foot"))
        # About the axis to the left, the shin turns from the thigh's line by a positive angle: heel to buttocks.
        thigh, shin = knee - hip, ankle - knee
        sine = (np.cross(thigh, shin) * left).sum(axis=1)
        sine /= np.linalg.norm(thigh, axis=1) * np.linalg.norm(shin, axis=1)
        assert sine.min() > -0.09
        assert sine.max() > 0.7
        assert np.ptp(np.linalg.norm(thigh, axis=1)) < 1e-6  # bones keep their length


@pytest.mark.parametrize(("name", "names"), BODIES)
def test_arms_stay_off_the_trunk(name: str, names: dict[str, str]) -> None:
    """The upper arms keep 12 deg from the line between the shoulders' and the hips' middle, outwards."""
    for seed in (1, 2, 3):
        places = joints(character(name), seed, names)
        shoulders = places["LeftArm"] - places["RightArm"]
        shoulders /= np.linalg.norm(shoulders, axis=1, keepdims=True)
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            arm = places[side + "ForeArm"] - places[side + "Arm"]
            outwards = sign * (arm * shoulders).sum(axis=1) / np.linalg.norm(arm, axis=1)
            assert np.degrees(np.arcsin(outwards.min())) > 12.0


@pytest.mark.parametrize("names", [UNREAL, BLENDER, MIXAMO], ids=["unreal", "blender", "mixamo"])
def test_names_and_axes_of_the_joints_do_not_matter(names: dict[str, str]) -> None:
    body, other = builtin_mannequin(), rigged_anew(names, seed=7)
    one, two = exploration_motion(body, 5, 10.0), exploration_motion(other, 5, 10.0)
    for t in np.arange(0.0, 10.0, 0.7):
        assert np.abs(one.pose(t) - two.pose(t)).max() < 1e-6


def test_a_figure_may_face_any_way() -> None:
    turn = 2.2
    body, other = builtin_mannequin(), rigged_anew(OWN, seed=None, turn=turn)
    one, two = exploration_motion(body, 5, 6.0), exploration_motion(other, 5, 6.0)
    about = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]])
    for t in (0.0, 2.0, 5.5):
        assert skin_vertices(other, two.pose(t)) == pytest.approx(skin_vertices(body, one.pose(t)) @ about.T, abs=1e-6)


def test_covers_what_clothes_should_have_seen() -> None:
    """Over a few seeds: standing and fast walking, sharp turns, deep squats, raised knees."""
    speeds, turns, heights, knees = [], [], [], []
    for seed in range(8):
        places = joints(builtin_mannequin(), seed, OWN)
        hips = places["Hips"]
        left = places["LeftUpLeg"] - places["RightUpLeg"]
        speeds.append(np.linalg.norm(np.diff(hips[::30], axis=0)[:, [0, 2]], axis=1) / 0.5)
        turns.append(np.abs(np.diff(np.unwrap(np.arctan2(-left[:, 2], left[:, 0]))[::15]) / 0.25))
        heights.append(hips[:, 1])
        knees.append(places["LeftLeg"][:, 1] - places["LeftUpLeg"][:, 1])
    speed, turn, height, knee = (np.concatenate(values) for values in (speeds, turns, heights, knees))
    assert (speed < 0.1).mean() > 0.1 and (speed > 1.3).mean() > 0.05 and speed.max() < 2.3
    assert np.percentile(turn, 97) > 1.2 and turn.max() > 2.5
    assert height.min() < 0.78 < 0.90 < height.max()
    assert knee.max() > -0.15  # a thigh that is nearly level


def test_is_smooth() -> None:
    """No joint's speed jumps: what moves a garment is band-limited."""
    for seed in (0, 2):
        places = joints(builtin_mannequin(), seed, OWN)
        for name, most in (
            ("Hips", 15.0),
            ("Spine2", 15.0),
            ("LeftHand", 60.0),
            ("LeftFoot", 90.0),
            ("LeftLeg", 150.0),
        ):
            acceleration = np.diff(places[name], n=2, axis=0) * 3600.0  # [m/s2]
            assert np.linalg.norm(acceleration, axis=1).max() < most


def test_bad_input_is_refused() -> None:
    body = builtin_mannequin()
    refuses("at least 2 s", exploration_motion, body, 0, 1.0)
    nameless = rigged_anew({name: f"part{k:02}" for k, name in enumerate(UNREAL)}, seed=None)
    refuses("left upleg", exploration_motion, nameless, 0, 5.0)
    crossed = dict(OWN) | {"LeftLeg": "LeftArm", "LeftArm": "LeftLeg"}
    refuses("no figure", exploration_motion, rigged_anew(crossed, seed=None), 0, 5.0)
