from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbd.geometry import surface_normals
from precompute.learning.run_recording import Recording
from precompute.learning.training import (
    Layer,
    build_layer,
    coefficients_of,
    features_of,
    fit_layer,
    residual_of,
    spread_frames,
    training_set,
)
from tests.runtime.players import skirt_stage
from wrinkles.dictionary import fit_coefficient_network
from wrinkles.features import DYNAMIC_COUNT
from wrinkles.fine_surface import FineSurface

FRAMES = 12


@pytest.fixture(scope="module")
def layer() -> Layer:
    return build_layer(skirt_stage().levels)


@pytest.fixture(scope="module")
def recording(layer: Layer) -> Recording:
    """A skirt that sways, with folds that run down it and grow with the sway."""
    levels, rng = layer.levels, np.random.default_rng(0)
    time = np.arange(FRAMES) / FRAMES
    coarse = levels.coarse.vertices + 0.02 * np.sin(2 * np.pi * time)[:, None, None] * [1.0, 0.0, 0.5]
    coarse = coarse + 0.002 * rng.standard_normal(coarse.shape)
    fine = levels.subdivision.upsample(coarse)
    for frame, t in zip(fine, time, strict=True):
        normals = np.zeros(frame.shape, np.float32)
        surface_normals(frame.astype(np.float32), levels.subdivision.faces, normals)
        angle = np.arctan2(frame[:, 2], frame[:, 0])
        frame += (0.004 * (1.0 + t) * np.sin(12 * angle + 2 * np.pi * t))[:, None] * normals
    count = len(levels.coarse.vertices)
    return Recording(
        "sway",
        2 * np.arange(1, FRAMES + 1),
        fine.astype(np.float32),
        coarse.astype(np.float32),
        np.full((FRAMES, count), 0.02, np.float32),
        np.zeros((FRAMES, count), np.int32),
        1.0,
    )


def test_the_residual_is_what_the_smooth_surface_lacks(layer: Layer, recording: Recording) -> None:
    residual = residual_of(layer, recording)
    assert residual.shape == recording.positions.shape and residual.dtype == np.float32
    size = np.linalg.norm(residual, axis=2)
    assert 0.0039 < size[0].max() < 0.0041 and 0.0068 < size[-1].max() < 0.0081
    smooth = replace(recording, positions=layer.levels.subdivision.upsample(recording.coarse).astype(np.float32))
    assert np.abs(residual_of(layer, smooth)).max() < 1e-6


def test_coefficients_say_what_the_residual_is(layer: Layer, recording: Recording) -> None:
    data = training_set(layer, [recording], atom_count=64, seed=0)
    assert data.features.shape == (FRAMES, len(layer.levels.coarse.vertices), DYNAMIC_COUNT)
    assert data.coefficients.shape == (*data.features.shape[:2], 64) and data.atoms.kept > 0.98
    assert np.array_equal(coefficients_of(layer, [recording], data.atoms), data.coefficients)
    frames, residual, patches = features_of(layer, recording)[1], residual_of(layer, recording), layer.patches
    for f in (0, FRAMES // 2, FRAMES - 1):
        grids = (data.coefficients[f] @ data.atoms.shapes + data.atoms.mean).astype(np.float32)
        decoded = np.zeros(residual[f].shape, np.float32)
        surface = FineSurface(layer.levels.subdivision, patches, np.zeros_like(decoded))
        surface(np.zeros((layer.levels.subdivision.middle.fine_count, 4), np.float32), grids, frames[f], decoded)
        rest = np.sqrt(((decoded - residual[f]) ** 2).sum(axis=1).mean())
        assert rest < 0.1 * np.sqrt((residual[f] ** 2).sum(axis=1).mean())


def test_frames_are_spread_over_all_recordings(layer: Layer, recording: Recording) -> None:
    some = spread_frames([recording, recording.where(slice(0, 6))], 6)
    assert [r.frames.tolist() for r in some] == [[4, 10, 16, 22], [4, 10]]
    assert len(spread_frames([recording], 1000)[0].frames) == FRAMES


def test_the_same_seed_gives_the_same_training_set(layer: Layer, recording: Recording) -> None:
    first, again = (training_set(layer, [recording], 8, seed=3) for _ in range(2))
    assert np.array_equal(first.coefficients, again.coefficients) and np.array_equal(first.features, again.features)
    assert np.array_equal(first.atoms.shapes, again.atoms.shapes)


def test_the_mapping_is_fitted_to_features_and_places(layer: Layer, recording: Recording) -> None:
    data, told = training_set(layer, spread_frames([recording], 3), 4, seed=0), []
    mapping = fit_layer(layer, data, hidden=(6, 5), epochs=3, seed=2, report=told.append)
    static = layer.stencil.static
    region = layer.stencil.regions()
    expected = fit_coefficient_network(
        data.features, static, data.coefficients, hidden=(6, 5), epochs=3, seed=2, region=region
    )
    assert all(np.array_equal(mapping.arrays()[name], array) for name, array in expected.arrays().items())
    assert mapping.place_bias.std(axis=0).min() > 0.0 and "fitting: 3.0 of at most 3 passes, loss " in " ".join(told)
