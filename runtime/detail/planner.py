"""Chooses for each garment the cheapest setting whose error on screen is small enough, within a frame budget.

The choice is arithmetic on a measured table (:mod:`runtime.detail.cost_table`). If the budget is too small, the
planner takes detail from where each saved millisecond costs the least error on screen, as Funkhouser and Sequin
("Adaptive display algorithm for interactive frame rates during visualization of complex virtual environments", 1993)
do for drawing.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from assets.io.scene import CameraSettings
from pbd.errors import InputError
from runtime.detail.cost_table import CostTable

__all__ = ["TARGETS", "DetailChoice", "Planner", "ViewSize", "sight_of"]

TARGETS = {"imperceptible": 1.0, "accepted": 10.0}
"""Largest error on screen [px] by the name of its class."""

LINES = 1080  # height of the screen [px]
ASPECT = 16.0 / 9.0  # width of the screen over its height [-]
# A garment changes to a cheaper setting only under three conditions, so that it does not change back and forth:
RELIEF = 0.9  # its error is at most this share of the target [-],
SAVING = 0.1  # it saves more than this share of the present cost [-],
HOLD = 0.5  # and the last change was this long ago [s].
TURNS = 1.03  # all turns are given out anew once a tick costs more than this times the least possible cost [-]
ROOM = 0.95  # share of a budget that is too small which is given out, so that the next tick keeps its choices [-]
QUICK, SLOW = 0.3, 0.01  # share of its difference by which the load follows a slower, or a faster, tick [-]
SPIKE = 1.3  # a slow tick counts as at most this times the load: a single one may be slow for any reason [-]


@dataclass(frozen=True)
class ViewSize:
    """View of a garment.

    Attributes:
        pixels_per_metre: scale of the picture at its distance in the camera that shows it largest; 0 where no camera
            shows it [px/m].
        size_px: its height on that screen, at most the screen's [px].
        speed: root mean square of the cloth's speed [m/s].
    """

    pixels_per_metre: float
    size_px: float
    speed: float

    def errors(self, cost_table: CostTable) -> np.ndarray:
        """Error of each setting on screen, at most the garment's size [px], shape (settings,)."""
        return np.minimum(self.pixels_per_metre * cost_table.errors(self.speed), self.size_px)


def sight_of(cameras: Sequence[CameraSettings], centre: Sequence[float], size: float, speed: float) -> ViewSize:
    """View of a garment in cameras of 1080 lines and 16:9.

    Args:
        cameras: the cameras whose pictures are shown.
        centre: centre of the garment [m], shape (3,).
        size: height of the garment, and its smallest distance from a camera that is reckoned with [m].
        speed: root mean square of its vertices' speed [m/s].
    """
    best = 0.0
    for camera in cameras:
        to_target, to_garment = (np.subtract(point, camera.position) for point in (camera.target, centre))
        distance = max(float(np.linalg.norm(to_garment)), size)
        half = math.tan(math.radians(camera.field_of_view_deg) / 2.0)
        axis = to_target / max(float(np.linalg.norm(to_target)), 1e-9)
        along = float(axis @ to_garment)
        # The garment counts as a ball, and the picture as the cone through its corners.
        aside = math.sqrt(max(0.0, float(to_garment @ to_garment) - along * along))
        if along > -size and aside <= max(along, 0.0) * half * math.hypot(1.0, ASPECT) + size:
            best = max(best, LINES / (2.0 * distance * half))
    return ViewSize(best, min(best * size, float(LINES)), speed)


@dataclass(frozen=True)
class DetailChoice:
    """The setting that a garment is played with.

    Attributes:
        index: of the setting in its front.
        wait: its turn: it works in the ticks, counted from the first plan, that are this many after a multiple of the
            detail's ``every``.
        cost_ms, peak_ms: of the setting [ms].
        error_px: on screen [px].
        why: in a line.
    """

    index: int
    wait: int
    cost_ms: float
    peak_ms: float
    error_px: float
    why: str


class Planner:
    """Chooses a setting for each of some garments that share a frame budget.

    A garment keeps its setting while its error is small enough. It takes a dearer setting at once when the error
    exceeds the target. It takes a cheaper one only if the error is well below the target, the saving is large enough
    and the last change was some time ago.

    Args:
        cost_tables: of each garment.
        target_px: largest error on screen [px].
        budget_ms: time for all garments in one tick [ms].

    Attributes:
        load: measured time of a tick over its time by the table [-], see :meth:`report`.

    Raises:
        InputError: no garments, a target or a budget that is not positive.
    """

    def __init__(self, cost_tables: Sequence[CostTable], target_px: float, budget_ms: float) -> None:
        for key, value in (("target", target_px), ("budget_ms", budget_ms), ("garments", len(cost_tables))):
            if not 0.0 < value < math.inf:
                raise InputError("bad plan", key=key, received=value, expected="above 0")
        self.cost_tables = tuple(cost_tables)
        self.target_px, self.budget_ms = target_px, budget_ms
        self.load = 1.0
        self._current: list[int | None] = [None] * len(cost_tables)
        self._since = np.zeros(len(cost_tables))
        self._turns: dict[int, tuple[int, int]] = {}
        self._short = False  # whether the budget is too small
        self._slots = max(setting.detail.every for cost_table in cost_tables for setting in cost_table.settings)

    def plan(self, views: Sequence[ViewSize], elapsed: float = math.inf) -> list[DetailChoice]:
        """Choose a setting for each garment.

        Args:
            views: how each garment is seen now.
            elapsed: time since the last plan [s].

        Raises:
            InputError: another number of garments.
        """
        if len(views) != len(self.cost_tables):
            raise InputError(
                "bad plan", key="views", received=len(views), expected=f"{len(self.cost_tables)}, one a garment"
            )
        self._since += elapsed
        budget = self.budget_ms / self.load
        errors = [_fitting(cost_table, view, budget) for view, cost_table in zip(views, self.cost_tables, strict=True)]
        wanted = [self._wanted(i, errors[i]) for i in range(len(views))]
        chosen = self._within_budget(views, errors, wanted, budget)
        for i, index in enumerate(chosen):
            if index != self._current[i]:
                self._current[i], self._since[i] = index, 0.0
        return [
            DetailChoice(
                index,
                wait,
                cost_table.settings[index].cost_ms,
                cost_table.settings[index].peak_ms,
                float(errors[i][index]),
                self._why(cost_table, views[i], errors[i], index, wanted[i]),
            )
            for i, (cost_table, index, wait) in enumerate(
                zip(self.cost_tables, chosen, self._waits(chosen, budget), strict=True)
            )
        ]

    def tick_ms(self, choices: Sequence[DetailChoice]) -> float:
        """Cost of the dearest tick by the table [ms]."""
        return float(self._share([choice.index for choice in choices])[1].max())

    def report(self, spent_ms: float, foretold_ms: float) -> None:
        """Take note of the time that a tick took, so that budgets are met on the machine as it is.

        Args:
            spent_ms: measured [ms].
            foretold_ms: by the table [ms].
        """
        ratio = min(max(spent_ms / max(foretold_ms, 1e-6), 0.25), 4.0)
        difference = min(ratio, SPIKE * self.load) - self.load
        self.load += (QUICK if difference > 0.0 else SLOW) * difference

    def _wanted(self, i: int, errors: np.ndarray) -> int:
        """The setting that a garment should have if the budget were endless."""
        costs, current = self.cost_tables[i].costs, self._current[i]
        best = _cheapest(costs, errors, self.target_px)
        if current is None or errors[current] > self.target_px:
            return best
        if self._since[i] < HOLD or costs[best] >= (1.0 - SAVING) * costs[current]:
            return current
        calm = _cheapest(costs, errors, RELIEF * self.target_px)
        return calm if costs[calm] < (1.0 - SAVING) * costs[current] else current

    def _within_budget(
        self, views: Sequence[ViewSize], errors: list[np.ndarray], wanted: list[int], budget: float
    ) -> list[int]:
        """Settings that fit into a budget [ms]: the wanted ones, the present ones, or those that lose least."""
        current = [index for index in self._current if index is not None]
        if not self._short or len(current) < len(wanted):
            self._short = bool(self._share(wanted)[1].max() > budget)
            return self._give_up(views, errors, budget) if self._short else wanted
        if self._share(wanted)[1].max() <= ROOM * budget:
            self._short = False
            return wanted
        if self._share(current)[1].max() <= budget and self._since.min() < HOLD:
            return current
        chosen = self._give_up(views, errors, ROOM * budget)
        if self._share(current)[1].max() > budget:
            return chosen
        lost = [
            sum(self._losses(*seen)[index] for seen, index in zip(zip(views, errors, strict=True), which, strict=True))
            for which in (chosen, current)
        ]
        return chosen if lost[0] < (1.0 - SAVING) * lost[1] else current

    def _give_up(self, views: Sequence[ViewSize], errors: list[np.ndarray], budget: float) -> list[int]:
        """Take detail from where each saved millisecond loses least, until the dearest tick is within the budget."""
        # With many garments that take turns the mean cost decides, with few of them the peaks do: both are tried.
        found = []
        for prices in (
            [cost_table.costs for cost_table in self.cost_tables],
            [cost_table.peaks for cost_table in self.cost_tables],
        ):
            start = [_cheapest(*pair, self.target_px) for pair in zip(prices, errors, strict=True)]
            chosen = self._cut(views, errors, prices, start, budget)
            losses = [
                self._losses(*seen)[index] for seen, index in zip(zip(views, errors, strict=True), chosen, strict=True)
            ]
            over = max(0.0, float(self._share(chosen)[1].max()) - budget)
            found.append((over, sum(losses), chosen))
        return min(found)[2]

    def _cut(
        self,
        views: Sequence[ViewSize],
        errors: list[np.ndarray],
        prices: list[np.ndarray],
        chosen: list[int],
        budget: float,
    ) -> list[int]:
        """Step down to cheaper settings, first where the loss for each saved millisecond is smallest.

        Args:
            views: view of each garment.
            errors: error of each setting of each garment [px].
            prices: cost of each setting of each garment that is to be saved [ms].
            chosen: settings to begin with; the steps change them.
            budget: for the dearest tick [ms].

        Returns:
            ``chosen``.
        """
        steps: list[tuple[float, int, int]] = []

        def offer(i: int) -> None:
            price, loss = prices[i], self._losses(views[i], errors[i])
            cheaper = np.flatnonzero((price < price[chosen[i]]) & np.isfinite(loss))
            if len(cheaper):
                rates = (np.maximum(loss[cheaper] - loss[chosen[i]], 0.0) + 1e-9) / (price[chosen[i]] - price[cheaper])
                k = int(np.argmin(rates))
                heapq.heappush(steps, (float(rates[k]), i, int(cheaper[k])))

        for i in range(len(chosen)):
            offer(i)
        mean = sum(cost_table.costs[index] for cost_table, index in zip(self.cost_tables, chosen, strict=True))
        while steps and (mean > budget or self._share(chosen)[1].max() > budget):
            _, i, index = heapq.heappop(steps)
            mean += self.cost_tables[i].costs[index] - self.cost_tables[i].costs[chosen[i]]
            chosen[i] = index
            offer(i)
        return chosen

    def _losses(self, view: ViewSize, errors: np.ndarray) -> np.ndarray:
        """Error above the target times the area on screen [px^3], shape (settings,)."""
        return np.maximum(errors - self.target_px, 0.0) * view.size_px**2

    def _share(
        self, chosen: Sequence[int], kept: Mapping[int, tuple[int, int]] = MappingProxyType({})
    ) -> tuple[list[int], np.ndarray]:
        """Turns of the garments, given out so that all ticks cost about the same.

        Args:
            chosen: setting of each garment.
            kept: earlier setting and turn of garments; a garment that still has this setting keeps the turn.

        Returns:
            the turn of each garment, and the cost of each tick [ms].
        """
        ticks, waits = np.zeros(self._slots), [0] * len(chosen)
        settings = [cost_table.settings[index] for cost_table, index in zip(self.cost_tables, chosen, strict=True)]
        fixed = {i for i, (index, _) in kept.items() if chosen[i] == index}
        for i in sorted(range(len(chosen)), key=lambda i: (i not in fixed, -settings[i].peak_ms)):
            every, peak = settings[i].detail.every, settings[i].peak_ms
            between = (every * settings[i].cost_ms - peak) / max(1, every - 1)
            waits[i] = kept[i][1] if i in fixed else min(range(every), key=lambda wait: ticks[wait::every].max())
            ticks += between if every > 1 else 0.0
            ticks[waits[i] :: every] += peak - (between if every > 1 else 0.0)
        return waits, ticks

    def _waits(self, chosen: Sequence[int], budget: float) -> list[int]:
        """Turn of each garment; one that keeps its setting keeps its turn, unless a tick would become too dear."""
        waits, ticks = self._share(chosen, self._turns)
        anew = self._share(chosen)
        if ticks.max() > max(TURNS * budget, TURNS * anew[1].max()):
            waits = anew[0]
        self._turns = dict(enumerate(zip(chosen, waits, strict=True)))
        return waits

    def _why(self, cost_table: CostTable, view: ViewSize, errors: np.ndarray, index: int, wanted: int) -> str:
        """Reason for a choice, one line."""
        setting, error, costs = cost_table.settings[index], errors[index], cost_table.costs
        if view.pixels_per_metre == 0.0:
            return f"no camera sees it: the cheapest setting, {setting.cost_ms:.3g} ms"
        seen = f"{view.size_px:.0f} px high"
        if index != wanted:
            return (
                f"{seen}: {setting.cost_ms:.3g} ms and {error:.2g} px; {costs[wanted]:.3g} ms would show "
                f"{errors[wanted]:.2g} px, but the budget is spent on garments that are seen better"
            )
        if error > self.target_px:
            return f"{seen}: no setting within the budget shows less than {error:.2g} px"
        cheaper = np.flatnonzero(costs < setting.cost_ms)
        if not len(cheaper):
            return f"{seen}: the cheapest setting shows {error:.2g} px, below {self.target_px:g}"
        least = float(errors[cheaper].min())
        other = f"shows at least {least:.2g} px" if math.isfinite(least) else "takes more than the budget in one tick"
        return (
            f"{seen}: the cheapest below {self.target_px:g} px shows {error:.2g} px for {setting.cost_ms:.3g} ms; "
            f"each cheaper one {other}"
        )


def _fitting(cost_table: CostTable, view: ViewSize, budget: float) -> np.ndarray:
    """Error of each setting on screen [px]; infinite if one update takes longer than the budget [ms]."""
    return np.where(cost_table.peaks <= max(budget, float(cost_table.peaks.min())), view.errors(cost_table), np.inf)


def _cheapest(costs: np.ndarray, errors: np.ndarray, target: float) -> int:
    """Index of the cheapest setting whose error is at most the target, or of the least error if there is none.

    Args:
        costs: cost of each setting [ms], shape (settings,).
        errors: error of each setting, shape (settings,).
        target: largest allowed error, in the unit of the errors.
    """
    good = errors <= target
    return int(np.argmin(np.where(good, costs, np.inf))) if good.any() else int(np.argmin(errors))
