"""Several garments that share a frame budget: planned, changed and played together."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

import numpy as np

from pbd.errors import InputError
from pbd.wind import CALM, Air
from runtime.detail import Detail
from runtime.planner import Choice, Planner, Sight

__all__ = ["Changeable", "Ensemble"]

PLANNED = 5  # ticks from one plan to the next
CUT = 1.5  # times as large as in the last tick, or not seen then: the picture was cut, and nothing of it goes on
CHANGES = 2  # garments that change their detail in one tick: each takes another decoding


class Changeable(Protocol):
    """The methods that a group calls of a :class:`runtime.player.Player`."""

    @property
    def detail(self) -> Detail: ...

    def prepare(self, details: Iterable[Detail]) -> Any: ...

    def change(self, detail: Detail, wait: int = ..., fade: bool = ...) -> Any: ...

    def update(self, pose: np.ndarray, dt: float, wind: Air = ...) -> Any: ...


class Ensemble:
    """Plays several garments within one frame budget, each at the detail that the planner chooses.

    Args:
        players: one for each garment.
        planner: of the same garments, in the same order.
        clock: time that is spent [s]; the default is the processor time of this process.

    Attributes:
        choices: the planner's last ones; a garment may still wait for its turn to change.
        spent_ms: time of the last tick [ms].

    Raises:
        InputError: another number of players than of fronts.
    """

    def __init__(
        self, players: Sequence[Changeable], planner: Planner, *, clock: Callable[[], float] = time.process_time
    ) -> None:
        if len(players) != len(planner.fronts):
            expected = f"{len(planner.fronts)}, as the planner has"
            raise InputError("bad ensemble", key="players", received=len(players), expected=expected)
        self.players, self.planner, self._clock = tuple(players), planner, clock
        for player, front in zip(players, planner.fronts, strict=True):
            player.prepare(setting.detail for setting in front.settings)
        self.choices: list[Choice] = []
        self.spent_ms = 0.0
        self._tick, self._elapsed = 0, math.inf
        self._places: list[tuple[int, int]] = [(0, 0)] * len(players)  # setting, tick of its turn
        self._seen = np.zeros(len(players))  # how large each was [px/m]

    def update(
        self,
        poses: Sequence[np.ndarray],
        dt: float,
        sights: Sequence[Sight],
        wind: Air = CALM,
    ) -> None:
        """Play one tick of all garments.

        Args:
            poses: of each body at the end of the tick.
            dt: [s].
            sights: how each garment is seen.
            wind: velocity of the air [m/s].

        Raises:
            InputError: another number of sights than of garments, or as :meth:`runtime.player.Player.step`.
        """
        began = self._clock()
        planner = self.planner
        foretold = self._foretold()
        seen = np.array([sight.pixels_per_metre for sight in sights])
        cut, self._seen = set(np.flatnonzero(seen > CUT * self._seen).tolist()), seen
        if self._tick % PLANNED == 0 or self.spent_ms > planner.budget_ms or cut:
            self.choices = planner.plan(sights, self._elapsed)
            self._elapsed = 0.0
        self._change(cut)
        for player, pose in zip(self.players, poses, strict=True):
            player.update(pose, dt, wind)
        self._tick += 1
        self._elapsed += dt
        self.spent_ms = 1e3 * (self._clock() - began)
        if foretold > 0.0:
            planner.report(self.spent_ms, foretold)

    def _change(self, cut: set[int]) -> None:
        """Let garments take up their choices: those that a cut made larger at once, of others what saves most first."""
        waiting = [i for i, choice in enumerate(self.choices) if choice.index != self._places[i][0] or not self._tick]
        fronts = self.planner.fronts
        waiting.sort(key=lambda i: self.choices[i].cost_ms - fronts[i].settings[self._places[i][0]].cost_ms)
        turned = [i for i, choice in enumerate(self.choices) if i not in waiting and choice.wait != self._places[i][1]]
        first = [i for i in waiting if i in cut or not self._tick]
        others = [i for i in waiting if i not in first][:CHANGES]
        for i in first + others + turned:
            choice, detail = self.choices[i], fronts[i].settings[self.choices[i].index].detail
            self.players[i].change(detail, (choice.wait - self._tick) % detail.every, i not in cut)
            self._places[i] = choice.index, choice.wait

    def _foretold(self) -> float:
        """What this tick takes by the table [ms]: 0 before the first."""
        total = 0.0
        for front, (index, wait) in zip(self.planner.fronts, self._places, strict=True):
            setting = front.settings[index]
            every, peak = setting.detail.every, setting.peak_ms
            works = (self._tick - wait) % every == 0
            total += peak if works else (every * setting.cost_ms - peak) / (every - 1)
        return total if self._tick else 0.0
