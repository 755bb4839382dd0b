"""Other mappings from a coarse garment to fine wrinkles, learned from the same pairs, decoded by the same patches.

Both give the coefficients of the patches' atoms, so that the mapping alone differs: a linear operator, and the nearest
neighbour with delta (as game engines ship it), which sees the whole garment at once by the inner ring of every stencil.
How strongly each is regularised is chosen on pieces of the training motion, each left out in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from precompute.learning.decoding import Predictor
from precompute.learning.training import TrainingSet
from wrinkles.features import INNER_OFFSETS

__all__ = ["WrinkleBaseline", "fit_baselines"]

COMPONENTS = 128  # of the whole garment's features and of its coefficients
FOLDS = 5  # pieces of the training motion
TRIED_PLACES = 12  # where the linear operator's softness is chosen
SOFTNESS = (1.0, 10.0, 100.0, 1e3, 1e4)  # of ridge regressions that are tried, in variances of a feature
SEEN_COMPONENTS = (8, 32, 128)  # that neighbours are compared by


@dataclass(frozen=True)
class WrinkleBaseline:
    """A fitted mapping.

    Attributes:
        name: for people.
        predict: features of one frame, float32, shape (n, DYNAMIC_COUNT), to coefficients, shape (n, K).
        arrays: the ones to store.
        settings: the ones chosen for it, in words.
    """

    name: str
    predict: Predictor
    arrays: tuple[np.ndarray, ...]
    settings: str = ""

    @property
    def megabytes(self) -> float:
        return sum(array.size for array in self.arrays) * 4e-6  # as float32


def fit_baselines(data: TrainingSet, seed: int, report: Callable[[str], None] | None = None) -> list[WrinkleBaseline]:
    """Fit every baseline to a training set.

    Args:
        data: pairs, frames in the order of the motion.
        seed: of the principal components.
        report: called with lines of progress.
    """
    progress = report or (lambda line: None)
    progress("fitting baselines: linear operator")
    linear = _linear_operator(data)
    progress("fitting baselines: nearest neighbour")
    return [linear, _neighbour(_Whole(data, seed), data)]


def _chosen(settings: Sequence[Any], fit: Callable, inputs: np.ndarray, outputs: np.ndarray) -> Any:
    """The setting with the least error on pieces of the motion that it was not fitted to, each left out in turn.

    Args:
        settings: to choose from.
        fit: setting, inputs and outputs to a function of inputs.
        inputs, outputs: first axis over frames, in the order of the motion.
    """
    from sklearn.model_selection import KFold

    folds = list(KFold(FOLDS).split(inputs))

    def error(setting: Any) -> float:
        off = (fit(setting, inputs[seen], outputs[seen])(inputs[left]) - outputs[left] for seen, left in folds)
        return sum(float((one**2).sum()) for one in off)

    return min(settings, key=error)


def _linear_operator(data: TrainingSet) -> WrinkleBaseline:
    from sklearn.linear_model import Ridge

    places = data.features.shape[1]

    def solve(softness: float, features: np.ndarray, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        weights = np.zeros((features.shape[1], features.shape[2], coefficients.shape[2]), np.float32)
        bias = np.zeros((features.shape[1], coefficients.shape[2]), np.float32)
        for place in range(features.shape[1]):
            ridge = Ridge(softness).fit(features[:, place], coefficients[:, place])
            weights[place], bias[place] = ridge.coef_.T, ridge.intercept_
        return weights, bias

    def fit(softness: float, features: np.ndarray, coefficients: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        weights, bias = solve(softness, features, coefficients)
        return lambda f: np.matmul(f[..., None, :], weights)[..., 0, :] + bias

    some = np.linspace(0, places - 1, min(TRIED_PLACES, places)).astype(int)
    softness = _chosen(SOFTNESS, fit, data.features[:, some], data.coefficients[:, some])
    weights, bias = solve(softness, data.features, data.coefficients)
    predict = lambda f: np.matmul(f[:, None], weights)[:, 0] + bias  # noqa: E731
    return WrinkleBaseline("linear operator", predict, (weights, bias), f"softness {softness:g}")


class _Whole:
    """The whole garment in principal components: what it sees at unit variance, and what it draws.

    Attributes:
        inputs, outputs: of the training frames, shapes (S, COMPONENTS) each.
        bases: that are needed to see and to draw.
    """

    def __init__(self, data: TrainingSet, seed: int) -> None:
        from sklearn.decomposition import PCA

        frames, *self._shape = data.coefficients.shape
        count = min(COMPONENTS, frames - 1)
        reduce = lambda a: PCA(count, svd_solver="randomized", random_state=seed).fit(a)  # noqa: E731
        self._seen, self._drawn = reduce(_ring(data.features)), reduce(data.coefficients.reshape(frames, -1))
        inputs = self._seen.transform(_ring(data.features))
        spread = inputs.std(axis=0)
        self._spread = spread + 1e-3 * spread.max()  # components of no size are noise
        self.inputs = inputs / self._spread
        self.outputs = self._drawn.transform(data.coefficients.reshape(frames, -1))
        self.bases = (self._seen.components_, self._seen.mean_, self._drawn.components_, self._drawn.mean_)

    def see(self, features: np.ndarray) -> np.ndarray:
        """Components of one frame's features, shape (1, COMPONENTS)."""
        return self._seen.transform(_ring(features)[None]) / self._spread

    def draw(self, components: np.ndarray) -> np.ndarray:
        """Coefficients of one frame, float32, shape (n, K)."""
        return self._drawn.inverse_transform(components).reshape(self._shape).astype(np.float32)


def _ring(features: np.ndarray) -> np.ndarray:
    return features[..., INNER_OFFSETS].reshape(*features.shape[:-2], -1)


def _ridge(softness: float, inputs: np.ndarray, outputs: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    from sklearn.linear_model import Ridge

    return Ridge(softness).fit(inputs, outputs).predict


def _neighbour(whole: _Whole, data: TrainingSet) -> WrinkleBaseline:
    """The neighbour's wrinkles, and the difference that a linear model makes between it and here."""
    from sklearn.neighbors import NearestNeighbors

    softness = _chosen(SOFTNESS, _ridge, whole.inputs, whole.outputs)

    def fit(count: int, inputs: np.ndarray, outputs: np.ndarray) -> Callable:
        """Components to the neighbour's number and the difference to it."""
        linear = _ridge(softness, inputs, outputs)
        neighbours, said = NearestNeighbors(n_neighbors=1).fit(inputs[:, :count]), linear(inputs)

        def find(now: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            nearest = neighbours.kneighbors(now[:, :count])[1][:, 0]
            return nearest, linear(now) - said[nearest]

        return find

    def whole_fit(count: int, inputs: np.ndarray, outputs: np.ndarray) -> Callable:
        find = fit(count, inputs, outputs)

        def predict(now: np.ndarray) -> np.ndarray:
            nearest, delta = find(now)
            return outputs[nearest] + delta

        return predict

    counts = [count for count in SEEN_COMPONENTS if count <= whole.inputs.shape[1]] or [whole.inputs.shape[1]]
    count = _chosen(counts, whole_fit, whole.inputs, whole.outputs)
    find, origin = fit(count, whole.inputs, whole.outputs), whole.draw(np.zeros((1, whole.outputs.shape[1])))

    def predict(features: np.ndarray) -> np.ndarray:
        nearest, delta = find(whole.see(features))
        return data.coefficients[nearest[0]] + whole.draw(delta) - origin

    arrays = (*whole.bases, whole.inputs, whole.outputs, data.coefficients)
    return WrinkleBaseline("nearest neighbour with delta", predict, arrays, f"by {count} components")
