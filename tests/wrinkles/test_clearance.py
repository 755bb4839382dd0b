from __future__ import annotations

import numpy as np
import pytest

from pbd import ClothMesh
from tests.wrinkles.meshes import icosphere, tube
from wrinkles.clearance import MAX_EXTRA_CLEARANCE, clearances, facing

THICKNESS = 0.003


def with_bump(height: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A ball of 10 cm with a bump of 5 mm radius on one side, and which vertices are on it."""
    vertices, faces = icosphere(6, 0.1)
    away = np.linalg.norm(vertices - [0.1, 0.0, 0.0], axis=1)
    bump = height * np.exp(-((away / 0.004) ** 2))
    return vertices * (1.0 + bump / 0.1)[:, None], faces, away


def test_a_smooth_body_asks_for_little() -> None:
    vertices, faces, _ = with_bump(0.0)
    kept = clearances(vertices, faces, 0.01, THICKNESS)
    # The mean of a disc of radius L on a ball of radius R lies L^2 / (4 R) under its middle.
    assert kept.dtype == np.float32 and kept - THICKNESS == pytest.approx(0.01**2 / 0.4, rel=0.25)


def test_what_stands_out_gives_its_height_to_its_surroundings() -> None:
    vertices, faces, away = with_bump(0.003)
    kept = clearances(vertices, faces, 0.01, THICKNESS) - THICKNESS
    assert kept[away < 0.008].min() > 0.0018
    assert kept[away > 0.025].max() < 0.0004
    high, _, _ = with_bump(0.03)
    assert clearances(high, faces, 0.01, THICKNESS).max() == np.float32(THICKNESS + MAX_EXTRA_CLEARANCE)


def test_a_hollow_and_another_part_of_the_body_ask_for_nothing() -> None:
    vertices, faces, away = with_bump(-0.003)
    assert (clearances(vertices, faces, 0.01, THICKNESS) - THICKNESS)[away < 0.002].max() < 0.001
    ball, faces, _ = with_bump(0.0)
    other = ball + [0.203, 0.0, 0.0]  # 3 mm away
    both = clearances(np.concatenate([ball, other]), np.concatenate([faces, faces + len(ball)]), 0.01, THICKNESS)
    np.testing.assert_allclose(both[: len(ball)], clearances(ball, faces, 0.01, THICKNESS), atol=1e-6)


def test_without_a_body_there_is_the_thickness() -> None:
    assert np.array_equal(clearances(np.zeros((2, 3)), np.zeros((0, 3), int), 0.01, 0.5), np.full(2, 0.5, np.float32))


def test_a_garment_faces_away_from_its_body_or_at_it() -> None:
    ball, faces = icosphere(3, 0.9)
    vertices, around = tube(12)
    centred = vertices - vertices.mean(axis=0)
    centred /= np.linalg.norm(centred[:, [0, 2]], axis=1).max()
    outward = facing(ClothMesh.from_surface(centred, around), ball, faces)
    assert facing(ClothMesh.from_surface(centred, around[:, ::-1].copy()), ball, faces) == -outward
    corners = centred[around]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert outward == np.sign((normal * corners.mean(axis=1)).sum())
    assert facing(ClothMesh.from_surface(centred, around), ball[:0], faces[:0]) == 1.0
