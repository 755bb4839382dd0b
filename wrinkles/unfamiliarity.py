"""How unfamiliar a coarse state is: a second head of the network that foretells the error of each patch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Unfamiliarity"]

FADED_OUT = np.log(2.0)  # from where wrinkles start to fade to where they are gone, in the error foretold (log)


@dataclass(frozen=True)
class Unfamiliarity:
    """The score, log of the mean normal error [deg] that is to be expected at a coarse vertex, and what follows.

    It reads the first hidden layer of :class:`wrinkles.dictionary.Mapping` and has a layer of rectified units of its
    own. It learned from ordinary motion and from motion whose features were made strange.

    Attributes:
        weights_1: float32, shape (h1, u); bias_1: float32, shape (u,); weights_2: float32, shape (u,); bias_2: of the
            score.
        fade_from: error foretold from which wrinkles fade [deg].
    """

    weights_1: np.ndarray
    bias_1: np.ndarray
    weights_2: np.ndarray
    bias_2: float
    fade_from: float

    def score(self, hidden: np.ndarray) -> np.ndarray:
        """Log of the error to be expected [log deg] for the first hidden layer, shape (..., n, h1) to (..., n)."""
        seen = hidden @ self.weights_1
        seen += self.bias_1
        np.maximum(seen, 0.0, out=seen)
        return seen @ self.weights_2 + np.float32(self.bias_2)

    def amplitude(self, score: np.ndarray) -> np.ndarray:
        """Share of the wrinkles that is drawn: 1 in familiar states, 0 from twice the error on where fading starts."""
        return np.clip((np.float32(np.log(self.fade_from) + FADED_OUT) - score) / np.float32(FADED_OUT), 0.0, 1.0)
