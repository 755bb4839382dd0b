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
from precompute.learning.decoding import by_features, decode_recording
from precompute.learning.recording import Recording, Run, record_runs
from precompute.learning.training import FeatureStatistics, Layer, features_of
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.dictionary import Atoms, Mapping
from wrinkles.gathers import Gathers
from wrinkles.metrics import normal_error_deg
from wrinkles.spectrum import BandedEnergy

__all__ = ["Calibration", "calibrate"]

SQUEEZE = (1.0, 10.0, 100.0)
SHEAR = (1.0, 0.3, 0.1)
BEND = (1.0, 3.0, 10.0)
NEIGHBOUR = 0.5  # weight of a model's neighbours in judging it
GAINS = (1.0, 1.25, 1.5)  # beyond that the spectrum may be better still, but lumps are seen
SKIPPED = 2
EXCESS = 1.2  # over the fine cloth's energy in an octave, from which on wrinkles are not raised: that is noise
EVERY = 16  # recorded frames from one that is decoded to the next: energy and error change slowly
CHAOS = 1.0  # how far apart two runs of one garment may be for no reason [mm, deg]
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
    gathers: Gathers | None = None,
) -> Calibration:
    """Try coarse models and gains on training motion and keep those that come nearest to the fine garment.

    Judged by three logarithms that count alike: bending energy in octave bands of wavelength, and in all of them
    together, of what is seen in the end and not of the coarse garment, root mean square of log(decoded / fine); how far
    the filtered coarse garment is from the filtered fine one, and how far the normals of what is seen are turned from
    the true ones, both over the least that any model comes to. The spectrum alone takes false folds of a coarse model
    that is too stiff under compression for wrinkles. These are raised only as far as no octave has more energy than the
    fine cloth's. Cloth is chaotic, and one run of a model may come out better or worse by a fifth for no reason: a
    model is judged together with its neighbours.

    Args:
        layer: of the garment.
        mapping, atoms: the dictionary.
        runs: fine training runs.
        recordings: what they gave.
        solver: of the coarse garment.
        bend_factor: hinge factor of the coarse mesh.
        cache, workers, report: as for :func:`precompute.learning.recording.record_runs`.
        gains: on the wrinkles, to choose from.
        gathers: of the coarse mesh.
    """
    recordings = [settled(r, run) for r, run in zip(recordings, runs, strict=True)]
    statistics = FeatureStatistics.of(np.concatenate([features_of(layer, r)[0] for r in recordings]))
    faces = layer.levels.fine.faces
    bands = BandedEnergy(layer.levels.rest_vertices, faces)
    whole = replace(runs[0], poses=np.concatenate([run.poses for run in runs]))  # set up once to decode all of them
    fine = _joined(recordings, runs).positions
    wanted = bands.energy(fine).mean(axis=0)
    matrix = CoarseFilter(layer.levels).matrix
    own = runs[0].options  # with the fabric itself calibration is compared
    models = [
        replace(own, compression_compliance_scale=squeeze, shear_scale=shear, bend_scale=bend)
        for squeeze, shear, bend in itertools.product(SQUEEZE, SHEAR, BEND)
    ]
    tries = [
        replace(run, fine=False, options=model, solver=solver, bend_factor=bend_factor, gathers=gathers)
        for model in models
        for run in runs
    ]
    found = record_runs(tries, cache, workers, report)
    coarse = [settled(filtered(r, matrix), run) for r, run in zip(found, tries, strict=True)]
    rows: list[dict[str, float]] = []

    def judge(number: int, some_gains: Sequence[float]) -> None:
        model, mine = models[number], coarse[number * len(runs) : (number + 1) * len(runs)]
        features = np.concatenate([features_of(layer, r)[0] for r in mine])
        off = {"shift": statistics.shift(features), "mismatch": statistics.mismatch(features)}
        off["apart_mm"] = 1e3 * _apart(mine, recordings)
        for gain in some_gains:
            predict = by_features(mapping.amplified(gain))
            _, decoded = decode_recording(layer, predict, atoms, whole, _joined(mine, runs))
            total = bands.energy(decoded).mean(axis=0)
            rows.append(
                {
                    "model": number,
                    "squeeze": model.compression_compliance_scale,
                    "shear_scale": model.shear_scale,
                    "bend_scale": model.bend_scale,
                    "gain": gain,
                    "spectrum_error": float(np.sqrt((np.log(_with_sum(total) / _with_sum(wanted)) ** 2).mean())),
                    "normal_error_deg": float(normal_error_deg(decoded, fine, faces).mean()),
                    "excess": float((total / wanted).max()),
                    **off,
                }
            )

    for number in range(len(models)):
        judge(number, gains[::SKIPPED])
        if report is not None:
            report(f"calibrating the coarse model: {number + 1} of {len(models)}")
    _rate(rows)
    first = min(_together(rows, gains[0]), key=lambda row: row["together"])["model"]
    judge(int(first), [gain for gain in gains if gain not in gains[::SKIPPED]])
    _rate(rows)
    fitting = [row for row in rows if row["model"] == first and (row["gain"] == gains[0] or row["excess"] <= EXCESS)]
    plain, kept = rows[0], min(fitting, key=lambda row: row["error"])
    return Calibration(
        models[int(kept["model"])],
        kept["gain"],
        plain["shift"],
        kept["shift"],
        plain["mismatch"],
        kept["mismatch"],
        tuple(rows),
    )


def _rate(rows: list[dict[str, float]]) -> None:
    """Give each row its error."""
    least = {name: min(row[name] for row in rows) for name in ("apart_mm", "normal_error_deg")}
    for row in rows:
        logs = [np.log((row[name] + CHAOS) / (value + CHAOS)) for name, value in least.items()]
        row["error"] = float(np.linalg.norm([row["spectrum_error"], *logs]))


def _together(rows: list[dict[str, float]], lowest: float) -> list[dict[str, float]]:
    """Rows that may be chosen, with the error that a model and its neighbours have together at one gain."""
    places = np.array(list(np.ndindex(len(SQUEEZE), len(SHEAR), len(BEND))))
    steps = np.abs(places[:, None] - places).sum(axis=2)
    weights = (steps == 0) + NEIGHBOUR * (steps == 1)
    weights /= weights.sum(axis=1, keepdims=True)
    chosen = []
    for gain in {row["gain"] for row in rows}:
        same = [row for row in rows if row["gain"] == gain]
        error, excess = (weights @ [row[name] for row in same] for name in ("error", "excess"))
        for row, one, other in zip(same, error, excess, strict=True):
            if gain == lowest or other <= EXCESS:
                chosen.append(row | {"together": float(one)})
    return chosen


def _joined(recordings: Sequence[Recording], runs: Sequence[Run]) -> Recording:
    """Some frames of all of them, counted on from run to run."""
    firsts = np.cumsum([0, *(len(run.poses) for run in runs)])
    some = [r.where(slice(None, None, EVERY)) for r in recordings]
    joined = {
        name: np.concatenate([getattr(r, name) for r in some]) for name in ("positions", "coarse", "contact", "nearest")
    }
    frames = np.concatenate([r.frames + first for r, first in zip(some, firsts, strict=False)])
    return replace(recordings[0], frames=frames, **joined)


def _apart(some: Sequence[Recording], others: Sequence[Recording]) -> float:
    """Root mean square distance of two coarse garments [m]."""
    squares = [((a.coarse - b.coarse) ** 2).sum(axis=2).ravel() for a, b in zip(some, others, strict=True)]
    return float(np.sqrt(np.concatenate(squares).mean()))


def _with_sum(energy: np.ndarray) -> np.ndarray:
    return np.append(energy, energy.sum())
