"""`gube precompute`: from a scene to a wrinkle database."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from assets.io.scene import Scene, scene_text
from pbd import Fabric, InputError, ModelOptions, SolverOptions
from pbd.bending import hinge_calibration
from precompute.learning.calibration import GAINS, Calibration, calibrate
from precompute.learning.coverage import PART, choose
from precompute.learning.decoding import by_features, with_vertex_mean
from precompute.learning.evaluation import Evaluation, Truth, evaluate, fine_run, given_frames, settled, truth_of
from precompute.learning.recording import Recording, Run, body_source, record_runs
from precompute.learning.training import Layer, build_layer, fit_layer, spread_frames, training_set
from precompute.learning.unfamiliarity import fit_unfamiliarity
from runtime.simulation import Motion
from runtime.stage import Stage, colliders_of, fabrics_of
from wrinkles.charts import leading_vertices
from wrinkles.database import LearnedFabric, WrinkleDatabase, as_stored, body_hash, code_version, write_database
from wrinkles.dictionary import fabric_features
from wrinkles.gathers import Gathers
from wrinkles.metrics import given_coarse_figures

__all__ = [
    "EPOCHS",
    "TRAINING_FRAMES",
    "Precomputed",
    "default_cache",
    "epochs_for",
    "precompute",
    "scene_run",
    "training_motions",
    "training_recordings",
    "training_runs",
]

CALIBRATION_SECONDS = 6.0  # of each motion, to calibrate on: enough to see it move, short enough to try many models
TRAINING_FRAMES = 2400
EPOCHS = 12
MOST_EPOCHS = 48  # where there are few frames


@dataclass(frozen=True)
class Precomputed:
    """What came out.

    Attributes:
        database: as written.
        path: where.
        calibration: of the coarse model in the garment's own fabric.
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
    options: ModelOptions
    solver: SolverOptions
    frame_rate: float


def default_cache(output: Path) -> Path:
    """Where simulated runs are kept: beside the database."""
    return output.parent / ".gube-cache"


@threadpool_limits.wrap(limits=1, user_api="blas")  # small systems: more threads only wait for each other
def precompute(
    scene: Scene,
    output: str | Path,
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
    began, output = time.monotonic(), Path(output)
    tell = report or (lambda line: None)
    stage = Stage.of(scene)
    cache = cache or default_cache(output)
    training = scene.training
    overlap = [m for m in training.held_out if any(m.overlaps(other) for other in training.clips)]
    if overlap:
        clips = sorted(f"{m.file}: {m.name}" for m in overlap)
        raise InputError("a held-out clip is trained on", key="training.held_out", received=clips, expected="another")
    held_out = [stage.motion(m) for m in scene.training.held_out]  # refused now, and not after the simulations
    levels, seed, solver = stage.levels, scene.wrinkles.seed, scene.solver.options()
    fabrics = fabrics_of(scene, stage.settings)
    layer = build_layer(levels)
    motions, choice = training_motions(layer, stage, scene, cache, workers, tell)
    runs = [scene_run(stage, scene, motion, name) for name in fabrics for motion in motions]
    recordings = training_recordings(runs, cache, workers, tell)

    tell("fitting patches")
    learned = spread_frames(recordings, TRAINING_FRAMES)
    data = training_set(layer, learned, scene.wrinkles.atoms, seed)
    width, own = scene.wrinkles.hidden_width, runs[0].fabric
    hidden = (8 * width // 3, width)
    worn = [fabric_features(run.fabric, own) for run in runs]
    told = np.repeat(worn, [len(recording.frames) for recording in learned], axis=0)
    epochs = epochs_for(len(data.features))
    mapping = fit_layer(layer, data, hidden=hidden, epochs=epochs, seed=seed, report=tell, fabrics=told)
    mappings = [mapping.for_fabric(features) for features in worn]
    atoms = with_vertex_mean(layer, [by_features(one) for one in mappings], data.atoms, runs, learned)

    coarse_bend = hinge_calibration(levels.coarse)
    gathers = Gathers.none(levels.coarse.faces)
    if levels.subdivision.binding is not None:  # sewn as it came, perhaps in pleats
        gathers = Gathers.of(levels.coarse, np.concatenate([recording.coarse for recording in learned]))
    calibrations: dict[str, Calibration] = {}
    for first, name in zip(range(0, len(runs), len(motions)), fabrics, strict=True):
        shorts = _excerpts(runs[first : first + len(motions)])
        excerpts = [_start_of(recordings[first + number], short) for number, short in enumerate(shorts)]
        # The own fabric comes first and chooses how strongly wrinkles are drawn; the others share its network.
        gains = (1.0,) if calibrations else GAINS
        calibrations[name] = calibrate(
            layer, mapping.for_fabric(worn[first]), atoms, shorts, excerpts, solver, coarse_bend, cache, workers,
            tell, gains, gathers,
        )  # fmt: skip
        mapping = mapping.amplified(calibrations[name].gain)
    mappings = [mapping.for_fabric(features) for features in worn]
    atoms = with_vertex_mean(layer, [by_features(one) for one in mappings], atoms, runs, learned)  # of what is raised
    own_name, *others = fabrics
    calibration = calibrations[own_name]
    database = WrinkleDatabase(
        garment_name=stage.settings.name,
        coarse_vertices=levels.coarse.vertices,
        coarse_faces=levels.coarse.faces,
        gathers=gathers,
        subdivisions=stage.settings.subdivisions,
        held=levels.coarse_held.astype(np.int32),
        limits=levels.coarse_limits,
        warp=(0.0, 1.0, 0.0),
        binding=levels.subdivision.binding,
        fabric_name=own_name,
        fabric=own,
        options=calibration.options,
        other_fabrics=tuple(LearnedFabric(name, fabrics[name], calibrations[name].options) for name in others),
        bend_factor=coarse_bend,
        solver=solver,
        frame_rate=scene.solver.frame_rate,
        atoms=atoms,
        mapping=mapping,
        unfamiliarity=fit_unfamiliarity(layer, mappings, atoms, runs, recordings, seed),
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
    truth, evaluation, quality = None, None, dict(choice)
    if held_out:  # the first held-out clip is the one that is reported
        run = scene_run(stage, scene, held_out[0])
        truth = truth_of(run, cache, workers, tell)
        evaluation = evaluate(database, truth, cache, tell)
        quality |= evaluation.figures
        for other in database.other_fabrics:
            run = scene_run(stage, scene, held_out[0], other.name)
            given = _given_figures(database.in_fabric(other.name), run, cache, workers, tell)
            quality |= {f"{other.name}_{name}": value for name, value in given.items()}
    quality |= {
        "feature_shift_before": calibration.shift_before,
        "feature_shift_after": calibration.shift_after,
        "feature_mismatch_before": calibration.mismatch_before,
        "feature_mismatch_after": calibration.mismatch_after,
        "wrinkle_gain": calibration.gain,
        "atoms_kept": atoms.kept,
    }
    database = replace(database, quality=quality, training_minutes=(time.monotonic() - began) / 60.0)
    write_database(output, database)
    return Precomputed(database, output, calibration, truth, evaluation)


def epochs_for(frame_count: int) -> int:
    """Passes over the training frames: ``EPOCHS`` from half of ``TRAINING_FRAMES`` on, as much learning from fewer."""
    return max(EPOCHS, min(MOST_EPOCHS, EPOCHS * TRAINING_FRAMES // (2 * frame_count)))


def training_motions(
    layer: Layer, stage: Stage, scene: Scene, cache: Path, workers: int, report: Callable[[str], None] | None = None
) -> tuple[list[Motion], dict[str, float]]:
    """The motions that a scene learns from: all that it names, or the parts of them that add most.

    Returns:
        the motions, and figures of the choice, none where all are taken.

    Raises:
        InputError: nothing to learn from, or more seconds to choose than there are, or fewer than a part has.
    """
    budget = scene.training.choose_s
    motions = stage.training_motions() if budget is None else stage.training_parts(PART)
    if not motions:
        raise InputError("nothing to learn from", key="training", expected="clips or procedural_seconds")
    if budget is None:
        return motions, {}
    offered = [motion.duration for motion in motions]
    if not min(offered) <= budget < sum(offered):
        expected = f"at least {min(offered):.3g} (a part), below {sum(offered):.3g} (all) [s]"
        raise InputError("nothing to choose", key="training.choose_s", received=budget, expected=expected)
    runs = [scene_run(stage, scene, motion) for motion in motions]
    held_out = [scene_run(stage, scene, stage.motion(m)) for m in scene.training.held_out[:1]]
    solver, seed = scene.solver.options(), scene.wrinkles.seed
    found = choose(layer, runs, next(iter(held_out), None), budget, solver, seed, cache, workers, report)
    if report is not None:
        figures = found.figures
        report(f"choosing motion: {figures['chosen_s']:.0f} s of {figures['offered_s']:.0f} s on offer")
    return [motions[number] for number in found.numbers], found.figures


def training_runs(
    layer: Layer, stage: Stage, scene: Scene, cache: Path, report: Callable[[str], None] | None
) -> list[Run]:
    """The fine runs that a scene learns from, in the garment's own fabric."""
    motions, _ = training_motions(layer, stage, scene, cache, 2, report)
    return [scene_run(stage, scene, motion) for motion in motions]


def training_recordings(
    runs: list[Run], cache: Path, workers: int, report: Callable[[str], None] | None = None
) -> list[Recording]:
    """What the runs that a scene learns from gave, without what only leads to the motions that are meant."""
    recordings = record_runs(runs, cache, workers, report)
    return [r.where(r.frames * run.dt > run.lead_in) for r, run in zip(recordings, runs, strict=True)]


def scene_run(stage: Stage, scene: Scene, motion: Motion, fabric: str | None = None) -> Run:
    """The fine run of a motion under a scene's settings, in one of its fabrics; None takes the garment's own."""
    fabrics = fabrics_of(scene, stage.settings)
    worn = fabrics[next(iter(fabrics)) if fabric is None else fabric]
    options = ModelOptions(pressure=stage.settings.pressure)
    settings = _Settings(worn, options, scene.solver.options(), scene.solver.frame_rate)
    return fine_run(stage.levels, stage.body, motion, settings, wind=scene.wind.air(), primitives=colliders_of(scene))


def _given_figures(
    database: WrinkleDatabase, run: Run, cache: Path, workers: int, report: Callable[[str], None]
) -> dict[str, float]:
    """What the dictionary makes of the coarse states of a fine run: error and skill of its normals."""
    (recording,) = record_runs([run], cache, workers, report)
    recording = settled(recording, run)
    smooth, decoded, _ = given_frames(database, run, recording)
    owner = leading_vertices(run.levels.subdivision)[:, 0]
    figures = given_coarse_figures(decoded, recording.positions, smooth, run.levels.fine.faces, owner)
    return {name: float(figures[name]) for name in ("normal_error_deg", "normal_error_smooth_deg", "normal_skill")}


def _excerpts(runs: list[Run]) -> list[Run]:
    """The start of each training run, to calibrate on."""
    return [replace(run, poses=run.poses[: round(CALIBRATION_SECONDS / run.dt) + 1]) for run in runs]


def _start_of(recording: Recording, run: Run) -> Recording:
    """A recording as far as a shortened run goes."""
    return recording.where(recording.frames <= run.frame_count)
