"""Processes that work side by side: one thread each, none of them outlives a parent that was killed."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from multiprocessing import active_children, get_context, parent_process
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

__all__ = ["Workers", "limit_threads", "run_jobs", "timed", "worker_pool"]

Result = TypeVar("Result")

BLAS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
GLANCE = 4.0  # between two looks at what jobs have come to [s]


class Workers:
    """Processes that live until ``with`` ends, so that kernels are compiled once in each of them.

    They are started by the first jobs that need more than one. Results do not depend on their number.

    Args:
        count: processes at a time; with one of them all jobs stay in this process.
    """

    sees_files = True  # whether a job may read the files of this machine

    def __init__(self, count: int) -> None:
        self.count = count
        self._open = ExitStack()
        self._pool: ProcessPoolExecutor | None = None
        self._spent: dict[int | str, float] = {}

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
        """Processor time that the processes have used, their start included [s]."""
        return sum(self._spent.values())

    def run(
        self,
        jobs: Sequence[Callable[[], Result]],
        *,
        done: Callable[[int, Result], None] | None = None,
        meanwhile: Callable[[], None] | None = None,
    ) -> list[Result]:
        """Call every job and return the results in the order of the jobs; arguments as for :func:`run_jobs`."""
        tell = done or (lambda count, result: None)
        if self.count == 1:
            results = []
            for job in jobs:
                results.append(job())
                tell(len(results), results[-1])
            return results
        if self._pool is None:
            self._pool = self._open.enter_context(worker_pool(self.count))
        futures = [self._pool.submit(timed, job) for job in jobs]
        pending = set(futures)
        with _ending_children():
            while pending:
                ended, pending = wait(pending, timeout=GLANCE, return_when=FIRST_COMPLETED)
                for count, future in enumerate(ended, len(futures) - len(pending) - len(ended) + 1):
                    result, process, spent = future.result()
                    self._spent[process] = max(spent, self._spent.get(process, 0.0))
                    tell(count, result)
                if meanwhile is not None:
                    meanwhile()
        return [future.result()[0] for future in futures]

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: Any) -> None:
        self._open.__exit__(kind, error, trace)
        self._pool = None


def run_jobs(
    jobs: Sequence[Callable[[], Result]],
    workers: Workers | int,
    *,
    done: Callable[[int, Result], None] | None = None,
    meanwhile: Callable[[], None] | None = None,
) -> list[Result]:
    """Call every job in new processes and return the results in the order of the jobs.

    Args:
        jobs: functions that another process finds by name, or ``functools.partial`` of them, started in this order.
        workers: processes at a time, with one of them all jobs stay in this process; or workers that live on.
        done: called after each job with the number of jobs that have ended, and its result.
        meanwhile: called every few seconds while other processes work.

    Raises:
        Exception: the first that a job raises; jobs that wait for their turn are given up.
        concurrent.futures.BrokenExecutor: a process was ended from outside.
    """
    if isinstance(workers, int):
        workers = workers if workers == 1 else min(workers, len(jobs)) or 1
    with Workers.of(workers) as own:
        return own.run(jobs, done=done, meanwhile=meanwhile)


def timed(job: Callable[[], Any]) -> tuple[Any, int, float]:
    """The result, and the process that computed it with its processor time so far [s]."""
    return job(), os.getpid(), time.process_time()


def limit_threads() -> None:
    """One thread for Taichi, and one for each BLAS that is loaded from now on, such as SciPy's own copy."""
    os.environ["GUBE_THREADS"] = "1"
    for name in BLAS:
        os.environ[name] = "1"


@contextmanager
def _ending_children() -> Iterator[None]:
    """Where somebody ends this process in the block, the processes that it started end at once and write no more."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        started = active_children()
        for process in started:
            process.terminate()
        for process in started:
            process.join(GLANCE)
        raise


@contextmanager
def worker_pool(workers: int, prepare: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """A pool of new processes; an exception in the block gives up what still waits for its turn.

    Args:
        workers: how many.
        prepare: called in each of them before its first job.
    """
    with ProcessPoolExecutor(workers, get_context("spawn"), _begin, (prepare,)) as pool:
        try:
            with _ending_children():
                yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _begin(prepare: Callable[[], None] | None) -> None:
    """One thread, and an end of this process when the parent's comes."""
    limit_threads()
    threadpool_limits(1, user_api="blas")  # for what is loaded
    parent = parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
    if prepare is not None:
        prepare()
