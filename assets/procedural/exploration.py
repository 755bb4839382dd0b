"""Procedural motion of any figure, for its clothes to learn from before they meet a new clip.

A motion is cut into segments of 3 to 6 s. Each draws the speed and the turning of the figure, the posture of trunk and
arms, and the action of the legs; everything is low-passed over the joins. So the motion is smooth, never repeats, and
covers more than a recorded clip does: gaits of many speeds, sudden stops, turns, spins, squats, lunges, raised legs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from assets.character import Character, Clip
from assets.motion import ClipMotion
from assets.procedural.figure import Figure
from assets.procedural.gait import FRAME_RATE, Plan, Raise, Spin, curves_of, smooth
from pbd.errors import InputError

__all__ = ["exploration_clip", "exploration_motion"]

Floats = NDArray[np.float64]

_BLEND_SECONDS = 1.0  # from the bind pose into the motion [s]
# Kinds of segments, and the share of each.
_SEGMENT_SHARES = {"walk": 0.46, "turn": 0.14, "squat": 0.12, "lunge": 0.10, "raise": 0.10, "spin": 0.08}


def exploration_motion(character: Character, seed: int, duration: float) -> ClipMotion:
    """A random smooth motion that starts in the bind pose; the same for the same character, seed and duration.

    The root travels and the feet keep to the floor. Joints stay within a healthy range, the upper arms at least 12 deg
    off the trunk.

    Args:
        character: its joints have usual names ("LeftUpLeg", "thigh_l", ...), and it stands upright in its bind pose.
        seed: of the draw.
        duration: [s].

    Raises:
        InputError: joints that cannot be made out by their names; a duration below 2 s.
    """
    return ClipMotion(character, exploration_clip(character, seed, duration), blend=0.0)


def exploration_clip(character: Character, seed: int, duration: float) -> Clip:
    """The clip of :func:`exploration_motion`, at 60 Hz; arguments and errors are the same."""
    if not 2.0 <= duration < np.inf:
        raise InputError("bad duration", key="duration", received=duration, expected="at least 2 s")
    figure = Figure(character)
    curves = curves_of(figure, _plan(np.random.default_rng(seed), duration))
    return figure.clip(curves, f"exploration_{seed}", FRAME_RATE, blend=_BLEND_SECONDS)


def _plan(rng: np.random.Generator, duration: float) -> Plan:
    plan = Plan.standing(duration)
    start = _BLEND_SECONDS + 0.2
    while start < duration:
        end = start + rng.uniform(3.0, 6.0)
        kind = str(rng.choice(list(_SEGMENT_SHARES), p=list(_SEGMENT_SHARES.values())))
        _segment(plan, rng, kind, start, end)
        start = end
    # Speeds change within a few tenths of a second, postures more slowly; nothing jumps.
    plan.speed, plan.yaw_rate = smooth(plan.speed, 0.13), smooth(plan.yaw_rate, 0.12)
    for name in ("squat", "spread", "pelvis", "trunk", "shift", "arm_swing", "hip_swing", "cadence"):
        setattr(plan, name, smooth(getattr(plan, name), 0.22))
    plan.arms = np.stack([smooth(arm, 0.28) for arm in plan.arms])
    plan.pelvis += _waves(rng, plan, np.radians([3.0, 6.0, 3.0]))
    plan.trunk += _waves(rng, plan, np.radians([8.0, 14.0, 7.0]))
    plan.arms[0] += _waves(rng, plan, np.radians([10.0, 5.0, 8.0]))
    plan.arms[1] += _waves(rng, plan, np.radians([10.0, 5.0, 8.0]))
    low, high = np.radians([-45.0, 14.0, 5.0]), np.radians([95.0, 85.0, 95.0])
    plan.arms = np.clip(plan.arms, low, high)
    # An arm across the front or the back of the trunk needs more room.
    plan.arms[:, :, 1] += 0.12 * np.sin(np.minimum(plan.arms[:, :, 2], np.pi / 2.0))
    plan.trunk = np.clip(plan.trunk, np.radians([-18.0, -40.0, -22.0]), np.radians([42.0, 40.0, 22.0]))
    return plan


def _segment(plan: Plan, rng: np.random.Generator, kind: str, start: float, end: float) -> None:
    """Write one segment into the plan; values that it does not set stay as in a standing figure."""
    t = plan.times
    here = (t >= start) & (t < end)
    span = t[here] - start
    length = end - start
    plan.arm_swing[here] = rng.uniform(0.3, 1.3)
    plan.hip_swing[here] = rng.uniform(0.4, 1.5)
    plan.cadence[here] = rng.uniform(0.85, 1.2)
    plan.trunk[here] += np.radians(rng.normal(0.0, [7.0, 8.0, 5.0]))
    for side in (0, 1):
        raised = rng.random() < 0.3 and kind != "raise"
        flexion = rng.uniform(-20.0, 70.0) if raised else rng.normal(4.0, 8.0)
        # Knees and hips come up to the hands where the figure bends.
        nearest = {"squat": 24.0, "lunge": 24.0, "raise": 34.0}.get(kind, 15.0)
        abduction = rng.uniform(25.0, 80.0) if raised else nearest + rng.uniform(0.0, 12.0)
        plan.arms[side, here] = np.radians([flexion, abduction, rng.uniform(8.0, 70.0 if raised else 35.0)])
    if kind == "walk":
        plan.speed[here] = rng.uniform(0.3, 2.0)
        plan.yaw_rate[here] = rng.choice([0.0, 1.0]) * rng.normal(0.0, 0.5)
        if rng.random() < 0.5:
            plan.speed[here] *= span < rng.uniform(0.5, 0.8) * length  # a sudden stop
    elif kind == "turn":
        plan.speed[here] = rng.choice([0.0, rng.uniform(0.2, 0.9)])
        rate, flip = rng.choice([-1.0, 1.0]) * rng.uniform(0.8, 2.0), rng.uniform(0.4, 0.8) * length
        plan.yaw_rate[here] = rate * np.where(span < flip, 1.0, rng.choice([0.0, -1.0]))
    elif kind == "squat":
        depth, beats = rng.uniform(0.08, 0.30), rng.integers(1, 3)
        wave = np.sin(np.pi * beats * span / length) ** 2
        plan.squat[here] = depth * wave
        plan.trunk[here, 0] += 1.1 * depth * wave
        plan.pelvis[here, 0] += 0.9 * depth * wave
        plan.spread[here, 0] = rng.uniform(0.0, 0.12)
        plan.arms[:, here, 0] += 2.5 * depth * wave
    elif kind == "lunge":
        plan.spread[here, 1] = rng.choice([-1.0, 1.0]) * rng.uniform(0.35, 0.65)
        plan.squat[here] = rng.uniform(0.04, 0.18) * np.sin(np.pi * np.clip(span / length, 0.0, 1.0)) ** 2
    elif kind == "raise":
        side = int(rng.integers(2))
        for k in range(2):
            first = start + 0.9 + k * 0.5 * (length - 1.0)
            last = first + 0.5 * (length - 1.0) - 0.35
            ahead, out = rng.uniform(-0.15, 0.45), rng.uniform(0.0, 0.35)
            if last < plan.times[-1] - 0.5:
                plan.raises.append(Raise(first, last, (side + k) % 2, (out, rng.uniform(0.12, 0.42), ahead)))
    else:
        first, last = start + 0.9, start + 0.9 + rng.uniform(0.8, 1.6)
        if last < plan.times[-1] - 0.5:
            turning = (t >= first) & (t < last)
            plan.yaw_rate[turning] = rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 4.2)
            plan.spins.append(Spin(first - 0.3, last + 0.4))
            plan.arms[:, here, 1] += np.radians(rng.uniform(5.0, 35.0))


def _waves(rng: np.random.Generator, plan: Plan, amplitude: Floats) -> Floats:
    """A band of slow waves from 0.15 to 0.9 Hz that swells and ebbs, one for each amplitude, shape (F, columns)."""
    frequency = rng.uniform(0.15, 0.9, (4, len(amplitude)))
    phase = rng.uniform(0.0, 2.0 * np.pi, (4, len(amplitude)))
    t = plan.times[:, None, None]
    return 0.5 * amplitude * np.sin(2.0 * np.pi * frequency * t + phase).sum(axis=1)
