"""The calibrated coarse model: its compression and bending fitted until it moves like the filtered fine garment."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from pbd import ModelOptions, SolverOptions
from precompute.recording import Recording, Run, record_runs
from precompute.training import FeatureStatistics, Layer, features_of
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.spectrum import BandedEnergy

__all__ = ["Calibration", "calibrate"]

SQUEEZE = (1.0, 10.0)
BEND = (1.0, 3.0, 10.0, 30.0)
SETTLE = 1.5  # the blend from the bind pose does not count [s]


def filtered(recording: Recording, matrix: csr_matrix) -> Recording:
    """A coarse run as the dictionary sees it."""
    spread = lambda a: np.stack([matrix @ frame for frame in a]).astype(np.float32)  # noqa: E731
    return replace(recording, coarse=spread(recording.coarse), velocity=spread(recording.velocity))


def _smooth(layer: Layer, recordings: Sequence[Recording], settled: Sequence[np.ndarray]) -> np.ndarray:
    """Smooth surfaces of recorded coarse frames, every sixth: [m], shape (f, N, 3)."""
    coarse = np.concatenate([r.coarse[s][::6] for r, s in zip(recordings, settled, strict=True)])
    return np.stack([layer.levels.subdivision.upsample(frame) for frame in coarse])


@dataclass(frozen=True)
class Calibration:
    """What was found.

    Attributes:
        options: of the coarse model.
        shift_before, shift_after: root mean squared Mahalanobis distance of the coarse run's features from the mean of
            the filtered fine run's, per dimension [-]; the fine run's own is one.
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
    """Try coarse models on training motion and keep the one that folds as the filtered fine garment does.

    Judged by the bending energy of the smooth surface in octave bands of wavelength, from the first band that a coarse
    mesh carries: the mean of |log(coarse / filtered fine)|.

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
    fine = layer.levels.fine
    bands = BandedEnergy(fine.vertices, fine.faces)
    wanted = bands.energy(_smooth(layer, recordings, settled)).mean(axis=0)
    seen = np.array([0.0, *bands.cutoffs])[: len(wanted)] > 0.4 * layer.levels.cutoff
    options = [ModelOptions()]  # the first is the fabric itself: what calibration is compared with
    options += [ModelOptions(squeeze=s, bend_scale=b) for s, b in itertools.product(SQUEEZE, BEND)]
    tries = [
        replace(run, fine=False, options=option, solver=solver, bend_factor=bend_factor)
        for option in options
        for run in runs
    ]
    matrix = CoarseFilter(layer.levels).matrix
    coarse = [filtered(recording, matrix) for recording in record_runs(tries, cache, workers, report)]
    rows = []
    for number, option in enumerate(options):
        mine = coarse[number * len(runs) : (number + 1) * len(runs)]
        features = np.concatenate([features_of(layer, r)[0][s] for r, s in zip(mine, settled, strict=True)])
        energy = bands.energy(_smooth(layer, mine, settled)).mean(axis=0)
        rows.append(
            {
                "spectrum_error": float(np.abs(np.log(energy[seen] / wanted[seen])).mean()),
                "squeeze": option.squeeze,
                "bend_scale": option.bend_scale,
                "shift": statistics.shift(features),
                "mismatch": statistics.mismatch(features),
            }
        )
    # Folds are what is to be passed on, so the spectrum decides; features are reported.
    best = int(np.argmin([row["spectrum_error"] for row in rows]))
    plain, chosen = rows[0], rows[best]
    return Calibration(
        options[best], plain["shift"], chosen["shift"], plain["mismatch"], chosen["mismatch"], tuple(rows)
    )
