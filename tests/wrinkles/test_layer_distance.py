"""Distance of garments from the garments below them."""

from __future__ import annotations

import numpy as np

from pbd import ClothMesh
from pbd.geometry import FAR
from tests.pbd.meshes import grid
from wrinkles.layer_distance import LayerDistance


def three_sheets() -> tuple[ClothMesh, np.ndarray]:
    """Three level sheets, 1 cm over one another."""
    flat, faces = grid(8, 8, 0.02)
    vertices = np.concatenate([flat + [0.0, 0.0, 0.01 * number] for number in range(3)])
    mesh = ClothMesh.from_surface(vertices, np.concatenate([faces + number * len(flat) for number in range(3)]))
    return mesh, np.repeat(np.arange(3), len(flat))


def moved(mesh: ClothMesh, layer: np.ndarray, offsets: dict[int, tuple[float, float, float]]) -> np.ndarray:
    position = np.zeros((len(mesh.vertices), 4), np.float32)
    position[:, :3] = mesh.vertices
    for number, offset in offsets.items():
        position[layer == number, :3] += np.array(offset, np.float32)
    return position


def test_each_garment_sees_those_below_it_and_the_body() -> None:
    mesh, layer = three_sheets()
    below, contact = LayerDistance(mesh, layer), np.full(len(layer), FAR, np.float32)
    contact[layer == 0] = 0.002
    contact[np.flatnonzero(layer == 2)[:5]] = 0.001  # the body reaches past the others there
    found = below(moved(mesh, layer, {}), contact).copy()
    assert np.allclose(found[layer == 0], 0.002)
    assert np.allclose(found[layer == 1], 0.01, atol=1e-6)
    assert np.allclose(found[layer == 2][5:], 0.01, atol=1e-6) and np.allclose(found[layer == 2][:5], 0.001)


def test_it_is_the_distance_of_faces_and_not_of_vertices() -> None:
    mesh, layer = three_sheets()
    contact = np.full(len(layer), FAR, np.float32)
    found = LayerDistance(mesh, layer)(moved(mesh, layer, {1: (0.004, 0.007, 0.0), 2: (0.0, 0.0, 1.0)}), contact)
    inside = np.flatnonzero(layer == 1).reshape(9, 9)[:-1, :-1].ravel()
    assert np.allclose(found[inside], 0.01, atol=1e-6)
    assert np.allclose(found[layer == 2], FAR)


def test_it_does_not_hang_on_what_came_before() -> None:
    mesh, layer = three_sheets()
    below, contact = LayerDistance(mesh, layer), np.full(len(layer), FAR, np.float32)
    here, away = moved(mesh, layer, {}), moved(mesh, layer, {1: (0.1, 0.05, 0.01)})
    first = below(here, contact).copy()
    below(away, contact)
    assert np.array_equal(below(here, contact), first)
