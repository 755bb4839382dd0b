"""Calibration: compression, shear and bending of the coarse model, and how strongly wrinkles are drawn, chosen so that
the coarse garment goes where the fine one does and the decoded one folds as it does.

A mapping fitted to single folds leaves out what it cannot tell, so that all it draws together is too smooth. Raising
its coefficients a little gives the energy back, for little error in each fold: the expectation of a quantity known with
correlation R has R^2 of its variance, and R^2 of it is the least squared error, but 1/R times it the right spectrum.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from pbd import ModelOptions, SolverOptions
from precompute.decoding import decode_recording
from precompute.recording import Recording, Run, record_runs
from precompute.training import FeatureStatistics, Layer, features_of
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.dictionary import Atoms, Mapping
from wrinkles.spectrum import BandedEnergy

__all__ = ["Calibration", "calibrate"]

SQUEEZE = (1.0, 10.0, 100.0)
SHEAR = (1.0, 0.3, 0.1)
BEND = (3.0, 10.0)  # besides 1; tried once the others are chosen
GAINS = (1.0, 1.25, 1.5)  # beyond that the spectrum may be better still, but lumps are seen
SKIPPED = 2
EXCESS = 1.2  # over the fine cloth's energy in an octave, from which on wrinkles are not raised: that is noise
EVERY = 8  # recorded frames from one that is decoded to the next: bending energy changes slowly
CHAOS = 1.0  # how far apart two runs of one garment may be for no reason [mm]
SETTLE = 1.5  # the blend from the bind pose does not count [s]


def settled(recording: Recording, run: Run) -> Recording:
    """What of a recording counts: not the blend from the bind pose, nor what only leads to the motion."""
    return recording.where(recording.frames * run.dt > max(SETTLE, run.lead_in))


def filtered(recording: Recording, matrix: csr_matrix) -> Recording:
    """A coarse run as the dictionary sees it."""
    return replace(recording, coarse=np.stack([matrix @ frame for frame in recording.coarse]).astype(np.float32))


@dataclass(frozen=True)
class Calibration:
    """What was found.

    Attributes:
        options: of the coarse model.
        gain: on the wrinkles that the mapping foretells [-].
        shift_before, shift_after: root mean squared Mahalanobis distance of the coarse run's features from the mean of
            the filtered fine run's, per dimension [-]; the fine run's own is one.
        mismatch_before, mismatch_after: Frechet distance of their distributions, per dimension [-].
        rows: every setting tried.
    """

    options: ModelOptions
    gain: float
    shift_before: float
    shift_after: float
    mismatch_before: float
    mismatch_after: float
    rows: tuple[dict[str, float], ...]


def calibrate(
    layer: Layer,
    mapping: Mapping,
    atoms: Atoms,
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    solver: SolverOptions,
    bend_factor: float,
    cache: Path,
    workers: int,
    report: Callable[[str], None] | None = None,
    gains: Sequence[float] = GAINS,
    gathers: np.ndarray | None = None,
) -> Calibration:
    """Try coarse models and gains on training motion and keep those that come nearest to the fine garment.

    Judged by two logarithms that count alike: bending energy in octave bands of wavelength, and in all of them
    together, of what is seen in the end and not of the coarse garment, root mean square of log(decoded / fine); and how
    far the filtered coarse garment is from the filtered fine one, over the least that any model comes to. The spectrum
    alone takes false folds of a coarse model that is too stiff under compression for wrinkles. These are raised only
    as far as no octave has more energy than the fine cloth's.

    Args:
        layer: of the garment.
        mapping, atoms: the dictionary.
        runs: fine training runs.
        recordings: what they gave.
        solver: of the coarse garment.
        bend_factor: hinge factor of the coarse mesh.
        cache, workers, report: as for :func:`precompute.recording.record_runs`.
        gains: on the wrinkles, to choose from.
        gathers: of the coarse mesh.
    """
    recordings = [settled(r, run) for r, run in zip(recordings, runs, strict=True)]
    statistics = FeatureStatistics.of(np.concatenate([features_of(layer, r)[0] for r in recordings]))
    bands = BandedEnergy(layer.levels.rest_vertices, layer.levels.fine.faces)
    energies = [bands.energy(r.positions[::EVERY]) for r in recordings]
    wanted = np.concatenate(energies).mean(axis=0)
    matrix = CoarseFilter(layer.levels).matrix
    models: list[tuple[ModelOptions, list[Recording], dict[str, float]]] = []
    rows: list[dict[str, float]] = []

    def run_all(options: list[ModelOptions]) -> None:
        """Run the coarse garment by further models and judge each at two gains."""
        tries = [
            replace(run, fine=False, options=option, solver=solver, bend_factor=bend_factor, gathers=gathers)
            for option in options
            for run in runs
        ]
        found = record_runs(tries, cache, workers, report)
        coarse = [settled(filtered(r, matrix), run) for r, run in zip(found, tries, strict=True)]
        for number, option in enumerate(options):
            mine = coarse[number * len(runs) : (number + 1) * len(runs)]
            features = np.concatenate([features_of(layer, r)[0] for r in mine])
            off = {"shift": statistics.shift(features), "mismatch": statistics.mismatch(features)}
            models.append((option, mine, {"apart_mm": 1e3 * _apart(mine, recordings), **off}))
            for gain in gains[::SKIPPED]:
                judge(len(models) - 1, gain)
            if report is not None:
                report(f"calibrating the coarse model: {len(models)} tried")

    def judge(number: int, gain: float) -> None:
        louder, (option, mine, off) = mapping.amplified(gain), models[number]
        predict = lambda features, pose: louder.predict(features)  # noqa: E731
        energies = [
            bands.energy(decode_recording(layer, predict, atoms, run, r.where(slice(None, None, EVERY)))[1])
            for run, r in zip(runs, mine, strict=True)
        ]
        total = np.concatenate(energies).mean(axis=0)
        rows.append(
            {
                "model": number,
                "spectrum_error": float(np.sqrt((np.log(_with_sum(total) / _with_sum(wanted)) ** 2).mean())),
                "squeeze": option.squeeze,
                "shear_scale": option.shear_scale,
                "bend_scale": option.bend_scale,
                "gain": gain,
                "excess": float((total / wanted).max()),
                **off,
            }
        )

    def best() -> dict[str, float]:
        least = min(row["apart_mm"] for row in rows)
        for row in rows:
            lost = np.log((row["apart_mm"] + CHAOS) / (least + CHAOS))
            row["error"] = float(np.hypot(row["spectrum_error"], lost))
        fitting = [row for row in rows if row["gain"] == gains[0] or row["excess"] <= EXCESS]
        return min(fitting, key=lambda row: row["error"])

    own = runs[0].options  # with the fabric itself calibration is compared
    run_all([replace(own, squeeze=squeeze, shear_scale=shear) for squeeze, shear in itertools.product(SQUEEZE, SHEAR)])
    chosen = models[int(best()["model"])][0]
    run_all([replace(chosen, bend_scale=bend) for bend in BEND])
    chosen = models[int(best()["model"])][0]
    if chosen.bend_scale != 1.0:
        run_all([replace(chosen, shear_scale=shear) for shear in SHEAR if shear != chosen.shear_scale])
    first = int(best()["model"])
    for gain in gains:
        if gain not in gains[::SKIPPED]:
            judge(first, gain)
    plain, kept = rows[0], best()
    return Calibration(
        models[int(kept["model"])][0],
        kept["gain"],
        plain["shift"],
        kept["shift"],
        plain["mismatch"],
        kept["mismatch"],
        tuple(rows),
    )


def _apart(some: Sequence[Recording], others: Sequence[Recording]) -> float:
    """Root mean square distance of two coarse garments [m]."""
    squares = [((a.coarse - b.coarse) ** 2).sum(axis=2).ravel() for a, b in zip(some, others, strict=True)]
    return float(np.sqrt(np.concatenate(squares).mean()))


def _with_sum(energy: np.ndarray) -> np.ndarray:
    return np.append(energy, energy.sum())
