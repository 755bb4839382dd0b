"""What a scheduler adds to the time of many databases: Dask's own one, with workers that sleep."""

from __future__ import annotations

import asyncio
import heapq
import logging
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["cluster_row", "durations"]

SPREAD = (0.5, 1.5)  # of the times of databases, over their mean
LOOPBACK = "127.0.0.1"
TOGETHER = 50  # workers that start at a time
QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "1h",
    "distributed.admin.tick.limit": "1h",
    "distributed.comm.timeouts.connect": "600s",
    "distributed.comm.timeouts.tcp": "600s",
    "distributed.scheduler.worker-ttl": None,
}
SLEPT = 10.0  # by each worker in the simulation, about [s]


def durations(minutes: float, databases: int, seed: int = 0) -> np.ndarray:
    """Processor times of databases, spread about their mean [s], shape (databases,)."""
    return 60.0 * minutes * np.random.default_rng(seed).uniform(*SPREAD, databases)


def listed(durations: Sequence[float] | np.ndarray, workers: int) -> float:
    """When the last of them ends if each worker takes the next one as soon as it is free, without any delay [s]."""
    free = [0.0] * workers
    for one in durations:
        heapq.heapreplace(free, free[0] + one)
    return max(free)


def cluster_row(durations: np.ndarray, workers: int, size: int) -> dict[str, float]:
    """One database to a worker at a time, by a real scheduler whose workers sleep a scaled time.

    What the scheduler adds does not shrink with the tasks, so that it is taken in seconds as they come, and compared
    with the true time of the work. All workers live in this process: the figures count their own work, too, and are
    bounds from above.

    Args:
        durations: of the databases [s], shape (n,).
        workers: how many.
        size: of a database, which is sent back [bytes].

    Returns:
        figures of a table's row.
    """
    scale = SLEPT / (durations.sum() / workers)
    measured, spent = asyncio.run(_work(scale * durations, workers, size))
    ideal = listed(durations, workers)
    added = measured - scale * ideal
    return {
        "workers": workers,
        "databases": len(durations),
        "makespan_h": (ideal + added) / 3600.0,
        "least_h": ideal / 3600.0,
        "busy_percent": 100.0 * durations.sum() / (workers * (ideal + added)),
        "added_s": added,
        "added_percent": 100.0 * added / ideal,
        "processor_ms_per_task": 1e3 * spent / len(durations),
        "saturated_workers": durations.mean() * len(durations) / spent,  # where tasks end faster than they are dealt
        "moved_mb": 1e-6 * size * len(durations),
    }


async def _work(durations: np.ndarray, workers: int, size: int) -> tuple[float, float]:
    """Time and processor time until all of them have slept [s]."""
    import dask.config
    from distributed import Client, Scheduler, Worker

    loopback: dict[str, Any] = {"host": LOOPBACK, "dashboard_address": f"{LOOPBACK}:0"}
    # A worker that shares its process with hundreds is silent for long while they start.
    with dask.config.set(QUIET):
        async with Scheduler(**loopback, port=0) as scheduler:
            crew = [
                Worker(scheduler.address, nthreads=1, memory_limit=0, silence_logs=logging.CRITICAL, **loopback)
                for _ in range(workers)
            ]
            for first in range(0, workers, TOGETHER):
                await asyncio.gather(*(worker.start() for worker in crew[first : first + TOGETHER]))
            client: Any = Client(scheduler.address, asynchronous=True, set_as_default=False)
            async with client:
                began, spent = time.monotonic(), time.process_time()
                tasks = [client.submit(_asleep, float(one), size, pure=False) for one in durations]
                await client.gather(tasks)
                found = time.monotonic() - began, time.process_time() - spent
            await asyncio.gather(*(worker.close(nanny=False) for worker in crew))
    return found


async def _asleep(seconds: float, size: int) -> bytes:
    """A database's learning, as the scheduler sees it."""
    await asyncio.sleep(seconds)
    return bytes(size)
