"""Models no more than a scene needs: for each garment the cheapest setting whose error nobody sees, within a budget.

The choice is arithmetic on a measured table (:mod:`runtime.front`). Where the budget does not reach, detail goes where
least is lost for each millisecond, as Funkhouser and Sequin ("Adaptive display algorithm for interactive frame rates
during visualization of complex virtual environments", 1993) do for what is drawn.
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
from runtime.front import Front

__all__ = ["TARGETS", "Choice", "Planner", "Sight", "cheapest", "exhaustive", "sight_of"]

TARGETS = {"imperceptible": 1.0, "accepted": 10.0}
"""Largest error on screen [px] by the name of its class."""

LINES = 1080  # of the screen
ASPECT = 16.0 / 9.0
RELIEF = 0.9  # a cheaper setting is taken up while the scene moves only where its error is this far below the target
SAVING = 0.1  # and where it saves more than this part of the cost: so much dearer may a choice be than the cheapest
HOLD = 0.5  # and only so long after the last change [s]
TURNS = 1.03  # so much dearer may a tick be than it must before all turns are given out anew
ROOM = 0.95  # of the budget is given out where it does not reach, so that the next tick need not choose again
QUICK, SLOW = 0.3, 0.01  # parts of a difference by which the load follows a tick that took more, or less, than foretold
SPIKE = 1.3  # times the load: one tick may be slow for any reason


@dataclass(frozen=True)
class Sight:
    """How a garment is seen.

    Attributes:
        pixels_per_metre: at its distance, by the camera that shows most; 0 where none shows it [px/m].
        size_px: its height on that screen, at most the screen's [px].
        speed: root mean square of the cloth's speed [m/s].
    """

    pixels_per_metre: float
    size_px: float
    speed: float

    def errors(self, front: Front) -> np.ndarray:
        """Error of each setting on screen [px], shape (settings,): no more than the garment's size."""
        return np.minimum(self.pixels_per_metre * front.errors(self.speed), self.size_px)


def sight_of(cameras: Sequence[CameraSettings], centre: Sequence[float], size: float, speed: float) -> Sight:
    """How cameras of 1080 lines and 16:9 see a garment.

    Args:
        cameras: those that are shown.
        centre: of the garment [m], shape (3,).
        size: its height [m]; nearer than that to a camera all of it counts as that near.
        speed: root mean square of its vertices' speed [m/s].
    """
    best = 0.0
    for camera in cameras:
        to_target, to_garment = (np.subtract(point, camera.position) for point in (camera.target, centre))
        distance = max(float(np.linalg.norm(to_garment)), size)
        half = math.tan(math.radians(camera.field_of_view_deg) / 2.0)
        axis = to_target / max(float(np.linalg.norm(to_target)), 1e-9)
        along = float(axis @ to_garment)
        # In the cone around the picture's corners, the garment being a ball.
        aside = math.sqrt(max(0.0, float(to_garment @ to_garment) - along * along))
        if along > -size and aside <= max(along, 0.0) * half * math.hypot(1.0, ASPECT) + size:
            best = max(best, LINES / (2.0 * distance * half))
    return Sight(best, min(best * size, float(LINES)), speed)


@dataclass(frozen=True)
class Choice:
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

    A garment keeps its setting while that will do: a dearer one is taken at once where the error passes the target, a
    cheaper one only with room to spare, for a saving that is worth it, and not soon after another change.

    Args:
        fronts: of each garment.
        target_px: largest error on screen [px].
        budget_ms: for all garments in one tick [ms].

    Attributes:
        load: measured over foretold time of a tick, see :meth:`report`.

    Raises:
        InputError: no garments, a target or a budget that is not positive.
    """

    def __init__(self, fronts: Sequence[Front], target_px: float, budget_ms: float) -> None:
        for key, value in (("target", target_px), ("budget_ms", budget_ms), ("garments", len(fronts))):
            if not 0.0 < value < math.inf:
                raise InputError("bad plan", key=key, received=value, expected="above 0")
        self.fronts = tuple(fronts)
        self.target_px, self.budget_ms = target_px, budget_ms
        self.load = 1.0
        self._current: list[int | None] = [None] * len(fronts)
        self._since = np.zeros(len(fronts))
        self._turns: dict[int, tuple[int, int]] = {}
        self._short = False  # whether the budget does not reach
        self._slots = max(setting.detail.every for front in fronts for setting in front.settings)

    def plan(self, sights: Sequence[Sight], elapsed: float = math.inf) -> list[Choice]:
        """Choose a setting for each garment.

        Args:
            sights: how each garment is seen now.
            elapsed: time since the last plan [s].

        Raises:
            InputError: another number of garments.
        """
        if len(sights) != len(self.fronts):
            raise InputError(
                "bad plan", key="sights", received=len(sights), expected=f"{len(self.fronts)}, one a garment"
            )
        self._since += elapsed
        budget = self.budget_ms / self.load
        errors = [_fitting(front, sight, budget) for sight, front in zip(sights, self.fronts, strict=True)]
        wanted = [self._wanted(i, errors[i]) for i in range(len(sights))]
        chosen = self._within_budget(sights, errors, wanted, budget)
        for i, index in enumerate(chosen):
            if index != self._current[i]:
                self._current[i], self._since[i] = index, 0.0
        return [
            Choice(
                index,
                wait,
                front.settings[index].cost_ms,
                front.settings[index].peak_ms,
                float(errors[i][index]),
                self._why(front, sights[i], errors[i], index, wanted[i]),
            )
            for i, (front, index, wait) in enumerate(zip(self.fronts, chosen, self._waits(chosen, budget), strict=True))
        ]

    def tick_ms(self, choices: Sequence[Choice]) -> float:
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
        """The setting that a garment should have, whatever the budget."""
        costs, current = self.fronts[i].costs, self._current[i]
        best = cheapest(costs, errors, self.target_px)
        if current is None or errors[current] > self.target_px:
            return best
        if self._since[i] < HOLD or costs[best] >= (1.0 - SAVING) * costs[current]:
            return current
        calm = cheapest(costs, errors, RELIEF * self.target_px)
        return calm if costs[calm] < (1.0 - SAVING) * costs[current] else current

    def _within_budget(
        self, sights: Sequence[Sight], errors: list[np.ndarray], wanted: list[int], budget: float
    ) -> list[int]:
        """What fits into a budget [ms]: what is wanted, what there was, or what gives up least."""
        current = [index for index in self._current if index is not None]
        if not self._short or len(current) < len(wanted):
            self._short = bool(self._share(wanted)[1].max() > budget)
            return self._give_up(sights, errors, budget) if self._short else wanted
        if self._share(wanted)[1].max() <= ROOM * budget:
            self._short = False
            return wanted
        if self._share(current)[1].max() <= budget and self._since.min() < HOLD:
            return current
        chosen = self._give_up(sights, errors, ROOM * budget)
        if self._share(current)[1].max() > budget:
            return chosen
        lost = [
            sum(self._losses(*seen)[index] for seen, index in zip(zip(sights, errors, strict=True), which, strict=True))
            for which in (chosen, current)
        ]
        return chosen if lost[0] < (1.0 - SAVING) * lost[1] else current

    def _give_up(self, sights: Sequence[Sight], errors: list[np.ndarray], budget: float) -> list[int]:
        """Take detail from where least is lost for each millisecond until the dearest tick is within the budget."""
        # Many garments take turns and cost what they do on average; with few, the peaks decide.
        found = []
        for prices in ([front.costs for front in self.fronts], [front.peaks for front in self.fronts]):
            start = [cheapest(*pair, self.target_px) for pair in zip(prices, errors, strict=True)]
            chosen = self._cut(sights, errors, prices, start, budget)
            losses = [
                self._losses(*seen)[index] for seen, index in zip(zip(sights, errors, strict=True), chosen, strict=True)
            ]
            over = max(0.0, float(self._share(chosen)[1].max()) - budget)
            found.append((over, sum(losses), chosen))
        return min(found)[2]

    def _cut(
        self,
        sights: Sequence[Sight],
        errors: list[np.ndarray],
        prices: list[np.ndarray],
        chosen: list[int],
        budget: float,
    ) -> list[int]:
        """The steps down, each the one that loses least for what it saves by ``prices`` [ms], those of each setting."""
        steps: list[tuple[float, int, int]] = []

        def offer(i: int) -> None:
            price, loss = prices[i], self._losses(sights[i], errors[i])
            cheaper = np.flatnonzero((price < price[chosen[i]]) & np.isfinite(loss))
            if len(cheaper):
                rates = (np.maximum(loss[cheaper] - loss[chosen[i]], 0.0) + 1e-9) / (price[chosen[i]] - price[cheaper])
                k = int(np.argmin(rates))
                heapq.heappush(steps, (float(rates[k]), i, int(cheaper[k])))

        for i in range(len(chosen)):
            offer(i)
        mean = sum(front.costs[index] for front, index in zip(self.fronts, chosen, strict=True))
        while steps and (mean > budget or self._share(chosen)[1].max() > budget):
            _, i, index = heapq.heappop(steps)
            mean += self.fronts[i].costs[index] - self.fronts[i].costs[chosen[i]]
            chosen[i] = index
            offer(i)
        return chosen

    def _losses(self, sight: Sight, errors: np.ndarray) -> np.ndarray:
        """How much of the picture is off by how much: nothing while it is below the target; shape (settings,)."""
        return np.maximum(errors - self.target_px, 0.0) * sight.size_px**2

    def _share(
        self, chosen: Sequence[int], kept: Mapping[int, tuple[int, int]] = MappingProxyType({})
    ) -> tuple[list[int], np.ndarray]:
        """Which tick of each garment's turn it works in, so that all ticks are alike, and what each tick costs [ms].

        ``kept``: setting and turn of garments; who still has that setting keeps the turn.
        """
        ticks, waits = np.zeros(self._slots), [0] * len(chosen)
        settings = [front.settings[index] for front, index in zip(self.fronts, chosen, strict=True)]
        fixed = {i for i, (index, _) in kept.items() if chosen[i] == index}
        for i in sorted(range(len(chosen)), key=lambda i: (i not in fixed, -settings[i].peak_ms)):
            every, peak = settings[i].detail.every, settings[i].peak_ms
            between = (every * settings[i].cost_ms - peak) / max(1, every - 1)
            waits[i] = kept[i][1] if i in fixed else min(range(every), key=lambda wait: ticks[wait::every].max())
            ticks += between if every > 1 else 0.0
            ticks[waits[i] :: every] += peak - (between if every > 1 else 0.0)
        return waits, ticks

    def _waits(self, chosen: Sequence[int], budget: float) -> list[int]:
        """Everyone's turn; who stays with a setting keeps it, unless some tick would be too dear."""
        waits, ticks = self._share(chosen, self._turns)
        anew = self._share(chosen)
        if ticks.max() > max(TURNS * budget, TURNS * anew[1].max()):
            waits = anew[0]
        self._turns = dict(enumerate(zip(chosen, waits, strict=True)))
        return waits

    def _why(self, front: Front, sight: Sight, errors: np.ndarray, index: int, wanted: int) -> str:
        """The choice explained in a line."""
        setting, error, costs = front.settings[index], errors[index], front.costs
        if sight.pixels_per_metre == 0.0:
            return f"nobody sees it: the cheapest setting, {setting.cost_ms:.3g} ms"
        seen = f"{sight.size_px:.0f} px high"
        if index != wanted:
            return (
                f"{seen}: {setting.cost_ms:.3g} ms and {error:.2g} px; {costs[wanted]:.3g} ms would show "
                f"{errors[wanted]:.2g} px, but the budget is spent where more is seen"
            )
        if error > self.target_px:
            return f"{seen}: nothing that the budget can pay shows less than {error:.2g} px"
        cheaper = np.flatnonzero(costs < setting.cost_ms)
        if not len(cheaper):
            return f"{seen}: the cheapest setting shows {error:.2g} px, below {self.target_px:g}"
        least = float(errors[cheaper].min())
        other = f"shows {least:.2g} px and more" if math.isfinite(least) else "takes more than the budget in one tick"
        return (
            f"{seen}: the cheapest below {self.target_px:g} px shows {error:.2g} px for {setting.cost_ms:.3g} ms; "
            f"what is cheaper {other}"
        )


def _fitting(front: Front, sight: Sight, budget: float) -> np.ndarray:
    """Error of each setting on screen [px], endless where an update alone is beyond the budget [ms]."""
    return np.where(front.peaks <= max(budget, float(front.peaks.min())), sight.errors(front), np.inf)


def cheapest(costs: np.ndarray, errors: np.ndarray, target: float) -> int:
    """The cheapest setting whose error is at most the target; the one of least error where there is none."""
    good = errors <= target
    return int(np.argmin(np.where(good, costs, np.inf))) if good.any() else int(np.argmin(errors))


def exhaustive(fronts: Sequence[Front], sights: Sequence[Sight], target_px: float) -> float:
    """Cost of the cheapest settings that meet the target, by looking at all of them [ms]."""
    total = 0.0
    for front, sight in zip(fronts, sights, strict=True):
        rows = zip(front.settings, sight.errors(front), strict=True)
        total += min((row.cost_ms for row, error in rows if error <= target_px), default=front.settings[0].cost_ms)
    return total
