"""Which parts of the motions on offer to simulate finely: those that add most to what the dictionary has seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from pbd import SolverOptions
from pbd.bending import hinge_calibration
from precompute.learning.calibration import filtered
from precompute.learning.evaluation import settled
from precompute.learning.recording import Recording, Run, record_runs
from precompute.learning.training import FeatureStatistics, Layer, features_of
from precompute.workers import Workers
from wrinkles.coarse_filter import CoarseFilter

__all__ = ["PART", "Choice", "choose", "evenly", "greedily"]

PART = 4.0  # about how long a part is [s]; its blend from the bind pose comes on top
FRAME = 5  # recorded frames from one that is looked at to the next
SEEN, ASKED = 600, 80  # patch-frames of a part that others are compared with, and that ask how near they are
DIRECTIONS = 16  # of the whitened features; fainter ones are all alike


@dataclass(frozen=True)
class Choice:
    """What was chosen.

    Attributes:
        numbers: of the chosen runs, ascending.
        figures: ``chosen_s`` and ``offered_s`` [s]; with a held-out run also ``coverage`` (mean distance of its
            patch-frames to the nearest ones of all runs on offer, over that to the nearest ones of the chosen: 1 as
            near) and ``coverage_even``, of as many seconds taken evenly.
    """

    numbers: tuple[int, ...]
    figures: dict[str, float]


def choose(
    layer: Layer,
    runs: Sequence[Run],
    held_out: Run | None,
    budget: float,
    solver: SolverOptions,
    seed: int,
    cache: Path,
    workers: Workers | int,
    report: Callable[[str], None] | None = None,
) -> Choice:
    """Play the coarse garment over every run, compare what is seen of it, and take the runs that add most.

    Args:
        layer: of the garment.
        runs: fine runs on offer.
        held_out: a fine run of motion that nothing is learned from; it has no say.
        budget: time to simulate finely [s].
        solver: of the coarse garment.
        seed: of the patch-frames that are looked at.
        cache, workers, report: as for :func:`precompute.learning.recording.record_runs`.
    """
    bend = hinge_calibration(layer.levels.coarse)
    asked_too = [] if held_out is None else [held_out]
    coarse = [replace(run, fine=False, solver=solver, bend_factor=bend) for run in (*runs, *asked_too)]
    matrix = CoarseFilter(layer.levels).matrix
    rng = np.random.default_rng(seed)
    recordings = record_runs(coarse, cache, workers, report)
    # What only leads to a part is not learned from, and how the garment settles is not judged.
    used = [r.where(r.frames * run.dt > run.lead_in) for r, run in zip(recordings, runs, strict=False)]
    used += [settled(r, run) for r, run in zip(recordings[len(runs) :], asked_too, strict=True)]
    samples = [_sample(layer, filtered(recording, matrix), rng) for recording in used]
    statistics = FeatureStatistics.of(np.concatenate(samples[: len(runs)])[None], DIRECTIONS)
    seen = [(sample - statistics.mean) @ statistics.axes for sample in samples]
    asking = np.concatenate([sample[:ASKED] for sample in seen[: len(runs)]])
    far = np.stack([_distances(asking, sample) for sample in seen[: len(runs)]], axis=1)
    costs = np.array([run.frame_count * run.dt for run in runs])
    numbers = greedily(far, np.linalg.norm(asking, axis=1), costs, budget)
    figures = {"chosen_s": float(costs[numbers].sum()), "offered_s": float(costs.sum())}
    if held_out is not None:
        far = np.stack([_distances(seen[-1], sample) for sample in seen[:-1]], axis=1)
        nearest = lambda some: float(far[:, some].min(axis=1).mean())  # noqa: E731
        for name, some in (("coverage", numbers), ("coverage_even", evenly(costs, budget))):
            figures[name] = nearest(np.arange(len(runs))) / nearest(some)
    return Choice(tuple(numbers.tolist()), figures)


def _sample(layer: Layer, recording: Recording, rng: np.random.Generator) -> np.ndarray:
    """Features of some patch-frames of a coarse run: shape (SEEN, d) at most."""
    features = features_of(layer, recording.where(slice(FRAME // 2, None, FRAME)))[0]
    flat = features.reshape(-1, features.shape[-1])
    return flat[rng.permutation(len(flat))[:SEEN]]


def _distances(asking: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """To the nearest of those seen, shape (a,)."""
    return cKDTree(seen).query(asking)[0]


def greedily(far: np.ndarray, alone: np.ndarray, costs: np.ndarray, budget: float) -> np.ndarray:
    """Parts one after the other, each time the one that brings most nearness for its cost and still fits the budget.

    A facility location: what counts is the mean distance of all that ask to the nearest part taken.

    Args:
        far: distance of each that asks to each part, shape (a, parts).
        alone: distance of each that asks while nothing is taken, shape (a,).
        costs: of the parts [s], shape (parts,).
        budget: [s].

    Returns:
        numbers of the parts, ascending.
    """
    taken = np.zeros(len(costs), bool)
    while True:
        fits = ~taken & (costs <= budget - costs[taken].sum() + 1e-9)
        if not fits.any():
            return np.flatnonzero(taken)
        gain = np.maximum(alone[:, None] - far, 0.0).mean(axis=0) / costs
        best = int(np.argmax(np.where(fits, gain, -1.0)))
        taken[best] = True
        alone = np.minimum(alone, far[:, best])


def evenly(costs: np.ndarray, budget: float) -> np.ndarray:
    """As many parts as fit the budget, evenly spread over all: their numbers, ascending."""
    for count in range(len(costs), 0, -1):
        numbers = ((np.arange(count) + 0.5) * len(costs) / count).astype(int)
        if costs[numbers].sum() <= budget + 1e-9:
            return numbers
    return np.zeros(0, int)
