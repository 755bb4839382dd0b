"""Footsteps for a path: feet that stand still on the floor, legs, hips, trunk and arms that follow from them.

A path says where the hips are to go. Steps are planned one after the other: a foot that is not where the path will need
it swings there; when both are, the figure stands. Everything else is read off the feet, so that starting, stopping,
turning and walking need no cases of their own. Lengths are in metres for a leg of 0.8 m and scale with the leg.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from assets.procedural.figure import Curves, Figure, rot_y, smoothstep

__all__ = ["FRAME_RATE", "Plan", "Raise", "Spin", "curves_of", "smooth"]

Floats = NDArray[np.float64]

FRAME_RATE = 60.0  # [Hz]
_SWING_SHARE = 0.76  # share of a step in which the foot is in the air
_REFERENCE_LEG = 0.8  # leg length that the numbers here are meant for [m]


@dataclass(frozen=True)
class Raise:
    """A leg lifted from standing and set down again where it was.

    Attributes:
        start, end: [s].
        side: 0 left, 1 right.
        offset: highest place of the foot against where it stood: outwards, up, ahead [m], shape (3,).
    """

    start: float
    end: float
    side: int
    offset: tuple[float, float, float]


@dataclass(frozen=True)
class Spin:
    """A time [s] in which the feet turn with the body, on their balls, instead of stepping."""

    start: float
    end: float


@dataclass
class Plan:
    """Speed, turning and posture over time, sampled at :data:`FRAME_RATE`; F frames.

    Attributes:
        speed: forwards [m/s], shape (F,).
        yaw_rate: to the left [rad/s], shape (F,).
        squat: how far the hips are lowered [m], shape (F,).
        spread: how far the feet stand apart, more than usual: sideways each, left ahead of right [m], shape (F, 2).
        pelvis, trunk: see :class:`~assets.procedural.figure.Curves`; added to the gait's own [rad], shape (F, 3).
        shift: of the hips over the feet, left and ahead [m], shape (F, 2).
        arms: see :class:`~assets.procedural.figure.Curves` [rad], shape (2, F, 3).
        arm_swing, hip_swing: strength of the gait's swing of arms and hips [-], shape (F,).
        cadence: steps per second against the usual [-], shape (F,).
        raises, spins: events; the path should stand still during raises.
    """

    speed: Floats
    yaw_rate: Floats
    squat: Floats
    spread: Floats
    pelvis: Floats
    trunk: Floats
    shift: Floats
    arms: Floats
    arm_swing: Floats
    hip_swing: Floats
    cadence: Floats
    raises: list[Raise] = field(default_factory=list)
    spins: list[Spin] = field(default_factory=list)

    @classmethod
    def standing(cls, duration: float) -> Plan:
        """A plan of that many seconds in which nothing happens."""
        frames = round(duration * FRAME_RATE) + 1
        arms = np.tile(np.radians([2.0, 14.0, 14.0]), (2, frames, 1))
        zero = lambda *shape: np.zeros((frames, *shape))  # noqa: E731
        one = np.ones(frames)
        return cls(zero(), zero(), zero(), zero(2), zero(3), zero(3), zero(2), arms, one.copy(), one.copy(), one.copy())

    @property
    def times(self) -> Floats:
        """[s], shape (F,)."""
        return np.arange(len(self.speed)) / FRAME_RATE


@dataclass(frozen=True)
class _Move:
    """A foot's way from one place to the next; a way without an end in space is a spin."""

    start: float
    end: float
    origin: Floats
    goal: Floats
    turns: tuple[float, float]
    raised: Floats | None = None
    spin: bool = False


def smooth(values: Floats, width: float) -> Floats:
    """Gaussian low-pass over frames (the first axis) with a standard deviation of `width` [s]; ends are held."""
    reach = int(np.ceil(3.0 * width * FRAME_RATE))
    if reach == 0:
        return values
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (width * FRAME_RATE)) ** 2)
    kernel /= kernel.sum()
    padded = np.concatenate([np.repeat(values[:1], reach, axis=0), values, np.repeat(values[-1:], reach, axis=0)])
    flat = padded.reshape(len(padded), -1)
    smoothed = np.stack([np.convolve(column, kernel, "valid") for column in flat.T], axis=1)
    return np.asarray(smoothed, dtype=np.float64).reshape(values.shape)


def curves_of(figure: Figure, plan: Plan) -> Curves:
    """The figure's curves for a plan, one value for each of its frames."""
    scale = figure.leg_length / _REFERENCE_LEG
    walk = _Walk(figure, plan, scale)
    moves = walk.steps()
    feet, turns = walk.feet(moves)
    pitch, toes = walk.foot_pitch(moves)
    # How far the left foot is ahead of the right one, and which one carries: 1 the left, -1 the right.
    apart = np.einsum("fji,fj->fi", rot_y(walk.heading), feet[0] - feet[1])
    ahead = smooth(apart[:, 2], 0.04) / scale
    stepping = smooth(_carrying(plan, moves, raised=False), 0.09)
    raised = smooth(_carrying(plan, moves, raised=True), 0.15)

    pelvis, trunk, arms = _upper_body(plan, ahead, stepping)
    # The hips go along the path, over the foot that carries, and behind the feet in a squat.
    aside = np.zeros((len(plan.speed), 3))
    aside[:, 0] = 0.028 * stepping * plan.hip_swing + 0.075 * raised + plan.shift[:, 0]
    aside[:, 2] = plan.shift[:, 1] - 0.22 * plan.squat
    hips = walk.ground + scale * np.einsum("fij,fj->fi", rot_y(walk.heading), aside)
    curves = Curves(hips, walk.heading, pelvis, trunk, feet, turns, pitch, toes, arms)
    # As high as both legs allow, and higher where both feet stand on their balls.
    lift = (figure.ankle_places(curves)[:, :, 1] - feet[:, :, 1]).min(axis=0)
    walking = 0.011 * smoothstep(smooth(plan.speed, 0.1) / 0.8)
    wanted = lift - lift[0] - scale * (0.008 + walking + plan.squat)
    hips[:, 1] = smooth(_lower_envelope(np.minimum(figure.highest_hips(curves).min(axis=0), wanted), 0.05), 0.05)
    return curves


def _carrying(plan: Plan, moves: list[list[_Move]], raised: bool) -> Floats:
    """1 while only the left foot is on the floor, -1 while only the right one is, shape (F,); steps or raises."""
    carrying = np.zeros(len(plan.speed))
    for side in (0, 1):
        for move in moves[side]:
            if not move.spin and (move.raised is not None) == raised:
                carrying[(plan.times > move.start) & (plan.times < move.end)] += 2.0 * side - 1.0
    return carrying


def _upper_body(plan: Plan, ahead: Floats, carrying: Floats) -> tuple[Floats, Floats, Floats]:
    """Pelvis, trunk and arms (see :class:`~assets.procedural.figure.Curves`), planned and moved by the steps."""
    pelvis, trunk, arms = plan.pelvis.copy(), plan.trunk.copy(), plan.arms.copy()
    gait = smoothstep(plan.speed / 0.5)
    # The side of the leading foot goes ahead and that of the free foot sinks; the shoulders do the opposite.
    pelvis[:, 1] -= 0.17 * ahead * plan.hip_swing
    pelvis[:, 2] -= 0.075 * carrying * plan.hip_swing * gait
    trunk[:, 1] += (0.10 + 0.24 * plan.hip_swing) * ahead * gait
    trunk[:, 2] += 0.085 * carrying * plan.hip_swing * gait
    # Who is faster leans further forward.
    pelvis[:, 0] += 0.03 * smooth(plan.speed, 0.2)
    trunk[:, 0] += 0.02 * smooth(plan.speed, 0.2)
    swing = 0.62 * smooth(ahead, 0.05) * plan.arm_swing / (1.0 + 0.5 * np.maximum(plan.speed - 1.2, 0.0))
    for side, sign in ((0, -1.0), (1, 1.0)):
        arms[side, :, 0] += sign * swing
        arms[side, :, 2] += np.maximum(0.0, 0.35 + sign * swing) * 0.5 * gait * plan.arm_swing
    return pelvis, trunk, arms


def _lower_envelope(values: Floats, width: float) -> Floats:
    """The least value within `width` [s] before and after."""
    reach = round(width * FRAME_RATE)
    padded = np.pad(values, reach, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).min(axis=1)


class _Walk:
    """The path of a plan and the steps along it."""

    def __init__(self, figure: Figure, plan: Plan, scale: float) -> None:
        self.plan, self.scale, self.duration = plan, scale, float(plan.times[-1])
        self.heading = np.cumsum(plan.yaw_rate) / FRAME_RATE
        ahead = rot_y(self.heading)[:, :, 2]
        travel = np.cumsum(scale * plan.speed[:, None] * ahead, axis=0) / FRAME_RATE
        self.ground = travel - travel[0]
        self._stand = figure.ankles.copy()
        self._width = max(0.92 * np.abs(figure.ankles[:, 0]).mean(), 0.09 * scale)

    def _frame(self, time: float) -> int:
        return int(np.clip(round(time * FRAME_RATE), 0, len(self.heading) - 1))

    def place(self, side: int, time: float) -> tuple[Floats, float]:
        """Where the foot belongs when the body is where it is at a time, and how it is turned."""
        k = self._frame(time)
        sign = 1.0 - 2.0 * side
        wide, ahead = self.scale * self.plan.spread[k]
        local = np.array([sign * (self._width + wide), 0.0, self._stand[side, 2] + 0.5 * sign * ahead])
        return self.ground[k] + rot_y(self.heading[k]) @ local, self.heading[k] + sign * 0.07

    def _goal(self, side: int, landing: float, halfway: float) -> tuple[Floats, float]:
        """Where to set a foot down: where it belongs half-way through its stand, if a leg reaches that far."""
        goal, turn = self.place(side, halfway)
        near, _ = self.place(side, landing)
        far = np.linalg.norm(goal - near)
        return near + (goal - near) * min(1.0, 0.42 * self.scale / max(far, 1e-9)), turn

    def _pace(self, time: float, hasty: bool) -> float:
        """Steps per second [1/s]; in haste the feet get into place before a raise or a spin."""
        k = self._frame(time)
        soon = slice(k, k + round(0.45 * FRAME_RATE))
        pace = max(1.05 + 0.7 * self.plan.speed[soon].max(), np.abs(self.plan.yaw_rate[soon]).max() / 0.55)
        return float(np.clip(max(pace * self.plan.cadence[k], 2.0 * hasty), 1.2, 3.4))

    def steps(self) -> list[list[_Move]]:
        """Moves of each foot, in order."""
        feet = [self._stand[side].copy() for side in (0, 1)]
        turns = [0.0, 0.0]
        moves: list[list[_Move]] = [[], []]
        busy = sorted([*self.plan.raises, *self.plan.spins], key=lambda event: event.start)
        time, side = 0.15, 0
        while time < self.duration:
            step = 1.0 / self._pace(time, hasty=bool(busy) and busy[0].start < time + 1.2)
            landing = time + _SWING_SHARE * step
            if busy and landing > busy[0].start:
                time = self._event(busy.pop(0), feet, turns, moves)
                continue
            halfway = min(landing + 0.5 * (2.0 - _SWING_SHARE) * step, busy[0].start if busy else np.inf)
            goals = [self._goal(foot, landing, halfway) for foot in (0, 1)]
            gaps = [
                np.linalg.norm(goals[foot][0] - feet[foot]) + 0.3 * abs(goals[foot][1] - turns[foot]) for foot in (0, 1)
            ]
            if max(gaps) < 0.035 * self.scale:
                time, side = time + 0.05, int(gaps[1] > gaps[0])
                continue
            if gaps[side] < 0.02 * self.scale:
                side = 1 - side
            goal, turn = goals[side]
            moves[side].append(_Move(time, landing, feet[side], goal, (turns[side], turn)))
            feet[side], turns[side] = goal, turn
            time, side = time + step, 1 - side
        return moves

    def _event(self, event: Raise | Spin, feet: list, turns: list, moves: list) -> float:
        """Add a raise or a spin to the moves; the time after it."""
        first, last = self._frame(event.start), self._frame(event.end)
        if isinstance(event, Raise):
            sign = 1.0 - 2.0 * event.side
            offset = self.scale * np.array([sign * event.offset[0], event.offset[1], event.offset[2]])
            raised = rot_y(self.heading[first]) @ offset
            here, turn = feet[event.side], turns[event.side]
            moves[event.side].append(_Move(event.start, event.end, here, here, (turn, turn), raised))
            return event.end + 0.1
        turn = self.heading[last] - self.heading[first]
        for side in (0, 1):
            goal = self.ground[last] + rot_y(turn) @ (feet[side] - self.ground[first])
            moves[side].append(
                _Move(event.start, event.end, feet[side], goal, (turns[side], turns[side] + turn), spin=True)
            )
            feet[side], turns[side] = goal, turns[side] + turn
        return event.end + 0.1

    def feet(self, moves: list[list[_Move]]) -> tuple[Floats, Floats]:
        """Places of the flat feet, shape (2, F, 3), and their turns, shape (2, F)."""
        times = self.plan.times
        places = np.repeat(self._stand[:, None], len(times), axis=1)
        turns = np.zeros((2, len(times)))
        for side in (0, 1):
            for move in moves[side]:
                after = times >= move.end
                places[side][after], turns[side][after] = move.goal, move.turns[1]
                during = (times >= move.start) & ~after
                if move.spin:
                    first = self._frame(move.start)
                    turned = self.heading[during] - self.heading[first]
                    places[side][during] = self.ground[during] + rot_y(turned) @ (move.origin - self.ground[first])
                    turns[side][during] = move.turns[0] + turned
                    continue
                u = (times[during] - move.start) / (move.end - move.start)
                if move.raised is not None:
                    places[side][during] = move.origin + smoothstep(3.0 * np.minimum(u, 1.0 - u))[:, None] * move.raised
                    turns[side][during] = move.turns[0]
                    continue
                # It leaves faster than it lands; the greatest speed is 1.4 of the mean.
                share = -1.6 * u**3 + 2.25 * u**2 + 0.35 * u
                stride = np.linalg.norm(move.goal - move.origin)
                bump = np.sin(np.pi * u**0.8) ** 2
                # Round the other foot rather than through it.
                outward = rot_y(self.heading[during])[:, :, 0] * (1.0 - 2.0 * side)
                places[side][during] = move.origin + share[:, None] * (move.goal - move.origin)
                places[side][during] += (0.02 * self.scale * bump)[:, None] * outward
                places[side][during, 1] += bump * (0.045 * self.scale + 0.02 * stride)
                turns[side][during] = move.turns[0] + share * (move.turns[1] - move.turns[0])
        return np.stack([smooth(place, 0.018) for place in places]), turns

    def foot_pitch(self, moves: list[list[_Move]]) -> tuple[Floats, Floats]:
        """Pitch of the feet and bend of the toes, shape (2, F): the heel strikes first and leaves first."""
        times = self.plan.times
        pitch, toes = np.zeros((2, len(times))), np.zeros((2, len(times)))
        for side in (0, 1):
            keys, planted = [(-1.0, 0.0, 0.0)], -1.0
            for move in moves[side]:
                length, span = np.linalg.norm(move.goal - move.origin) / self.scale, move.end - move.start
                # Only steps ahead roll over the foot.
                k = self._frame(0.5 * (move.start + move.end))
                forward = max(0.0, float((move.goal - move.origin) @ rot_y(self.heading[k])[:, 2])) / self.scale
                roll = min(forward / 1.2, 1.0)
                off, strike = np.radians(12.0 + 46.0 * roll), np.radians(20.0 * roll)
                if move.spin:
                    off, strike = np.radians(22.0), 0.0
                    keys += [
                        (move.start - 0.2, 0.0, 0.0),
                        (move.start, off, off),
                        (move.end - 0.1, off, off),
                        (move.end + 0.2, 0.0, 0.0),
                    ]
                    planted = move.end + 0.2
                    continue
                if move.raised is not None:
                    keys += [(move.start, 0.0, 0.0), (move.start + 0.3 * span, np.radians(30.0), 0.0)]
                    keys += [(move.end - 0.3 * span, np.radians(30.0), 0.0), (move.end, 0.0, 0.0)]
                    planted = move.end
                    continue
                rise = min(0.25 + 0.1 * length, 0.55 * (move.start - planted))
                keys += [
                    (move.start - rise, 0.0, 0.0),
                    (move.start, off, 0.9 * off),
                    (move.start + 0.18 * span, 1.1 * off, 0.7 * off),
                    (move.start + 0.6 * span, 0.0, 0.0),
                    (move.end - 0.08 * span, -strike, 0.0),
                    (move.end, -strike, 0.0),
                    (move.end + 0.09, 0.0, 0.0),
                ]
                planted = move.end + 0.09
            when, heel, toe = np.array(keys).T
            when = np.maximum.accumulate(when)
            pitch[side] = smooth(np.interp(times, when, heel), 0.022)
            toes[side] = smooth(np.interp(times, when, toe), 0.022)
        return pitch, np.maximum(toes, 0.0)
