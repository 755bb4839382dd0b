"""The network that is fitted offline: rectified units, Adam, and a loss that does not bow to the largest folds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["Network"]

RATE, WARM_UP = 8e-3, 0.05  # of Adam, at its highest; share of the steps until the rate is reached
BATCHES = (64, 1024)  # samples in a batch, at least and at most
DECAY = 1e-5  # of the weights
KNEE = 0.1  # errors below this count squared, errors above it by their size; in units of the targets' RMS


class Network:
    """Layers of rectified units, fitted by Adam (Kingma and Ba 2015) with a rate that falls as a cosine.

    The loss of a sample is the Euclidean length of its error (smoothed below KNEE), not its square: a fold whose
    place cannot be told is left out instead of being half drawn, and flat patches count as much as folded ones.

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
        inputs: np.ndarray,
        place: np.ndarray,
        targets: np.ndarray,
        *,
        epochs: int,
        rate: float = RATE,
        on_epoch: Callable[[int, int, float], None] | None = None,
    ) -> float:
        """Fit to samples that run over all places again and again.

        Args:
            inputs: what changes, float32, shape (S n, d).
            place: what belongs to each place, float32, shape (n, s); sample k is at place k modulo n.
            targets: of unit variance, float32, shape (S n, K).
            epochs: passes over the samples.
            rate: of Adam, at its highest.
            on_epoch: told (passes done, epochs, mean loss) after each pass.

        Returns:
            the mean loss of the last pass.
        """
        count = len(inputs)
        batch = min(count, int(np.clip(count // 64, *BATCHES)))  # few samples still make enough steps
        steps = epochs * (count // batch)
        layers = [*self.weights, *self.biases]
        first, second = [np.zeros_like(p) for p in layers], [np.zeros_like(p) for p in layers]
        step, mean = 0, 0.0
        for epoch in range(epochs):
            order, total = self._rng.permutation(count), 0.0
            for begin in range(0, count - batch + 1, batch):
                chosen = order[begin : begin + batch]
                step += 1
                loss, gradients = self._gradients(
                    np.concatenate([inputs[chosen], place[chosen % len(place)]], axis=1), targets[chosen]
                )
                total += loss
                now = rate * min(1.0, step / (WARM_UP * steps)) * 0.5 * (1.0 + np.cos(np.pi * step / steps))
                even_1, even_2 = 1.0 - 0.9**step, 1.0 - 0.999**step
                for parameter, gradient, m, v in zip(layers, gradients, first, second, strict=True):
                    m *= 0.9
                    m += 0.1 * gradient
                    v *= 0.999
                    v += 0.001 * gradient**2
                    parameter -= np.float32(now / even_1) * m / (np.sqrt(v / np.float32(even_2)) + 1e-8)
            mean = total / max(1, count // batch)
            if on_epoch is not None:
                on_epoch(epoch + 1, epochs, mean)
        return mean

    def after_first(self, seed: int) -> Network:
        """A copy of the layers after the first, to be fitted further on what the first one gives."""
        sizes = [weight.shape[0] for weight in self.weights[1:]]
        copied = Network((*sizes, self.weights[-1].shape[1]), seed)
        copied.weights, copied.biases = ([one.copy() for one in a[1:]] for a in (self.weights, self.biases))
        return copied

    def _gradients(self, x: np.ndarray, targets: np.ndarray) -> tuple[float, list[np.ndarray]]:
        """Mean loss of a batch and its gradients by weights and biases."""
        seen = [x]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            seen.append(np.maximum(seen[-1] @ weight + bias, 0.0))
        error = seen[-1] @ self.weights[-1] + self.biases[-1] - targets
        size = np.sqrt((error**2).mean(axis=1, keepdims=True) + np.float32(KNEE**2))
        back = error / (size * len(x))
        by_weight, by_bias = [], []
        for layer in range(len(self.weights) - 1, -1, -1):
            by_weight.append(seen[layer].T @ back + np.float32(DECAY) * self.weights[layer])
            by_bias.append(back.sum(axis=0))
            if layer:
                back = (back @ self.weights[layer].T) * (seen[layer] > 0.0)
        return float(size.mean()) - KNEE, by_weight[::-1] + by_bias[::-1]
