"""A group put to the test: several garments that share a budget are played under the planner for minutes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pbd import InputError
from precompute.planning.cost_table import cost_table_key
from precompute.planning.plan_trial import SCENES, sight, there_and_back
from precompute.planning.planning import cost_table_of
from precompute.workers import Workers
from runtime.cost_table import cost_table_path, read_cost_table
from runtime.garment_group import GarmentGroup
from runtime.planner import TARGETS, Planner
from runtime.play import playback_inputs
from runtime.player import Player
from wrinkles.database import read_database

__all__ = ["group_figures", "play_group"]

TARGET_PX = TARGETS["imperceptible"]
STAGGER = 2.3  # one camera is so far ahead of that of the garment before [s]
AHEAD = 17  # ticks that one motion is ahead of that before, so that not all are dear in the same tick
BURST = 2.0  # a garment whose box is over this times as long as in the bind pose has burst


def group_figures(
    path: Path,
    garments: int,
    workers: int,
    budget_ms: float,
    seconds: float,
    report: Callable[[str], None] | None = None,
) -> dict[str, float]:
    """Play some copies of a garment or an outfit, each before its own camera that comes near and goes far.

    Args:
        path: the database; its cost table is read beside it, or measured and kept there.
        garments: how many.
        workers: processes that share them out evenly; each plans for its own.
        budget_ms: for all garments of a process in one tick [ms].
        seconds: to play [s].
        report: called with lines of progress.

    Returns:
        ``tick_ms_p50`` and ``tick_ms_p99``, processor time of a tick of one process; ``over_budget_percent``, the share
        of ticks that take longer than the budget; ``full_detail_ms`` of one garment by the table; ``error_px_p50``,
        foretold by the table; ``catastrophic``, ticks in which a garment was not finite or had burst.

    Raises:
        InputError: fewer garments than processes, or none of either.
    """
    if not 1 <= workers <= garments:
        expected = f"1 to {garments}, as many as there are garments"
        raise InputError("processes without garments", key="--workers", received=workers, expected=expected)
    table = cost_table_of(read_database(path), path, report)
    if report is not None:
        report(f"playing {garments} for {seconds:g} s")
    shares = [range(first, garments, workers) for first in range(workers)]
    jobs = [partial(play_group, path, tuple(share), budget_ms, seconds) for share in shares]
    with Workers(workers) as pool:
        found = pool.run(jobs)
    spent, errors = (np.concatenate([part[k] for part in found]) for k in (0, 1))
    return {
        "tick_ms_p50": float(np.median(spent)),
        "tick_ms_p99": float(np.percentile(spent, 99)),
        "over_budget_percent": 100.0 * float((spent > budget_ms).mean()),
        "full_detail_ms": table.settings[0].cost_ms,
        "error_px_p50": float(np.median(errors)),
        "catastrophic": float(sum(part[2] for part in found)),
    }


def play_group(path: Path, numbers: tuple[int, ...], budget_ms: float, seconds: float) -> tuple[Any, Any, int]:
    """Play garments with these numbers in this process; the table beside the database must be there.

    Returns:
        time of each tick [ms], shape (t,); error on screen of each garment in each tick by the table [px],
        shape (t k,); and catastrophic ticks.
    """
    database = read_database(path)
    table = read_cost_table(cost_table_path(path))
    assert table.database == cost_table_key(database)
    inputs, dt = playback_inputs(database), 1.0 / database.frame_rate
    motion, cameras = inputs.motions[0], SCENES["flight"]
    ticks = round(seconds / dt)
    times = there_and_back(motion.duration, dt, ticks + AHEAD * max(numbers))
    starts = [motion.pose(times[AHEAD * number]) for number in numbers]
    players = [Player(database, inputs.body, start, inputs.primitives) for start in starts]
    group = GarmentGroup(players, Planner([table] * len(players), TARGET_PX, budget_ms))
    size = float(np.linalg.norm(np.ptp(database.coarse_vertices, axis=0)))
    spent, errors, catastrophic = [], [], 0
    for tick in range(1, ticks + 1):
        views = [
            sight(player, cameras(tick * dt + STAGGER * number), table)
            for player, number in zip(players, numbers, strict=True)
        ]
        poses = [motion.pose(times[tick + AHEAD * number]) for number in numbers]
        try:
            group.update(poses, dt, views, inputs.wind)
        except InputError:  # a state is not finite
            catastrophic += 1
            break
        spent.append(group.spent_ms)
        errors += [choice.error_px for choice in group.choices]
        boxes = [np.linalg.norm(np.ptp(player.vertices, axis=0)) for player in players]
        catastrophic += not max(boxes) <= BURST * size
    return np.array(spent), np.array(errors), catastrophic
