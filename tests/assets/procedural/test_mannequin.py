"""The built-in mannequin: a sound surface, weights that bend well, and clips that move as people do."""

import functools

import numpy as np
import pytest
from scipy.spatial import cKDTree

from assets.character import Character, Clip
from assets.loading import load_character
from assets.procedural.mannequin import builtin_mannequin
from assets.procedural.mannequin_shape import body_field, skin_weights, strongest
from assets.skinning import skin_vertices
from tests.refusals import refuses

SIDES = ("Left", "Right")
CLIPS = ("walk", "slow_walk", "turn", "twirl", "sway")


def joint(name: str) -> int:
    return builtin_mannequin().joint_names.index(name)


@functools.cache
def joint_places(clip: str) -> np.ndarray:
    """Places of the joints over a clip [m], shape (frames, joints, 3)."""
    character = builtin_mannequin()
    return np.array([transforms(character, character.clips[clip], frame)[:, :3, 3] for frame in frames(clip)])


@functools.cache
def skins(clip: str) -> np.ndarray:
    """Vertices over a clip at a tenth of its rate [m], shape (frames, vertices, 3)."""
    character = builtin_mannequin()
    poses = [transforms(character, character.clips[clip], frame)[:, :3] for frame in frames(clip)[::6]]
    return np.array([skin_vertices(character, pose @ character.inverse_bind) for pose in poses])


def frames(clip: str) -> range:
    return range(builtin_mannequin().clips[clip].frame_count)


def transforms(character: Character, clip: Clip, frame: int) -> np.ndarray:
    return character.joint_transforms(clip.translation[frame], clip.rotation[frame], clip.scale[frame])


def trace(clip: str, vertex: int) -> np.ndarray:
    """Places of a vertex over a clip [m], shape (frames, 3)."""
    character = builtin_mannequin()
    bind = np.append(character.vertices[vertex], 1.0)
    poses = np.array([transforms(character, character.clips[clip], frame)[:, :3] for frame in frames(clip)])
    moved = poses[:, character.joint_indices[vertex]] @ character.inverse_bind[character.joint_indices[vertex]] @ bind
    return np.einsum("k,fki->fi", character.joint_weights[vertex], moved)


def total_weights(character: Character, names: list[str]) -> np.ndarray:
    wanted = np.isin(character.joint_indices, [joint(name) for name in names])
    return np.where(wanted, character.joint_weights, 0.0).sum(axis=1)


def test_surface_is_closed_manifold_and_faces_outwards() -> None:
    body = builtin_mannequin()
    sides = np.concatenate([body.faces[:, [0, 1]], body.faces[:, [1, 2]], body.faces[:, [2, 0]]])
    assert len(np.unique(sides, axis=0)) == len(sides)  # every edge once in each direction
    assert np.array_equal(np.unique(sides, axis=0), np.unique(sides[:, ::-1], axis=0))
    assert len(body.vertices) - len(sides) // 2 + len(body.faces) == 2  # one piece without handles
    a, b, c = (body.vertices[body.faces[:, k]] for k in range(3))
    volume = np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0
    assert 0.045 < volume < 0.065  # of a slim woman [m3]
    assert len(np.unique(body.vertices, axis=0)) == len(body.vertices)


def test_triangles_are_even() -> None:
    body = builtin_mannequin()
    assert 6000 <= len(body.vertices) <= 9000
    p = body.vertices[body.faces]
    lengths = np.linalg.norm(p - np.roll(p, -1, axis=1), axis=2)
    assert 0.012 < lengths.mean() < 0.017
    u, v = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
    angles = np.degrees(np.arctan2(np.linalg.norm(np.cross(u, v), axis=2), (u * v).sum(axis=2)))
    assert angles.min() > 10.0
    assert np.percentile(angles.min(axis=1), 1) > 30.0


def test_stands_upright_and_faces_ahead_with_limbs_apart() -> None:
    body = builtin_mannequin()
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    assert abs(low[1]) < 1e-3
    assert high[1] == pytest.approx(1.70, abs=0.01)
    soles = body.vertices[body.vertices[:, 1] < 0.02]
    assert soles[:, 2].max() > 1.8 * -soles[:, 2].min()  # toes are ahead of the ankles
    for side in SIDES:
        arm = total_weights(body, [side + "ForeArm", side + "Hand"]) > 0.9
        rest = total_weights(body, [side + part for part in ("Shoulder", "Arm", "ForeArm", "Hand")]) < 0.1
        assert cKDTree(body.vertices[arm]).query(body.vertices[rest])[0].min() > 0.08
    thighs = body.vertices[np.abs(body.vertices[:, 1] - 0.6) < 0.1]
    assert np.abs(thighs[:, 0]).min() > 0.015


def test_data_file_is_what_the_generator_makes() -> None:
    body = builtin_mannequin()
    assert np.abs(body_field(body.vertices)).max() < 2e-4
    indices, parts = strongest(skin_weights(body.vertices, body.faces))
    made, stored = np.zeros((2, len(indices), body.joint_count))
    rows = np.arange(len(indices))[:, None]
    np.add.at(made, (rows, indices), parts / 65535.0)
    np.add.at(stored, (rows, body.joint_indices), body.joint_weights)
    assert np.abs(stored - made).max() < 2e-3


def test_weights_are_smooth() -> None:
    """Neighbours 15 mm apart never differ so much that a bent joint would crease."""
    body = builtin_mannequin()
    weights = np.zeros((len(body.vertices), body.joint_count))
    np.add.at(weights, (np.arange(len(weights))[:, None], body.joint_indices), body.joint_weights)
    sides = np.concatenate([body.faces[:, [0, 1]], body.faces[:, [1, 2]]])
    step = np.abs(weights[sides[:, 0]] - weights[sides[:, 1]]).max(axis=1)
    length = np.linalg.norm(body.vertices[sides[:, 0]] - body.vertices[sides[:, 1]], axis=1)
    assert (step / length).max() < 40.0  # a full change takes 25 mm at least


def test_arms_do_not_pull_the_trunk() -> None:
    body = builtin_mannequin()
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        pull = total_weights(body, [side + part for part in ("Arm", "ForeArm", "Hand")])
        beyond = sign * body.vertices[:, 0] < 0.08
        below = (body.vertices[:, 1] < 1.18) & (np.abs(body.vertices[:, 0]) < 0.18)
        assert pull[beyond].max() < 0.12
        assert pull[below].max() < 0.01


@pytest.mark.parametrize("clip", CLIPS)
def test_clips_are_smooth_and_keep_to_the_floor(clip: str) -> None:
    assert builtin_mannequin().clips[clip].duration >= 6.0
    places, vertices = joint_places(clip), skins(clip)
    assert np.linalg.norm(np.diff(places, axis=0), axis=2).max() * 60.0 < 7.0
    lowest = vertices[:, :, 1].min(axis=1)
    assert lowest.min() > -0.02
    assert lowest.max() < 0.01


@pytest.mark.parametrize("clip", CLIPS)
def test_limbs_do_not_pass_through_each_other(clip: str) -> None:
    body = builtin_mannequin()
    legs = [total_weights(body, [side + part for part in ("UpLeg", "Leg", "Foot", "ToeBase")]) for side in SIDES]
    arms = [total_weights(body, [side + part for part in ("ForeArm", "Hand")]) for side in SIDES]
    upper = sum(total_weights(body, [side + "Arm"]) for side in SIDES)
    rest = np.flatnonzero(arms[0] + arms[1] + upper < 0.05)
    pairs = [(np.flatnonzero(legs[0] > 0.95), np.flatnonzero(legs[1] > 0.95))]
    pairs += [(np.flatnonzero(arm > 0.95), rest) for arm in arms]
    for vertices in skins(clip)[::2]:
        a, b, c = (vertices[body.faces[:, k]] for k in range(3))
        across = np.cross(b - a, c - a)
        normals = np.stack([np.bincount(body.faces.ravel(), np.repeat(across[:, k], 3)) for k in range(3)], axis=1)
        for limb, other in pairs:
            nearest = other[cKDTree(vertices[other]).query(vertices[limb])[1]]
            assert (((vertices[limb] - vertices[nearest]) * normals[nearest]).sum(axis=1) > 0.0).all()


@pytest.mark.parametrize("clip", CLIPS)
def test_knees_and_elbows_bend_the_right_way(clip: str) -> None:
    """Seen along the hinge, the shin never swings ahead of the thigh's line, nor the forearm behind the upper arm's."""
    character = builtin_mannequin()
    hips = joint("Hips")
    ahead = np.array([transforms(character, character.clips[clip], frame)[hips, :3, 2] for frame in frames(clip)])
    places = joint_places(clip)
    for side in SIDES:
        for names, sign in ((("UpLeg", "Leg", "Foot"), -1.0), (("Arm", "ForeArm", "Hand"), 1.0)):
            a, b, c = (places[:, joint(side + name)] for name in names)
            line = (c - a) / np.linalg.norm(c - a, axis=1, keepdims=True)
            out = (b - a) - ((b - a) * line).sum(axis=1, keepdims=True) * line
            assert (sign * (out * ahead).sum(axis=1)).max() < 0.01


@pytest.mark.parametrize(("clip", "speed"), [("walk", 1.2), ("slow_walk", 0.6)])
def test_walks_as_fast_as_it_says_without_sliding(clip: str, speed: float) -> None:
    places = joint_places(clip)[120:]
    hips = places[:, joint("Hips")]
    assert (hips[-1, 2] - hips[0, 2]) * 60.0 / (len(hips) - 1) == pytest.approx(speed, rel=0.02)
    character = builtin_mannequin()
    for sign in (1.0, -1.0):
        sole = int(np.linalg.norm(character.vertices - [sign * 0.126, 0.0, 0.085], axis=1).argmin())
        ball = trace(clip, sole)[120:]
        standing = ball[:-1, 1] < 0.006
        assert 0.5 < standing.mean() < 0.75
        slide = np.linalg.norm(np.diff(ball, axis=0)[:, [0, 2]], axis=1)[standing] * 60.0
        assert np.median(slide) < 0.05 * speed
        assert np.percentile(slide, 90) < 0.5 * speed


def test_walk_has_the_marks_of_a_human_gait() -> None:
    places = joint_places("walk")[150:]
    thigh = places[:, joint("LeftLeg")] - places[:, joint("LeftUpLeg")]
    shin = places[:, joint("LeftFoot")] - places[:, joint("LeftLeg")]
    cosine = (thigh * shin).sum(axis=1) / np.linalg.norm(thigh, axis=1) / np.linalg.norm(shin, axis=1)
    flexion = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    assert 50.0 < flexion.max() < 75.0  # in swing
    assert flexion.min() < 17.0  # the leg is nearly straight once a step
    height = places[:, joint("Hips"), 1]
    assert 0.015 < np.ptp(height) < 0.06
    # The left hand is ahead when the left foot is behind.
    hips = places[:, joint("Hips"), 2]
    hand, foot = places[:, joint("LeftHand"), 2] - hips, places[:, joint("LeftFoot"), 2] - hips
    assert np.corrcoef(hand, foot)[0, 1] < -0.8
    # Heel first: at touch-down the toes stand higher than they do flat on the floor.
    ankle, toe = places[:, joint("LeftFoot")], places[:, joint("LeftToeBase")]
    ahead = (ankle[:, 2] - hips) > 0.9 * (ankle[:, 2] - hips).max()
    assert (toe[ahead, 1] - ankle[ahead, 1]).max() > toe[:, 1].min() - 0.082 + 0.02


def test_turns_once_round_and_twirls_fast() -> None:
    def heading(clip: str) -> np.ndarray:
        places = joint_places(clip)
        left = places[:, joint("LeftUpLeg")] - places[:, joint("RightUpLeg")]
        return np.unwrap(np.arctan2(-left[:, 2], left[:, 0]))

    turn, twirl = heading("turn"), heading("twirl")
    assert turn.max() - turn[0] == pytest.approx(2.0 * np.pi, abs=0.25)
    assert abs(turn[-1] - turn[0]) < 0.2
    assert np.diff(twirl).max() * 60.0 > 5.0


def test_a_deeply_bent_leg_keeps_its_volume() -> None:
    body = builtin_mannequin()
    translation, rotation, scale = (part.copy() for part in body.rest_local)
    rotation[joint("LeftUpLeg")] = [-np.sin(0.7), 0.0, 0.0, np.cos(0.7)]  # thigh up by 80 deg
    rotation[joint("LeftLeg")] = [np.sin(0.7), 0.0, 0.0, np.cos(0.7)]
    bent = skin_vertices(body, body.pose_from_local(translation, rotation, scale))
    assert bent[total_weights(body, ["LeftLeg"]) > 0.99, 2].min() > 0.1  # the shin hangs ahead of the body

    def volume(vertices: np.ndarray) -> float:
        a, b, c = (vertices[body.faces[:, k]] for k in range(3))
        return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)

    assert volume(bent) == pytest.approx(volume(body.vertices), rel=0.05)


def test_it_is_loaded_by_its_name() -> None:
    assert load_character("builtin:mannequin") is builtin_mannequin()
    assert load_character("builtin:mannequin", name="Ann").name == "Ann"
    refuses("builtin:mannequin", load_character, "builtin:man")
