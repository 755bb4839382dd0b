"""Where the large motion of free runs lies, against that of true runs: how far off on average, and how far spread.

Free folding is chaotic: two converged simulations of one scene part company. The distance of one free run to one true
run therefore says little, and a garment that hardly moves has a small one. Several runs of each, with starts that
differ by less than anybody can set, tell two things apart (the energy distance's decomposition, Szekely and Rizzo 2013,
here with squared distances): the distance of both means, which is wrong, and the spread about them, which is right if
it is the truth's own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

__all__ = ["LowFrequency", "LowFrequencyFigures"]

FRAMES = 48  # of a motion that are measured, spread evenly


class LowFrequencyFigures(NamedTuple):
    """Large motion of some free runs.

    Attributes:
        bias: distance of their mean from the true runs' mean, over the truth's spread or its distance from the run in
            finer steps, whichever is larger [-]; 0 is right.
        spread: root mean square distance of two of them over that of two true runs [-]; 1 is right, nan of one run.
        bias_error, spread_error: standard errors of both, from leaving out each run in turn (jackknife); 0 where no
            set has three runs.
    """

    bias: float
    spread: float
    bias_error: float
    spread_error: float


class LowFrequency:
    """Measures the large motion of free runs, at :data:`FRAMES` moments.

    Args:
        low_pass: linear filter on positions, such as :class:`wrinkles.spectrum.LowPass`.
        truths: true runs that differ by their starts alone [m], shape (f, N, 3) each.
        finer: a true run in finer steps, likewise. It stands for another true run where there is one only.
    """

    def __init__(
        self, low_pass: Callable[[np.ndarray], np.ndarray], truths: Sequence[np.ndarray], finer: np.ndarray
    ) -> None:
        self._low_pass = low_pass
        self._true = [self._low(run) for run in (*truths, finer)]
        self._alike = list(range(max(len(truths), 2)))  # numbers of the runs of which one may be any
        self._finer = len(truths)
        self._between = _distances(self._true, self._true)

    def __call__(self, runs: Sequence[np.ndarray]) -> LowFrequencyFigures:
        """Figures of some free runs [m], shape (f, N, 3) each, at the true runs' frames."""
        low = [self._low(run) for run in runs]
        within, across, numbers = _distances(low, low), _distances(low, self._true), list(range(len(low)))

        def found(ours: list[int], alike: list[int]) -> np.ndarray:
            return self._found(within, across, ours, alike)

        bias, spread = found(numbers, self._alike)
        variance = np.zeros(2)
        for some, figures_of in (
            (numbers, lambda few: found(few, self._alike)),
            (self._alike, lambda few: found(numbers, few)),
        ):
            if len(some) > 2:
                left = np.array([figures_of([one for one in some if one != out]) for out in some])
                variance += (len(some) - 1) / len(some) * ((left - left.mean(axis=0)) ** 2).sum(axis=0)
        return LowFrequencyFigures(float(bias), float(spread), *np.sqrt(variance).tolist())

    @property
    def floor(self) -> float:
        """The largest bias [-] that one of the true runs, the finer one too, has against the others; 0 of two runs."""
        alike, between = self._alike, self._between
        found = [
            self._found(between[[one]][:, [one]], between[[one]], [0], rest)[0]
            for one in dict.fromkeys([*alike, self._finer])
            if len(rest := [other for other in alike if other != one]) > 1
        ]
        return float(max(found, default=0.0))

    def _low(self, run: np.ndarray) -> np.ndarray:
        some = np.unique(np.linspace(0, len(run) - 1, FRAMES).round().astype(int))
        return self._low_pass(np.asarray(run)[some]).astype(np.float32)

    def _found(self, within: np.ndarray, across: np.ndarray, ours: list[int], alike: list[int]) -> np.ndarray:
        """Bias and spread of some of our runs against some of the true ones, from mean square distances.

        The mean of k runs is off by 1/k of their variance, whose double is the mean square distance of two: the square
        distance between both means is therefore estimated without error from chance.
        """
        true = _pairs(self._between, alike)
        among_ours = _pairs(within, ours) if len(ours) > 1 else np.nan
        off = across[np.ix_(ours, alike)].mean() - 0.5 * true - 0.5 * (true if np.isnan(among_ours) else among_ours)
        scale = 0.5 * true
        if self._finer not in alike:
            scale = max(scale, self._between[self._finer, alike].mean() - true)
        return np.sqrt([max(off, 0.0) / scale, among_ours / true])


def _distances(some: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> np.ndarray:
    """Mean square distance of vertices [m2] of each run to each of the others, shape (a, b)."""
    return np.array([[3.0 * float(np.mean((one - other) ** 2)) for other in others] for one in some])


def _pairs(distances: np.ndarray, numbers: list[int]) -> float:
    """Mean over the pairs of different runs."""
    some = distances[np.ix_(numbers, numbers)]
    return float(some.sum() / (len(numbers) * (len(numbers) - 1)))
