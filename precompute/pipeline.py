"""`gube precompute`: from a scene to a wrinkle database."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from assets.scene import Scene, scene_text
from pbd import Fabric, InputError, SolverOptions
from pbd.bending import hinge_calibration
from precompute.calibration import Calibration, calibrate
from precompute.evaluation import Evaluation, Truth, evaluate, fine_run, truth_of
from precompute.recording import Recording, Run, body_source, record_runs
from precompute.training import build_layer, fit_layer, spread_frames, training_set
from precompute.unfamiliarity import fit_unfamiliarity
from runtime.simulation import Motion
from runtime.stage import Stage, fabric_of
from wrinkles.database import WrinkleDatabase, as_stored, body_hash, code_version, write_database

__all__ = [
    "EPOCHS",
    "TRAINING_FRAMES",
    "Precomputed",
    "default_cache",
    "precompute",
    "scene_run",
    "training_recordings",
    "training_runs",
]

CALIBRATION_SECONDS = (
    6.0  # motion that the coarse model is calibrated on: enough to see it move, short enough to try many
)
TRAINING_FRAMES = 2400
EPOCHS = 8


@dataclass(frozen=True)
class Precomputed:
    """What came out.

    Attributes:
        database: as written.
        path: where.
        calibration: of the coarse model.
        truth: of the first held-out motion, None without one.
        evaluation: of the database on it.
    """

    database: WrinkleDatabase
    path: Path
    calibration: Calibration
    truth: Truth | None
    evaluation: Evaluation | None


@dataclass(frozen=True)
class _Settings:
    fabric: Fabric
    solver: SolverOptions
    frame_rate: float

    @classmethod
    def of(cls, stage: Stage, scene: Scene) -> _Settings:
        return cls(fabric_of(stage.settings), scene.solver.options(), scene.solver.frame_rate)


def default_cache(output: Path) -> Path:
    """Where simulated runs are kept: beside the database."""
    return output.parent / ".gube-cache"


@threadpool_limits.wrap(limits=1, user_api="blas")  # small systems: more threads only wait for each other
def precompute(
    scene: Scene,
    output: Path,
    *,
    cache: Path | None = None,
    workers: int = 2,
    report: Callable[[str], None] | None = None,
) -> Precomputed:
    """Simulate, calibrate, learn, judge and write.

    Fine runs are cached by content and go on where they were cut off; everything after them is repeated from the
    same seed, so that an interrupted call gives the same database.

    Args:
        scene: one garment on one body, with training and held-out motion.
        output: the database to write.
        cache: folder of simulated runs; None keeps them beside the database.
        workers: processes that simulate.
        report: told lines of progress.

    Raises:
        InputError: a scene that names nothing to learn from, a held-out motion that is trained on too, and whatever
            cannot be loaded.
    """
    began = time.monotonic()
    tell = report or (lambda line: None)
    stage = Stage.of(scene)
    cache = cache or default_cache(output)
    training = scene.training
    overlap = [m for m in training.held_out if any(m.overlaps(other) for other in training.clips)]
    if overlap:
        clips = sorted(f"{m.file}: {m.name}" for m in overlap)
        raise InputError("a held-out clip is trained on", key="training.held_out", received=clips, expected="another")
    motions = stage.training_motions()
    if not motions:
        raise InputError("nothing to learn from", key="training", expected="clips or procedural_seconds")
    held_out = [stage.motion(m) for m in scene.training.held_out]  # refused now, and not after the simulations
    levels, seed, settings = stage.levels, scene.wrinkles.seed, _Settings.of(stage, scene)
    runs = training_runs(stage, scene)
    recordings = training_recordings(runs, cache, workers, tell)

    tell("fitting patches")
    layer = build_layer(levels)
    data = training_set(layer, spread_frames(recordings, TRAINING_FRAMES), scene.wrinkles.atoms, seed)
    width = scene.wrinkles.hidden_width
    mapping = fit_layer(layer, data, hidden=(2 * width, width), epochs=EPOCHS, seed=seed, report=tell)

    coarse_bend = hinge_calibration(levels.coarse)
    chosen = _excerpts(runs)
    excerpts = [_start_of(recordings[number], short) for number, short in chosen]
    shorts = [short for _, short in chosen]
    calibration = calibrate(
        layer, mapping, data.atoms, shorts, excerpts, settings.solver, coarse_bend, cache, workers, tell
    )
    database = WrinkleDatabase(
        garment_name=stage.settings.name,
        coarse_vertices=levels.coarse.vertices,
        coarse_faces=levels.coarse.faces,
        subdivisions=stage.settings.subdivisions,
        held=levels.coarse_held.astype(np.int32),
        warp=(0.0, 1.0, 0.0),
        binding=levels.subdivision.binding,
        fabric=settings.fabric,
        options=calibration.options,
        bend_factor=coarse_bend,
        solver=settings.solver,
        frame_rate=settings.frame_rate,
        atoms=data.atoms,
        mapping=mapping,
        unfamiliarity=fit_unfamiliarity(layer, mapping, data.atoms, runs, recordings, seed),
        cutoff=levels.cutoff,
        body_hash=body_hash(stage.body),
        body_vertex_count=len(body_source(stage.body).vertices),
        quality={},
        held_out=tuple(m.name for m in scene.training.held_out),
        trained_on=tuple(m.name for m in motions),
        training_minutes=0.0,
        seed=seed,
        scene=scene_text(scene),
        code_version=code_version(),
        created=date.today().isoformat(),
    )
    database = as_stored(database)  # judged as it will be played
    truth, evaluation, quality = None, None, {}
    if held_out:  # the first held-out clip is the one that is reported
        run = scene_run(stage, scene, held_out[0])
        truth = truth_of(run, cache, workers, tell)
        evaluation = evaluate(database, truth, cache, tell)
        quality = dict(evaluation.figures)
    quality |= {
        "feature_shift_before": calibration.shift_before,
        "feature_shift_after": calibration.shift_after,
        "feature_mismatch_before": calibration.mismatch_before,
        "feature_mismatch_after": calibration.mismatch_after,
        "atoms_kept": data.atoms.kept,
    }
    database = replace(database, quality=quality, training_minutes=(time.monotonic() - began) / 60.0)
    write_database(output, database)
    return Precomputed(database, output, calibration, truth, evaluation)


def training_runs(stage: Stage, scene: Scene) -> list[Run]:
    """The fine runs that a scene learns from."""
    return [scene_run(stage, scene, motion) for motion in stage.training_motions()]


def training_recordings(
    runs: list[Run], cache: Path, workers: int, report: Callable[[str], None] | None = None
) -> list[Recording]:
    """What the runs that a scene learns from gave, without what only leads to the motions that are meant."""
    recordings = record_runs(runs, cache, workers, report)
    return [r.where(r.frames * run.dt > run.lead_in) for r, run in zip(recordings, runs, strict=True)]


def scene_run(stage: Stage, scene: Scene, motion: Motion) -> Run:
    """The fine run of a motion under a scene's settings."""
    settings = _Settings.of(stage, scene)
    return fine_run(stage.levels, stage.body, motion, settings, wind=scene.wind.velocity, primitives=scene.primitives)


def _excerpts(runs: list[Run]) -> list[tuple[int, Run]]:
    """The start of the first and the last training run, to calibrate on: number and shortened run."""
    cut = lambda run: run.poses[: round(CALIBRATION_SECONDS / run.dt) + 1]  # noqa: E731
    return [(number, replace(runs[number], poses=cut(runs[number]))) for number in sorted({0, len(runs) - 1})]


def _start_of(recording: Recording, run: Run) -> Recording:
    """A recording as far as a shortened run goes."""
    return recording.where(recording.frames <= run.frame_count)
