from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from wrinkles.dictionary import CLIP, CoefficientNetwork, fit_atoms, fit_coefficient_network, whitening
from wrinkles.features import DYNAMIC_COUNT
from wrinkles.patches import Grid

GRID = Grid.of(2)
SIZE = 3 * GRID.nodes


def seen(patches: np.ndarray) -> np.ndarray:
    """Patches as the slope metric sees them: what an inner product of them is taken of, shape (s, SIZE)."""
    vectors = patches.reshape(-1, GRID.nodes, 3).astype(float)
    return np.einsum("snc,nm->smc", vectors, GRID.slope_metric()).reshape(len(patches), -1)


@pytest.fixture(scope="module")
def patches() -> np.ndarray:
    """Random mixtures of six waves [m], shape (400, SIZE), about a bump."""
    rng = np.random.default_rng(0)
    a, b = np.meshgrid(np.linspace(-1, 1, GRID.side), np.linspace(-1, 1, GRID.side), indexing="ij")
    waves = np.stack([np.sin(rng.uniform(1, 6) * a + rng.uniform(1, 6) * b + rng.uniform(0, 6)) for _ in range(6)])
    shapes = (waves[:, :, :, None] * rng.standard_normal((6, 1, 1, 3))).reshape(6, -1)
    strength = rng.standard_normal((400, 6)) * [5e-3, 4e-3, 3e-3, 2e-3, 1e-3, 5e-4]
    bump = np.repeat(np.exp(-(a**2) - b**2).ravel()[:, None], 3, axis=1).ravel()
    return (strength @ shapes + 0.004 * bump).astype(np.float32)


def test_atoms_are_orthonormal_in_the_slope_metric(patches: np.ndarray) -> None:
    atoms = fit_atoms(patches, 5, 0)
    assert atoms.shapes.shape == (5, SIZE) and atoms.analysis.shape == (SIZE, 5)
    np.testing.assert_allclose(seen(atoms.shapes) @ seen(atoms.shapes).T, np.eye(5), atol=1e-4)
    np.testing.assert_allclose(atoms.shapes @ atoms.analysis, np.eye(5), atol=1e-4)


def test_patches_in_the_span_of_the_atoms_are_given_back(patches: np.ndarray) -> None:
    atoms = fit_atoms(patches, 6, 0)  # as many as there are waves
    assert atoms.kept == pytest.approx(1.0, abs=1e-5)
    back = (patches - atoms.mean) @ atoms.analysis @ atoms.shapes + atoms.mean
    assert np.abs(back - patches).max() < 1e-4 * np.abs(patches).max()
    np.testing.assert_allclose(atoms.mean, patches.mean(axis=0), atol=1e-7)


def test_kept_is_the_share_of_what_is_seen_that_the_atoms_hold(patches: np.ndarray) -> None:
    shares = []
    for count in (1, 3, 5):
        atoms = fit_atoms(patches, count, 0)
        back = (patches - atoms.mean) @ atoms.analysis @ atoms.shapes
        lost = (seen(patches - atoms.mean - back) ** 2).sum() / (seen(patches - atoms.mean) ** 2).sum()
        assert atoms.kept == pytest.approx(1.0 - lost, abs=1e-4)
        shares.append(atoms.kept)
    assert 0.0 < shares[0] < shares[1] < shares[2] < 1.0


def test_coefficients_are_the_nearest_in_the_slope_metric(patches: np.ndarray) -> None:
    atoms = fit_atoms(patches, 3, 0)
    patch = patches[:20] - atoms.mean
    best, *_ = np.linalg.lstsq(seen(atoms.shapes).T, seen(patch).T, rcond=None)
    np.testing.assert_allclose(patch @ atoms.analysis, best.T, atol=1e-5 * np.abs(best).max())


TRAINED, ALL = 1200, 1500


@pytest.fixture(scope="module")
def examples() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features that tell of three causes, static features, and coefficients that depend on both."""
    rng = np.random.default_rng(1)
    cause = rng.standard_normal((ALL, 12, 3))
    features = cause @ rng.standard_normal((3, DYNAMIC_COUNT)) + 0.1 * rng.standard_normal((ALL, 12, DYNAMIC_COUNT))
    features = features * rng.uniform(0.1, 20.0, DYNAMIC_COUNT) + rng.uniform(-5.0, 5.0, DYNAMIC_COUNT)  # of any unit
    static = rng.standard_normal((12, 4)).astype(np.float32)
    a, b, c = np.moveaxis(cause, 2, 0)
    place = static[:, 0]
    coefficients = 0.01 * np.stack([np.tanh(2 * a) * (1.0 + 0.5 * place), np.abs(b) - 0.5 * c, a - b + place], axis=2)
    return features.astype(np.float32), static, coefficients.astype(np.float32)


@pytest.fixture(scope="module")
def mapping(examples: tuple) -> CoefficientNetwork:
    features, static, coefficients = examples
    return fit_coefficient_network(
        features[:TRAINED], static, coefficients[:TRAINED], hidden=(32, 24), epochs=24, seed=3
    )


def test_the_mapping_learns_a_known_function(examples: tuple, mapping: CoefficientNetwork) -> None:
    features, _, coefficients = (part[TRAINED:] if len(part) == ALL else part for part in examples)
    predicted = mapping.predict(features)
    assert predicted.shape == coefficients.shape
    error = ((predicted - coefficients) ** 2).mean(axis=(0, 1))
    assert (1.0 - error / coefficients.var(axis=(0, 1)) > 0.9).all()
    # What depends on the place is learned at the place: read at another one, it is wrong.
    moved = mapping.predict(np.roll(features, 1, axis=1))
    wrong = ((np.roll(moved, -1, axis=1) - coefficients) ** 2).mean(axis=(0, 1))
    assert wrong[2] > 10.0 * error[2]


def test_regions_go_on_from_what_all_places_have_learned(examples: tuple) -> None:
    features, static, coefficients = examples
    there = np.arange(12) >= 6
    opposed = np.where(there, -1.0, 1.0)[:, None] * coefficients[..., 1:2]  # of two minds, and no place is told
    learned = features[:TRAINED], 0.0 * static, opposed[:TRAINED]
    fit = partial(fit_coefficient_network, *learned, hidden=(32, 24), epochs=12, seed=3)
    one, two = fit(), fit(region=there)
    assert np.array_equal(one.weights_1, two.weights_1) and np.array_equal(one.bias_1, two.bias_1)
    assert one.weights_2.shape == (1, 32, 24) and two.weights_2.shape == (2, 32, 24)
    error = [((m.predict(features[TRAINED:]) - opposed[TRAINED:]) ** 2).mean() for m in (one, two)]
    assert error[1] < 0.4 * error[0]
    told: list[str] = []
    fit(region=there, report=told.append)
    assert [line.split(",")[0] for line in told[-2:]] == ["fitting: region 1 of 2", "fitting: region 2 of 2"]
    assert all(" of at most 12 passes, loss " in line for line in told[:-2])


def test_the_same_seed_gives_the_same_bits(examples: tuple) -> None:
    features, static, coefficients = (part[:100] if len(part) == ALL else part for part in examples)

    def fit(seed: int) -> dict[str, np.ndarray]:
        return fit_coefficient_network(features, static, coefficients, hidden=(8, 6), epochs=3, seed=seed).arrays()

    first, again, other = fit(5), fit(5), fit(6)
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert all(array.dtype == np.float32 for name, array in first.items() if name != "region")
    assert not np.array_equal(first["weights_2"], other["weights_2"])


def test_features_far_out_count_as_if_they_stood_at_the_limit(examples: tuple, mapping: CoefficientNetwork) -> None:
    features = examples[0][:2].copy()
    features[..., 0] = mapping.center[0] + CLIP / mapping.scale[0]
    at_limit = mapping.predict(features)
    features[..., 0] = 1e6
    np.testing.assert_allclose(mapping.predict(features), at_limit, atol=1e-6)


def test_a_target_that_cannot_be_told_is_its_median_and_not_its_mean() -> None:
    rng = np.random.default_rng(2)
    features = rng.standard_normal((400, 5, DYNAMIC_COUNT)).astype(np.float32)
    # Once in four times a fold of height four: the mean is one, the point of least distance zero.
    coefficients = np.where(rng.random((400, 5, 1)) < 0.25, 4.0, 0.0) * np.ones(2)
    fitted = fit_coefficient_network(
        features, np.zeros((5, 1)), coefficients.astype(np.float32), hidden=(4, 4), epochs=20
    )
    fresh = rng.standard_normal((100, 5, DYNAMIC_COUNT)).astype(np.float32)
    assert np.abs(np.median(fitted.predict(fresh))) < 0.3


def test_faint_directions_weigh_as_much_as_strong_ones() -> None:
    rng = np.random.default_rng(3)
    samples = (rng.standard_normal((4000, 5)) * [1.0, 0.3, 0.1, 0.05, 0.02]) @ rng.standard_normal((5, 5)) + 2.0
    mean, axes = whitening(samples.astype(np.float32))
    np.testing.assert_allclose(np.cov(((samples - mean) @ axes).T), np.eye(5), atol=5e-3)
    np.testing.assert_allclose(mean, samples.mean(axis=0), atol=1e-4)
