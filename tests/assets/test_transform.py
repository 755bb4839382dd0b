"""Translation, rotation and scale against scipy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from assets.transform import decompose, local_matrices, quaternions, slerp
from tests.refusals import refuses

# Quarter and half turns too, where one quaternion component or the angle vanishes.
TURNS = Rotation.concatenate([Rotation.random(200, random_state=0), Rotation.create_group("O")])


def test_matrices_from_quaternions_and_back() -> None:
    rng = np.random.default_rng(0)
    count = len(TURNS)
    translation, scale = rng.normal(size=(count, 3)), rng.uniform(0.5, 2.0, (count, 3))
    matrices = local_matrices(translation, TURNS.as_quat(), scale)
    np.testing.assert_allclose(matrices[:, :3, :3], TURNS.as_matrix() * scale[:, None], atol=1e-14)
    np.testing.assert_allclose(local_matrices(*decompose(matrices)), matrices, atol=1e-13)
    np.testing.assert_allclose(
        Rotation.from_quat(quaternions(TURNS.as_matrix())).as_matrix(), TURNS.as_matrix(), atol=1e-14
    )


def test_a_mirror_decomposes() -> None:
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    np.testing.assert_allclose(local_matrices(*decompose(mirror)), mirror, atol=1e-14)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.diag([1.0, 0.0, 1.0, 1.0]), "joint 3: a transform that flattens space"),
        (np.eye(4) + 0.5 * np.eye(4, k=1), "joint 3: a transform that shears"),
    ],
)
def test_what_does_not_decompose_is_refused(matrix: np.ndarray, message: str) -> None:
    refuses(message, decompose, matrix, "joint 3")


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_slerp_goes_the_short_way(share: float) -> None:
    start, end = TURNS[:100], TURNS[100:200]
    pairs = np.stack([start.as_quat(), end.as_quat()], axis=1)
    expected = [Slerp([0, 1], Rotation.from_quat(pair))(share).as_matrix() for pair in pairs]
    for sign in (1.0, -1.0):  # a quaternion and its negative are the same rotation
        mixed = Rotation.from_quat(slerp(start.as_quat(), sign * end.as_quat(), share))
        np.testing.assert_allclose(mixed.as_matrix(), expected, atol=1e-12)


def test_slerp_between_equal_rotations() -> None:
    same = np.array([[0.5, 0.5, 0.5, 0.5]])
    for other in (same, -same):
        assert np.array_equal(slerp(same, other, 0.4), same)
