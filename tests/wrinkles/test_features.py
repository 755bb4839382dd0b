from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbd import ClothMesh
from pbd.geometry import FAR
from tests.pbd.meshes import turn
from tests.wrinkles.meshes import flat_sheet, tube
from wrinkles.charts import Charts
from wrinkles.features import CENTRE, DYNAMIC_COUNT, OTHERS, Stencil, slow_modes

OFFSETS, DISTANCES = np.arange(72), np.arange(72, 81)


class Cloth:
    """A crumpled tube that touches something."""

    def __init__(self) -> None:
        vertices, faces = tube(14)
        self.mesh = ClothMesh.from_surface(vertices, faces)
        self.stencil = Stencil.of(Charts.of(self.mesh), np.arange(0, len(vertices), 15))
        rng = np.random.default_rng(0)
        self.position = vertices + 0.02 * rng.standard_normal(vertices.shape)
        self.distance = rng.uniform(0.0, FAR, len(vertices))

    def read(self, rotation: np.ndarray | None = None, shift: tuple = (0.0, 0.0, 0.0), **kept) -> tuple:
        """Features and frames after the garment was turned and moved as a whole."""
        rotation = np.eye(3) if rotation is None else rotation
        count = len(self.position)
        position = np.full((count, 4), 7.0, np.float32)  # the last column does not matter
        position[:, :3] = self.position @ rotation.T + shift
        contact = self.distance.astype(np.float32)
        frames = np.zeros((count, 9), np.float32)
        features = np.zeros((count, DYNAMIC_COUNT), np.float32)
        self.stencil.read(position, contact, frames, features, **kept)
        return features, frames


@pytest.fixture(scope="module")
def cloth() -> Cloth:
    return Cloth()


def test_the_blocks_of_features_are_what_they_are_taken_for() -> None:
    blocks = np.concatenate([OFFSETS, DISTANCES])
    assert np.array_equal(np.sort(blocks), np.arange(DYNAMIC_COUNT))


def test_turning_and_moving_change_nothing(cloth: Cloth) -> None:
    before, frames = cloth.read()
    assert before.std(axis=0).min() > 0.01  # nothing is left out
    for axis, degrees, shift in (
        ((0, 1, 0), 0.0, (0.5, -0.25, 1.0)),
        ((0, 1, 0), 73.0, (0.0, 0.0, 0.0)),
        ((1, 0, 0.3), 190.0, (-0.7, 0.3, 0.2)),
    ):
        rotation = turn(axis, degrees)
        after, turned = cloth.read(rotation, shift)
        np.testing.assert_allclose(after, before, atol=2e-5)
        rows = frames.reshape(-1, 3, 3) @ rotation.T
        np.testing.assert_allclose(turned.reshape(-1, 3, 3), rows, atol=2e-5)


def test_frames_are_warp_weft_and_normal(cloth: Cloth) -> None:
    frames = cloth.read()[1].reshape(-1, 3, 3).astype(float)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (len(frames), 1, 1)), atol=1e-5)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-5)
    flat = cloth.mesh.vertices * [1, 0, 1]
    normal = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    height = cloth.mesh.vertices[:, 1]
    inside = (height > 0.3) & (height < height.max() - 0.3)  # clear of the rim
    assert np.einsum("ni,ni->n", frames[:, 2], normal)[inside].min() > 0.5
    assert frames[inside, 0, 1].min() > 0.5  # the warp is upright


def test_features_of_a_flat_sheet_are_its_stencil() -> None:
    vertices, faces = flat_sheet(9, 0.8)
    mesh = ClothMesh.from_surface(vertices, faces, (1.0, 0.0, 0.0))
    stencil = Stencil.of(Charts.of(mesh), np.array([], int))
    assert stencil.spacing == pytest.approx(mesh.edge_lengths()[1].mean())
    position = np.zeros((81, 4), np.float32)
    position[:, :3] = vertices
    contact = np.full(81, FAR, np.float32)
    frames, features = np.zeros((81, 9), np.float32), np.zeros((81, DYNAMIC_COUNT), np.float32)
    stencil.read(position, contact, frames, features)
    middle = features[40]
    steps = np.array([(a, b, 0.0) for a in range(-2, 3) for b in range(-2, 3)])[OTHERS]
    np.testing.assert_allclose(middle[OFFSETS].reshape(24, 3), steps, atol=1e-5)
    np.testing.assert_allclose(middle[DISTANCES], 1.0, atol=1e-6)
    # What does not move: all stencil points exist in the middle, 8 of 24 at a corner.
    exists = stencil.static[:, :24]
    assert exists[40].all() and exists[0].sum() == 8.0
    assert CENTRE == 12 and not stencil.static[:, 24].any()


def test_the_share_that_is_held_is_counted() -> None:
    vertices, faces = flat_sheet(9, 0.8)
    charts = Charts.of(ClothMesh.from_surface(vertices, faces, (1.0, 0.0, 0.0)))
    everything, side = Stencil.of(charts, np.arange(81)), Stencil.of(charts, np.arange(9))
    np.testing.assert_allclose(everything.static[:, 24], 1.0, atol=1e-6)
    share = side.static[:, 24].reshape(9, 9)
    assert (np.diff(share[:5, 4]) < 0).all() and not share[5:].any() and 0.2 < share[0, 4] <= 1.0


def test_features_are_scaled_and_clipped(cloth: Cloth) -> None:
    plain, _ = cloth.read()
    rng = np.random.default_rng(4)
    center = rng.standard_normal(DYNAMIC_COUNT).astype(np.float32)
    scale = rng.uniform(0.5, 3.0, DYNAMIC_COUNT).astype(np.float32)
    scaled, _ = cloth.read(center=center, scale=scale, limit=2.0)
    expected = np.clip((plain - center) * scale, -2.0, 2.0)
    np.testing.assert_allclose(scaled, expected, atol=1e-5)
    assert (np.abs(expected) == 2.0).any() and (np.abs(expected) < 2.0).any()


def test_slow_modes_are_smooth_orthogonal_and_the_same_every_time() -> None:
    vertices, faces = flat_sheet(9, 1.0, jitter=0.3)
    mesh = ClothMesh.from_surface(vertices, faces, (1.0, 0.0, 0.0))
    modes = slow_modes(mesh)
    assert modes.shape == (81, 8) and np.array_equal(modes, slow_modes(mesh))
    np.testing.assert_allclose(modes.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(modes.T @ modes / 81, np.eye(8), atol=1e-9)
    peak = np.take_along_axis(modes, np.abs(modes).argmax(axis=0)[None], axis=0)
    assert (peak > 0).all()
    # The two slowest of a square are its two directions.
    plane, *_ = np.linalg.lstsq(np.c_[np.ones(81), vertices[:, [0, 2]]], modes[:, :2], rcond=None)
    rest = modes[:, :2] - np.c_[np.ones(81), vertices[:, [0, 2]]] @ plane
    assert (rest.var(axis=0) < 0.1).all()


def test_regions_are_parts_that_hang_together(cloth: Cloth) -> None:
    region = cloth.stencil.regions(4)
    assert sorted(set(region)) == [0, 1, 2, 3] and np.bincount(region).min() > len(region) // 12
    edges = cloth.mesh.edge_lengths()[0]
    assert (region[edges[:, 0]] == region[edges[:, 1]]).mean() > 0.75
    assert cloth.stencil.regions(8).max() + 1 == min(8, len(region) // 40)
    nowhere = replace(cloth.stencil, static=np.zeros_like(cloth.stencil.static))
    assert not nowhere.regions(4).any()
