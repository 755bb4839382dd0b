"""`gube precompute`: from a scene to a wrinkle database."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import cache
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from assets.io.scene import Scene, scene_text
from assets.motion import Motion
from pbd import Fabric, InputError, ModelOptions, SolverOptions
from pbd.bending import hinge_calibration
from precompute.learning.crossed import WHOLE, crossed_figures, crossed_jobs, crossed_words, joined_crossed
from precompute.learning.decoding import with_vertex_mean
from precompute.learning.evaluation import Evaluation, evaluate, given_frames
from precompute.learning.kept import Kept
from precompute.learning.novelty_fit import fit_novelty
from precompute.learning.options import LearningOptions
from precompute.learning.run_recording import Recording, Run, record_runs
from precompute.learning.stages import StageClock, StageTime, counted
from precompute.learning.training import Layer, TrainingSet, build_layer, fit_layer, spread_frames, training_set
from precompute.learning.truth import SETTLE, Truth, fine_run, settled, truth_of, truth_runs
from precompute.workers import Workers
from runtime.output.report import processor_name
from runtime.play.simulation import body_source
from runtime.setup.garment_mesh import texture_of
from runtime.setup.garment_setup import GarmentSetup, colliders_of, fabrics_of, fine_options
from wrinkles.charts import leading_vertices
from wrinkles.database import WrinkleDatabase, body_hash, code_version
from wrinkles.database_file import as_stored, write_database
from wrinkles.dictionary import Atoms, CoefficientNetwork
from wrinkles.metrics import given_coarse_figures
from wrinkles.novelty import NoveltyScore
from wrinkles.rest_shape import RestShapeCorrection

__all__ = [
    "STAGES",
    "Precomputed",
    "default_cache",
    "precompute",
    "scene_run",
    "training_recordings",
    "training_run",
]

DEFAULT = LearningOptions()
SHORTEST = 0.1  # part of a held-out motion that is judged at least [s]
STAGES = (
    "simulating", "fitting patches", "fitting", "means of vertices", "unfamiliarity", "evaluating",
)  # fmt: skip


@dataclass(frozen=True)
class Precomputed:
    """What came out.

    Attributes:
        database: as written.
        path: where.
        truth: of the first held-out motion, None without one.
        evaluation: of the database on it.
        stages: where the time went.
    """

    database: WrinkleDatabase
    path: Path
    truth: Truth | None
    evaluation: Evaluation | None
    stages: tuple[StageTime, ...] = ()


@dataclass(frozen=True)
class _Settings:
    fabric: Fabric
    options: ModelOptions
    solver: SolverOptions
    frame_rate: float


@dataclass(frozen=True)
class _Example:
    """A fine run that is learned from.

    Attributes:
        fabric: name of the fabric that is worn.
        run: the run.
        recording: of it, without what only leads to the motion.
        crossed: how much its cloth goes through itself, see :func:`joined_crossed`.
    """

    fabric: str
    run: Run
    recording: Recording
    crossed: np.ndarray


@dataclass(frozen=True)
class _Work:
    """What all stages of a precompute need.

    Attributes:
        scene, stage: what is learned.
        layer: of the garment.
        fabrics: by name, the garment's own first.
        cache: folder of simulated runs.
        workers: of all stages.
        clock: times the stages, and reports.
        options: how much is done.
    """

    scene: Scene
    stage: GarmentSetup
    layer: Layer
    fabrics: dict[str, Fabric]
    cache: Path
    workers: Workers
    clock: StageClock
    options: LearningOptions

    @property
    def seed(self) -> int:
        return self.scene.wrinkles.seed

    @property
    def own_fabric(self) -> str:
        return next(iter(self.fabrics))

    def run(self, motion: Motion, fabric: str | None = None) -> Run:
        return scene_run(self.stage, self.scene, motion, fabric)


def default_cache(output: Path) -> Path:
    """Where simulated runs are kept: beside the database."""
    return output.parent / ".gube-cache"


@threadpool_limits.wrap(limits=1, user_api="blas")  # small systems: more threads only wait for each other
def precompute(
    scene: Scene,
    output: str | Path,
    *,
    cache: Path | None = None,
    workers: Workers | int = 2,
    report: Callable[[str], None] | None = None,
    options: LearningOptions = DEFAULT,
    clock: StageClock | None = None,
) -> Precomputed:
    """Simulate, learn, judge and write.

    Fine runs are cached by content and go on where they were cut off, and so is what each stage after them gives: an
    interrupted call gives the same database. It is the same for any number of workers, too.

    Args:
        scene: one garment on one body, with training and held-out motion.
        output, cache: the database to write; the folder of simulated runs, None keeps them beside it.
        workers: processes that simulate and decode, or how many of them there are to be.
        report: called with lines of progress.
        options: how much is done.
        clock: of a longer work that STAGES are a part of; None times STAGES alone.

    Raises:
        InputError: nothing to learn from, a held-out motion that is trained on too, or a file that cannot be loaded.
    """
    began, output = time.monotonic(), Path(output)
    stage = GarmentSetup.of(scene)
    held_out = _held_out(scene, stage)
    with Workers.of(workers) as pool:
        clock = clock or StageClock(STAGES if held_out else STAGES[:-1], pool, report)
        fabrics, layer = fabrics_of(scene, stage.settings), build_layer(stage.levels)
        work = _Work(scene, stage, layer, fabrics, cache or default_cache(output), pool, clock, options)
        made = _precomputed(work, held_out, output)
    database = replace(made.database, training_minutes=(time.monotonic() - began) / 60.0)
    write_database(output, database)
    return replace(made, database=database)


def _precomputed(work: _Work, held_out: Sequence[Motion], output: Path) -> Precomputed:
    """Learn and judge; nothing is written."""
    clock, stage, scene = work.clock, work.stage, work.scene
    with clock.stage("simulating"):
        for opening in stage.openings:
            clock(str(opening))
        motions = stage.training_motions()
        if not motions:
            raise InputError("nothing to learn from", key="training", expected="clips or procedural_seconds")
        examples, left_out = _simulated(work, motions, held_out[:1])
    kept = Kept(work.cache, scene, [example.run for example in examples], work.options)
    mapping, atoms = _learned(work, examples, kept)
    database = _finished(work, examples, mapping, atoms, kept)
    database = as_stored(replace(database, trained_on=tuple(m.name for m in motions)))  # judged as it is played
    truth, evaluation, quality = None, None, {}
    if held_out:  # the first held-out clip is the one that is reported
        with clock.stage("evaluating"):
            truth, evaluation, figures = _evaluated(work, database, held_out[0])
            quality |= figures
    crossed = crossed_figures(joined_crossed([example.crossed for example in examples]), outfit=False)
    quality |= {f"training_{name}": value for name, value in crossed.items()} | {
        "training_left_out_percent": left_out,
        "atoms_kept": atoms.kept,
    }
    database = replace(database, quality=quality)
    return Precomputed(database, output, truth, evaluation, tuple(clock.times))


def _held_out(scene: Scene, stage: GarmentSetup) -> list[Motion]:
    """Motions that nothing may be learned from; refused now, and not after the simulations."""
    training = scene.training
    overlap = [m for m in training.held_out if any(m.overlaps(other) for other in training.clips)]
    if overlap:
        clips = sorted(f"{m.file}: {m.name}" for m in overlap)
        raise InputError("a held-out clip is trained on", key="training.held_out", received=clips, expected="another")
    motions = [stage.motion(m) for m in training.held_out]
    for number, motion in enumerate(motions):
        settling = max(SETTLE, motion.lead_in)
        if motion.duration - settling < SHORTEST:
            key, received = f"training.held_out[{number}]", f"{motion.duration:.2f} s with the way from the bind pose"
            expected = f"at least {settling + SHORTEST:.1f} s: the cloth settles in the first {settling:.1f} s"
            raise InputError("too short to be judged by", key=key, received=received, expected=expected)
    return motions


def _simulated(work: _Work, motions: Sequence[Motion], judged: Sequence[Motion]) -> tuple[list[_Example], float]:
    """All fine runs, those that the database is judged by too: the more there are, the less do workers wait.

    Returns:
        what is learned from, and the share of frames that are left out because the cloth is through itself [%].

    Raises:
        InputError: nothing is left of a fabric.
    """
    worn = [(name, motion) for name in work.fabrics for motion in motions]
    runs = [training_run(work.stage, work.scene, motion, name) for name, motion in worn]
    later = [one for motion in judged for one in truth_runs(work.run(motion), work.options)]
    later += [work.run(motion, name) for motion in judged for name in work.fabrics if name != work.own_fabric]
    record_runs([*runs, *later], work.cache, work.workers, report=work.clock)
    recordings = training_recordings(runs, work.cache, work.workers)
    levels, examples, frame_count = work.layer.levels, [], 0
    for (name, _), run, recording in zip(worn, runs, recordings, strict=True):
        jobs = crossed_jobs(levels.fine, levels.fine_layer, recording.positions)
        told = counted(work.clock, f"looking for crossings: {run.name}: parts", len(jobs))
        crossed = joined_crossed(work.workers.run(jobs, done=told))
        end = run.frame_count // run.every * run.every * run.dt
        words = crossed_words(run.name, recording.frames * run.dt, crossed, end)
        if words:
            work.clock(words)
        whole = crossed[:, 0] <= WHOLE
        frame_count += int((np.arange(run.every, run.frame_count + 1, run.every) * run.dt > run.lead_in).sum())
        examples.append(_Example(name, run, recording.where(whole), crossed[whole]))
    examples = [example for example in examples if len(example.recording.frames)]
    if {example.fabric for example in examples} != set(work.fabrics):
        received, expected = [run.name for run in runs], "calmer clips, or a wider garment"
        problem = "the fine cloth is through itself in all of the training"
        raise InputError(problem, key="training", received=received, expected=expected)
    kept = sum(len(example.recording.frames) for example in examples)
    return examples, 100.0 * (1.0 - kept / frame_count)


def _learned(work: _Work, examples: Sequence[_Example], kept: Kept) -> tuple[CoefficientNetwork, Atoms]:
    """The dictionary."""
    clock, scene, layer, options = work.clock, work.scene, work.layer, work.options

    @cache
    def training() -> TrainingSet:
        learned = spread_frames([example.recording for example in examples], options.training_frames)
        return training_set(layer, learned, scene.wrinkles.atoms, work.seed, clock)

    def fitted() -> CoefficientNetwork:
        width, epochs = scene.wrinkles.hidden_width, options.epochs_for(len(training().features))
        hidden = (8 * width // 3, width)
        return fit_layer(layer, training(), hidden=hidden, epochs=epochs, seed=work.seed, report=clock)

    with clock.stage("fitting patches"):
        patches = kept.instance(Atoms, "patches", lambda: training().atoms)
    with clock.stage("fitting"):
        mapping = kept.instance(CoefficientNetwork, "network", fitted)
    with clock.stage("means of vertices"):
        return mapping, kept.instance(Atoms, "means", lambda: _with_means(work, examples, mapping, patches))


def _with_means(work: _Work, examples: Sequence[_Example], mapping: CoefficientNetwork, atoms: Atoms) -> Atoms:
    return with_vertex_mean(
        work.layer,
        mapping.predict,
        atoms,
        [example.run for example in examples],
        [example.recording for example in examples],
        work.workers,
        frames=work.options.mean_frames,
        report=work.clock,
    )


def _rest_shape(work: _Work, examples: Sequence[_Example]) -> RestShapeCorrection:
    levels = work.layer.levels
    if levels.subdivision.binding is None:
        return RestShapeCorrection.none(levels.coarse.faces)
    # Sewn as it came, perhaps in pleats.
    learned = spread_frames([example.recording for example in examples], work.options.training_frames)
    return RestShapeCorrection.of(levels.coarse, np.concatenate([recording.coarse for recording in learned]))


def _finished(
    work: _Work,
    examples: Sequence[_Example],
    mapping: CoefficientNetwork,
    atoms: Atoms,
    kept: Kept,
) -> WrinkleDatabase:
    """The database without what judging it gives."""
    runs, recordings = [example.run for example in examples], [example.recording for example in examples]
    with work.clock.stage("unfamiliarity"):
        given = (work.layer, mapping, atoms, runs, recordings, work.seed, work.workers, work.options.score_frames)
        novelty = kept.instance(NoveltyScore, "unfamiliarity", lambda: fit_novelty(*given, work.clock))
    scene, settings, levels, body = work.scene, work.stage.settings, work.stage.levels, work.stage.body
    own, *others = work.fabrics
    return WrinkleDatabase(
        garment_name=work.stage.name,
        coarse_vertices=levels.coarse.vertices,
        coarse_faces=levels.coarse.faces,
        rest_shape=_rest_shape(work, examples),
        subdivisions=settings.subdivision_count,
        held=levels.coarse_held.astype(np.int32),
        limits=levels.coarse_limits,
        warp=(0.0, 1.0, 0.0),
        binding=levels.subdivision.binding,
        sewn=levels.sewn,
        layers=levels.layers,
        fabric_name=own,
        fabric=work.fabrics[own],
        pressure=settings.pressure,
        other_fabrics={name: work.fabrics[name] for name in others},
        bend_factor=hinge_calibration(levels.coarse),
        solver=scene.solver.options(),
        frame_rate=scene.solver.frame_rate,
        atoms=atoms,
        mapping=mapping,
        novelty=novelty,
        cutoff=levels.cutoff,
        body_hash=body_hash(body),
        body_vertex_count=len(body_source(body).vertices),
        quality={},
        held_out=tuple(m.name for m in scene.training.held_out),
        trained_on=(),
        training_minutes=0.0,
        machine=processor_name(),
        seed=work.seed,
        scene=scene_text(scene),
        code_version=code_version(),
        created=date.today().isoformat(),
        texture=texture_of(scene),
    )


def _evaluated(work: _Work, database: WrinkleDatabase, motion: Motion) -> tuple[Truth, Evaluation, dict[str, float]]:
    """How good the database is on a held-out motion, in its own fabric and, given the coarse states, in the others."""
    cache, workers, clock = work.cache, work.workers, work.clock
    truth = truth_of(work.run(motion), cache, workers, clock)
    evaluation = evaluate(database, truth, cache, clock, workers=workers, options=work.options)
    figures = dict(evaluation.figures)
    for other in database.other_fabrics:
        given = _given_figures(database.in_fabric(other), work.run(motion, other), cache, workers, clock)
        figures |= {f"{other}_{name}": value for name, value in given.items()}
    return truth, evaluation, figures


def training_recordings(
    runs: list[Run], cache: Path, workers: Workers | int, report: Callable[[str], None] | None = None
) -> list[Recording]:
    """What the runs that a scene learns from gave, without what only leads to the motions that are meant."""
    recordings = record_runs(runs, cache, workers, report=report)
    return [r.where(r.frames * run.dt > run.lead_in) for r, run in zip(recordings, runs, strict=True)]


def training_run(stage: GarmentSetup, scene: Scene, motion: Motion, fabric: str | None = None) -> Run:
    """The fine run of a motion that is learned from: :func:`scene_run`, which ends where the cloth has come apart."""
    return replace(scene_run(stage, scene, motion, fabric), while_whole=True)


def scene_run(stage: GarmentSetup, scene: Scene, motion: Motion, fabric: str | None = None) -> Run:
    """The fine run of a motion under a scene's settings, in one of its fabrics; None takes the garment's own."""
    fabrics = fabrics_of(scene, stage.settings)
    worn = fabrics[next(iter(fabrics)) if fabric is None else fabric]
    options = ModelOptions(pressure=stage.settings.pressure)
    settings = _Settings(worn, options, scene.solver.options(), scene.solver.frame_rate)
    return fine_run(
        stage.levels,
        stage.body,
        motion,
        settings,
        wind=scene.wind.air(),
        primitives=colliders_of(scene),
        substep=fine_options(scene, stage.subdivisions_of_mesh).substep,
    )


def _given_figures(
    database: WrinkleDatabase, run: Run, cache: Path, workers: Workers | int, report: Callable[[str], None]
) -> dict[str, float]:
    """What the dictionary makes of the coarse states of a fine run: error and skill of its normals."""
    (recording,) = record_runs([run], cache, workers, report=report)
    recording = settled(recording, run)
    smooth, decoded, _ = given_frames(database, run, recording)
    owner = leading_vertices(run.levels.subdivision)[:, 0]
    figures = given_coarse_figures(decoded, recording.positions, smooth, run.levels.fine.faces, owner)
    return {name: float(figures[name]) for name in ("normal_error_deg", "normal_error_smooth_deg", "normal_skill")}
