"""Predicts the error of the wrinkles at each coarse vertex, and fades wrinkles where it is too large.

The prediction is a second head of the dictionary's network. It is large in states unlike the training data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["NoveltyScore"]

FADE_WIDTH = np.log(2.0)  # from the predicted error at which wrinkles start to fade to where they vanish [log deg]


@dataclass(frozen=True)
class NoveltyScore:
    """A network for the score, the log of the mean normal error [deg] to be expected at a coarse vertex.

    Its input is the first hidden layer of :class:`wrinkles.dictionary.CoefficientNetwork`, and it has one layer of
    rectified units of its own. It was fitted to ordinary motion and to motion with distorted features.

    Attributes:
        weights_1, bias_1: of the rectified units, float32, shapes (h1, u), (u,).
        weights_2, bias_2: of the score, float32, shape (u,), and a number.
        fade_from: predicted error above which wrinkles fade [deg].
    """

    weights_1: np.ndarray
    bias_1: np.ndarray
    weights_2: np.ndarray
    bias_2: float
    fade_from: float

    def score(self, hidden: np.ndarray) -> np.ndarray:
        """Log of the error to be expected [log deg], shape (..., n).

        Args:
            hidden: first hidden layer of the mapping, shape (..., n, h1).
        """
        units = hidden @ self.weights_1
        units += self.bias_1
        np.maximum(units, 0.0, out=units)
        return units @ self.weights_2 + np.float32(self.bias_2)

    def amplitude(self, score: np.ndarray) -> np.ndarray:
        """Share of the wrinkles that is drawn [-], shape of the scores.

        It is 1 up to the error ``fade_from`` and 0 from twice this error on.
        """
        return np.clip((np.float32(np.log(self.fade_from) + FADE_WIDTH) - score) / np.float32(FADE_WIDTH), 0.0, 1.0)
