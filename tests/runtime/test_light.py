"""How much light reaches points: known shares of simple scenes."""

from __future__ import annotations

import numpy as np
import pytest

from pbd.mesh import edges_of, lattice_faces
from runtime.draw.light import LitSurface, Rings, directions_about, directions_everywhere, exposure


def plate(width: float, height: float, cells: int = 40) -> LitSurface:
    """A level square at a height [m], its normals up."""
    line = np.linspace(-0.5 * width, 0.5 * width, cells + 1)
    x, z = np.meshgrid(line, -line, indexing="ij")
    vertices = np.stack([x, np.full_like(x, height), z], axis=-1).reshape(-1, 3).astype(np.float32)
    up = np.broadcast_to(np.array([0.0, 1.0, 0.0], np.float32), vertices.shape).copy()
    return LitSurface(vertices, lattice_faces(np.arange(x.size).reshape(x.shape)), up)


def share(surfaces: list[LitSurface], point: tuple[float, float, float], directions: np.ndarray) -> np.ndarray:
    points = np.array([point], np.float32)
    up = np.array([[0.0, 1.0, 0.0]], np.float32)
    return exposure(surfaces, points, up, directions, np.ones(len(directions)))[0]


def test_directions_are_unit_and_even() -> None:
    sky = directions_everywhere(400)
    np.testing.assert_allclose(np.linalg.norm(sky, axis=1), 1.0)
    np.testing.assert_allclose(sky.mean(axis=0), 0.0, atol=1e-2)
    np.testing.assert_allclose(sky.T @ sky / 400, np.eye(3) / 3.0, atol=1e-2)
    axis = np.array([0.6, 0.0, 0.8])
    box = directions_about(axis, 6.0, 200)
    angles = np.degrees(np.arccos(np.clip(box @ axis, -1.0, 1.0)))
    assert 5.8 < angles.max() <= 6.0
    # On a disc half of the directions are further out than its radius over the root of 2.
    assert np.median(angles) == pytest.approx(6.0 / np.sqrt(2.0), rel=0.03)


def test_a_square_over_a_point_takes_the_share_of_the_sky_that_it_fills() -> None:
    """A square of side 2 a at height a fills 4 atan(1 / sqrt 2) / (pi sqrt 2) of the sky, by its cosine."""
    above = plate(0.4, 0.2)
    open_to = share([above], (0.0, 0.0, 0.0), directions_everywhere(4000))
    form_factor = 4.0 / np.pi / np.sqrt(2.0) * np.arctan(1.0 / np.sqrt(2.0))
    assert open_to[0] == pytest.approx(1.0 - form_factor, abs=0.02)
    assert open_to[1] == 1.0  # nothing is below


@pytest.mark.parametrize("slant", [0.0, 40.0, 75.0])
def test_a_plane_does_not_shade_itself(slant: float) -> None:
    own = plate(0.6, 0.0)
    light = np.array([np.sin(np.radians(slant)), np.cos(np.radians(slant)), 0.0])
    found = exposure([own], own.vertices, own.normals, light[None], np.ones(1))
    assert found[:, 0].min() > 0.99


def test_a_layer_near_by_shades() -> None:
    """Also one centimetre away, as the next layer of a pleat, and from both sides."""
    lower, upper = plate(0.4, 0.0), plate(0.4, 0.01)
    sky = directions_everywhere(64)
    inner = np.abs(lower.vertices[:, [0, 2]]).max(axis=1) < 0.1
    below = exposure([lower, upper], lower.vertices, lower.normals, sky, np.ones(64))[inner]
    above = exposure([lower, upper], upper.vertices, upper.normals, sky, np.ones(64))[inner]
    assert below[:, 0].max() < 0.25 and below[:, 1].min() > 0.95
    assert above[:, 1].max() < 0.25 and above[:, 0].min() > 0.95


def test_the_curvature_of_a_cylinder_is_half_its_inverse_radius() -> None:
    radius, rows = 0.1, 60
    turn, along = np.meshgrid(np.linspace(-1.0, 1.0, rows + 1), np.linspace(0.0, 0.2, rows + 1), indexing="ij")
    normals = np.stack([np.sin(turn), 0.0 * turn, np.cos(turn)], axis=-1).reshape(-1, 3)
    vertices = radius * normals + np.stack([0.0 * along, along, 0.0 * along], axis=-1).reshape(-1, 3)
    faces = lattice_faces(np.arange(turn.size).reshape(turn.shape))
    found = Rings(edges_of(faces)[0], len(vertices)).curvature(vertices, normals).reshape(turn.shape)[2:-2, 2:-2]
    np.testing.assert_allclose(found.mean(), 0.5 / radius, rtol=0.15)
    assert found.min() > 0.0


def test_a_scene_of_any_size_is_lit_alike() -> None:
    """The grids grow with it: sixty metres in cells of half a centimetre would be gigabytes."""
    sky = directions_everywhere(200)
    small, large = (
        share([plate(2.0 * size, size), plate(40.0 * size, 0.0)], (0.0, 0.0, 0.0), sky) for size in (0.25, 2.5)
    )
    np.testing.assert_allclose(small, large, atol=0.03)
