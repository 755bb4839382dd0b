from __future__ import annotations

import numpy as np
import pytest

from precompute.learning.training import TrainingSet, build_layer
from precompute.wrinkle_comparison.wrinkle_baselines import SOFTNESS, fit_baselines
from tests.runtime.players import skirt_stage
from wrinkles.dictionary import fit_atoms
from wrinkles.features import DYNAMIC_COUNT
from wrinkles.patches import Grid

FRAMES, ATOMS = 24, 5


@pytest.fixture(scope="module")
def baselines() -> tuple[list, TrainingSet]:
    """Baselines fitted to wrinkles that are a linear function of the features."""
    layer, rng = build_layer(skirt_stage().levels), np.random.default_rng(0)
    count = len(layer.levels.coarse.vertices)
    sway = rng.standard_normal((FRAMES, 3))
    features = (sway @ rng.standard_normal((3, count * DYNAMIC_COUNT))).reshape(FRAMES, count, DYNAMIC_COUNT)
    coefficients = 0.01 * np.einsum("fnd,dk->fnk", features, rng.standard_normal((DYNAMIC_COUNT, ATOMS)))
    atoms = fit_atoms(rng.standard_normal((500, 3 * Grid.of(2).nodes)), ATOMS, 0)
    data = TrainingSet(features.astype(np.float32), coefficients.astype(np.float32), atoms)
    return fit_baselines(data, seed=0), data


def test_every_rival_learns_what_it_can(baselines: tuple) -> None:
    fitted, data = baselines
    spread = np.sqrt((data.coefficients**2).mean())
    off = {}
    for baseline in fitted:
        guesses = np.stack([baseline.predict(data.features[f]) for f in range(0, FRAMES, 7)])
        assert guesses.shape[1:] == data.coefficients.shape[1:] and baseline.megabytes > 0.0
        off[baseline.name] = np.sqrt(((guesses - data.coefficients[::7]) ** 2).mean()) / spread
    assert list(off) == ["linear operator", "nearest neighbour with delta"]
    assert off["nearest neighbour with delta"] < 1e-5  # a frame that it has seen
    assert off["linear operator"] < 0.01


def test_softness_is_chosen_by_motion_that_was_left_out() -> None:
    layer, rng = build_layer(skirt_stage().levels), np.random.default_rng(1)
    count = len(layer.levels.coarse.vertices)
    features = rng.standard_normal((180, count, DYNAMIC_COUNT)).astype(np.float32)
    atoms = fit_atoms(rng.standard_normal((500, 3 * Grid.of(2).nodes)), ATOMS, 0)
    noise = rng.standard_normal((180, count, ATOMS)).astype(np.float32)  # nothing to be learned: the softest is best
    fitted = fit_baselines(TrainingSet(features, noise, atoms), seed=0)
    assert fitted[0].settings == f"softness {SOFTNESS[-1]:g}"
