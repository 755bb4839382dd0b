"""Calibration: compression, shear and bending of the coarse model, chosen so that the coarse garment goes where the
fine one does and the decoded one folds as it does.

All models are tried on a few seconds of a few motions, the better third of them on more, and the last few on everything
(successive halving: Jamieson and Talwalkar 2016, "Non-stochastic Best Arm Identification and Hyperparameter
Optimization"). Most models are much worse than the best, and little motion shows that.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from pbd import ModelOptions, SolverOptions
from precompute.learning.decoding import bands_of, decode_recording, joined
from precompute.learning.options import LearningOptions
from precompute.learning.recording import Recording, Run, record_runs
from precompute.learning.stages import counted
from precompute.learning.training import FeatureStatistics, Layer, features_of
from precompute.workers import Workers
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.dictionary import Atoms, CoefficientNetwork
from wrinkles.metrics import normal_error_deg
from wrinkles.rest_shape import RestShapeCorrection

__all__ = ["Calibration", "CoarseModel", "calibrate", "filtered"]

KEPT = 3  # one in so many models goes on to the next rung, and no fewer than so many are tried on everything
NEIGHBOUR = 0.5  # weight of a model's neighbours in judging it
DECODED = 40  # frames that a model is decoded at, about: energy and error change slowly
FEATURES = 4  # recorded frames from one whose features are compared to the next
CHAOS = 1.0  # how far apart two runs of one garment may be for no reason [mm, deg]


def settled(recording: Recording, run: Run, settle_s: float) -> Recording:
    """What of a recording counts: not the blend from the bind pose, nor what only leads to the motion."""
    return recording.where(recording.frames * run.dt > max(settle_s, run.lead_in))


def filtered(recording: Recording, matrix: csr_matrix) -> Recording:
    """A coarse run as the dictionary sees it."""
    return replace(recording, coarse=np.stack([matrix @ frame for frame in recording.coarse]).astype(np.float32))


@dataclass(frozen=True)
class Calibration:
    """What was found.

    Attributes:
        options: of the coarse model.
        shift_before, shift_after: root mean squared Mahalanobis distance of the coarse run's features from the mean of
            the filtered fine run's, per dimension [-]; the fine run's own is one.
        mismatch_before, mismatch_after: Frechet distance of their distributions, per dimension [-].
        rows: every setting tried; ``rung`` counts from zero.
    """

    options: ModelOptions
    shift_before: float
    shift_after: float
    mismatch_before: float
    mismatch_after: float
    rows: tuple[dict[str, float], ...]


@dataclass(frozen=True)
class CoarseModel:
    """What the coarse garment has whatever is calibrated.

    Attributes:
        solver: its solver.
        bend_factor: hinge factor of its mesh.
        rest_shape: corrections of the rest shape of its mesh.
    """

    solver: SolverOptions
    bend_factor: float
    rest_shape: RestShapeCorrection | None = None

    def run(self, run: Run, options: ModelOptions) -> Run:
        """A fine run's motion for the coarse garment."""
        return replace(
            run,
            fine=False,
            options=options,
            solver=self.solver,
            bend_factor=self.bend_factor,
            rest_shape=self.rest_shape,
        )


def calibrate(
    layer: Layer,
    mapping: CoefficientNetwork,
    atoms: Atoms,
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    coarse: CoarseModel,
    cache: Path,
    workers: Workers,
    options: LearningOptions,
    report: Callable[[str], None] | None = None,
) -> Calibration:
    """Try coarse models on training motion and keep the one that comes nearest to the fine garment.

    Judged by three logarithms that count alike: bending energy in octave bands of wavelength, and in all of them
    together, of the decoded garment and not of the coarse one, root mean square of log(decoded / fine); how far
    the filtered coarse garment is from the filtered fine one, and how far the normals of the decoded garment are turned
    from the true ones, both over the least that any model comes to. The spectrum alone takes false folds of a coarse
    model that is too stiff under compression for wrinkles. Cloth is chaotic, and one run of a model may come out better
    or worse by a fifth for no reason: a model is judged together with its neighbours, as far as they are tried as long
    as it is.

    Args:
        layer: of the garment.
        mapping, atoms: the dictionary.
        runs: fine training runs.
        recordings: of these runs.
        coarse: what all coarse models have in common.
        cache: folder of recorded runs.
        workers: that simulate and decode.
        options: models and times.
        report: called with lines of progress.
    """
    models = _models(runs[0].options, options)
    neighbours = _neighbours(options)
    sizes = [len(models)]
    while sizes[-1] > KEPT:
        sizes.append(-(-sizes[-1] // KEPT))
    alive, rows = list(range(len(models))), []
    for rung in range(len(sizes)):
        share = (rung + 1) / len(sizes)
        bench = _Bench.of(layer, mapping, atoms, runs, recordings, coarse, cache, options, share)
        tried = alive if 0 in alive else [0, *alive]  # the fabric itself is compared with to the end
        tell = counted(report, f"calibrating, round {rung + 1} of {len(sizes)}: models", len(tried))
        jobs = [partial(_judge, bench, number, models[number]) for number in tried]
        found = workers.run(jobs, done=tell)
        here = [row | {"rung": float(rung)} for row in found]
        _rate(here)
        rows += here
        # The fabric itself is a neighbour only as long as it may be chosen: it would count against some models alone.
        together = _together([row for row in here if row["model"] in alive], neighbours)
        alive = sorted(alive, key=lambda number: together[number])[: sizes[rung + 1] if rung + 1 < len(sizes) else 1]
        alive.sort()
    (first,) = alive
    plain, kept = here[0], next(row for row in here if row["model"] == first)
    shifts, mismatches = ((plain[name], kept[name]) for name in ("shift", "mismatch"))
    return Calibration(models[first], *shifts, *mismatches, tuple(rows))


@dataclass(frozen=True)
class _Bench:
    """What models are tried on in one rung.

    Attributes:
        layer, mapping, atoms, coarse, cache, settle_s: as for :func:`calibrate`.
        runs: of the motions that are played, as far as they are.
        recordings: settled frames of the fine garment.
        fine: some of them [m], float32, shape (f, N, 3).
        every: recorded frames from one of these to the next.
        statistics: of the features of the filtered fine garment.
        wanted: bending energy of the fine garment in octave bands, shape (b,).
    """

    layer: Layer
    mapping: CoefficientNetwork
    atoms: Atoms
    coarse: CoarseModel
    cache: Path
    settle_s: float
    runs: list[Run]
    recordings: list[Recording]
    fine: np.ndarray
    every: int
    statistics: FeatureStatistics
    wanted: np.ndarray

    @classmethod
    def of(
        cls,
        layer: Layer,
        mapping: CoefficientNetwork,
        atoms: Atoms,
        runs: Sequence[Run],
        recordings: Sequence[Recording],
        coarse: CoarseModel,
        cache: Path,
        options: LearningOptions,
        share: float,
    ) -> _Bench:
        """Some of the motions, as far as a share of all of them and of their time goes."""
        seconds = options.settle_s + share * (options.calibration_s - options.settle_s)
        numbers = np.unique(np.linspace(0, len(runs) - 1, max(1, round(share * len(runs)))).round().astype(int))
        cut = [replace(runs[k], poses=runs[k].poses[: round(seconds / runs[k].dt) + 1]) for k in numbers]
        parts = [
            recordings[k].where(recordings[k].frames <= run.frame_count) for k, run in zip(numbers, cut, strict=True)
        ]
        parts = [settled(r, run, options.settle_s) for r, run in zip(parts, cut, strict=True)]
        every = max(1, sum(len(r.frames) for r in parts) // DECODED)
        fine = np.concatenate([r.positions[::every] for r in parts])
        features = [features_of(layer, r.where(slice(None, None, FEATURES)))[0] for r in parts]
        return cls(
            layer, mapping, atoms, coarse, cache, options.settle_s, cut,
            [replace(r, positions=r.positions[:0]) for r in parts],
            fine, every,
            FeatureStatistics.of(np.concatenate(features)),
            bands_of(layer.levels).energy(fine).mean(axis=0),
        )  # fmt: skip


def _judge(bench: _Bench, number: int, model: ModelOptions) -> dict[str, float]:
    """Simulate a coarse model and decode it."""
    layer, tries = bench.layer, [bench.coarse.run(run, model) for run in bench.runs]
    matrix = CoarseFilter(layer.levels).matrix
    found = record_runs(tries, bench.cache, 1)
    mine = [settled(filtered(r, matrix), run, bench.settle_s) for r, run in zip(found, tries, strict=True)]
    features = np.concatenate([features_of(layer, r.where(slice(None, None, FEATURES)))[0] for r in mine])
    off = {
        "shift": bench.statistics.shift(features),
        "mismatch": bench.statistics.mismatch(features),
        "apart_mm": 1e3 * _apart(mine, bench.recordings),
    }
    whole, some = joined(tries, [r.where(slice(None, None, bench.every)) for r in mine])
    _, decoded = decode_recording(layer, bench.mapping.predict, bench.atoms, whole, some)
    total = bands_of(layer.levels).energy(decoded).mean(axis=0)
    return {
        "model": number,
        "squeeze": model.compression_compliance_scale,
        "shear_scale": model.shear_scale,
        "bend_scale": model.bend_scale,
        "spectrum_error": float(np.sqrt((np.log(_with_sum(total) / _with_sum(bench.wanted)) ** 2).mean())),
        "normal_error_deg": float(normal_error_deg(decoded, bench.fine, layer.levels.fine.faces).mean()),
        **off,
    }


def _rate(rows: list[dict[str, float]]) -> None:
    """Give each row its error."""
    least = {name: min(row[name] for row in rows) for name in ("apart_mm", "normal_error_deg")}
    for row in rows:
        logs = [np.log((row[name] + CHAOS) / (value + CHAOS)) for name, value in least.items()]
        row["error"] = float(np.linalg.norm([row["spectrum_error"], *logs]))


def _models(own: ModelOptions, options: LearningOptions) -> list[ModelOptions]:
    """The coarse models that are tried; the first is the fabric itself, with which calibration is compared."""
    grid = itertools.product(options.compression_scales, options.shear_scales, options.bend_scales)
    return [
        replace(own, compression_compliance_scale=squeeze, shear_scale=shear, bend_scale=bend)
        for squeeze, shear, bend in grid
    ]


def _neighbours(options: LearningOptions) -> np.ndarray:
    """How much each model counts in judging each other one, shape (models, models)."""
    scales = options.compression_scales, options.shear_scales, options.bend_scales
    places = np.array(list(np.ndindex(*(len(some) for some in scales))))
    steps = np.abs(places[:, None] - places).sum(axis=2)
    return (steps == 0) + NEIGHBOUR * (steps == 1)


def _together(rows: list[dict[str, float]], neighbours: np.ndarray) -> dict[int, float]:
    """The error that each model and its neighbours have together."""
    numbers = [int(row["model"]) for row in rows]
    weights = neighbours[np.ix_(numbers, numbers)]
    errors = (weights / weights.sum(axis=1, keepdims=True)) @ [row["error"] for row in rows]
    return dict(zip(numbers, errors.tolist(), strict=True))


def _apart(some: Sequence[Recording], others: Sequence[Recording]) -> float:
    """Root mean square distance of two coarse garments [m]."""
    squares = [((a.coarse - b.coarse) ** 2).sum(axis=2).ravel() for a, b in zip(some, others, strict=True)]
    return float(np.sqrt(np.concatenate(squares).mean()))


def _with_sum(energy: np.ndarray) -> np.ndarray:
    return np.append(energy, energy.sum())
