"""Calibration: compression, shear and bending of the coarse model, chosen so that the coarse garment goes where the
fine one does and the decoded one folds as it does.
"""

from __future__ import annotations

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

LEAST_GAIN = 0.2  # a model whose error is smaller than the fabric's by a smaller share is so by chance
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
        rows: every model tried.
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
    or worse by a fifth for no reason: another model than the fabric itself must be better by more.

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
    models = [
        replace(runs[0].options, compression_compliance_scale=squeeze, shear_scale=shear, bend_scale=bend)
        for squeeze, shear, bend in options.coarse_models
    ]
    bench = _Bench.of(layer, mapping, atoms, runs, recordings, coarse, cache, options)
    tell = counted(report, "calibrating: models", len(models))
    rows = workers.run([partial(_judge, bench, model) for model in models], done=tell)
    _rate(rows)
    best = int(np.argmin([row["error"] for row in rows]))
    chosen = best if rows[best]["error"] < (1.0 - LEAST_GAIN) * rows[0]["error"] else 0
    shifts, mismatches = ((rows[0][name], rows[chosen][name]) for name in ("shift", "mismatch"))
    return Calibration(models[chosen], *shifts, *mismatches, tuple(rows))


@dataclass(frozen=True)
class _Bench:
    """What models are tried on.

    Attributes:
        layer, mapping, atoms, coarse, cache, settle_s: as for :func:`calibrate`.
        runs: of the motions, as far as they are played.
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
    ) -> _Bench:
        """The beginnings of all motions."""
        cut = [replace(run, poses=run.poses[: round(options.calibration_s / run.dt) + 1]) for run in runs]
        parts = [r.where(r.frames <= run.frame_count) for r, run in zip(recordings, cut, strict=True)]
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


def _judge(bench: _Bench, model: ModelOptions) -> dict[str, float]:
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


def _apart(some: Sequence[Recording], others: Sequence[Recording]) -> float:
    """Root mean square distance of two coarse garments [m]."""
    squares = [((a.coarse - b.coarse) ** 2).sum(axis=2).ravel() for a, b in zip(some, others, strict=True)]
    return float(np.sqrt(np.concatenate(squares).mean()))


def _with_sum(energy: np.ndarray) -> np.ndarray:
    return np.append(energy, energy.sum())
