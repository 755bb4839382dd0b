"""Cloth that starts through itself."""

import numpy as np

from pbd.crossings import SelfCrossings
from pbd.opening import CLEARANCE, smoothed_apart
from tests.pbd.meshes import cloth, grid
from tests.wrinkles.meshes import icosphere

NOTHING = np.zeros((0, 3)), np.zeros((0, 3), np.int32)


def creased(depth: float) -> tuple[np.ndarray, np.ndarray]:
    """A sheet with a crease that is folded into itself: its flanks go through one another."""
    vertices, faces = grid(24, 12, 0.01)
    across = vertices[:, 0] - vertices[:, 0].mean()
    folded = vertices.copy()
    folded[:, 0] = across - depth * np.sin(across / 0.012) * np.exp(-((across / 0.03) ** 2))
    folded[:, 1] -= vertices[:, 1].mean()
    folded[:, 2] = 0.02 * np.exp(-((across / 0.02) ** 2)) + 0.004 * np.sin(vertices[:, 1] / 0.01)
    return folded, faces


def test_a_crease_that_is_folded_into_itself_is_opened() -> None:
    vertices, faces = creased(0.035)
    mesh = cloth(vertices, faces)
    crossings = SelfCrossings(mesh)
    assert len(crossings.find(vertices)) > 10
    held = np.array([0, 5])
    free = smoothed_apart(mesh, held, None, *NOTHING)
    assert not len(crossings.find(free))
    assert np.array_equal(free[held], vertices[held])
    far = np.abs(vertices[:, 0]) > 0.1  # from the crease
    assert np.array_equal(free[far], vertices[far])


def test_crossings_of_two_garments_are_left_to_the_solver() -> None:
    vertices, faces = creased(0.035)
    mesh = cloth(vertices, faces)
    layer = (vertices[:, 0] > 0.0).astype(int)
    rows = SelfCrossings(mesh).find(smoothed_apart(mesh, np.zeros(0, int), layer, *NOTHING))
    assert (layer[rows[:, 0]] != layer[faces[rows[:, 2], 0]]).all()


def test_what_is_smoothed_stays_outside_the_body() -> None:
    vertices, faces = creased(0.035)
    body, body_faces = icosphere(3)
    body = 0.05 * body - [0.0, 0.0, 0.052]
    free = smoothed_apart(cloth(vertices, faces), np.zeros(0, int), None, body, body_faces)
    moved = np.abs(free - vertices).max(axis=1) > 0.0
    assert moved.any()
    assert np.linalg.norm(free[moved] - [0.0, 0.0, -0.052], axis=1).min() > 0.05 + 0.8 * CLEARANCE


def test_a_mesh_that_cannot_be_opened_comes_back_with_the_fewest_crossings() -> None:
    random = np.random.default_rng(3)
    vertices, faces = grid(8, 8, 0.01)
    crumpled = random.normal(0.0, 0.02, vertices.shape)
    mesh = cloth(vertices, faces)
    mesh.vertices[:] = crumpled
    crossings = SelfCrossings(mesh)
    before, after = (len(crossings.find(x)) for x in (crumpled, smoothed_apart(mesh, np.zeros(0, int), None, *NOTHING)))
    assert before > 100 and after < before
