from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pbd import ClothMesh, Fabric, State, build_model
from tests.wrinkles.databases import placed, small_correction, small_database
from tests.wrinkles.meshes import tube
from wrinkles.charts import Charts
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.database import as_stored, read_database, write_database
from wrinkles.decoder import StateReader
from wrinkles.dictionary import CLIP
from wrinkles.features import AROUND, Stencil
from wrinkles.levels import levels_of
from wrinkles.motion_correction import STILL, MotionCorrection, MotionCorrector, VelocityReader

HELD = np.arange(12, dtype=np.int32)


class Garment:
    """A crumpled tube that moves, held at one end."""

    def __init__(self) -> None:
        vertices, faces = tube(12)
        rng = np.random.default_rng(3)
        levels = levels_of(vertices, faces, HELD, np.zeros((0, 3)), np.zeros((0, 3), int), 1, (0.0, 1.0, 0.0))
        self.filter = CoarseFilter(levels)
        self.stencil = Stencil.of(Charts.of(ClothMesh.from_surface(vertices, faces)), HELD)
        place = rng.standard_normal((len(vertices), 4))
        self.mapping = placed(small_database().mapping, np.concatenate([place, place], axis=1))
        self.correction = small_correction(8, size=0.3)
        self.state = State.at_rest(build_model(levels.coarse, Fabric(), held=HELD))
        self.state.position[:, :3] += 0.01 * rng.standard_normal(vertices.shape)
        self.state.velocity[:] = rng.standard_normal(vertices.shape) * np.linspace(0.01, 1.0, len(vertices))[:, None]
        self.state.velocity[-1] -= self.state.velocity.sum(axis=0)  # a mean of zero
        self.state.contact[:] = 0.01
        self.reader = StateReader(self.stencil, self.mapping)
        self.reader.read(self.filter(self.state.position), self.state.contact)

    def corrector(self, correction: MotionCorrection) -> MotionCorrector:
        return MotionCorrector(correction, self.mapping.place, self.stencil, self.filter)


@pytest.fixture(scope="module")
def garment() -> Garment:
    return Garment()


def velocity_differences(garment: Garment) -> np.ndarray:
    """Velocities of the eight points around each vertex less its own, in its frame [m/s], shape (n, 24)."""
    count = len(garment.state.velocity)
    smooth = garment.filter.matrix @ garment.state.velocity
    corners, weights = (
        array.reshape(count, -1, 3)[:, AROUND] for array in (garment.stencil.corners, garment.stencil.weights)
    )
    off = np.einsum("npc,npci->npi", weights, smooth[corners]) - smooth[:, None]
    return np.einsum("nai,npi->npa", garment.reader.frames.reshape(count, 3, 3), off).reshape(count, -1)


def test_velocities_are_read_in_the_frame_of_the_vertex(garment: Garment) -> None:
    read, expected = VelocityReader(garment.stencil, garment.filter), velocity_differences(garment)
    scale = np.linspace(0.5, 2.0, expected.shape[1], dtype=np.float32)
    for limit in (np.inf, 0.2):
        found = read(garment.state.velocity, garment.reader.frames, scale, limit)
        np.testing.assert_allclose(found, np.clip(expected * scale, -limit, limit), atol=2e-5)
    assert (np.abs(expected * scale) > 0.2).mean() > 0.1


def test_the_correction_is_the_network_filtered_and_bounded(garment: Garment) -> None:
    c, dt, count = garment.correction, 1.0 / 50.0, len(garment.state.velocity)
    seen = np.clip(velocity_differences(garment) * c.velocity_scale, -CLIP, CLIP)
    hidden = garment.reader.features @ c.weights_1 + seen @ c.velocity_weights
    hidden = np.maximum(hidden + garment.mapping.place @ c.place_weights + c.bias_1, 0.0)
    acceleration = np.maximum(hidden @ c.weights_2 + c.bias_2, 0.0) @ c.weights_3 + c.bias_3
    sizes = np.linalg.norm(acceleration, axis=1)
    moving = np.linalg.norm(garment.state.velocity - garment.state.velocity.mean(axis=0), axis=1) / STILL
    assert moving.min() < 1.0 < moving.max()
    for most in (float(np.median(sizes)), 1e6):
        bounded = acceleration * (np.minimum(1.0, most / sizes) * np.minimum(1.0, moving**2))[:, None]
        world = np.einsum("na,nai->ni", bounded, garment.reader.frames.reshape(count, 3, 3))
        corrector = garment.corrector(replace(c, most=most))
        change = corrector.change(garment.state, garment.reader.frames, garment.reader.features, dt)
        np.testing.assert_allclose(change[:, :3], dt * (garment.filter.matrix @ world), atol=1e-5 * dt * sizes.max())


def test_free_vertices_get_it_and_held_ones_do_not(garment: Garment) -> None:
    state, corrector = garment.state.copy(), garment.corrector(garment.correction)
    before = state.velocity.copy()
    corrector(state, garment.reader.frames, garment.reader.features, 0.0)
    assert np.array_equal(state.velocity, before)
    corrector(state, garment.reader.frames, garment.reader.features, 0.02)
    changed = (state.velocity != before).any(axis=1)
    assert not changed[HELD].any() and changed[len(HELD) :].all()
    assert np.array_equal(state.position, garment.state.position)


@pytest.mark.parametrize("correction", [None, small_correction(5)])
def test_a_database_keeps_the_correction_or_that_there_is_none(
    correction: MotionCorrection | None, tmp_path: Path
) -> None:
    database = small_database(correction=correction)
    write_database(tmp_path / "skirt.h5", database)
    found, stored = read_database(tmp_path / "skirt.h5").correction, as_stored(database).correction
    if correction is None:
        assert found is None and stored is None
        return
    assert found is not None and stored is not None
    for name, value in vars(correction).items():
        assert np.array_equal(getattr(found, name), value) and np.array_equal(getattr(stored, name), value)
