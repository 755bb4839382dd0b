"""Divides the time of a frame among its parts, from outside: methods and launches of kernels are wrapped meanwhile."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from typing import Any
from unittest.mock import patch

from pbd.taichi_internals import Launch
from runtime.play.fine_garment import FineGarment
from runtime.play.simulation import Simulation
from wrinkles.relaxation import Relaxation

__all__ = ["PARTS", "Stopwatch", "stopwatch"]

PARTS = ("skinning", "preparation", "search", "coarse_step", "network", "surface", "relaxation", "normals", "rest")
"""All parts. ``preparation`` and ``network`` are all that their methods do outside of the kernels of other parts,
``rest`` is all that is outside of every other part."""

METHODS = (
    (Simulation, "pose_body", "skinning"),
    (Simulation, "step_cloth", "preparation"),
    (FineGarment, "make", "network"),
    (Relaxation, "__call__", "relaxation"),
    (FineGarment, "update_normals", "normals"),
)
# Where a kernel is launched while a part runs, and its module begins so, its time is another part's. The first that
# fits counts.
KERNELS = (
    ("preparation", "pbd.xpbd.state_summary", "preparation"),
    ("preparation", "pbd.contact", "search"),
    ("preparation", "pbd.xpbd", "coarse_step"),
    ("network", "wrinkles.dictionary", "network"),
    ("network", "wrinkles.network", "network"),
    ("network", "wrinkles", "surface"),
    ("network", "pbd", "relaxation"),
)


class Stopwatch:
    """Counts processor time by part; parts nest, and the innermost one is charged."""

    def __init__(self) -> None:
        self._spent: dict[str, float] = defaultdict(float)
        self._running = ["rest"]
        self._marked = time.process_time()

    def _mark(self) -> None:
        now = time.process_time()
        self._spent[self._running[-1]] += now - self._marked
        self._marked = now

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Charge what runs inside to a part."""
        self._mark()
        self._running.append(name)
        try:
            yield
        finally:
            self._mark()
            self._running.pop()

    def take(self) -> dict[str, float]:
        """Time of each part since the last call [ms]; a part that did not run is left out."""
        self._mark()
        spent = {name: 1e3 * seconds for name, seconds in self._spent.items()}
        self._spent.clear()
        return spent

    def part_of(self, module: str) -> str:
        """The part that a kernel of a module belongs to when it is launched now."""
        running = self._running[-1]
        return next((part for where, start, part in KERNELS if where == running and module.startswith(start)), running)


@contextmanager
def stopwatch() -> Iterator[Stopwatch]:
    """A stopwatch that is started and stopped by the methods and kernels of a frame while this is open."""
    watch = Stopwatch()

    def charged(function: Callable[..., Any], part: str) -> Callable[..., Any]:
        @wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            with watch.part(part):
                return function(*arguments, **named)

        return call

    plain = Launch.__call__

    def launch(self: Launch, *arguments: Any) -> None:
        with watch.part(watch.part_of(self.module)):
            plain(self, *arguments)

    with ExitStack() as stack:
        for owner, name, part in METHODS:
            stack.enter_context(patch.object(owner, name, charged(getattr(owner, name), part)))
        stack.enter_context(patch.object(Launch, "__call__", launch))
        yield watch
