"""The network that is fitted offline: rectified units, even steps, a loss that does not bow to the largest folds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["Network"]

RATE, WARM_UP = 0.03, 0.05  # at its highest; share of the steps until the rate is reached
BIAS_SHARE = 0.25  # of the rate, for biases
MOMENTUM = 0.9
# Newton-Schulz iteration towards the nearest orthogonal matrix: x becomes a x + b x^3 + c x^5 for each singular value.
QUINTIC, ITERATIONS = (3.4445, -4.7750, 2.0315), 5
BATCHES = (64, 1024)  # samples in a batch, at least and at most
DECAY = 1e-5  # of the weights
KNEE = 0.1  # errors below this count squared, errors above it by their size; in units of the targets' RMS


class Network:
    """Layers of rectified units, fitted with a rate that falls as a cosine.

    Weights go along their momentum with all of its singular values made even (Jordan et al. 2024, "Muon"), so that
    directions which few samples ask for are learned as fast as those that most ask for; biases go by Adam (Kingma and
    Ba 2015).

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
            rate: of weights, at its highest.
            on_epoch: told (passes done, epochs, mean loss) after each pass.

        Returns:
            the mean loss of the last pass.
        """
        count = len(inputs)
        batch = min(count, int(np.clip(count // 64, *BATCHES)))  # few samples still make enough steps
        steps = epochs * (count // batch)
        depth = len(self.weights)
        momentum = [np.zeros_like(p) for p in (*self.weights, *self.biases)]
        squares = [np.zeros_like(p) for p in self.biases]
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
                for m, gradient in zip(momentum, gradients, strict=True):
                    m *= MOMENTUM
                    m += (1.0 - MOMENTUM) * gradient
                for weight, m, gradient in zip(self.weights, momentum, gradients, strict=False):
                    wide = np.sqrt(max(1.0, weight.shape[1] / weight.shape[0]))
                    weight -= np.float32(now * wide) * _even(MOMENTUM * m + (1.0 - MOMENTUM) * gradient)
                so_far, squared = 1.0 - MOMENTUM**step, 1.0 - 0.999**step
                for bias, m, v, gradient in zip(self.biases, momentum[depth:], squares, gradients[depth:], strict=True):
                    v *= 0.999
                    v += 0.001 * gradient**2
                    bias -= np.float32(BIAS_SHARE * now / so_far) * m / (np.sqrt(v / np.float32(squared)) + 1e-8)
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
