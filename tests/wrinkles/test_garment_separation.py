"""An outer garment that lies under an inner one is brought over it, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from pbd import Fabric
from tests.wrinkles.meshes import flat_sheet
from wrinkles.charts import leading_vertices
from wrinkles.garment_separation import GarmentSeparation
from wrinkles.levels import Layers, Levels, build_levels

SIDE, KEPT, EDGE = 9, 0.002, 0.05


@pytest.fixture(scope="module")
def levels() -> Levels:
    """Two level sheets of 40 cm; the outer one is moved by 10 cm, so that a quarter of it is over nothing."""
    vertices, faces = flat_sheet(SIDE, 0.4)
    flat = vertices - vertices.mean(axis=0)
    flat = flat[:, np.argsort(-np.ptp(flat, axis=0), kind="stable")][:, [0, 2, 1]]  # the sheet lies in x and z
    layers = Layers(
        ("inner", "outer"), (Fabric(),), np.repeat(np.array([0, 1], np.int32), len(flat)), np.zeros(0, np.int32)
    )
    both = np.concatenate([flat, flat + [0.1, 0.004, 0.0]])
    nothing = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    joined = np.concatenate([faces, faces + len(flat)])
    return build_levels(both, joined, np.zeros(0, int), *nothing, 2, warp=(1.0, 0.0, 0.2), layers=layers)


def separation(levels: Levels, held: np.ndarray) -> tuple[GarmentSeparation, np.ndarray, float]:
    corners = levels.fine.vertices[levels.fine.faces[0]]
    up = float(np.sign(np.cross(corners[1] - corners[0], corners[2] - corners[0])[1]))
    layers, leading = levels.layers, leading_vertices(levels.subdivision)
    layer = layers.subdivided(levels.subdivision).layer
    return GarmentSeparation(layers, levels.subdivision, leading, 1, held, up, KEPT, EDGE), layer, up


def test_what_is_under_the_inner_garment_comes_over_it(levels: Levels) -> None:
    held = np.array([SIDE * SIDE + 3])
    separate, layer, _ = separation(levels, held)
    fine = levels.fine.vertices.astype(np.float32)
    inner, outer = layer == 0, layer == 1
    rng = np.random.default_rng(1)
    fine[inner, 1] = 0.0
    fine[outer, 1] = rng.uniform(-0.006, 0.006, outer.sum())
    before = fine.copy()
    separate(fine)
    np.testing.assert_array_equal(fine[inner], before[inner])
    np.testing.assert_array_equal(fine[held], before[held])
    over = outer & (before[:, 0] < before[inner, 0].max() - 0.01) & (np.abs(before[:, 2]) < 0.15)
    over[held] = False
    low = before[:, 1] < KEPT
    assert (over & low).sum() > 200
    np.testing.assert_allclose(fine[over & low, 1], KEPT, atol=1e-6)
    np.testing.assert_allclose(fine[over & low][:, [0, 2]], before[over & low][:, [0, 2]], atol=1e-6)
    # What is high enough stays, and so does what is beyond the rim of the inner garment.
    beyond = outer & (before[:, 0] > before[inner, 0].max() + 0.01)
    assert beyond.sum() > 100
    for still in (over & ~low, beyond):
        np.testing.assert_array_equal(fine[still], before[still])
    again = before.copy()
    separate(again)
    np.testing.assert_array_equal(again, fine)


def test_cloth_that_is_far_under_is_another_place(levels: Levels) -> None:
    separate, layer, _ = separation(levels, np.zeros(0, int))
    fine = levels.fine.vertices.astype(np.float32)
    fine[layer == 0, 1], fine[layer == 1, 1] = 0.0, -0.015
    before = fine.copy()
    separate(fine)
    np.testing.assert_array_equal(fine, before)


def test_the_outside_is_where_the_faces_look(levels: Levels) -> None:
    """Garments whose faces look at the body are kept over the inner one all the same."""
    separate, layer, up = separation(levels, np.zeros(0, int))
    layers = levels.layers
    assert layers is not None
    leading = leading_vertices(levels.subdivision)
    turned = GarmentSeparation(layers, levels.subdivision, leading, 1, np.zeros(0, int), -up, KEPT, EDGE)
    fine = levels.fine.vertices.astype(np.float32)
    fine[layer == 0, 1], fine[layer == 1, 1] = 0.0, 0.001
    other = fine.copy()
    separate(fine)
    turned(other)
    middle = (layer == 1) & (np.abs(fine[:, 0]) < 0.1) & (np.abs(fine[:, 2]) < 0.1)
    np.testing.assert_allclose(fine[middle, 1], KEPT, atol=1e-6)
    np.testing.assert_allclose(other[middle, 1], -KEPT, atol=1e-6)
