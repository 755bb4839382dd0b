"""Who shares the work on one garment: one worker alone, or several that meet after every colour of constraints.

Both are made and used in kernels. Methods say which part of a range a worker has; what it writes there is
for the others to read once all have met.
"""

from typing import Any

from pbd.engine import in_kernel, running_arch, subscript, ti

__all__ = ["MOST_WORKERS", "Alone", "Part", "Team"]

MOST_WORKERS = 512  # on one garment: a block of threads of a GPU


@in_kernel
class Alone:
    """One worker that has every range for itself and never waits."""

    _data_oriented = True  # Taichi takes it as it is

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
        """Whether this is the worker that does what is not shared."""
        return True

    @in_kernel
    def row(self, k: Any) -> Any:
        """Row of this worker in a table with k as the slower index."""
        return k

    @in_kernel
    def size(self) -> Any:
        """Number of workers."""
        return 1

    @in_kernel
    def meet(self) -> None:
        """Wait until all workers are here."""


class Team(Alone):
    """Worker of several.

    Args:
        worker, workers: its number and how many there are.
        meetings: int32 array; how many workers have come to all meetings so far, zero at the start.
        garment: index into ``meetings``.
        awaited: an int32 variable of the kernel, zero at the start.
    """

    def __init__(self, worker: Any, workers: Any, meetings: Any, garment: Any, awaited: Any) -> None:
        self._worker, self._workers = worker, workers
        self._meetings, self._garment, self._awaited = meetings, garment, awaited

    @in_kernel
    def begin(self, begin: Any, end: Any) -> Any:
        return _bound(begin, end, self._worker, self._workers)

    @in_kernel
    def end(self, begin: Any, end: Any) -> Any:
        return _bound(begin, end, self._worker + 1, self._workers)

    @in_kernel
    def first(self) -> Any:
        return self._worker == 0

    @in_kernel
    def row(self, k: Any) -> Any:
        return k * self._workers + self._worker

    @in_kernel
    def size(self) -> Any:
        return self._workers

    @in_kernel
    def meet(self) -> None:
        if running_arch() == "cuda":
            ti.simt.block.sync()
        else:
            _wait(self._meetings, self._garment, self._workers, self._awaited)


@ti.func
def _bound(begin: ti.i32, end: ti.i32, part: ti.i32, parts: ti.i32) -> ti.i32:
    return begin + (end - begin) * part // parts


@ti.func
def _wait(meetings: ti.template(), garment: ti.i32, workers: ti.i32, awaited: ti.template()):
    # Atomic operations of the CPU are fences too: whatever was written before is there for all to read.
    if workers > 1:
        awaited += workers
        ti.atomic_add(meetings[garment], 1)
        while ti.atomic_add(meetings[garment], 0) < awaited:
            pass


@in_kernel
class Part:
    """Rows of a longer array, used in a kernel as if they were an array of their own.

    Args:
        array: argument of the kernel.
        start: where its first element is.
        rows: number of rows.
        width: elements in a row, None for an array of one dimension.
    """

    _data_oriented = True

    def __init__(self, array: Any, start: Any, rows: Any, width: Any = None) -> None:
        self._array, self._start, self._width = array, start, width
        self.shape = [rows] if width is None else [rows, width]

    def __getitem__(self, index: Any) -> Any:
        if self._width is not None:
            row, column = index
            index = row * self._width + column
        return subscript(self._array, self._start + index)
