"""Attachments ride on a body; points are pushed out of it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pbd.attachment import Attachment, closest_points, push_outside
from tests.pbd.meshes import icosphere, to_triangles, turn
from tests.refusals import refuses

BALL, FACES = icosphere(3, 0.15)


def around(seed: int, low: float, high: float, count: int = 60) -> np.ndarray:
    """Points at distances between low and high [m] from the ball's centre."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True) * rng.uniform(low, high, (count, 1))


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_closest_points_against_all_faces(seed: int) -> None:
    points = around(seed, 0.12, 0.2)
    vertices = BALL * np.random.default_rng(seed).uniform(0.7, 1.3, 3)
    face, weights = closest_points(points, vertices, FACES)
    found = np.einsum("pk,pkx->px", weights, vertices[FACES[face]])
    exact, foot = to_triangles(points, vertices, FACES)
    assert np.abs(weights.sum(axis=1) - 1.0).max() < 1e-9 and weights.min() > -1e-9
    assert np.linalg.norm(found - points, axis=1) == pytest.approx(exact, abs=1e-9)
    assert found == pytest.approx(foot, abs=1e-6)


def test_bound_points_stay_where_they_are_in_the_bind_pose() -> None:
    points = around(0, 0.13, 0.18)
    assert Attachment.bind(points, BALL, FACES).targets(BALL) == pytest.approx(points, abs=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.floats(-180.0, 180.0))
def test_bound_points_follow_a_rigid_motion(seed: int, degrees: float) -> None:
    points = around(seed, 0.13, 0.18)
    rng = np.random.default_rng(seed)
    rotation, shift = turn(tuple(rng.normal(size=3)), degrees), rng.uniform(-1.0, 1.0, 3)
    attachment = Attachment.bind(points, BALL, FACES)
    expected = points @ rotation.T + shift
    assert attachment.targets(BALL @ rotation.T + shift) == pytest.approx(expected, abs=1e-12)
    in_float32 = (BALL @ rotation.T + shift).astype(np.float32)
    assert np.abs(attachment.targets(in_float32) - expected).max() < 1e-5


def test_bound_points_keep_their_distance_when_the_body_swells() -> None:
    points = around(1, 0.17, 0.18)
    distance = np.linalg.norm(Attachment.bind(points, BALL, FACES).targets(1.5 * BALL), axis=1)
    before = np.linalg.norm(points, axis=1)
    assert np.abs(distance - (before + 0.5 * 0.15)).max() < 2e-3


def test_nothing_to_bind_and_nothing_to_bind_to() -> None:
    none = Attachment.bind(np.zeros((0, 3)), BALL, FACES)
    assert none.targets(BALL).shape == (0, 3)
    refuses("nothing to attach to", Attachment.bind, around(0, 0.1, 0.2), BALL, FACES[:0])


@pytest.mark.parametrize("clearance", [0.0, 0.002, 0.01])
def test_points_inside_are_pushed_out_and_others_are_left_alone(clearance: float) -> None:
    points = np.concatenate([around(2, 0.12, 0.15), around(3, 0.15, 0.16), around(4, 0.17, 0.3)])
    distance, foot = to_triangles(points, BALL, FACES)
    signed = distance * np.sign(np.linalg.norm(points, axis=1) - np.linalg.norm(foot, axis=1))
    pushed = push_outside(points, BALL, FACES, clearance)
    after, foot = to_triangles(pushed, BALL, FACES)
    assert (np.linalg.norm(pushed, axis=1) >= np.linalg.norm(foot, axis=1) - 1e-5).all()
    assert after.min() > 0.98 * clearance - 1e-5
    clear = signed > clearance + 1e-4
    assert clear.any() and np.array_equal(pushed[clear], points[clear])
    # Straight out, and not further than was needed.
    moved = np.linalg.norm(pushed - points, axis=1)
    assert moved == pytest.approx(np.maximum(clearance - signed, 0.0), abs=5e-4)
    assert np.array_equal(points[0], around(2, 0.12, 0.15)[0])  # the input is not written to
