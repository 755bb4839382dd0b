"""Fitting the score for unfamiliar states: what error does the dictionary make, and where."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from precompute.learning.decoding import blocks_of, decode_recording
from precompute.learning.run_recording import Recording, Run
from precompute.learning.stages import counted
from precompute.learning.training import Layer, features_of, spread_frames
from precompute.workers import Workers
from wrinkles.charts import leading_vertices
from wrinkles.dictionary import Atoms, CoefficientNetwork
from wrinkles.metrics import patch_normal_errors
from wrinkles.network import Network, Samples, in_threads
from wrinkles.novelty import NoveltyScore

__all__ = ["fit_novelty"]

STRANGE_SHARE = 0.1  # as many frames as that are decoded with noise on their features besides
NOISE = (1.0, 4.0)  # of it, in standard deviations
UNITS, EPOCHS = 24, 24
LEAST = 0.5  # errors below it need not be distinguished [deg]
BLOCK, KEPT_OUT = 20, 8  # every eighth block of twenty frames says where fading starts
FAMILIAR = 99.5  # percentile of the score there


def fit_novelty(
    layer: Layer,
    mapping: CoefficientNetwork,
    atoms: Atoms,
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    seed: int,
    workers: Workers,
    frames: int,
    report: Callable[[str], None] | None = None,
) -> NoveltyScore:
    """Fit the score to the true errors of decoded training motion.

    Ordinary motion alone does not say what lies beyond it. So some of it is decoded with noise on all features,
    up to their limits: the further off they are, the larger the error.

    Args:
        layer: of the garment.
        mapping, atoms: the dictionary.
        runs: fine training runs.
        recordings: of these runs.
        seed: of noise, first weights and shuffling.
        workers: that decode.
        frames: of training motion that are decoded, at most.
        report: called with lines of progress.
    """
    plain = _blocks(layer, mapping, atoms, runs, spread_frames(recordings, frames), None)
    strange = _blocks(layer, mapping, atoms, runs, spread_frames(recordings, round(STRANGE_SHARE * frames)), seed)
    jobs = [partial(_patch_errors, block) for _, block in (*plain, *strange)]
    errors = workers.run(jobs, done=counted(report, "unfamiliarity: parts", len(jobs)))
    hidden, error = np.concatenate([h for h, _ in plain]), np.concatenate(errors[: len(plain)])
    kept_out = np.arange(len(hidden)) // BLOCK % KEPT_OUT == KEPT_OUT - 1
    seen = np.concatenate([hidden[~kept_out], *(h for h, _ in strange)]).reshape(-1, hidden.shape[2])
    target = np.log(np.concatenate([error[~kept_out], *errors[len(plain) :]]).reshape(-1, 1) + LEAST)
    middle, spread = seen.mean(axis=0), seen.std(axis=0) + np.float32(1e-3)
    level, unit = target.mean(), target.std()
    network = Network((seen.shape[1], UNITS, 1), seed)
    nowhere = np.zeros((1, 0), np.float32)  # the first layer includes the place
    seen -= middle
    seen /= spread
    samples = Samples(seen, nowhere, ((target - level) / unit).astype(np.float32))
    tell = report or (lambda line: None)
    network.fit(samples, epochs=EPOCHS, on_check=lambda done, _: tell(f"unfamiliarity: {done:.1f} of {EPOCHS} passes"))
    weights = network.weights[0] / spread[:, None]
    found = NoveltyScore(
        weights.astype(np.float32),
        (network.biases[0] - middle @ weights).astype(np.float32),
        (network.weights[1][:, 0] * unit).astype(np.float32),
        float(network.biases[1][0] * unit + level),
        1.0,
    )
    judged = found.score(hidden[kept_out] if kept_out.any() else hidden)
    return replace(found, fade_from=float(np.exp(np.percentile(judged, FAMILIAR))))


@dataclass(frozen=True)
class _Block:
    """Frames to decode with given coefficients, float32, shape (f, n, K)."""

    layer: Layer
    atoms: Atoms
    run: Run
    recording: Recording
    coefficients: np.ndarray


def _blocks(
    layer: Layer,
    mapping: CoefficientNetwork,
    atoms: Atoms,
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    noise_seed: int | None,
) -> list[tuple[np.ndarray, _Block]]:
    """First hidden layer in blocks of frames, float32, shape (f, k, h1), and how to decode them.

    Of the k coarse vertices that lead fine ones; a delivered fine mesh may leave some out.

    Args:
        layer, mapping, atoms, runs, recordings: as above.
        noise_seed: of what makes the features strange; None leaves them.
    """
    leading = np.unique(leading_vertices(layer.levels.subdivision)[:, 0])
    blocks = blocks_of(runs, recordings)
    features = [features_of(layer, recording)[0] for _, recording in blocks]

    def block_of(number: int) -> tuple[np.ndarray, _Block]:
        (run, recording), seen = blocks[number], features[number]
        if noise_seed is not None:
            rng = np.random.default_rng((noise_seed, number))
            sizes = rng.uniform(*NOISE, (len(seen), 1, 1))
            seen = (seen + sizes * rng.standard_normal(seen.shape) / mapping.scale).astype(np.float32)
        hidden = mapping.hidden(seen).astype(np.float32)
        return hidden[:, leading], _Block(layer, atoms, run, recording, mapping.coefficients(hidden))

    return in_threads(block_of, range(len(blocks)))


def _patch_errors(block: _Block) -> np.ndarray:
    """Normal error of each patch [deg], float32, shape (f, k)."""
    layer, given = block.layer, iter(block.coefficients)
    _, decoded = decode_recording(layer, lambda features: next(given), block.atoms, block.run, block.recording)
    faces, owner = layer.levels.fine.faces, leading_vertices(layer.levels.subdivision)[:, 0]
    return patch_normal_errors(decoded, block.recording.positions, faces, owner).astype(np.float32)
