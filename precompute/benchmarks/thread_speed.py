"""The gain of a second core: for a batch of garments, and for one large cloth that threads share."""

import time
from collections.abc import Callable

import numpy as np

from pbd import BatchSolver, Colliders, Solver, SolverOptions, State
from pbd.engine import ensure_initialized, running_threads
from precompute.benchmarks.solver_scenes import hanging_square
from precompute.mechanics import FRAME_RATE

__all__ = ["thread_speedups"]

FRAMES = 20
# Vertices a side, garments, threads of each, substeps and passes over coarser levels.
CASES = {"thread_speedup_crowd16": (32, 16, 1, 8, 4), "thread_speedup_128": (128, 1, 2, 16, 4)}


def thread_speedups() -> dict[str, float]:
    """Time of a frame on one core over that on two, medians of 20 frames in turns; empty where Taichi has one thread.

    Times of day: they are worth something only while no other program runs.
    """
    ensure_initialized()
    if running_threads() < 2:
        return {}
    return {name: _speedup(*case) for name, case in CASES.items()}


def _speedup(side: int, count: int, threads_each: int, substeps: int, sweeps: int) -> float:
    scene = hanging_square(side)
    solver = Solver(scene.model, SolverOptions(substep=1.0 / (FRAME_RATE * substeps), coarse_sweeps=sweeps))
    batch, colliders = BatchSolver([solver] * count, threads_each), [Colliders() for _ in range(count)]
    singles = [State.at_rest(scene.model) for _ in range(count)]
    shared = [state.copy() for state in singles]

    def alone() -> None:
        for state, collider in zip(singles, colliders, strict=True):
            solver.step(state, collider, 1.0 / FRAME_RATE)

    def together() -> None:
        batch.step(shared, colliders, 1.0 / FRAME_RATE)

    times = np.array([[_time(alone), _time(together)] for _ in range(FRAMES)])
    one, two = np.median(times[1:], axis=0)  # the first frame compiles
    return float(one / two)


def _time(step: Callable[[], None]) -> float:
    begin = time.perf_counter()
    step()
    return time.perf_counter() - begin
