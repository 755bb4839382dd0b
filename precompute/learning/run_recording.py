"""Simulated runs on disk: cached by the hash of everything they depend on, resumed where they were cut off."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import assets.skinning
import pbd
import runtime.play.simulation
import wrinkles.levels
import wrinkles.surface
from assets.character import Character
from assets.io.sequence import Sequence as VertexSequence
from pbd import DistanceField, Fabric, ModelOptions, SolverOptions, State
from pbd.fingerprint import source_fingerprint
from pbd.storage import replacing
from pbd.wind import CALM, Air, Wind
from precompute.cluster import ClusterWorkers, cache_here
from precompute.learning.crossed import COME_APART, crossed_share
from precompute.workers import Workers
from runtime.play.simulation import Simulation, body_source
from wrinkles.levels import Levels

__all__ = ["Recording", "Run", "move_start", "record_runs"]

CHUNK_ARRAYS = ("frames", "positions", "contact", "nearest", "coarse", "step_ms")

START_OFF = 1e-5  # standard deviation of each coordinate of a start that is moved [m]
CHUNK_SECONDS = 1.0  # what a cut-off run loses at most [s of motion]

# Simulations that a cluster's process keeps: Dask gives it the next job before the client has followed the last one.
GOING_ON = 3
_going_on: dict[tuple[str, int], Simulation] = {}  # in such a process: the last simulations, by their next chunks


@dataclass(frozen=True)
class Run:
    """One simulation to record.

    Attributes:
        name: for progress lines.
        levels: of the garment; ``fine`` says which of both meshes is simulated.
        body: the character or vertex sequence.
        poses: shape (frames + 1, ...), one every ``dt`` [s]; the first is where the garment starts.
        fabric, options, solver: of the model and the solver.
        wind: velocity of the air [m/s].
        primitives: what the garment meets besides the body: planes, spheres, capsules, fields.
        lead_in: time at the start that only leads to the motion that is meant [s].
        every: frames from one recorded frame to the next.
        bend_factor: hinge factor if known; None measures it.
        start: number of its start, see :func:`move_start`.
        while_whole: it ends at the first chunk after the lead-in that begins with cloth that has come apart, see
            :data:`precompute.learning.crossed.COME_APART`.
    """

    name: str
    levels: Levels
    fine: bool
    body: Character | VertexSequence
    poses: np.ndarray
    dt: float
    fabric: Fabric
    options: ModelOptions
    solver: SolverOptions
    every: int = 2
    bend_factor: float | None = None
    wind: Air = CALM
    primitives: tuple = ()
    lead_in: float = 0.0
    start: int = 0
    while_whole: bool = False

    @property
    def frame_count(self) -> int:
        return len(self.poses) - 1

    @property
    def chunk(self) -> int:
        """Frames in a chunk: a whole number of recorded frames."""
        return max(1, round(CHUNK_SECONDS / self.dt / self.every)) * self.every

    @property
    def chunk_count(self) -> int:
        return -(-self.frame_count // self.chunk)

    def key(self) -> str:
        """Hash of everything that the result depends on, the solver's source included."""
        digest = hashlib.sha256(_solver_version().encode())
        levels = self.levels
        mesh = levels.fine if self.fine else levels.coarse
        attachment = levels.fine_attachment if self.fine else levels.coarse_attachment
        arrays = [
            mesh.vertices,
            mesh.faces,
            mesh.flat,
            mesh.stitches,
            mesh.stitch_weights,
            np.zeros(0) if mesh.rest_bends is None else mesh.rest_bends,
            np.zeros(0) if mesh.cloth_areas is None else mesh.cloth_areas,
            np.zeros(0) if mesh.layers is None else mesh.layers,
            np.zeros(0) if mesh.max_stretch is None else mesh.max_stretch,
            attachment.corners,
            attachment.weights,
            attachment.offset,
        ]
        arrays += [
            levels.fine_held if self.fine else levels.coarse_held,
            *asdict(levels.fine_limits if self.fine else levels.coarse_limits).values(),
            self.poses,
            self.body.vertices,
            self.body.faces,
        ]
        if isinstance(self.body, Character):
            arrays += [self.body.joint_indices, self.body.joint_weights]
        arrays += [primitive.values for primitive in self.primitives if isinstance(primitive, DistanceField)]
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())
        settings = [asdict(self.fabric), asdict(self.options), asdict(self.solver), self.dt, self.every]
        if levels.layers is not None:
            digest.update(levels.layers.layer.tobytes())
            settings += [asdict(fabric) for fabric in levels.layers.fabrics]
        settings += [self.chunk]  # files of other lengths would be put together wrongly
        settings += [
            self.bend_factor,
            asdict(self.wind if isinstance(self.wind, Wind) else Wind(tuple(self.wind))),
            [primitive.row().tolist() for primitive in self.primitives],
        ]
        settings += [self.start] * (self.start > 0)  # runs that start where they are put keep their names
        settings += ["while whole"] * self.while_whole
        digest.update(json.dumps(settings, sort_keys=True).encode())
        return digest.hexdigest()[:24]

    def simulation(self) -> Simulation:
        """The simulation at the first pose, in which nothing is moved without contact."""
        levels = self.levels
        attachment = levels.fine_attachment if self.fine else levels.coarse_attachment
        model = levels.model(self.fabric, self.options, bend_factor=self.bend_factor, fine=self.fine)
        source = body_source(self.body)
        simulation = Simulation(model, attachment, source, self.poses[0], self.solver, self.primitives)
        simulation.redressing = None
        move_start(simulation.state, self.start)
        return simulation


def move_start(state: State, start: int) -> None:
    """Move the free vertices of a garment that starts by less than anybody can set, drawn by a number; 0 moves none.

    Free folding is chaotic: from there on such runs part company, so that several show what is chance.
    """
    if start:
        free = state.position[:, 3] > 0.0
        off = START_OFF * np.random.default_rng(start).standard_normal((int(free.sum()), 3))
        state.position[free, :3] += off.astype(state.position.dtype)


@lru_cache(maxsize=1)
def _solver_version() -> str:
    """Hash of the source of the solver, of what moves bodies and of what filters the result."""
    return source_fingerprint(pbd, assets.skinning, runtime.play.simulation, wrinkles.levels, wrinkles.surface)


@dataclass(frozen=True)
class Recording:
    """Recorded frames of a run, in the world.

    Attributes:
        name: of the run.
        frames: index of each recorded frame into the run's poses, int, shape (f,).
        positions: of the simulated mesh [m], float32, shape (f, N, 3).
        coarse: a fine run filtered down (a coarse run itself) [m], float32, shape (f, n, 3).
        contact: of the coarse vertices, as in :class:`pbd.State`, float32, shape (f, n).
        nearest: body vertices near the coarse ones, int32, shape (f, n).
        step_ms: median time of a step [ms].
    """

    name: str
    frames: np.ndarray
    positions: np.ndarray
    coarse: np.ndarray
    contact: np.ndarray
    nearest: np.ndarray
    step_ms: float

    def where(self, keep: np.ndarray | slice) -> Recording:
        """Some of the frames."""
        names = ("frames", "positions", "coarse", "contact", "nearest")
        return replace(self, **{name: getattr(self, name)[keep] for name in names})


def record_runs(
    runs: Sequence[Run],
    cache: Path,
    workers: Workers | int = 2,
    *,
    report: Callable[[str], None] | None = None,
) -> list[Recording]:
    """Simulate what is not in the cache yet, and read everything back.

    Args:
        runs: what to record.
        cache: folder; each run has a folder of its own in it, named by :meth:`Run.key`.
        workers: processes that go on living, or a number of processes for these runs; each run stays on one.
        report: called with a line of progress now and then.
    """
    cache = cache_here(cache)
    folders = [cache / run.key() for run in runs]
    for folder in folders:
        _drop_broken(folder)
    total = sum(run.frame_count for run in runs)
    done = lambda: sum(  # noqa: E731
        min(run.frame_count, run.chunk * len(list(folder.glob("chunk_*.npz"))))
        for run, folder in zip(runs, folders, strict=True)
    )
    todo = {
        folder: run
        for run, folder in zip(runs, folders, strict=True)
        if len(list(folder.glob("chunk_*.npz"))) < run.chunk_count
    }
    longest_first = sorted(todo.items(), key=lambda item: -item[1].frame_count)
    began, before = time.monotonic(), done()
    if isinstance(workers, ClusterWorkers):
        _record_apart(longest_first, workers, lambda: _tell(report, done(), before, total, began))
    elif len(todo) == 1 or workers == 1:
        for folder, run in longest_first:
            _record(run, folder, lambda: _tell(report, done(), before, total, began))
    elif todo:
        with Workers.of(workers) as pool:
            jobs = [partial(_record, run, folder) for folder, run in longest_first]
            pool.run(jobs, meanwhile=lambda: _tell(report, done(), before, total, began))
    return [_read(run, folder) for run, folder in zip(runs, folders, strict=True)]


def _drop_broken(folder: Path) -> None:
    """Remove the first chunk that cannot be read as it was written, and all after it, which went on from it."""
    chunks = sorted(folder.glob("chunk_*.npz"))
    for number, path in enumerate(chunks):
        try:
            with np.load(path, allow_pickle=False) as file:
                for name in (*CHUNK_ARRAYS, *(f"state_{name}" for name in State._names)):
                    file[name]  # the archive checks the sum of each array that is read
        except Exception:  # noqa: BLE001 - NumPy and zipfile raise what they like for damaged files
            for broken in chunks[number:]:
                broken.unlink(missing_ok=True)  # another process may have found it too
            return


def _tell(report: Callable[[str], None] | None, done: int, before: int, total: int, began: float) -> None:
    if report is None:
        return
    spent = time.monotonic() - began
    left = spent * (total - done) / (done - before) if done > before else float("nan")
    rest = f", {left:.0f} s left" if np.isfinite(left) else ""
    report(f"simulating: {done} of {total} frames{rest}")


@threadpool_limits.wrap(limits=1, user_api="blas")
def _record(run: Run, folder: Path, after_chunk: Callable[[], None] | None = None) -> None:
    """Simulate a run chunk by chunk; each chunk holds the state at its end, from which the next one goes on."""
    first = _first_missing(folder)
    simulation = _simulation_at(run, first, _state(folder, first))
    for chunk in range(first, run.chunk_count):
        _write(folder, chunk, _chunk(run, simulation, chunk))
        if after_chunk is not None:
            after_chunk()


def _record_apart(todo: Sequence[tuple[Path, Run]], workers: ClusterWorkers, told: Callable[[], None]) -> None:
    """The same by processes that do not see the folders: each gets a state and sends a chunk back."""
    chunks = [_first_missing(folder) for folder, _ in todo]

    def job(number: int) -> partial[dict[str, np.ndarray]]:
        (folder, run), chunk = todo[number], chunks[number]
        return partial(_chunk_apart, run, run.key(), chunk, _state(folder, chunk))

    def after(number: int, arrays: dict[str, np.ndarray]) -> partial[dict[str, np.ndarray]] | None:
        folder, run = todo[number]
        _write(folder, chunks[number], arrays)
        chunks[number] += 1
        return job(number) if chunks[number] < run.chunk_count else None

    workers.run_in_steps([job(number) for number in range(len(todo))], after, told)


def _chunk_apart(run: Run, key: str, chunk: int, state: State | None) -> dict[str, np.ndarray]:
    """A chunk from the state before it; the simulation is kept for the next one."""
    simulation = _going_on.pop((key, chunk), None) or _simulation_at(run, chunk, state)
    arrays = _chunk(run, simulation, chunk)
    _going_on[key, chunk + 1] = simulation
    while len(_going_on) > GOING_ON:
        _going_on.pop(next(iter(_going_on)))
    return arrays


def _first_missing(folder: Path) -> int:
    """The number of the first chunk that is not there."""
    first = 0
    while (folder / f"chunk_{first:04d}.npz").exists():
        first += 1
    return first


def _state(folder: Path, chunk: int) -> State | None:
    """The state from which a chunk goes on; None for the first."""
    if chunk == 0:
        return None
    with np.load(folder / f"chunk_{chunk - 1:04d}.npz", allow_pickle=False) as last:
        return State(*(last[f"state_{name}"] for name in State._names))


def _simulation_at(run: Run, chunk: int, state: State | None) -> Simulation:
    """The simulation of a run where a chunk begins."""
    simulation = run.simulation()
    if state is not None and chunk < run.chunk_count:
        simulation.state = state
        body = simulation.body
        probes = body.probes, body.probe_weights  # chosen by the first pose, not by the one to go on from
        simulation.place_body(run.poses[chunk * run.chunk])
        body.probes, body.probe_weights = probes
    return simulation


def _chunk(run: Run, simulation: Simulation, chunk: int) -> dict[str, np.ndarray]:
    """Simulate a chunk: its arrays as they are stored."""
    levels, count = run.levels, run.levels.subdivision.coarse_count
    at_coarse = levels.subdivision.at_coarse if run.fine else np.arange(count)
    rows: dict[str, list] = {"frames": [], "positions": [], "contact": [], "nearest": []}
    times = []
    first, last = chunk * run.chunk, min((chunk + 1) * run.chunk, run.frame_count)
    if run.while_whole and first * run.dt > run.lead_in and _has_come_apart(run, simulation):
        last = first
    for frame in range(first, last):
        simulation.pose_body(run.poses[frame + 1])
        began = time.perf_counter()
        simulation.step_cloth(run.dt, run.wind)
        times.append(time.perf_counter() - began)
        if (frame + 1) % run.every == 0:
            state = simulation.state
            rows["frames"].append(frame + 1)
            rows["positions"].append(state.world().astype(np.float32))
            rows["contact"].append(state.contact[at_coarse])
            rows["nearest"].append(state.nearest[at_coarse])
    arrays = {name: np.array(values) for name, values in rows.items()}
    if not len(arrays["frames"]):
        arrays["frames"] = np.zeros(0, int)
        arrays["positions"] = np.zeros((0, simulation.model.vertex_count, 3), np.float32)
        arrays["contact"], arrays["nearest"] = np.zeros((0, count), np.float32), np.zeros((0, count), np.int32)
    arrays["coarse"] = arrays["positions"]
    if run.fine:
        arrays["coarse"] = levels.filter_down(arrays["positions"]).astype(np.float32)
    arrays["step_ms"] = np.array(1e3 * np.median(times) if times else np.nan)
    return arrays | {f"state_{name}": np.array(getattr(simulation.state, name)) for name in State._names}


def _has_come_apart(run: Run, simulation: Simulation) -> bool:
    mesh = run.levels.fine if run.fine else run.levels.coarse
    return crossed_share(mesh, simulation.state.position[:, :3]) > COME_APART


def _write(folder: Path, chunk: int, arrays: dict[str, np.ndarray]) -> None:
    with replacing(folder / f"chunk_{chunk:04d}.npz") as temporary, open(temporary, "wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def _read(run: Run, folder: Path) -> Recording:
    names = ("frames", "positions", "coarse", "contact", "nearest", "step_ms")
    parts: dict[str, list] = {name: [] for name in names}
    for chunk in range(run.chunk_count):
        with np.load(folder / f"chunk_{chunk:04d}.npz", allow_pickle=False) as data:
            for name in names:
                parts[name].append(data[name])
    step_ms = float(np.nanmedian(parts.pop("step_ms")))
    return Recording(name=run.name, step_ms=step_ms, **{name: np.concatenate(parts[name]) for name in names[:-1]})
