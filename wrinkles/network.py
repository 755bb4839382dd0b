"""The network that is fitted offline: rectified units, even steps, a loss that does not bow to the largest folds."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

__all__ = ["Network", "Samples", "in_threads"]

RATE = 0.04  # of weights, at its highest
WARM_UP = 0.05  # share of the steps until the rate is reached
DECAY_SHARE = 0.6  # share of all steps in which the rate falls to zero
CHECKS = 12  # of the validation loss in the longest fit
LEAST_GAIN = 0.015  # relative; where the validation loss gains less from one check to the next, the rate falls
BIAS_SHARE = 0.25  # of the rate, for biases
MOMENTUM, SQUARES = 0.9, 0.999  # shares of running means that stay from step to step
# Newton-Schulz iteration towards the nearest orthogonal matrix: x becomes a x + b x^3 + c x^5 for each singular value.
QUINTIC, ITERATIONS = (3.4445, -4.7750, 2.0315), 5
BATCHES = (64, 2048)  # samples in a batch, at least and at most
PART = 1024  # samples of a batch that one thread takes at a time
THREADS = 2  # the sums are the same on any number of them
WEIGHT_DECAY = 1e-5
KNEE = 0.1  # errors below this count squared, errors above it by their size; in units of the targets' RMS

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Results of a function for each item, in order, on two threads, each of which has one thread for its BLAS.

    For functions that spend their time in numpy, which lets other threads run meanwhile. BLAS with threads of its own
    would spin where matrices are small, and its sums would depend on their number.
    """
    with threadpool_limits(limits=1, user_api="blas"), ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(function, items))


@dataclass(frozen=True)
class Samples:
    """What a network is fitted to: samples that run over all places again and again.

    Attributes:
        inputs: what changes, float32, shape (S n, d).
        place: what belongs to each place, float32, shape (n, s); sample k is at place k modulo n.
        targets: of unit variance, float32, shape (S n, K).
        validation: samples that say when to stop, int, shape (v,); they are learned from only after that.
    """

    inputs: np.ndarray
    place: np.ndarray
    targets: np.ndarray
    validation: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    def __len__(self) -> int:
        return len(self.inputs)

    def of(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inputs with those of the places, shape (r, d + s), and targets, shape (r, K), of some samples."""
        width = self.inputs.shape[1]
        x = np.zeros((len(rows), width + self.place.shape[1]), np.float32)
        x[:, :width] = self.inputs[rows]
        x[:, width:] = self.place[rows % len(self.place)]
        return x, self.targets[rows]


class Network:
    """Layers of rectified units, fitted at a constant rate that falls to zero in the end.

    Weights go along their momentum with all of its singular values made even (Jordan et al. 2024, "Muon"), so that
    directions which few samples ask for are learned as fast as those that most ask for; biases go by Adam (Kingma and
    Ba 2015).

    The loss of a sample is the Euclidean length of its error (smoothed below KNEE), not its square: a fold whose place
    is uncertain is left out instead of being half drawn, and flat patches count as much as folded ones.

    How long it takes is found on the way: the rate stays as it is until samples that are kept out say that it brings
    no more, and only then falls (Haegele et al. 2024, "Scaling Laws and Compute-Optimal Training Beyond Fixed Training
    Durations"). A rate that falls as a cosine would have to know the last step from the first one on.

    Args:
        sizes: of the input, the hidden layers and the output.
        seed: of the first weights and of shuffling.

    Attributes:
        weights, biases: of each layer, float32.
    """

    def __init__(self, sizes: tuple[int, ...], seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        draw = lambda a, b: (self._rng.standard_normal((a, b)) * np.sqrt(2.0 / a)).astype(np.float32)  # noqa: E731
        self.weights = [draw(a, b) for a, b in zip(sizes[:-1], sizes[1:], strict=True)]
        self.weights[-1] *= np.float32(0.3)  # the first guess is near the mean
        self.biases = [np.zeros(b, np.float32) for b in sizes[1:]]

    def fit(
        self,
        samples: Samples,
        *,
        epochs: int,
        rate: float = RATE,
        on_check: Callable[[float, float], None] | None = None,
    ) -> float:
        """Fit to samples, on two threads; the result does not depend on their number.

        Args:
            samples: to learn from.
            epochs: passes over the samples at most; the samples for validation say whether fewer do.
            rate: of weights, at its highest.
            on_check: called with passes done and the mean loss since the last call, now and then.

        Returns:
            the mean loss of the steps up to the last call.
        """
        count = len(samples)
        batch = min(count, int(np.clip(count // 64, *BATCHES)))  # few samples still make enough steps
        steps = epochs * (count // batch)
        last, falling = steps, steps - round(DECAY_SHARE * steps)
        every, warm_up = max(1, steps // CHECKS), WARM_UP * steps
        learned = np.delete(np.arange(count), samples.validation)
        order, motion = learned[:0], _Motion.of(self)
        before, mean, losses = np.inf, 0.0, []
        step = 0
        with threadpool_limits(limits=1, user_api="blas"), ThreadPoolExecutor(THREADS) as pool:
            while step < last:
                if len(order) < batch:
                    order = self._rng.permutation(learned if step < falling else count)
                chosen, order = order[:batch], order[batch:]
                step += 1
                loss, gradients = self._gradients(samples, chosen, pool)
                losses.append(loss)
                now = rate * min(1.0, step / warm_up, (last - step + 1) / (last - falling))
                motion.follow(self, gradients, now, step, pool)
                if step % every and step < last:
                    continue
                mean, losses = float(np.mean(losses)), []
                if on_check is not None:
                    on_check(step * batch / count, mean)
                if len(samples.validation) and warm_up < step < falling:
                    after = self.loss(samples, samples.validation, pool)
                    if after > (1.0 - LEAST_GAIN) * before:
                        falling, last = step, round(step / (1.0 - DECAY_SHARE))
                        order = order[:0]
                    before = after
        return mean

    def loss(self, samples: Samples, rows: np.ndarray, pool: ThreadPoolExecutor) -> float:
        """Mean loss of some samples."""

        def of_part(part: np.ndarray) -> float:
            x, targets = samples.of(part)
            return float(_size(self._outputs(x)[-1] - targets).sum())

        return sum(pool.map(of_part, _parts(rows))) / len(rows) - KNEE

    def first(self, samples: Samples, rows: np.ndarray) -> np.ndarray:
        """What the first layer gives for some samples, float32, shape (r, h1)."""
        x = samples.of(rows)[0] @ self.weights[0]
        x += self.biases[0]
        return np.maximum(x, 0.0, out=x)

    def after_first(self, seed: int) -> Network:
        """A copy of the layers after the first, to be fitted further on what the first one gives."""
        sizes = [weight.shape[0] for weight in self.weights[1:]]
        copied = Network((*sizes, self.weights[-1].shape[1]), seed)
        copied.weights, copied.biases = ([one.copy() for one in a[1:]] for a in (self.weights, self.biases))
        return copied

    def _outputs(self, x: np.ndarray) -> list[np.ndarray]:
        """The input and what every layer makes of it."""
        found = [x]
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True), start=1):
            y = found[-1] @ weight
            y += bias
            if layer < len(self.weights):
                np.maximum(y, 0.0, out=y)
            found.append(y)
        return found

    def _gradients(
        self, samples: Samples, rows: np.ndarray, pool: ThreadPoolExecutor
    ) -> tuple[float, list[np.ndarray]]:
        """Mean loss of a batch and K times its gradients by weights and biases: their common size does not matter."""
        found = list(pool.map(lambda part: self._sums(*samples.of(part)), _parts(rows)))
        share = np.float32(1.0 / len(rows))
        gradients = [share * np.sum(parts, axis=0) for parts in zip(*(part for _, part in found), strict=True)]
        for gradient, weight in zip(gradients, self.weights, strict=False):
            gradient += np.float32(WEIGHT_DECAY) * weight
        return sum(loss for loss, _ in found) / len(rows) - KNEE, gradients

    def _sums(self, x: np.ndarray, targets: np.ndarray) -> tuple[float, list[np.ndarray]]:
        """Loss of a part of a batch, and K times its gradients by weights and biases, summed over the samples."""
        *seen, back = self._outputs(x)
        back -= targets
        size = _size(back)
        back /= size
        by_weight, by_bias = [], []
        for layer in range(len(self.weights) - 1, -1, -1):
            by_weight.append(seen[layer].T @ back)
            by_bias.append(back.sum(axis=0))
            if layer:
                back = back @ self.weights[layer].T
                back *= seen[layer] > 0.0
        return float(size.sum()), by_weight[::-1] + by_bias[::-1]


@dataclass
class _Motion:
    """Running means of the gradients of weights and biases, and of the squares of the latter."""

    weights: list[np.ndarray]
    biases: list[np.ndarray]
    squares: list[np.ndarray]

    @classmethod
    def of(cls, network: Network) -> _Motion:
        zeros = lambda arrays: [np.zeros_like(array) for array in arrays]  # noqa: E731
        return cls(zeros(network.weights), zeros(network.biases), zeros(network.biases))

    def follow(
        self, network: Network, gradients: list[np.ndarray], rate: float, step: int, pool: ThreadPoolExecutor
    ) -> None:
        """Take a step along the means with new gradients; ``step`` counts from one."""
        keep, new = np.float32(MOMENTUM), np.float32(1.0 - MOMENTUM)

        def move(layer: int) -> None:
            weight, mean, gradient = network.weights[layer], self.weights[layer], gradients[layer]
            mean *= keep
            mean += new * gradient
            wide = np.sqrt(max(1.0, weight.shape[1] / weight.shape[0]))
            weight -= np.float32(rate * wide) * _even(keep * mean + new * gradient)

        list(pool.map(move, range(len(self.weights))))
        so_far, squared = 1.0 - MOMENTUM**step, np.float32(1.0 - SQUARES**step)
        by_bias = gradients[len(self.weights) :]
        for bias, mean, square, gradient in zip(network.biases, self.biases, self.squares, by_bias, strict=True):
            mean *= keep
            mean += new * gradient
            square *= np.float32(SQUARES)
            square += np.float32(1.0 - SQUARES) * gradient**2
            bias -= np.float32(BIAS_SHARE * rate / so_far) * mean / (np.sqrt(square / squared) + np.float32(1e-8))


def _parts(rows: np.ndarray) -> list[np.ndarray]:
    """As many samples as a thread takes at a time, for any number of threads."""
    return np.array_split(rows, -(-len(rows) // PART))


def _size(error: np.ndarray) -> np.ndarray:
    """Smoothed root mean square of each sample's error, shape (r, 1)."""
    squares = np.einsum("rk,rk->r", error, error) / np.float32(error.shape[1])
    return np.sqrt(squares + np.float32(KNEE**2))[:, None]


def _even(matrix: np.ndarray) -> np.ndarray:
    """The matrix with singular values near one, 0.7 to 1.2, instead of its own; float32, as it is."""
    tall = matrix.shape[0] > matrix.shape[1]
    x = matrix.T if tall else matrix
    x = x / (np.linalg.norm(x) + np.float32(1e-7))
    a, b, c = (np.float32(factor) for factor in QUINTIC)
    for _ in range(ITERATIONS):
        square = x @ x.T
        x = a * x + (b * square + c * (square @ square)) @ x
    return x.T if tall else x
