"""Several garments that share a frame budget: planned, changed and played together."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

import numpy as np

from pbd.errors import InputError
from pbd.wind import CALM, Air
from runtime.detail.planner import DetailChoice, Planner, ViewSize
from runtime.play.level_of_detail import LevelOfDetail

__all__ = ["Changeable", "GarmentGroup"]

PLANNED = 5  # ticks from one plan to the next [-]
CUT = 1.5  # growth on screen in one tick that counts as a cut to another picture; nothing fades over a cut [-]
CHANGES = 2  # largest number of garments that change their detail in one tick: each change decodes once more


class Changeable(Protocol):
    """The part of :class:`runtime.play.player.Player` that an ensemble needs."""

    @property
    def detail(self) -> LevelOfDetail:
        """Level of detail now."""
        ...

    def prepare(self, details: Iterable[LevelOfDetail]) -> Any:
        """Make everything that these details need."""
        ...

    def change(self, detail: LevelOfDetail, wait: int = ..., *, fade: bool = ...) -> Any:
        """Take a level of detail whose first update comes after ``wait`` ticks."""
        ...

    def update(self, pose: np.ndarray, dt: float, wind: Air = ...) -> Any:
        """Play one tick of ``dt`` [s]."""
        ...


class GarmentGroup:
    """Plays several garments within one frame budget, each at the detail that the planner chooses.

    Args:
        players: one for each garment.
        planner: plans the same garments, in the same order.
        clock: returns the time spent so far [s]; by default the processor time of this process.

    Attributes:
        choices: the planner's last choices; a garment may still wait for its turn to change.
        spent_ms: time that the last tick took [ms].

    Raises:
        InputError: another number of players than of cost tables.
    """

    def __init__(
        self, players: Sequence[Changeable], planner: Planner, *, clock: Callable[[], float] = time.process_time
    ) -> None:
        if len(players) != len(planner.cost_tables):
            expected = f"{len(planner.cost_tables)}, as the planner has"
            raise InputError("bad ensemble", key="players", received=len(players), expected=expected)
        self.players, self.planner, self._clock = tuple(players), planner, clock
        for player, cost_table in zip(players, planner.cost_tables, strict=True):
            player.prepare(setting.detail for setting in cost_table.settings)
        self.choices: list[DetailChoice] = []
        self.spent_ms = 0.0
        self._tick, self._elapsed = 0, math.inf
        self._places: list[tuple[int, int]] = [(0, 0)] * len(players)  # setting, tick of its turn
        self._seen = np.zeros(len(players))  # size on screen of each in the last tick [px/m]

    def update(
        self,
        poses: Sequence[np.ndarray],
        dt: float,
        views: Sequence[ViewSize],
        wind: Air = CALM,
    ) -> None:
        """Play one tick of all garments.

        Args:
            poses: pose of each body at the end of the tick.
            dt: length of the tick [s].
            views: view of each garment.
            wind: velocity of the air [m/s].

        Raises:
            InputError: another number of poses or views than of garments, or as
                :meth:`runtime.play.player.Player.step`.
        """
        for key, values in (("poses", poses), ("views", views)):
            if len(values) != len(self.players):
                raise InputError("one a garment", key=key, received=len(values), expected=str(len(self.players)))
        began = self._clock()
        planner = self.planner
        foretold = self._foretold()
        seen = np.array([view.pixels_per_metre for view in views])
        cut, self._seen = set(np.flatnonzero(seen > CUT * self._seen).tolist()), seen
        if self._tick % PLANNED == 0 or self.spent_ms > planner.budget_ms or cut:
            self.choices = planner.plan(views, self._elapsed)
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
        """Let garments take their choices: after a cut at once, otherwise the ones that save most first."""
        waiting = [i for i, choice in enumerate(self.choices) if choice.index != self._places[i][0] or not self._tick]
        cost_tables = self.planner.cost_tables
        waiting.sort(key=lambda i: self.choices[i].cost_ms - cost_tables[i].settings[self._places[i][0]].cost_ms)
        turned = [i for i, choice in enumerate(self.choices) if i not in waiting and choice.wait != self._places[i][1]]
        first = [i for i in waiting if i in cut or not self._tick]
        others = [i for i in waiting if i not in first][:CHANGES]
        for i in first + others + turned:
            choice, detail = self.choices[i], cost_tables[i].settings[self.choices[i].index].detail
            self.players[i].change(detail, (choice.wait - self._tick) % detail.every, fade=i not in cut)
            self._places[i] = choice.index, choice.wait

    def _foretold(self) -> float:
        """Time of this tick by the cost tables [ms]; 0 before the first tick."""
        total = 0.0
        for cost_table, (index, wait) in zip(self.planner.cost_tables, self._places, strict=True):
            setting = cost_table.settings[index]
            every, peak = setting.detail.every, setting.peak_ms
            works = (self._tick - wait) % every == 0
            total += peak if works else (every * setting.cost_ms - peak) / (every - 1)
        return total if self._tick else 0.0
