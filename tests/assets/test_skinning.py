"""The skinning kernel against its float64 reference."""

import numpy as np
import pytest

from assets.character import Character
from assets.loading import load_character
from assets.skinning import SkinnedBody, skin_vertices
from pbd.engine import ti
from tests.data import data_path


def random_character(vertex_count: int = 300, joint_count: int = 7, reach: float = 1.0) -> tuple[Character, np.ndarray]:
    """A cloud of vertices with one to four influences each, and a random pose of its joints."""
    rng = np.random.default_rng(1)
    weights = rng.uniform(0.1, 1.0, (vertex_count, 4))
    weights[np.arange(4) > rng.integers(0, 4, vertex_count)[:, None]] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    unit = np.tile([0.0, 0.0, 0.0, 1.0], (joint_count, 1))
    character = Character(
        name="cloud",
        vertices=rng.uniform(-reach, reach, (vertex_count, 3)),
        faces=np.arange(vertex_count, dtype=np.int32).reshape(-1, 3),
        joint_names=tuple(map(str, range(joint_count))),
        joint_parents=np.full(joint_count, -1, dtype=np.int32),
        joint_indices=rng.integers(0, joint_count, (vertex_count, 4)).astype(np.int32),
        joint_weights=weights.astype(np.float32),
        rest_local=(np.zeros((joint_count, 3)), unit, np.ones((joint_count, 3))),
        inverse_bind=np.tile(np.eye(4), (joint_count, 1, 1)),
        root_transform=np.eye(4),
    )
    rotation = rng.normal(size=(joint_count, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    return character, character.pose_from_local(rng.normal(size=(joint_count, 3)), rotation, np.ones((joint_count, 3)))


def test_one_influence_is_rigid() -> None:
    character, pose = random_character()
    matrix = pose[3]
    rigid = skin_vertices(character, np.tile(matrix, (character.joint_count, 1, 1)))
    np.testing.assert_allclose(rigid, character.vertices @ matrix[:, :3].T + matrix[:, 3], atol=1e-12)


def test_the_bind_pose_leaves_the_mesh_alone() -> None:
    character, _ = random_character()
    np.testing.assert_allclose(skin_vertices(character, character.bind_pose()), character.vertices, atol=1e-14)


@pytest.mark.parametrize("kind", ["taichi", "numpy"])
def test_the_kernel_agrees_with_the_reference(kind: str) -> None:
    character, pose = random_character()
    body, count = SkinnedBody(character), len(character.vertices)
    out = ti.ndarray(dtype=ti.math.vec3, shape=count) if kind == "taichi" else np.zeros((count, 3), dtype=np.float32)
    body.skin(pose, np.zeros(3), out)
    result = out.to_numpy() if kind == "taichi" else out
    np.testing.assert_allclose(result, skin_vertices(character, pose), atol=2e-6)


def test_far_from_the_origin_nothing_is_lost() -> None:
    """The frame follows the body: 1 km away the result has the digits that it has at home."""
    character, pose = random_character()
    out, far = np.zeros((len(character.vertices), 3), dtype=np.float32), np.array([1000.1, -3.3, 512.7])
    moved = pose.copy()
    moved[:, :, 3] += far
    SkinnedBody(character).skin(moved, far, out)
    np.testing.assert_allclose(out, skin_vertices(character, pose), atol=2e-6)


def test_two_bodies_do_not_share_memory() -> None:
    first, pose = random_character()
    second, _ = random_character(vertex_count=30, joint_count=2)
    bodies = SkinnedBody(first), SkinnedBody(second)
    outs = [np.zeros((len(body.vertices), 3), dtype=np.float32) for body in bodies]
    for body, out, matrices in zip(bodies, outs, (pose, pose[:2]), strict=True):
        body.skin(matrices, np.zeros(3), out)
    np.testing.assert_allclose(outs[0], skin_vertices(first, pose), atol=2e-6)
    np.testing.assert_allclose(outs[1], skin_vertices(second, pose[:2]), atol=2e-6)


def test_the_woman_walks_like_the_reference() -> None:
    woman = load_character(data_path("characters/mh_female_bandai_NC.glb"))
    clip = woman.clip("walk_bandai")
    body, out = SkinnedBody(woman), np.zeros((13380, 3), dtype=np.float32)
    for frame in (0, 70, 194):
        pose = woman.pose_from_local(clip.translation[frame], clip.rotation[frame], clip.scale[frame])
        reference = skin_vertices(woman, pose)
        origin = reference.mean(axis=0)
        body.skin(pose, origin, out)
        assert np.abs(out - (reference - origin)).max() < 2e-6
    assert 7.0 < np.linalg.norm(origin) < 9.0  # she has walked away
