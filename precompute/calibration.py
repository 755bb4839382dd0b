"""The calibrated coarse model: its compression and bending fitted until it moves like the filtered fine garment."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pbd import ModelOptions, SolverOptions
from precompute.recording import Recording, Run, record_runs
from precompute.training import FeatureStatistics, Layer, features_of

__all__ = ["Calibration", "calibrate"]

SQUEEZE = (1.0, 10.0, 100.0)
BEND = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
SETTLE = 1.5  # the blend from the bind pose does not count [s]


@dataclass(frozen=True)
class Calibration:
    """What was found.

    Attributes:
        options: of the coarse model.
        shift_before, shift_after: root mean squared Mahalanobis distance of the coarse run's features from the mean of the
            filtered fine run's, per dimension [-]; the fine run's own is one.
        mismatch_before, mismatch_after: Frechet distance of their distributions, per dimension [-].
        rows: every setting tried.
    """

    options: ModelOptions
    shift_before: float
    shift_after: float
    mismatch_before: float
    mismatch_after: float
    rows: tuple[dict[str, float], ...]


def calibrate(
    layer: Layer,
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    solver: SolverOptions,
    bend_factor: float,
    cache: Path,
    workers: int,
    report: Callable[[str], None] | None = None,
) -> Calibration:
    """Try coarse models on training motion and keep the one whose features are distributed as the filtered fine ones are.

    Args:
        layer: of the garment.
        runs: fine training runs.
        recordings: what they gave.
        solver: of the coarse garment.
        bend_factor: hinge factor of the coarse mesh.
        cache, workers, report: as for :func:`precompute.recording.record_runs`.
    """
    settled = [r.frames * runs[0].dt > SETTLE for r in recordings]
    reference = np.concatenate([features_of(layer, r)[0][s] for r, s in zip(recordings, settled, strict=True)])
    statistics = FeatureStatistics.of(reference)
    options = [ModelOptions(squeeze=s, bend_scale=b) for s, b in itertools.product(SQUEEZE, BEND)]
    tries = [
        replace(run, fine=False, options=option, solver=solver, bend_factor=bend_factor)
        for option in options
        for run in runs
    ]
    coarse = record_runs(tries, cache, workers, report)
    rows = []
    for number, option in enumerate(options):
        mine = coarse[number * len(runs) : (number + 1) * len(runs)]
        features = np.concatenate([features_of(layer, r)[0][s] for r, s in zip(mine, settled, strict=True)])
        rows.append(
            {
                "squeeze": option.squeeze,
                "bend_scale": option.bend_scale,
                "shift": statistics.shift(features),
                "mismatch": statistics.mismatch(features),
            }
        )
    best = int(np.argmin([row["mismatch"] for row in rows]))
    return Calibration(
        options[best], rows[0]["shift"], rows[best]["shift"], rows[0]["mismatch"], rows[best]["mismatch"], tuple(rows)
    )
