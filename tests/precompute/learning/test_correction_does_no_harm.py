"""The correction of the coarse motion harms nothing in states unlike those of training. `pytest -s -m proof`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest

from pbd.distance import penetration_figures
from precompute.learning.evaluation import CHANCE, SETTLE, Truth, body_distances, free_figures, mean_figures
from precompute.learning.pipeline import scene_run
from precompute.learning.recording import Recording, Run, move_start
from precompute.workers import Workers
from runtime.garment_setup import GarmentSetup, scene_of
from runtime.player import Player
from runtime.simulation import Simulation
from tests.data import ROOT
from wrinkles.database import WrinkleDatabase, read_database

SECONDS = 2.0  # of each situation that are judged [s]
TRUE_RUNS, OUR_RUNS = 3, 4
PULL = 0.25  # how far a vertex of the hem is pulled [m]
DASH = 4.0  # [m/s]
JUDGED = {"low_frequency_bias": 0.1, "octave_error_max": 0.02, "inside_body_percent": 0.1}
"""Figures that may become worse by chance, or by so little."""


@dataclass(frozen=True)
class Situation:
    """Something that may happen to a garment.

    Attributes:
        run: the fine run, whose poses lie a tick of 1/60 s apart.
        rate: ticks of ours [Hz].
        pulls: whether a vertex is dragged.
    """

    run: Run
    rate: float = 60.0
    pulls: bool = False

    @property
    def first(self) -> int:
        """Pose at which what is judged begins."""
        return round(SETTLE / self.run.dt)

    @property
    def frames(self) -> np.ndarray:
        """Poses that are judged: each second one."""
        return np.arange(self.first + 2, len(self.run.poses), 2)

    def pose(self, number: float) -> np.ndarray:
        """A pose, between those of the run interpolated."""
        before, poses = min(int(number), len(self.run.poses) - 2), self.run.poses
        return ((1.0 - number + before) * poses[before] + (number - before) * poses[before + 1]).astype(poses.dtype)

    def target(self, number: float, start: np.ndarray) -> np.ndarray:
        """Where a vertex is dragged that was at a point when it was caught [m]: outwards, and along with the body."""
        middle = np.append(self.run.body.vertices.mean(axis=0), 1.0)
        there, caught = (self.pose(k)[0] @ middle for k in (number, self.first))
        out = np.array([1.0, 0.0, 1.0]) * (start - caught)
        pulled = min(1.0, (number - self.first) * self.run.dt / 0.5)
        return start + there - caught + pulled * PULL * out / np.linalg.norm(out)


def situations(run: Run) -> dict[str, Situation]:
    first, count = round(SETTLE / run.dt), round(SECONDS / run.dt)
    led, there = run.poses[:first], run.poses[first : first + count]
    lasts = np.clip(np.arange(count) * run.dt, 0.0, 0.5 * SECONDS)  # the dash ends half-way
    dashed = there.copy()
    dashed[..., 2, 3] += (DASH * lasts).reshape(-1, *[1] * (there.ndim - 3))
    usual = replace(run, poses=np.concatenate([led, there]))
    return {
        "as learned": Situation(usual),
        "3 times as fast": Situation(replace(run, poses=np.concatenate([led, run.poses[first::3][:count]]))),
        "30 Hz": Situation(usual, rate=30.0),
        "120 Hz": Situation(usual, rate=120.0),
        "wind of 5 m/s": Situation(replace(usual, wind=(0.0, 0.0, 5.0))),
        "pulled at its hem": Situation(usual, pulls=True),
        "a dash of 4 m/s": Situation(replace(run, poses=np.concatenate([led, dashed]))),
    }


def hem(run: Run) -> int:
    """The lowest coarse vertex that is free."""
    heights = run.levels.coarse.vertices[:, 1].copy()
    heights[run.levels.coarse_held] = np.inf
    return int(heights.argmin())


def played(
    situation: Situation,
    a_tick: float,
    simulation: Simulation,
    vertex: int,
    step: Callable[[np.ndarray], None],
    shown: Callable[[], np.ndarray],
) -> np.ndarray:
    """Vertices in the frames that are judged [m], float32, shape (f, N, 3); a step goes on by ``a_tick`` poses."""
    wanted, found, caught = set(situation.frames.tolist()), [], None
    for number in np.arange(a_tick, len(situation.run.poses) - 1 + 1e-6, a_tick):
        if situation.pulls and number > situation.first:
            caught = simulation.state.world()[vertex] if caught is None else caught
            simulation.drag(vertex, situation.target(number, caught))
        step(situation.pose(number))
        if number in wanted:
            found.append(shown())
    return np.array(found)


def true_frames(situation: Situation, start: int, finer: float) -> np.ndarray:
    run = situation.run
    simulation = replace(run, start=start, solver=replace(run.solver, substep=run.solver.substep / finer)).simulation()

    def step(pose: np.ndarray) -> None:
        simulation.pose_body(pose)
        simulation.step_cloth(run.dt, run.wind)

    vertex = int(run.levels.subdivision.at_coarse[hem(run)])
    return played(situation, 1.0, simulation, vertex, step, lambda: simulation.state.world().astype(np.float32))


def our_frames(database: WrinkleDatabase, situation: Situation, start: int) -> np.ndarray:
    run, dt = situation.run, 1.0 / situation.rate
    player = Player(database, run.body, run.poses[0], run.primitives)
    move_start(player.simulation.state, start)
    return played(
        situation,
        dt / run.dt,
        player.simulation,
        hem(run),
        lambda pose: player.update(pose, dt, run.wind),
        lambda: (player.vertices + player.origin).astype(np.float32),
    )


def truth_of(situation: Situation, workers: Workers) -> Truth:
    jobs = [partial(true_frames, situation, start, 1.0) for start in range(TRUE_RUNS)]
    first, *others, finer = workers.run([*jobs, partial(true_frames, situation, 0, 1.5)])
    run = situation.run
    recording = Recording(run.name, situation.frames, first, *[first[:0]] * 3, step_ms=0.0)
    truth = Truth(run, run.levels, recording, finer, first[:0, 0], tuple(others))
    return replace(truth, energy=truth.bands.energy(first))


def figures_of(database: WrinkleDatabase, situation: Situation, truth: Truth, workers: Workers) -> dict[str, float]:
    runs = workers.run([partial(our_frames, database, situation, start) for start in range(OUR_RUNS)])
    return mean_figures(truth, runs, workers.run([partial(figures_of_run, truth, frames) for frames in runs]))


def figures_of_run(truth: Truth, frames: np.ndarray) -> dict[str, float]:
    return free_figures(truth, frames) | penetration_figures(*body_distances(truth, frames))


@pytest.mark.proof
@pytest.mark.parametrize("name", ["demo/skirt", "sewn_tshirt"])
def test_the_correction_does_no_harm(name: str) -> None:
    """Databases as `gube demo` and `gube precompute docs/scenes/sewn_tshirt.toml -o out/sewn_tshirt.h5` learn them."""
    path = ROOT / "out" / f"{name}.h5"
    if not path.exists():
        pytest.skip(f"no {path}")
    database = read_database(path)
    if database.correction is None:
        pytest.skip(f"{path} has no correction of the coarse motion")
    scene = scene_of(database)
    stage = GarmentSetup.of(scene)
    truths: dict[tuple[int, bool], Truth] = {}  # another rate of ours has the same
    harmed = []
    with Workers.of(2) as workers:
        for words, situation in situations(scene_run(stage, scene, stage.motion(scene.training.held_out[0]))).items():
            key = id(situation.run), situation.pulls
            truths[key] = truth = truths.get(key) or truth_of(situation, workers)
            without, corrected = (
                figures_of(one, situation, truth, workers) for one in (replace(database, correction=None), database)
            )
            for figure, least in JUDGED.items():
                off = corrected[figure] - without[figure]
                chance = np.hypot(corrected[CHANCE + figure], without[CHANCE + figure])
                if figure != "low_frequency_bias":  # whose chance is that of the mean already
                    chance /= np.sqrt(OUR_RUNS)
                sys.stdout.write(
                    f"\n{name}, {words}: {figure} {without[figure]:.3f} without, {corrected[figure]:.3f} with, "
                    f"chance of the difference {chance:.3f}"
                )
                if off > max(2.0 * chance, least):
                    harmed.append(f"{words}: {figure}")
    assert not harmed
