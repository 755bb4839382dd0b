"""Where the time of a precompute went: its stages, by the clock and by the processor."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from precompute.workers import Workers

__all__ = ["StageClock", "StageTime", "counted", "remaining", "stage_figures", "stage_table"]

LEAST = 1.0  # from one line about parts that are done to the next [s]


@dataclass(frozen=True)
class StageTime:
    """What a stage took.

    Attributes:
        name: of the stage.
        wall_s: by the clock [s].
        processor_s: of this process and its workers [s].
    """

    name: str
    wall_s: float
    processor_s: float


class StageClock:
    """Times stages that follow each other, and says in every line of progress which of them it belongs to.

    Args:
        names: of all stages, in order.
        workers: whose processor time counts besides that of this process.
        report: called with lines of progress.
    """

    def __init__(self, names: Sequence[str], workers: Workers, report: Callable[[str], None] | None = None) -> None:
        self.times: list[StageTime] = []
        self._names, self._workers, self._report = tuple(names), workers, report

    def __call__(self, line: str) -> None:
        """Report a line of the running stage."""
        if self._report is not None:
            number = min(len(self.times) + 1, len(self._names))
            self._report(f"stage {number} of {len(self._names)}: {line}")

    def begin(self, name: str) -> None:
        """Say that a stage begins."""
        self(name)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the next stage, and begin it with a line.

        Raises:
            ValueError: another stage is next.
        """
        if name != self._names[len(self.times)]:
            raise ValueError(f"stage {name!r} is not next, but {self._names[len(self.times)]!r}")
        self.begin(name)
        wall, processor = time.monotonic(), self._processor_s()
        yield
        self.times.append(StageTime(name, time.monotonic() - wall, self._processor_s() - processor))

    def _processor_s(self) -> float:
        return time.process_time() + self._workers.processor_s


def remaining(began: float, share: float) -> str:
    """``, 12 s left`` for work that began at a time of the monotonic clock [s] and is done to a share."""
    return f", {(time.monotonic() - began) * (1.0 - share) / share:.0f} s left" if 0.0 < share else ""


def counted(report: Callable[[str], None] | None, what: str, total: int) -> Callable[[int, object], None]:
    """A function that reports how many of ``total`` parts are done, and the time left; called after each part.

    Of parts that end soon after each other it reports some, the first and the last among them.
    """
    began, told = time.monotonic(), -LEAST

    def tell(done: int, result: object = None) -> None:
        nonlocal told
        now = time.monotonic() - began
        if report is not None and done and (done >= total or now - told >= LEAST):
            told = now
            report(f"{what}: {done} of {total}{remaining(began, done / total)}")

    return tell


def stage_figures(times: Sequence[StageTime]) -> dict[str, float]:
    """Seconds of each stage by the clock: ``stage_NAME_s``."""
    return {f"stage_{one.name.replace(' ', '_')}_s": one.wall_s for one in times}


def stage_table(times: Sequence[StageTime]) -> str:
    """Stages with their seconds, how many cores they kept busy, and their share of the time."""
    wall, processor = sum(one.wall_s for one in times), sum(one.processor_s for one in times)
    rows = [*times, StageTime("all", wall, processor)]
    lines = [f"{'stage':<24}{'wall s':>10}{'processor s':>14}{'cores':>8}{'share':>8}"]
    for one in rows:
        cores = one.processor_s / one.wall_s if one.wall_s > 0.0 else 0.0
        share = one.wall_s / wall if wall > 0.0 else 0.0
        lines.append(f"{one.name:<24}{one.wall_s:>10.1f}{one.processor_s:>14.1f}{cores:>8.2f}{share:>8.0%}")
    return "\n".join(lines)
