"""A game loop at 30 or 60 Hz: fixed ticks, pictures in between, and a count of missed deadlines."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from assets.motion import Motion
from pbd.errors import InputError
from pbd.wind import CALM, Air
from runtime.play.simulation import Simulation

__all__ = ["GameLoop", "LiveInput", "Playable", "ScriptedInput"]

_SPIN = 1e-3  # the last part of a wait is spent awake, because sleeping may end this late [s]
_ROUNDING = 1e-6  # two times that are closer than this count as one [tick]


class LiveInput(NamedTuple):
    """The game's input at one time.

    Attributes:
        pose: pose of the body, as ``player.step`` takes it.
        wind: velocity of the air [m/s].
        drag: a coarse vertex and the point in the world [m], shape (3,), where it is held; None if none is held.
    """

    pose: np.ndarray
    wind: Air = CALM
    drag: tuple[int, np.ndarray] | None = None


class Playable(Protocol):
    """What the loop calls: :class:`runtime.play.player.Player` or :class:`runtime.play.simulation.Simulation`."""

    def step(self, pose: np.ndarray, dt: float, wind: Air = ...) -> Any:
        """Advance by ``dt`` [s] to a pose."""
        ...

    def decode(self, alpha: float = ...) -> Any:
        """Make the picture between the state before the last step (0) and the one after it (1)."""
        ...

    def drag(self, vertex: int, target: np.ndarray | None) -> Any:
        """Hold a vertex at a point in the world [m], shape (3,); None lets it go."""
        ...


class GameLoop:
    """Plays a garment against the clock.

    The garment advances by ticks of a fixed length at any frame rate, so it moves the same at 30 and at 60 Hz, bit for
    bit. A picture between two ticks is interpolated. The last tick reaches the time of the picture or passes it by
    less than a tick, so garment and body are shown at the same time and neither lags. Where the ticks divide the
    frame, the picture is a tick itself.

    An engine with a frame loop of its own calls :meth:`advance` once a frame. :meth:`run` is a whole loop. It makes
    each frame's picture for the end of the frame's period. A late picture is shown at the next multiple of the period,
    as on a display, and the following frame makes up for it. So frames last whole periods, and the number of ticks
    does not depend on small errors of the clock.

    A frame has at most ``max_ticks`` ticks. Time beyond them is dropped and counted: the garment falls behind the
    clock, and frames do not become longer and longer.

    Args:
        player: steps and decodes.
        input: returns the game's input at a time of the garment [s]; called once a tick with the time of the tick's
            end. Live input ignores the time and returns the input that holds now.
        rate_hz: rate of frames [Hz].
        tick: length of a tick [s].
        max_ticks: largest number of ticks in a frame.
        clock: returns a time that only grows [s].
        sleep: waits for about a given time [s].

    Attributes:
        paused: True stops time: no ticks are made, and none are made up for later.
        alpha: place of the last picture: 1 at the last tick, 0 at the tick before.
        tick_count: ticks since the start; the garment's time is ``tick_count * tick``.
        dropped_time: time that was dropped [s].
        missed_deadlines: periods of the last run that ended without a new frame.
        frames_of_ticks: number of frames with 0, 1, ... ticks, int64, shape (max_ticks + 1,).

    Raises:
        InputError: a rate or tick that is not positive; fewer ticks than a frame needs.
    """

    def __init__(
        self,
        player: Playable,
        input: Callable[[float], LiveInput],
        rate_hz: float = 60.0,
        tick: float = 1.0 / 60.0,
        max_ticks: int = 4,
        *,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        for key, value in (("rate_hz", rate_hz), ("tick", tick)):
            if not 0.0 < value < math.inf:
                raise InputError("bad game loop", key=key, received=value, expected="above 0")
        needed = max(1, math.ceil(1.0 / (rate_hz * tick) - _ROUNDING))
        if max_ticks < needed:
            expected = f"at least the {needed} that a frame lasts"
            raise InputError("too few ticks", key="max_ticks", received=max_ticks, expected=expected)
        self.player, self.input = player, input
        self.rate_hz, self.tick, self.max_ticks = rate_hz, tick, max_ticks
        self._clock, self._sleep = clock, sleep
        self.paused = False
        self.alpha = 1.0
        self.tick_count = 0
        self._ahead = 0.0  # from the last tick to the picture [s], 0 or less after each frame
        self._held: int | None = None
        self._clear(0)

    def advance(self, elapsed: float) -> int:
        """Make the next picture.

        Args:
            elapsed: time since the last picture [s]; 0 changes nothing.

        Returns:
            number of ticks that were made.

        Raises:
            InputError: a time below 0 or one that is not finite.
        """
        if not 0.0 <= elapsed < math.inf:
            raise InputError("bad time", key="elapsed", received=elapsed, expected="a finite number, at least 0 [s]")
        if not self.paused:
            self._ahead += elapsed
        ticks = max(0, math.ceil(self._ahead / self.tick - _ROUNDING))
        if ticks > self.max_ticks:
            ticks = self.max_ticks
            self.dropped_time += self._ahead - ticks * self.tick
            self._ahead = ticks * self.tick
        for _ in range(ticks):
            self._advance_tick()
        alpha = 1.0 + self._ahead / self.tick
        if alpha > 1.0 - _ROUNDING:
            alpha = 1.0
        if ticks or alpha != self.alpha:
            self.player.decode(alpha)
        self.alpha = alpha
        self.frames_of_ticks[ticks] += 1
        return ticks

    def go_to(self, tick: int) -> None:
        """Go on from another tick, into whose state the player has been put; its picture is shown already."""
        self.tick_count, self.alpha, self._ahead, self._held = tick, 1.0, 0.0, None

    def run(self, seconds: float, show: Callable[[], Any] | None = None) -> dict[str, float]:
        """Play by the clock.

        Args:
            seconds: time by the clock, rounded to frames [s].
            show: draws or hands on the player's vertices; its time counts as the frame's. Its exceptions end the run.

        Returns:
            :meth:`figures` of this run.

        Raises:
            InputError: less than one frame.
        """
        frames = round(seconds * self.rate_hz) if math.isfinite(seconds) else 0
        if frames < 1:
            raise InputError("nothing to play", key="seconds", received=seconds, expected="at least one frame")
        self._clear(frames)
        clock, period = self._clock, 1.0 / self.rate_hz
        start = clock()
        shown = turn = 0  # periods from the start to the last picture's time, and to the frame's start
        while turn < frames:
            began = clock()
            self.advance((turn + 1 - shown) * period)
            if show is not None:
                show()
            ready = clock()
            shown = turn = turn + 1
            self._frame_ms[self._frame_count] = 1e3 * (ready - began)
            self._frame_count += 1
            if ready > start + turn * period:
                turn = math.ceil((ready - start) * self.rate_hz)
                self.missed_deadlines += turn - shown
            self._wait(start + turn * period)
        return self.figures()

    def figures(self) -> dict[str, float]:
        """Figures of the last run, even if it ended early: frame times without waits [ms], deadlines, ticks."""
        frame_ms = self._frame_ms[: self._frame_count]
        p50, p99 = np.percentile(frame_ms, [50, 99]) if len(frame_ms) else (math.nan, math.nan)
        figures = {
            "frame_count": float(self._frame_count),
            "frame_ms_p50": float(p50),
            "frame_ms_p99": float(p99),
            "missed_deadlines": float(self.missed_deadlines),
            "dropped_time_s": self.dropped_time,
        }
        return figures | {f"frames_of_{ticks}_ticks": float(n) for ticks, n in enumerate(self.frames_of_ticks)}

    def _clear(self, frames: int) -> None:
        self.dropped_time = 0.0
        self.missed_deadlines = 0
        self.frames_of_ticks = np.zeros(self.max_ticks + 1, np.int64)
        self._frame_ms = np.zeros(frames)
        self._frame_count = 0

    def _advance_tick(self) -> None:
        self.tick_count += 1
        self._ahead -= self.tick
        pose, wind, drag = self.input(self.tick_count * self.tick)
        held = self._held
        if held is not None and (drag is None or drag[0] != held):
            self.player.drag(held, None)
            self._held = None
        if drag is not None:
            self.player.drag(*drag)
            self._held = drag[0]
        self.player.step(pose, self.tick, wind)

    def _wait(self, until: float) -> None:
        left = until - self._clock()
        if left > _SPIN:
            self._sleep(left - _SPIN)
        while self._clock() < until:
            pass


class ScriptedInput:
    """Input for demonstrations and measurements: a motion, a gust of wind, and a pull at the garment.

    The gust rises and falls over the middle fifth of the time. After seven tenths of the time the lowest vertex in
    front is held for half a second; it moves along with the body and is pulled outwards.

    Args:
        simulation: simulation of the garment that is played.
        motion: motion of its body.
        seconds: length of the play [s].
        gust: strongest wind of the gust [m/s].
        pull: distance over which the vertex is pulled [m].

    Attributes:
        vertex: the coarse vertex that is held.
        gust_time, drag_time: start and end of each [s].
    """

    def __init__(
        self,
        simulation: Simulation,
        motion: Motion,
        seconds: float,
        gust: tuple[float, float, float] = (5.0, 0.0, 0.0),
        pull: float = 0.15,
    ) -> None:
        self._simulation, self._motion = simulation, motion
        self._gust, self._pull = gust, pull
        self.gust_time = 0.4 * seconds, 0.6 * seconds
        self.drag_time = 0.7 * seconds, 0.7 * seconds + 0.5
        model = simulation.model
        height, cost_table = model.mesh.vertices[:, 1], model.mesh.vertices[:, 2]
        # Height counts five times as much as depth: a hem is nearly level, and its front part is chosen.
        self.vertex = int(np.argmax(np.where(model.inverse_mass > 0.0, cost_table - 5.0 * height, -np.inf)))
        self._grip: np.ndarray | None = None  # where the vertex was taken, less where the body was
        self._outwards = np.zeros(3)

    def __call__(self, t: float) -> LiveInput:
        """Input at a time [s]."""
        pose = self._motion.pose(t)
        begin, end = self.gust_time
        strength = math.sin(math.pi * (t - begin) / (end - begin)) ** 2 if begin < t < end else 0.0
        x, y, z = self._gust
        return LiveInput(pose, (strength * x, strength * y, strength * z), self._drag(pose, t))

    def _drag(self, pose: np.ndarray, t: float) -> tuple[int, np.ndarray] | None:
        begin, end = self.drag_time
        if not begin <= t < end:
            self._grip = None
            return None
        body = self._body_place(pose)
        if self._grip is None:
            world = self._simulation.state.world()
            self._grip = world[self.vertex] - body
            outwards = (world[self.vertex] - world.mean(axis=0)) * [1.0, 0.0, 1.0]
            self._outwards = outwards / max(float(np.linalg.norm(outwards)), 1e-9)
        share = (t - begin) / (end - begin)
        return self.vertex, body + self._grip + self._pull * share * share * (3.0 - 2.0 * share) * self._outwards

    def _body_place(self, pose: np.ndarray) -> np.ndarray:
        """A point that moves along with the body [m], shape (3,)."""
        if pose.shape[1:] != (3, 4):
            return pose.mean(axis=0)  # vertices of a sequence
        mean = pose.mean(axis=0)
        return mean[:, :3] @ self._simulation.model.mesh.vertices[self.vertex] + mean[:, 3]
