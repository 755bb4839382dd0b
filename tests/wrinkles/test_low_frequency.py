"""Bias and spread of free runs against true runs, on runs of which both are known."""

from __future__ import annotations

import numpy as np
import pytest

from wrinkles.low_frequency import LowFrequency

SHAPE = (40, 300, 3)


def runs(seed: int, count: int, spread: float = 0.01, mean: float = 0.0) -> list[np.ndarray]:
    """Runs about a mean, each off by noise of a size in each coordinate [m]."""
    rng = np.random.default_rng(seed)
    return [mean + spread * rng.standard_normal(SHAPE) for _ in range(count)]


def judge(seed: int = 0, finer: float = 0.0, count: int = 4) -> LowFrequency:
    return LowFrequency(lambda run: run, runs(seed, count), runs(seed + 1, 1, mean=finer)[0])


def test_runs_of_the_same_process_are_right() -> None:
    found = judge()(runs(7, 4))
    assert found.bias < 0.05 and found.spread == pytest.approx(1.0, abs=0.02)
    assert judge().floor < 0.2  # the root of what chance leaves of a difference of squares


@pytest.mark.parametrize("count", [1, 2, 4])
def test_bias_is_the_distance_of_the_means_whatever_the_number_of_runs(count: int) -> None:
    found = judge()(runs(7, count, mean=0.02))
    assert found.bias == pytest.approx(2.0, rel=0.02)  # over the truth's standard deviation
    assert np.isnan(found.spread) == (count == 1)


def test_cloth_that_follows_the_mean_has_no_bias_but_too_little_spread() -> None:
    found = judge()(runs(7, 4, spread=0.002))
    assert found.bias < 0.1 and found.spread == pytest.approx(0.2, rel=0.02)
    assert judge()(runs(7, 4, spread=0.03)).spread == pytest.approx(3.0, rel=0.02)


def test_a_finer_truth_that_lies_elsewhere_is_the_scale_and_the_floor() -> None:
    found = judge(finer=0.04)(runs(7, 4, mean=0.02))
    assert found.bias == pytest.approx(0.5, rel=0.02)
    assert judge(finer=0.04).floor == pytest.approx(1.0, rel=0.02)


def test_the_finer_run_stands_for_another_true_run_where_there_is_one_only() -> None:
    few = judge(count=1)
    assert few(runs(7, 2, mean=0.02)).bias == pytest.approx(2.0, rel=0.05)
    assert few(runs(7, 2)).spread == pytest.approx(1.0, abs=0.05) and few.floor == 0.0


def test_standard_errors_are_those_of_chance() -> None:
    rng = np.random.default_rng(3)

    def common(mean: float) -> list[np.ndarray]:
        """Runs whose noise is the same everywhere in each: few numbers, and so much chance."""
        return [mean + 0.01 * rng.standard_normal((1, 1, 3)) + np.zeros(SHAPE) for _ in range(4)]

    found = [LowFrequency(lambda run: run, common(0.0), common(0.0)[0])(common(0.05)) for _ in range(200)]
    spread = np.std([one.spread for one in found])
    assert np.median([one.spread_error for one in found]) == pytest.approx(spread, rel=0.5)
    assert judge()(runs(7, 2)).spread_error < 0.02
