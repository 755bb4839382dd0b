"""Play, pause, step, slow, scrub and drag: the state of a viewer's time, without a window.

A motion is played from its start to its end and then from its start again. The moments that were played are kept, so
that each can be shown again and played on from.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from assets.motion import Motion
from pbd import InputError
from pbd.wind import CALM, Air, Wind
from runtime.play.game_loop import GameLoop, LiveInput
from runtime.play.moment import Moment
from runtime.play.simulation import Simulation

__all__ = ["FILM_BYTES", "NO_BODY_SECONDS", "Playback", "Replayable"]

FILM_BYTES = 256e6  # that the kept moments may take; with larger ones some ticks are left out evenly
STILL = Wind(CALM)
NO_BODY_SECONDS = 10.0  # of garments without a body, before they start again [s]


class Replayable(Protocol):
    """What a viewer plays: a :class:`runtime.play.player.Player`."""

    @property
    def simulation(self) -> Simulation: ...

    @property
    def timings(self) -> Mapping[str, float]: ...

    def step(self, pose: Any, dt: float, wind: Air = ...) -> Any: ...

    def decode(self, alpha: float = ...) -> Any: ...

    def drag(self, vertex: int, target: np.ndarray | None) -> Any: ...

    def keep(self) -> Moment: ...

    def go_back(self, moment: Moment, pose: Any) -> Any: ...

    def interpolated(self) -> tuple[np.ndarray, np.ndarray]: ...


class Playback:
    """The time of a viewer.

    Args:
        player: at the start of the motion.
        motion: of its body; None without a body.
        tick: length of a tick [s].
        wind: velocity of the air [m/s].

    Attributes:
        player: shows the present moment.
        wind: velocity of the air from the next tick on [m/s].
        playing: whether time passes.
        speed: the garment's time over the clock's [-].
        dragged: the simulated vertex that is held and where in the world [m]; None if none is.
        end: number of the motion's last tick.
        stride: ticks from one kept moment to the next.
    """

    def __init__(self, player: Replayable, motion: Motion | None, tick: float, wind: Wind = STILL) -> None:
        self.player, self.motion, self.wind = player, motion, wind
        self.playing, self.speed = True, 1.0
        self.dragged: tuple[int, np.ndarray] | None = None
        seconds = NO_BODY_SECONDS if motion is None else motion.duration
        self.end = max(1, math.floor(seconds / tick + 1e-6))
        self._loop = GameLoop(player, self._input, tick=tick)
        first = player.keep()
        self.stride = max(1, math.ceil((self.end + 1) * first.byte_count / FILM_BYTES))
        self._film: list[Moment | None] = [first, *[None] * (self.end // self.stride)]

    @property
    def tick(self) -> float:
        """Length of a tick [s]."""
        return self._loop.tick

    @property
    def tick_count(self) -> int:
        """Number of the last tick."""
        return self._loop.tick_count

    @property
    def time(self) -> float:
        """Time of the picture [s]."""
        return (self.tick_count - 1.0 + self._loop.alpha) * self.tick if self.tick_count else 0.0

    @property
    def duration(self) -> float:
        """Time from the start of the motion to its end [s]."""
        return self.end * self.tick

    def advance(self, elapsed: float) -> None:
        """Make the next picture.

        Args:
            elapsed: time by the clock since the last one [s].
        """
        if not self.playing:
            return
        if self.tick_count >= self.end and self._loop.alpha == 1.0:
            self.go_to(0)
        self._loop.advance(min(elapsed * self.speed, self.duration - self.time))

    def step(self, ticks: int) -> None:
        """Pause and go some ticks on, or back to a kept moment."""
        self.playing = False
        if ticks < 0:
            self.go_to(self.tick_count + ticks if self._loop.alpha == 1.0 else self.tick_count - 1)
            return
        for _ in range(ticks):
            if self.tick_count < self.end or self._loop.alpha < 1.0:
                self._loop.advance(self.tick * ((1.0 - self._loop.alpha) or 1.0))  # to the end of a begun tick

    def scrub(self, seconds: float) -> None:
        """Pause and show the moment at a time [s], or the kept one before it.

        Raises:
            InputError: a time that is not finite.
        """
        if not math.isfinite(seconds):
            raise InputError("bad time", key="time", received=seconds, expected="a finite number [s]")
        self.playing = False
        self.go_to(round(seconds / self.tick))

    def go_to(self, tick: int) -> None:
        """Show the kept moment at a tick, or the last one before it that is kept."""
        place = min(max(tick, 0) // self.stride, len(self._film) - 1)
        while (moment := self._film[place]) is None:
            place -= 1
        self.show(moment, place * self.stride)

    def forget(self, start: Moment) -> None:
        """Keep no moment that was played: the player wears other garments.

        Args:
            start: moment of these at the start of the motion.
        """
        self._film = [start, *[None] * (self.end // self.stride)]
        self.dragged = None

    def show(self, moment: Moment, tick: int) -> None:
        """Show a moment of the player at a tick."""
        self.player.go_back(moment, self._pose(tick))
        self._loop.go_to(tick)

    @property
    def kept_ticks(self) -> list[int]:
        """Ticks whose moments are kept, ascending."""
        return [place * self.stride for place, moment in enumerate(self._film) if moment is not None]

    def drag(self, vertex: int, target: np.ndarray) -> None:
        """Hold a simulated vertex at a point in the world [m], shape (3,), from the next tick on.

        Raises:
            InputError: no such vertex, one that the body carries, or a bad target.
        """
        inverse_mass = self.player.simulation.model.inverse_mass
        if not 0 <= vertex < len(inverse_mass) or inverse_mass[vertex] == 0.0:
            expected = f"a vertex that is free, 0..{len(inverse_mass) - 1}"
            raise InputError("no vertex to drag", key="vertex", received=vertex, expected=expected)
        if np.shape(target) != (3,) or not np.isfinite(target).all():
            raise InputError("bad target", key="target", received=target, expected="three finite numbers [m]")
        self.dragged = vertex, np.asarray(target, float)

    def release(self) -> None:
        """Let the dragged vertex go."""
        self.dragged = None

    def nearest_free_vertex(self, point: np.ndarray) -> int:
        """The simulated vertex that is nearest to a point in the world [m], shape (3,), and free."""
        simulation = self.player.simulation
        distance = np.linalg.norm(simulation.state.world() - point, axis=1)
        return int(np.argmin(np.where(simulation.model.inverse_mass > 0.0, distance, np.inf)))

    def _pose(self, tick: int) -> Any:
        return None if self.motion is None else self.motion.pose(tick * self.tick)

    def _input(self, t: float) -> LiveInput:
        """The loop asks for it once before each tick: the moment before that tick is kept."""
        before = self.tick_count - 1
        if before % self.stride == 0:
            self._film[before // self.stride] = self.player.keep()
        return LiveInput(self._pose(self.tick_count), self.wind, self.dragged)
