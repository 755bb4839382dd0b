"""Worker processes: one pool for a whole command, so that kernels are compiled once in each of them."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

__all__ = ["Workers", "begin_worker"]

WAIT = 5.0  # from one look at the progress to the next [s]

Item = TypeVar("Item")
Result = TypeVar("Result")


def begin_worker() -> None:
    """One thread a worker; and a worker whose parent was killed ends too, instead of simulating on for nobody."""
    os.environ["GUBE_THREADS"] = "1"
    parent = parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


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
            self._pool = ProcessPoolExecutor(self.count, get_context("spawn"), begin_worker)
        futures = [self._pool.submit(_timed, function, item) for item in items]
        try:
            pending: set[Future] = set(futures)
            while pending:
                finished, pending = wait(pending, timeout=WAIT, return_when=FIRST_COMPLETED)
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
