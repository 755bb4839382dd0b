"""Rows of the validation table about motion: swinging, falling, turning."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.optimize import curve_fit
from scipy.special import jn_zeros, jv

from precompute.experiment.measures import FRAME_RATE, GRAVITY
from precompute.experiment.sheets import level
from precompute.validation.membrane_rows import ROPE
from precompute.validation.strip_references import swing_period
from precompute.validation.trial import FABRIC, Curve, Trial, TrialResult, TrialSetting, strip
from precompute.validation.validation_row import Parameter, ParameterChoice, Row

__all__ = ["ROWS"]

MOVING = ("default", "fem-stvk/verlet")
SWINGS = 10
AMPLITUDE = 0.01  # of the tip over the length


@lru_cache(maxsize=4)
def _swinging(setting: TrialSetting) -> tuple[np.ndarray, np.ndarray, float]:
    """Times [s] and side displacement over L of the tip of a 1 m strip let go in its first mode; cost [ms]."""
    length = 1.0
    specimen = strip(length, 3.0 * length / setting.edges, setting.edges, clamp=0)
    x = specimen.flat[:, 0]
    start = np.stack([np.zeros_like(x), -x, specimen.flat[:, 1]], axis=1)
    trial = Trial(specimen, start, ROPE, x < 1e-9, setting)
    trial.settle(math.sqrt(length / GRAVITY), still=1e-6)
    mode = jv(0, jn_zeros(0, 1)[0] * np.sqrt(np.clip(1.0 - x / length, 0.0, 1.0)))
    trial.state.position[:, 0] += (AMPLITUDE * length * mode).astype(np.float32)
    trial.state.velocity[:] = 0.0
    frames = math.ceil(SWINGS * swing_period() * math.sqrt(length / GRAVITY) * FRAME_RATE)
    tip = x > length - 1e-9
    way = np.zeros(frames + 1)
    for frame in range(frames + 1):
        if frame:
            trial.frame()
        way[frame] = trial.world()[tip, 0].mean() / length
    return np.arange(frames + 1) / FRAME_RATE, way, trial.cost_ms


def _fitted(times: np.ndarray, way: np.ndarray) -> tuple[float, float]:
    """Frequency [rad/s] and rate of decay [1/s] of a swing."""
    law = lambda t, size, rate, omega, phase: size * np.exp(-rate * t) * np.cos(omega * t + phase)  # noqa: E731
    omega = 2.0 * math.pi / (swing_period() / math.sqrt(GRAVITY))
    found, _ = curve_fit(law, times, way, (AMPLITUDE, 0.01, omega, 0.0), maxfev=20_000)
    return abs(float(found[2])), float(found[1])


def _swing(setting: TrialSetting) -> TrialResult:
    times, way, cost = _swinging(setting)
    omega, _ = _fitted(times, way)
    exact = AMPLITUDE * np.cos(2.0 * math.pi * times / (swing_period() / math.sqrt(GRAVITY)))
    curve = Curve("t [s]", "tip / L", (times, exact), (times, way))
    return TrialResult.relative(swing_period(), 2.0 * math.pi / omega * math.sqrt(GRAVITY), cost, curve)


def _damping(setting: TrialSetting) -> TrialResult:
    """Implicit Euler keeps 1/sqrt(1 + z^2) of the amplitude a step, z = omega h."""
    times, way, cost = _swinging(setting)
    omega, rate = _fitted(times, way)
    h = 1.0 / (FRAME_RATE * setting.substeps)
    period = swing_period() / math.sqrt(GRAVITY)
    keeps = -0.5 * math.log1p((2.0 * math.pi / period * h) ** 2) / h  # [1/s]
    curve = Curve("t [s]", "amplitude / L", (times, AMPLITUDE * np.exp(keeps * times)), (times, np.abs(way)))
    exact = math.exp(keeps * SWINGS * period)
    return TrialResult.relative(exact, math.exp(-rate * SWINGS * 2.0 * math.pi / omega), cost, curve)


def _momentum(setting: TrialSetting, quantity: str, spin: float) -> TrialResult:
    """A wavy sheet: falls for 1 s, or turns and flies for 1 s without weight."""
    specimen = strip(0.5, 0.4, setting.edges, clamp=0)
    start = level(specimen.flat - specimen.flat.mean(axis=0))
    start[:, 1] = 0.03 * np.sin(9.0 * start[:, 0]) * np.cos(7.0 * start[:, 2])
    falls = quantity == "fall"
    gravity = (0.0, -GRAVITY if falls else 0.0, 0.0)
    trial = Trial(specimen, start, FABRIC, np.zeros(0, int), setting, gravity)
    mass = trial.model.mass
    arm = start - mass @ start / mass.sum()
    if not falls:
        trial.state.velocity[:] = np.cross([0.0, spin, 0.0], arm) + [0.5, 0.2, -0.1]
    before = _momenta(trial, mass)
    for _ in range(round(FRAME_RATE)):
        trial.frame()
    after = _momenta(trial, mass)
    if falls:
        drop = -float(mass @ (trial.world() - start)[:, 1] / mass.sum())
        h = 1.0 / (FRAME_RATE * setting.substeps)
        return TrialResult.relative(0.5 * GRAVITY * (1.0 + h), drop, trial.cost_ms)
    k = ("linear", "angular").index(quantity)
    size = float(np.linalg.norm(before[k]))
    error = float(np.linalg.norm(after[k] - before[k])) / size
    return TrialResult(size, float(np.linalg.norm(after[k])), error, trial.cost_ms)


def _momenta(trial: Trial, mass: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Linear momentum [kg m/s] and angular momentum about the centre of mass [kg m2/s]."""
    velocity, position = trial.state.velocity.astype(float), trial.world()
    total = mass @ velocity
    arm = position - mass @ position / mass.sum()
    return total, np.cross(arm, mass[:, None] * (velocity - total / mass.sum())).sum(axis=0)


ROWS = (
    Row("swing", "hanging strip let go in its first mode: T sqrt(g/L)", _swing, 0.003, 0.01,
        best_solvers=MOVING),
    Row("damping", "amplitude left after 10 swings, against that of implicit Euler", _damping, 0.02, 0.05,
        best_solvers=("default", "fem-stvk/implicit-euler")),
    Row("momentum", "wavy sheet, 1 s: drop in free fall [m], linear momentum [kg m/s], angular momentum [kg m2/s]",
        _momentum, 1e-6, 1e-4,
        {"quantity": ParameterChoice("what is measured", "fall", ("fall", "linear", "angular")),
         "spin": Parameter("angular velocity [rad/s]", 1.0, 0.0, 20.0)},
        tuple({"quantity": q} for q in ("fall", "linear", "angular")), MOVING),
)  # fmt: skip
