"""A crowd of characters with a plain garment each, on one core and on all that Taichi has."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pbd import BatchSolver
from pbd.engine import running_threads
from precompute.wrinkle_comparison.baselines import Cloth

__all__ = ["crowd_figures"]

COUNT = 16
FRAMES, SKIPPED = 16, 4
DELAY = 3  # frames that each character is behind the one before it


def crowd_figures(cloth: Cloth) -> dict[str, float]:
    """Time of a frame of 16 characters: skinning of all bodies and a step of all garments.

    Garments do not collide with themselves, which a batch cannot do. Times of day, in turns: they are worth something
    only while no other program runs.

    Returns:
        ``crowd16_one_core_ms``: each garment is stepped alone; ``crowd16_NUMBER_cores_ms``: all in one batch;
        ``crowd16_speedup``: of the batch. The last two are left out where Taichi has one thread.
    """
    poses, run = cloth.run.poses, cloth.run
    options = replace(cloth.options, self_collision=False)
    alone, together = ([cloth.simulation(options) for _ in range(COUNT)] for _ in range(2))
    batch = BatchSolver([simulation.solver for simulation in together])

    def step_alone(frame: int) -> None:
        for number, simulation in enumerate(alone):
            simulation.step(poses[_place(frame, number, len(poses))], run.dt, run.wind)

    def step_together(frame: int) -> None:
        for number, simulation in enumerate(together):
            simulation.pose_body(poses[_place(frame, number, len(poses))])
        carried = [simulation.carried(run.dt, run.wind) for simulation in together]
        targets, winds, limit_targets = zip(*carried, strict=True)
        states, colliders = zip(*((one.state, one.colliders) for one in together), strict=True)
        batch.step(states, colliders, run.dt, targets, winds, limit_targets)

    ways = [step_alone, step_together] if running_threads() > 1 else [step_alone]
    times = np.array([[_ms(way, frame) for way in ways] for frame in range(1, FRAMES + 1)])
    middle = np.median(times[SKIPPED:], axis=0)
    figures = {"crowd16_one_core_ms": float(middle[0])}
    if len(ways) > 1:
        figures[f"crowd16_{running_threads()}_cores_ms"] = float(middle[1])
        figures["crowd16_speedup"] = float(middle[0] / middle[1])
    return figures


def _place(frame: int, number: int, count: int) -> int:
    """The pose of a character in a frame."""
    return min(max(0, frame - DELAY * number), count - 1)


def _ms(step: Callable[[int], None], frame: int) -> float:
    begin = time.perf_counter()
    step(frame)
    return 1e3 * (time.perf_counter() - begin)
