"""Processes that work side by side: one thread each, none of them outlives a parent that was killed."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from typing import TypeVar

from threadpoolctl import threadpool_limits

__all__ = ["run_jobs", "worker_pool"]

Result = TypeVar("Result")

BLAS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
GLANCE = 5.0  # between two looks at what jobs have come to [s]


def run_jobs(
    jobs: Sequence[Callable[[], Result]],
    workers: int,
    *,
    done: Callable[[int, Result], None] | None = None,
    meanwhile: Callable[[], None] | None = None,
) -> list[Result]:
    """Call every job and return the results in the order of the jobs.

    Args:
        jobs: functions that another process finds by name, or ``functools.partial`` of them, started in this order.
        workers: processes at a time; with one of them all jobs stay in this process.
        done: called after each job with the number of jobs that have ended, and its result.
        meanwhile: called every few seconds while other processes work.

    Raises:
        Exception: the first that a job raises; jobs that wait for their turn are given up.
        concurrent.futures.BrokenExecutor: a process was ended from outside.
    """
    tell = done or (lambda count, result: None)
    if workers == 1:
        results = []
        for job in jobs:
            results.append(job())
            tell(len(results), results[-1])
        return results
    with worker_pool(min(workers, len(jobs)) or 1) as pool:
        futures = [pool.submit(job) for job in jobs]
        pending = set(futures)
        while pending:
            ended, pending = wait(pending, timeout=GLANCE, return_when=FIRST_COMPLETED)
            for count, future in enumerate(ended, len(futures) - len(pending) - len(ended) + 1):
                tell(count, future.result())
            if meanwhile is not None:
                meanwhile()
        return [future.result() for future in futures]


@contextmanager
def worker_pool(workers: int, prepare: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """A pool of new processes; an exception in the block gives up what still waits for its turn.

    Args:
        workers: how many.
        prepare: called in each of them before its first job.
    """
    with ProcessPoolExecutor(workers, get_context("spawn"), _begin, (prepare,)) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _begin(prepare: Callable[[], None] | None) -> None:
    """One thread for Taichi and one for BLAS; and an end of this process when the parent's comes."""
    os.environ["GUBE_THREADS"] = "1"
    threadpool_limits(1, user_api="blas")  # for what is loaded
    for name in BLAS:  # for what is loaded later, such as SciPy's own copy
        os.environ[name] = "1"
    parent = parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
    if prepare is not None:
        prepare()
