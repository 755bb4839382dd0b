"""One run of a compared scene: a method at a resolution and a number of substeps, measured and kept on disk."""

from __future__ import annotations

import hashlib
import json
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import pbd
from pbd import InputError, Model, State
from pbd.fingerprint import source_fingerprint
from pbd.models import SOLVERS, AnySolver, Options, StepError, make_solver
from pbd.storage import replacing
from precompute import experiment
from precompute.experiment.engines import ENGINES, start_engine
from precompute.experiment.error_classes import START
from precompute.experiment.measures import FRAME_RATE, TimedSteps, deepest, edge_strain, mechanical_energy
from precompute.method_comparison import compare_scenes
from precompute.method_comparison.compare_scenes import CompareScene

__all__ = ["SceneRun", "MethodSetting", "parse_setting", "read_run", "run_path", "run_setting"]

TOLERANCE = 1e-4  # of Newton's method: a hundredth of a millimetre on these meshes [mean edges]


@dataclass(frozen=True)
class MethodSetting:
    """A method and how it is set.

    Attributes:
        method: name in :data:`pbd.models.SOLVERS` or :data:`precompute.experiment.engines.ENGINES`.
        edges: along the length of the cloth.
        substeps: of a frame of 1/60 s; None takes the method's own (explicit ones ask the mesh).
        iterations: passes or Newton steps of a substep at most; None takes the method's own.
        seed: of the perturbed start; 0 for none.
    """

    method: str
    edges: int
    substeps: int | None = None
    iterations: int | None = None
    seed: int = 0

    @property
    def numbers(self) -> str:
        """Its numbers as short as in :func:`parse_setting`: "16x4x10"."""
        parts = [self.edges, self.substeps, self.iterations]
        while parts[-1] is None:
            parts.pop()
        return "x".join("0" if part is None else str(part) for part in parts)

    @property
    def words(self) -> str:
        """For people."""
        found = [f"{self.edges} edges"]
        found += [f"{self.substeps} substep{'s' * (self.substeps > 1)}"] if self.substeps else []
        found += [f"{self.iterations} pass{'es' * (self.iterations > 1)}"] if self.iterations else []
        return ", ".join(found)

    @property
    def baseline(self) -> bool:
        """Whether it is another engine."""
        return self.method in ENGINES

    def solver(self, model: Model) -> AnySolver:
        """The solver for a model; raises :class:`pbd.InputError` where it cannot take the mesh."""
        substep = None if self.substeps is None else 1.0 / (FRAME_RATE * self.substeps)
        return make_solver(self.method, model, Options(substep, iterations=self.iterations, tolerance=TOLERANCE))


def parse_setting(text: str) -> tuple[str, tuple[int | None, ...]]:
    """A method's name and, after an @, its numbers: "xpbd", "xpbd@16x4" (edges, substeps), "xpbd@16x4x10" (passes).

    A 0 leaves a number to the method.

    Raises:
        InputError: no such method, or bad numbers.
    """
    name, sign, numbers = text.strip().partition("@")
    if name not in SOLVERS and name not in ENGINES:
        expected = ", ".join([*SOLVERS, *ENGINES])
        raise InputError("no such method", key="--methods", received=name, expected=expected)
    parts = numbers.split("x") if sign else []
    if any(not part.isdecimal() or int(part) > 10_000 for part in parts) or len(parts) > 3 or (sign and not parts):
        expected = "NAME, NAME@EDGES, NAME@EDGESxSUBSTEPS or NAME@EDGESxSUBSTEPSxPASSES"
        raise InputError("bad setting", key="--methods", received=text, expected=expected)
    if parts and not 4 <= int(parts[0]) <= 400:
        raise InputError("bad resolution", key="--methods", received=text, expected="4 to 400 edges")
    return name, tuple(int(part) or None for part in parts)


@dataclass(frozen=True)
class SceneRun:
    """A run with its costs.

    Attributes:
        setting: method and numbers.
        position, velocity: at the compared points and each frame's end [m], [m/s], float32, shape (f, m, 3); up to
            where it ended.
        energy: kinetic and gravity's energy [J], and kinetic alone, shape (2, f).
        depth: deepest vertex under a collider's surface [m], shape (f,).
        strain: 95th percentile of the edges' |strain| and greatest strain after half a second, on its own mesh [-].
        frame_ms: processor time of each frame [ms], shape (f,).
        setup_s: processor time to make model and solver [s].
        memory_mb: greatest memory of Python and NumPy for model, solver, state and a step [MB].
        vertex_count: of the simulated mesh.
        substeps: of a frame, as they were.
        total_s: processor time of everything [s].
        problem: why it ended before its time; empty if it did not.
        gave_up: ended because it took too long: it says nothing about the method's error.
    """

    setting: MethodSetting
    position: np.ndarray = field(repr=False)
    velocity: np.ndarray = field(repr=False)
    energy: np.ndarray = field(repr=False)
    depth: np.ndarray = field(repr=False)
    strain: np.ndarray
    frame_ms: np.ndarray = field(repr=False)
    setup_s: float
    memory_mb: float
    vertex_count: int
    substeps: int
    total_s: float
    problem: str = ""
    gave_up: bool = False


@threadpool_limits.wrap(limits=1, user_api="blas")
def run_setting(scene: CompareScene, setting: MethodSetting, limit_s: float = np.inf) -> SceneRun:
    """Run a scene and measure it.

    Args:
        scene: what is simulated.
        setting: how.
        limit_s: processor time after which the run is given up [s].

    Raises:
        InputError: a method that cannot take the mesh.
    """
    began = time.process_time()
    model = scene.model(setting.edges, setting.seed)
    stepped = _baseline(scene, model, setting) if setting.baseline else _ours(scene, model, setting)
    setup_s = time.process_time() - began
    frames, gave_up, problem = [], False, ""
    steps = TimedSteps(lambda frame: frames.append(stepped(frame)), (StepError, InputError))
    for frame in range(1, scene.frame_count + 1):
        moment = f"after {frame / FRAME_RATE:.2f} s"
        if not steps(frame):  # a state that is no longer finite is refused as input
            problem = f"{moment}: {steps.error}"
            break
        if not np.isfinite(frames[-1]).all():
            problem = f"{moment}: not finite"
            frames.pop()
            steps.times.pop()
            break
        if time.process_time() - began > limit_s and frame < scene.frame_count:
            problem, gave_up = f"given up {moment} of motion: {limit_s:.0f} s of time", True
            break
    x, v = np.array(frames).reshape(-1, 2, model.vertex_count, 3).transpose(1, 0, 2, 3)
    return SceneRun(
        setting,
        scene.sampled(setting.edges, x).astype(np.float32),
        scene.sampled(setting.edges, v).astype(np.float32),
        np.array(mechanical_energy(model.mass, x, v)),
        deepest(scene.colliders(), x),
        _strain(model, x),
        1e3 * np.array(steps.times),
        setup_s,
        float("nan") if setting.baseline else _memory_mb(scene, setting),
        model.vertex_count,
        _substeps(setting, model),
        time.process_time() - began,
        problem,
        gave_up,
    )


_Stepped = Callable[[int], tuple[np.ndarray, np.ndarray]]  # makes a frame; positions and velocities after it


def _ours(scene: CompareScene, model: Model, setting: MethodSetting) -> _Stepped:
    solver = setting.solver(model)
    state, colliders = State.at_rest(model), scene.scene_colliders()
    rail = model.mesh.vertices[model.held]

    def stepped(frame: int) -> tuple[np.ndarray, np.ndarray]:
        solver.step(state, colliders, 1.0 / FRAME_RATE, rail + scene.rail(frame / FRAME_RATE) if len(rail) else None)
        return state.world(), state.velocity.copy()

    return stepped


def _baseline(scene: CompareScene, model: Model, setting: MethodSetting) -> _Stepped:
    if scene.colliders() or scene.driven:
        raise InputError("an engine that is driven on a still clamp alone", key="--methods", received=setting.method)
    step, world = start_engine(setting.method, model, setting.substeps, setting.iterations)
    last = [world()]

    def stepped(frame: int) -> tuple[np.ndarray, np.ndarray]:
        step()
        now = world()
        velocity = (now - last[0]) * FRAME_RATE
        last[0] = now
        return now, velocity

    return stepped


def _substeps(setting: MethodSetting, model: Model) -> int:
    if setting.substeps or setting.baseline:
        return setting.substeps or 1
    solver = setting.solver(model)
    substep = getattr(solver, "substep", None) or solver.options.substep  # pyright: ignore[reportAttributeAccessIssue]
    return max(1, int(np.ceil(1.0 / (FRAME_RATE * substep) - 1e-6)))


def _strain(model: Model, x: np.ndarray) -> np.ndarray:
    later = x[min(round(START * FRAME_RATE), max(len(x) - 1, 0)) :]
    if not len(later):
        return np.array([np.nan, np.nan])
    strain = edge_strain(later, *model.mesh.edge_lengths())
    return np.array([np.percentile(np.abs(strain), 95), strain.max()])


def _memory_mb(scene: CompareScene, setting: MethodSetting) -> float:
    """Of a second set-up and step, so that measuring slows nothing that is timed."""
    tracemalloc.start()
    try:
        model = scene.model(setting.edges, setting.seed)
        state = State.at_rest(model)
        setting.solver(model).step(state, scene.scene_colliders(), 1.0 / FRAME_RATE)
        return tracemalloc.get_traced_memory()[1] / 1e6
    except (StepError, InputError):
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


@lru_cache(maxsize=1)
def _version() -> str:
    """Hash of the source of the solvers and of the scenes."""
    return source_fingerprint(pbd, experiment, compare_scenes, Path(__file__))


def run_path(cache: Path, scene: CompareScene, setting: MethodSetting) -> Path:
    """Where a run is kept: its name holds everything that it depends on."""
    text = json.dumps([_version(), scene.name, scene.seconds, asdict(setting)])
    return cache / f"{scene.name}_{hashlib.sha256(text.encode()).hexdigest()[:20]}.npz"


_ARRAYS = ("position", "velocity", "energy", "depth", "strain", "frame_ms")
_NUMBERS = ("setup_s", "memory_mb", "vertex_count", "substeps", "total_s", "problem", "gave_up")


def write_run(path: Path, run: SceneRun) -> None:
    """Keep a run; the file appears whole or not at all."""
    text = json.dumps({"setting": asdict(run.setting), **{name: getattr(run, name) for name in _NUMBERS}})
    arrays = {name: getattr(run, name) for name in _ARRAYS}
    with replacing(path) as beside, open(beside, "wb") as file:
        np.savez(file, allow_pickle=False, text=np.array(text), **arrays)


def read_run(path: Path) -> SceneRun | None:
    """What :func:`write_run` wrote; None where there is nothing."""
    try:
        with np.load(path, allow_pickle=False) as data:
            numbers = json.loads(str(data["text"]))
            setting = MethodSetting(**numbers.pop("setting"))
            return SceneRun(setting, **{name: data[name] for name in _ARRAYS}, **numbers)
    except (OSError, ValueError, KeyError):
        return None
