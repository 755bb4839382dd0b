"""Fitting the score for unfamiliar states: what error does the dictionary make, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from precompute.learning.decoding import decode_recording
from precompute.learning.recording import Recording, Run
from precompute.learning.training import Layer, spread_frames
from wrinkles.charts import leading_vertices
from wrinkles.dictionary import Atoms, Mapping
from wrinkles.metrics import patch_normal_errors
from wrinkles.network import Network, Samples
from wrinkles.unfamiliarity import Unfamiliarity

__all__ = ["fit_unfamiliarity"]

FRAMES, STRANGE_FRAMES = 800, 80  # of training motion as it is, and with noise on its features
NOISE = (1.0, 4.0)  # of it, in standard deviations
UNITS, EPOCHS = 24, 24
LEAST = 0.5  # errors below it need not be told apart [deg]
BLOCK, KEPT_OUT = 20, 8  # every eighth block of twenty frames says where fading starts
FAMILIAR = 99.5  # percentile of the score there


def fit_unfamiliarity(
    layer: Layer,
    mappings: Sequence[Mapping],
    atoms: Atoms,
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    seed: int,
) -> Unfamiliarity:
    """Fit the score to the true errors of decoded training motion.

    Ordinary motion alone does not say what lies beyond it. So some of it is decoded with noise on all features,
    up to their limits: the further off they are, the larger the error.

    Args:
        layer: of the garment.
        mappings, atoms: the dictionary, for the fabric of each run.
        runs: fine training runs.
        recordings: what they gave.
        seed: of noise, first weights and shuffling.
    """
    rng = np.random.default_rng(seed)
    hidden, error = _decoded_errors(layer, mappings, atoms, runs, spread_frames(recordings, FRAMES), None)
    strange = _decoded_errors(layer, mappings, atoms, runs, spread_frames(recordings, STRANGE_FRAMES), rng)
    kept_out = np.arange(len(hidden)) // BLOCK % KEPT_OUT == KEPT_OUT - 1
    seen = np.concatenate([hidden[~kept_out], strange[0]]).reshape(-1, hidden.shape[2])
    target = np.log(np.concatenate([error[~kept_out], strange[1]]).reshape(-1, 1) + LEAST)
    middle, spread = seen.mean(axis=0), seen.std(axis=0) + 1e-3
    level, unit = target.mean(), target.std()
    network = Network((seen.shape[1], UNITS, 1), seed)
    nowhere = np.zeros((1, 0), np.float32)  # places have told the first layer already
    samples = Samples((seen - middle) / spread, nowhere, ((target - level) / unit).astype(np.float32))
    network.fit(samples, epochs=EPOCHS)
    weights = network.weights[0] / spread[:, None]
    found = Unfamiliarity(
        weights.astype(np.float32),
        (network.biases[0] - middle @ weights).astype(np.float32),
        (network.weights[1][:, 0] * unit).astype(np.float32),
        float(network.biases[1][0] * unit + level),
        1.0,
    )
    judged = found.score(hidden[kept_out] if kept_out.any() else hidden)
    return replace(found, fade_from=float(np.exp(np.percentile(judged, FAMILIAR))))


def _decoded_errors(
    layer: Layer,
    mappings: Sequence[Mapping],
    atoms: Atoms,
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    rng: np.random.Generator | None,
) -> tuple[np.ndarray, np.ndarray]:
    """First hidden layer, float32, shape (f, k, h1), and normal error of each patch [deg], shape (f, k).

    Of the k coarse vertices that lead fine ones; a delivered fine mesh may leave some out.

    Args:
        layer, mappings, atoms, runs, recordings: as above.
        rng: makes the features strange; None leaves them.
    """
    hidden: list[np.ndarray] = []

    def predict(mapping: Mapping, features: np.ndarray, pose: np.ndarray) -> np.ndarray:
        if rng is not None:
            features = features + rng.uniform(*NOISE) * rng.standard_normal(features.shape) / mapping.scale
        hidden.append(mapping.hidden(features).astype(np.float32))
        return mapping.coefficients(hidden[-1])

    faces, owner = layer.levels.fine.faces, leading_vertices(layer.levels.subdivision)[:, 0]
    errors = []
    for mapping, run, recording in zip(mappings, runs, recordings, strict=True):
        _, decoded = decode_recording(layer, partial(predict, mapping), atoms, run, recording)
        errors.append(patch_normal_errors(decoded, recording.positions, faces, owner))
    return np.array(hidden)[:, np.unique(owner)], np.concatenate(errors).astype(np.float32)
