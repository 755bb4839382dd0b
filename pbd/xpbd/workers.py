"""Who shares the work on one garment: one worker, or several that wait for each other after every colour.

Both kinds are made and used in kernels. Their methods give the part of a range that a worker has. After a barrier all
workers may read what any of them wrote before it.
"""

from typing import Any

from pbd.engine import running_arch, ti
from pbd.taichi_internals import in_kernel

__all__ = ["MAX_WORKERS", "SerialWorker", "WorkerGroup"]

MAX_WORKERS = 512  # on one garment: a block of threads of a GPU


@in_kernel
class SerialWorker:
    """One worker that has every range for itself and never waits."""

    _data_oriented = True  # Taichi hands it on as it is

    @in_kernel
    def begin(self, begin: Any, end: Any) -> Any:
        """Where this worker's part of a range begins."""
        return begin

    @in_kernel
    def end(self, begin: Any, end: Any) -> Any:
        """Where this worker's part of a range ends."""
        return end

    @in_kernel
    def first(self) -> Any:
        """Whether this worker does the work that is not shared."""
        return True

    @in_kernel
    def row(self, k: Any) -> Any:
        """Row of this worker in a table with k as the slower index."""
        return k

    @in_kernel
    def barrier(self) -> None:
        """Wait until all workers are here."""


class WorkerGroup(SerialWorker):
    """One of several workers.

    Args:
        worker, worker_count: its number, and how many workers there are.
        barrier_counts: int32 array, zero at the start; how many workers have come to all barriers so far.
        garment: index into ``barrier_counts``.
        awaited: an int32 variable of the kernel, zero at the start.
    """

    def __init__(self, worker: Any, worker_count: Any, barrier_counts: Any, garment: Any, awaited: Any) -> None:
        self._worker, self._worker_count = worker, worker_count
        self._barrier_counts, self._garment, self._awaited = barrier_counts, garment, awaited

    @in_kernel
    def begin(self, begin: Any, end: Any) -> Any:
        return _bound(begin, end, self._worker, self._worker_count)

    @in_kernel
    def end(self, begin: Any, end: Any) -> Any:
        return _bound(begin, end, self._worker + 1, self._worker_count)

    @in_kernel
    def first(self) -> Any:
        return self._worker == 0

    @in_kernel
    def row(self, k: Any) -> Any:
        return k * self._worker_count + self._worker

    @in_kernel
    def barrier(self) -> None:
        if running_arch() == "cuda":
            ti.simt.block.sync()
        else:
            _wait(self._barrier_counts, self._garment, self._worker_count, self._awaited)


@ti.func
def _bound(begin: ti.i32, end: ti.i32, part: ti.i32, parts: ti.i32) -> ti.i32:
    return begin + (end - begin) * part // parts


@ti.func
def _wait(barrier_counts: ti.template(), garment: ti.i32, worker_count: ti.i32, awaited: ti.template()):
    # Atomic operations of the CPU are fences too: after them all workers see whatever was written before.
    if worker_count > 1:
        awaited += worker_count
        ti.atomic_add(barrier_counts[garment], 1)
        while ti.atomic_add(barrier_counts[garment], 0) < awaited:
            pass
