"""`gube compare SCENE...`: every method at several settings on the same scenes, within a budget of time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pbd import InputError
from precompute.experiment.error_classes import ErrorClass
from precompute.method_comparison.compare_scenes import SCENES, CompareScene, scene_of
from precompute.method_comparison.scene_judging import Judge, Judgement, reference_settings
from precompute.method_comparison.scene_runs import (
    MethodSetting,
    SceneRun,
    parse_setting,
    read_run,
    run_path,
    run_setting,
    write_run,
)
from precompute.workers import worker_pool

__all__ = ["BUDGET", "METHODS", "ComparedRun", "SceneComparison", "chosen_settings", "compare_scenes"]

BUDGET = 900.0  # for everything [s]
WORKERS = 2  # processes at a time
MAX_OVER_ESTIMATE = 6.0  # a run is given up after so many times its estimate, and at least 20 s [-]
MAX_DEFAULT_RUN_S = 20.0  # a run with a longer estimate is made only where its method is named [s]
STARTING_S = 0.05  # added to the estimate of every run [s]


@dataclass(frozen=True)
class _Kind:
    """How a method is set for a comparison.

    Attributes:
        numbers: substeps and passes that are tried at every resolution.
        edges: how many of the scene's resolutions, from the coarsest.
        pass_ms: processor time of a pass over 153 vertices, about [ms].
        newton: its passes take longer in contact and in folds.
    """

    numbers: Sequence[tuple[int | None, int | None]]
    edges: int
    pass_ms: float
    newton: bool = False


_FEW, _NEWTON = ((1, 10), (10, 1)), ((1, None), (4, None))
METHODS = {
    "default": _Kind(((4, None), (8, None), (16, None), (48, None)), 3, 0.005),
    "pbd": _Kind(_FEW, 2, 5.6),
    "xpbd": _Kind(_FEW, 2, 5.6),
    "strain-based": _Kind(((1, 6), (6, 1)), 2, 8.6),
    "vertex-block-descent": _Kind(((1, 5), (4, 2)), 2, 13.0),
    "projective-dynamics": _Kind(((1, 10), (4, 10)), 2, 1.5),
    "springs-square/symplectic-euler": _Kind(((None, None),), 2, 0.8),
    "fem-stvk+isometric/verlet": _Kind(((None, None),), 2, 0.7),
    "springs-triangle/implicit-euler": _Kind(_NEWTON, 2, 22.0, True),
    "baraff-witkin/implicit-euler": _Kind(_NEWTON, 2, 25.0, True),
    "fem-stvk/implicit-euler": _Kind(_NEWTON, 2, 35.0, True),
    "fem-stvk+isometric/bdf2": _Kind(_NEWTON, 2, 20.0, True),
}
BASELINES = {
    "newton": _Kind(((40, None), (150, None)), 2, 1.0),
    "pypbd": _Kind(((10, None), (40, None)), 2, 0.2),
    "bpy": _Kind(((1, None), (2, None)), 2, 1.3),
    "mujoco": _Kind(((None, 20), (None, 100)), 2, 0.1),
    "pybullet": _Kind(((40, None), (150, None)), 2, 0.5),
}
OTHER_METHOD = _Kind(((None, None),), 2, 30.0)  # of the methods that are compared only where they are named


def _kind(method: str) -> _Kind:
    return METHODS.get(method) or BASELINES.get(method, OTHER_METHOD)


@dataclass(frozen=True)
class ComparedRun:
    """One point of the chart.

    Attributes:
        run: with its costs.
        judgement: its errors.
        command: repeats it.
    """

    run: SceneRun = field(repr=False)
    judgement: Judgement
    command: str

    @property
    def frame_ms(self) -> tuple[float, float]:
        """Processor time of a frame after the first, p50 and p99 [ms]."""
        times = self.run.frame_ms[1:] if len(self.run.frame_ms) > 1 else self.run.frame_ms
        if not len(times):
            return float("nan"), float("nan")
        return float(np.median(times)), float(np.percentile(times, 99))

    def row(self, scene: str) -> dict[str, Any]:
        """Everything in one line."""
        setting, (p50, p99) = self.run.setting, self.frame_ms
        return {
            "scene": scene,
            "method": setting.method,
            "edges": setting.edges,
            "substeps": self.run.substeps,
            "passes": setting.iterations,
            "vertex_count": self.run.vertex_count,
            "frame_ms_p50": p50,
            "frame_ms_p99": p99,
            "setup_s": self.run.setup_s,
            "memory_mb": self.run.memory_mb,
            "error": self.judgement.error,
            "error_class": self.judgement.worst.name.lower(),
            "because": self.judgement.because,
            "command": self.command,
            **self.judgement.figures,
        }


@dataclass(frozen=True)
class SceneComparison:
    """All methods on one scene.

    Attributes:
        scene: the one simulated.
        judge: with its references and the floor.
        points: by method and setting.
        dropped: settings that were not run or not finished, with the reason.
    """

    scene: CompareScene
    judge: Judge = field(repr=False)
    points: tuple[ComparedRun, ...]
    dropped: tuple[tuple[MethodSetting, str], ...]

    def runs(self) -> list[SceneRun]:
        """Of the points."""
        return [point.run for point in self.points]

    def pareto_front(self) -> list[ComparedRun]:
        """Points that no other beats in both cost and error, by growing cost."""
        found: list[ComparedRun] = []
        for point in sorted(self.points, key=lambda point: (point.frame_ms[0], point.judgement.error)):
            if np.isfinite(point.judgement.error) and (not found or point.judgement.error < found[-1].judgement.error):
                found.append(point)
        return found

    def figures(self) -> dict[str, float]:
        """Figures of the scene, with its name before each."""
        name = self.scene.name
        found = {f"{name}_points": float(len(self.points)), f"{name}_floor": self.judge.floor}
        found[f"{name}_refined"] = self.judge.refined
        found[f"{name}_processor_s"] = sum(run.total_s for run in [*self.judge.references, *self.runs()])
        for kind in ErrorClass:
            found[f"{name}_{kind.name.lower()}"] = float(sum(p.judgement.worst is kind for p in self.points))
        enough = max(self.judge.floor, 1.0 if self.scene.unique else self.judge.refined)
        good = [p.frame_ms[0] for p in self.points if p.judgement.error <= enough]
        return found | ({f"{name}_cheapest_good_ms": min(good)} if good else {})


@dataclass(frozen=True)
class _Job:
    """A run that is wanted; ``estimate`` is its processor time [s]."""

    scene: CompareScene
    setting: MethodSetting
    path: Path
    estimate: float
    reference: bool

    def run(self) -> float:
        """Run and write; returns the processor time that it took [s]."""
        began = time.process_time()
        limit = np.inf if self.reference else max(20.0, MAX_OVER_ESTIMATE * self.estimate)
        write_run(self.path, run_setting(self.scene, self.setting, limit))
        return time.process_time() - began


def chosen_settings(scene: CompareScene, methods: Sequence[str]) -> list[MethodSetting]:
    """Settings of some methods for a scene; of all that are compared by default if none is named.

    Raises:
        InputError: no such method, or a bad setting.
    """
    settings = []
    for text in methods or METHODS:
        name, numbers = parse_setting(text)
        kind = _kind(name)
        resolutions = [numbers[0]] if numbers and numbers[0] else scene.edges[: kind.edges]
        pairs = kind.numbers
        if len(numbers) > 1:
            pairs = [(numbers[1], numbers[2] if len(numbers) > 2 else None)]
        settings += [MethodSetting(name, edges, *pair) for edges in resolutions for pair in pairs]
    return list(dict.fromkeys(settings))


def _estimate(scene: CompareScene, setting: MethodSetting) -> float:
    """Processor time of a run, roughly [s]."""
    kind = _kind(setting.method)
    vertices = len(scene.sheet(setting.edges).flat)
    passes = (setting.substeps or 4) * (setting.iterations or 1)
    if setting.method.endswith(("symplectic-euler", "verlet")):
        fabric, step = scene.fabric, scene.size[0] / setting.edges
        stiff = max(fabric.stretch_warp, fabric.stretch_weft)
        stretch = 0.57 * step * (fabric.areal_density / stiff) ** 0.5
        bend = 0.18 * step**2 * (fabric.areal_density / max(fabric.bend_warp, 1e-12)) ** 0.5
        passes = 1.0 / 60.0 / min(stretch, bend)
    size = 0.4 + 0.6 * vertices / 153.0
    harder = (10.0 if scene.colliders() else 3.0 if not scene.unique else 1.0) if kind.newton else 1.0
    return STARTING_S + 1e-3 * scene.frame_count * passes * kind.pass_ms * size * harder


def _warm() -> None:
    """Compile the default solver before anything is measured."""
    scene = scene_of("swing", 1.0 / 30.0)
    run_setting(scene, MethodSetting("default", 4, 1))


def compare_scenes(
    names: Sequence[str],
    output: Path,
    *,
    methods: Sequence[str] = (),
    budget_s: float = BUDGET,
    seconds: float | None = None,
    workers: int = WORKERS,
    report: Callable[[str], None] | None = None,
) -> list[SceneComparison]:
    """Run everything that is not in ``output``'s cache yet, and judge it.

    References are run outside the budget, then settings from the cheapest; the dearest are left out where it ends.

    Args:
        names: of the scenes; all built-in ones if none is named.
        output: runs are kept in its folder ``runs`` and found again.
        methods: see :func:`precompute.method_comparison.scene_runs.parse_setting`; none takes the default ones.
        budget_s, seconds: time for everything; length at which each motion is cut [s].
        workers: processes at a time; 1 stays in this one.
        report: called with lines of progress.

    Raises:
        InputError: no such scene or method.
    """
    began = time.monotonic()
    scenes = [scene_of(name, seconds) for name in dict.fromkeys(names or SCENES)]
    cache, jobs = output / "runs", []
    for scene in scenes:
        wanted = [(setting, True) for setting in reference_settings(scene)]
        wanted += [(setting, False) for setting in chosen_settings(scene, methods)]
        jobs += [
            _Job(scene, setting, run_path(cache, scene, setting), _estimate(scene, setting), reference)
            for setting, reference in wanted
        ]
    todo = {job.path: job for job in jobs if read_run(job.path) is None}
    reasons = {}
    for job in list(todo.values()):
        if not methods and not job.reference and job.estimate > MAX_DEFAULT_RUN_S:
            reasons[job.path] = f"about {todo.pop(job.path).estimate:.0f} s: only where it is named by --methods"
    reasons |= _run_all(list(todo.values()), began + budget_s, workers, report)
    found = []
    for scene in scenes:
        own = [job for job in jobs if job.scene is scene]
        references = [read_run(job.path) for job in own if job.reference]
        if any(run is None or run.problem for run in references):
            problems = [run.problem if run else "not run" for run in references]
            raise InputError("a reference did not come to its end", key=scene.name, received=problems)
        judge = Judge(scene, [run for run in references if run is not None])
        points, dropped = [], []
        for job in (job for job in own if not job.reference):
            run = read_run(job.path)
            if run is None or run.gave_up:
                dropped.append((job.setting, run.problem if run else reasons.get(job.path, "not run")))
                continue
            text = f"gube compare {scene.name} --methods {job.setting.method}@{job.setting.numbers} -o {output}"
            text += "" if seconds is None else f" --seconds {seconds:g}"
            points.append(ComparedRun(run, judge.judge(run), text))
        found.append(SceneComparison(scene, judge, tuple(points), tuple(dropped)))
    return found


class _Queue:
    """Runs that wait for their turn: references first, then the cheapest, and none that the time left is too short for.

    Args:
        jobs: to run.
        deadline: by the monotonic clock [s].
        workers: processes at a time.
        report: called with lines of progress.

    Attributes:
        reasons: why a run was left out, by its path.
    """

    def __init__(
        self, jobs: Sequence[_Job], deadline: float, workers: int, report: Callable[[str], None] | None
    ) -> None:
        self.reasons: dict[Path, str] = {}
        self._waiting = sorted(jobs, key=lambda job: (not job.reference, job.estimate))
        self._running: list[_Job] = []
        self._total, self._deadline, self._workers = len(jobs), deadline, workers
        self._report = report or (lambda line: None)
        self._spent, self._estimated = 0.0, 0.0  # by and for the runs that have ended [s]

    @property
    def _slowness(self) -> float:
        """Seconds that a worker takes for a second of an estimate, once enough has been run to say."""
        return self._spent / self._estimated if self._estimated > 10.0 else 1.0

    def take(self) -> _Job | None:
        """The next run; None where there is none, or no time for the cheapest of those left."""
        left = self._deadline - time.monotonic()
        if not self._waiting:
            return None
        if not self._waiting[0].reference and self._slowness * self._waiting[0].estimate > left:
            for job in self._waiting:
                seconds = self._slowness * job.estimate
                self.reasons[job.path] = f"left out: about {seconds:.0f} s, more than the budget left"
            self._waiting.clear()
            return None
        job = self._waiting.pop(0)
        self._running.append(job)
        rest = sum(self._slowness * job.estimate for job in [*self._waiting, *self._running]) / self._workers
        done = self._total - len(self._waiting) - len(self._running)
        what = f"{job.scene.name}, {job.setting.method}, {job.setting.words}"
        self._report(f"{done} of {self._total} runs, {max(0.0, min(rest, left)):.0f} s left: {what}")
        return job

    def ended(self, job: _Job, seconds: float) -> None:
        """Learn from a run how far estimates are off; it took so many seconds [s]."""
        self._running.remove(job)
        self._spent, self._estimated = self._spent + seconds, self._estimated + job.estimate


def _run_all(
    jobs: Sequence[_Job], deadline: float, workers: int, report: Callable[[str], None] | None
) -> dict[Path, str]:
    """Run jobs as :class:`_Queue` orders them; returns why some were left out."""
    queue = _Queue(jobs, deadline, workers, report)
    if workers == 1:
        while (job := queue.take()) is not None:
            queue.ended(job, job.run())
    elif jobs:
        with worker_pool(workers, _warm) as pool:
            running: dict[Future[float], tuple[_Job, float]] = {}
            while True:
                while len(running) < workers and (job := queue.take()) is not None:
                    running[pool.submit(job.run)] = job, time.monotonic()
                if not running:
                    break
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    future.result()
                    job, begin = running.pop(future)
                    queue.ended(job, time.monotonic() - begin)
    return queue.reasons
