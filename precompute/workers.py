"""Processes that work side by side: one thread each, none of them outlives a parent that was killed."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

__all__ = ["Workers", "run_jobs", "worker_pool"]

Item = TypeVar("Item")
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


class Workers:
    """Processes that live until ``with`` ends; they are started by the first work that needs more than one.

    Results do not depend on their number: each item is worked on alone, with one thread for its kernels and its BLAS.

    Args:
        count: processes; with one alone all work is done in this process.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: ProcessPoolExecutor | None = None
        self._spent: dict[int, float] = {}

    @staticmethod
    @contextmanager
    def of(workers: Workers | int) -> Iterator[Workers]:
        """Workers that live on, or as many as are named, for as long as ``with`` lasts."""
        if isinstance(workers, Workers):
            yield workers
            return
        with Workers(workers) as own:
            yield own

    @property
    def processor_s(self) -> float:
        """Processor time that the workers have used, their start included [s]."""
        return sum(self._spent.values())

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item], on_wait: Callable[[int], None] | None = None
    ) -> list[Result]:
        """Results of a function for each item, in order; the first items are begun first.

        Args:
            function: of a module, so that a worker finds it by its name.
            items: what it is called with, one by one.
            on_wait: told how many items are done, after each of them and every few seconds.

        Raises:
            whatever the function raises; items that were not begun by then never are.
        """
        items, tell = list(items), on_wait or (lambda done: None)
        if self.count == 1 or len(items) < 2:
            results = []
            with threadpool_limits(limits=1, user_api="blas"):
                for item in items:
                    results.append(function(item))
                    tell(len(results))
            return results
        if self._pool is None:
            self._pool = ProcessPoolExecutor(self.count, get_context("spawn"), _begin, (None,))
        futures = [self._pool.submit(_timed, function, item) for item in items]
        try:
            pending: set[Future] = set(futures)
            while pending:
                finished, pending = wait(pending, timeout=GLANCE, return_when=FIRST_COMPLETED)
                for future in finished:
                    _, worker, spent = future.result()
                    self._spent[worker] = max(spent, self._spent.get(worker, 0.0))
                tell(len(futures) - len(pending))
        except BaseException:
            self._close(cancel=True)  # items that wait their turn would only delay the message
            raise
        return [future.result()[0] for future in futures]

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def _close(self, cancel: bool = False) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=not cancel, cancel_futures=cancel)
            self._pool = None


def _timed(function: Callable[[Any], Any], item: Any) -> tuple[Any, int, float]:
    """The result, and which worker gave it after how much processor time [s]."""
    with threadpool_limits(limits=1, user_api="blas"):
        result = function(item)
    return result, os.getpid(), time.process_time()
