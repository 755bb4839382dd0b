from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from wrinkles import network
from wrinkles.network import Network, Samples, in_threads


def samples(count: int, noise: float, validated: int = 0, seed: int = 0) -> Samples:
    """Two smooth functions of four inputs and of the place, with noise."""
    rng = np.random.default_rng(seed)
    x, place = rng.standard_normal((count, 4)), rng.standard_normal((10, 1))
    there = np.tile(place[:, 0], count // 10)
    y = np.stack([np.tanh(x[:, 0]) + there, x[:, 1] * x[:, 2]], axis=1) + noise * rng.standard_normal((count, 2))
    x, place, y = (a.astype(np.float32) for a in (x, place, y))
    return Samples(x, place, y, np.arange(validated))


def test_the_fit_stops_when_the_kept_out_samples_say_so() -> None:
    def passes(validated: int) -> list[float]:
        told: list[float] = []
        Network((5, 16, 2), 1).fit(
            samples(20_000, 3.0, validated), epochs=40, on_check=lambda done, _: told.append(done)
        )
        return told

    stopped, whole = passes(2_000), passes(0)  # noise that nothing can be learned from, and nobody who says so
    assert whole[-1] == pytest.approx(40.0, abs=0.5)
    assert stopped[-1] < 0.5 * whole[-1]


def test_a_fit_that_was_stopped_is_as_good() -> None:
    unseen = samples(20_000, 0.3, seed=5)
    with ThreadPoolExecutor(1) as pool:
        losses = []
        for validated in (2_000, 0):
            fitted = Network((5, 16, 2), 1)
            fitted.fit(samples(20_000, 0.3, validated), epochs=40)
            losses.append(fitted.loss(unseen, np.arange(20_000), pool))
    assert losses[0] < 1.1 * losses[1]


def test_the_number_of_threads_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    def fitted() -> list[np.ndarray]:
        one = Network((5, 16, 2), 1)
        one.fit(samples(200_000, 0.3, 5_000), epochs=1)  # batches of several parts
        return one.weights + one.biases

    two = fitted()
    monkeypatch.setattr(network, "THREADS", 1)
    assert all(np.array_equal(a, b) for a, b in zip(two, fitted(), strict=True))


def test_gradients_are_those_of_the_loss() -> None:
    data, one, rows = samples(100, 0.3), Network((5, 6, 2), 2), np.arange(50)
    with ThreadPoolExecutor(1) as pool:
        _, gradients = one._gradients(data, rows, pool)
        for array, gradient in zip([*one.weights, *one.biases], gradients, strict=True):
            step, before = 1e-2 * np.sign(gradient) / np.sqrt(gradient.size), array.copy()
            array[:] = before + step
            above = one.loss(data, rows, pool)
            array[:] = before - step
            below = one.loss(data, rows, pool)
            array[:] = before
            # Steps have sizes of their own: gradients are those of the loss but for one factor, the targets' number.
            assert above - below == pytest.approx(2.0 * float((gradient * step).sum()) / 2, rel=0.02, abs=1e-6)


def test_results_of_threads_are_in_order() -> None:
    assert in_threads(lambda number: number**2, range(50)) == [number**2 for number in range(50)]
