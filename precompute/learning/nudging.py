"""Learns the correction of the coarse garment's motion: what must be added to its velocity to follow the fine one.

The coarse garment is nudged along each training motion towards the filtered fine one, and a network learns what the
nudging had to add.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from pbd import State
from precompute.learning.recording import Recording, Run, move_start
from precompute.learning.training import Layer
from precompute.workers import Workers
from runtime.simulation import Simulation
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.decoder import StateReader
from wrinkles.dictionary import CLIP, CoefficientNetwork
from wrinkles.features import DYNAMIC_COUNT
from wrinkles.motion_correction import VELOCITY_COUNT, MotionCorrection, MotionCorrector, VelocityReader
from wrinkles.network import Network, Samples

__all__ = ["Corrected", "Nudging", "learn_correction"]

KEPT_OUT = 0.25  # last part of each motion, which nothing is learned from: it says whether the correction helps
TICK = 1.0 / 60.0  # to which the strength of nudging belongs [s]
SETTLE = 0.5  # from where the nudging begins: nothing is learned from how the garment is pulled there [s]
STARTS = 2  # free runs of each motion that are judged, 0.01 mm apart
LEAST_GAIN = 0.1  # a correction that brings the garment nearer to the fine one by a smaller share is chance
SAMPLES = 300_000  # that are learned from
HIDDEN, EPOCHS = (96, 48), 6
FAINT = np.float32(1e-2)  # added to the spread of features: some are constant
G = 9.81  # with which a force is compared to the weight [m/s2]
OUTLIERS = 99.9  # percentile of the accelerations of training above which none is


@dataclass(frozen=True)
class Nudging:
    """A motion along which the coarse garment is nudged.

    Attributes:
        run: of the coarse garment.
        frames: ticks at which the fine garment was recorded, ascending, int, shape (f,).
        target: the filtered fine garment in them [m], float32, shape (f, n, 3).
    """

    run: Run
    frames: np.ndarray
    target: np.ndarray

    @classmethod
    def of(cls, run: Run, recording: Recording) -> Nudging:
        """Towards a recorded fine run of the same motion."""
        return cls(run, recording.frames, recording.coarse)

    @property
    def learned_ticks(self) -> int:
        """Ticks that are learned from: the first ones."""
        return round((1.0 - KEPT_OUT) * self.run.frame_count)

    @property
    def judged(self) -> np.ndarray:
        """Which recorded frames nothing is learned from: bool, shape (f,)."""
        return self.frames > self.learned_ticks

    def at(self, tick: int) -> np.ndarray | None:
        """Where the garment is to be [m], shape (n, 3), between recorded frames interpolated; None before the first."""
        after = int(np.searchsorted(self.frames, tick))
        if tick < self.frames[0] or after == len(self.frames):
            return None
        if self.frames[after] == tick:
            return self.target[after]
        part = (tick - self.frames[after - 1]) / (self.frames[after] - self.frames[after - 1])
        return (1.0 - part) * self.target[after - 1] + part * self.target[after]


@dataclass(frozen=True)
class Corrected:
    """What was learned, and how far free runs then are from the fine garment on motion that was kept out.

    Attributes:
        correction: what helps most; None where nothing helps beyond chance.
        without_mm, with_mm: root mean square distance of the mean of free runs without and with it [mm]; equal without.
        force_percent: momentum that it adds in a second, mean size over the ticks, in percent of the weight [%].
        power_w_kg: kinetic energy that it adds, on average [W/kg]; below 0 it takes some away.
    """

    correction: MotionCorrection | None
    without_mm: float
    with_mm: float
    force_percent: float = 0.0
    power_w_kg: float = 0.0


def learn_correction(
    layer: Layer,
    mapping: CoefficientNetwork,
    nudgings: Sequence[Nudging],
    strengths: Sequence[float],
    workers: Workers,
    seed: int,
    report: Callable[[str], None],
) -> Corrected:
    """Nudge, fit and judge with each strength, and keep what helps most.

    Args:
        layer: of the garment.
        mapping: whose features the correction sees.
        nudgings: training motions.
        strengths: shares of what is missing, in place and in velocity, that are added in 1/60 s [-].
        workers: that simulate.
        seed: of weights, shuffling and which samples are taken.
        report: called with lines of progress.
    """
    nudgings = [one for one in nudgings if one.judged.any()]
    if not strengths or not nudgings:
        return Corrected(None, 0.0, 0.0)

    def judged(correction: MotionCorrection | None) -> list[float]:
        """Mean distance over the motions [mm], force [%], power [W/kg]: a mean square would be that of the wildest."""
        stages = [_Stage(layer, mapping, one, correction) for one in nudgings]
        free = workers.run([partial(_follow_freely, stage, start) for stage in stages for start in range(STARTS)])
        places = [run for run, _ in free]
        means = [np.mean(places[first : first + STARTS], axis=0) for first in range(0, len(free), STARTS)]
        off = [mean - one.target[one.judged] for mean, one in zip(means, nudgings, strict=True)]
        mean_mm = 1e3 * float(np.mean([np.sqrt((part**2).sum(axis=2).mean()) for part in off]))
        return [mean_mm, *np.mean([added for _, added in free], axis=0).tolist()]

    without, ticks = judged(None)[0], sum(one.learned_ticks for one in nudgings)
    best = Corrected(None, without, without)
    for strength in strengths:
        jobs = [
            partial(
                _nudged, _Stage(layer, mapping, one, None), strength, SAMPLES * one.learned_ticks // ticks, (seed, k)
            )
            for k, one in enumerate(nudgings)
        ]
        seen, added = (np.concatenate(parts) for parts in zip(*workers.run(jobs), strict=True))
        correction = _fitted(seen, added, seed)
        found = judged(correction)
        report(f"correcting, strength {strength}: {found[0]:.1f} mm from the fine garment, {without:.1f} without")
        if found[0] < min(best.with_mm, (1.0 - LEAST_GAIN) * without):
            best = Corrected(correction, without, *found)
    return best


@dataclass(frozen=True)
class _Stage:
    """The coarse garment with what corrects it."""

    layer: Layer
    mapping: CoefficientNetwork
    nudging: Nudging
    correction: MotionCorrection | None

    def played(self, start: int = 0) -> tuple[Simulation, CoarseFilter, StateReader, MotionCorrector | None]:
        layer, simulation = self.layer, self.nudging.run.simulation()
        move_start(simulation.state, start)
        coarse_filter, reader = CoarseFilter(layer.levels), StateReader(layer.stencil, self.mapping)
        corrector = None
        if self.correction is not None:
            corrector = MotionCorrector(self.correction, self.mapping.place, layer.stencil, coarse_filter)
        return simulation, coarse_filter, reader, corrector


@threadpool_limits.wrap(limits=1, user_api="blas")
def _nudged(stage: _Stage, strength: float, samples: int, seed: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Nudge the coarse garment along a motion.

    Returns:
        inputs of the network, float32, shape (s, DYNAMIC_COUNT + VELOCITY_COUNT + static ones); the accelerations that
        were added, in the frames of the vertices [m/s2], float32, shape (s, 3).
    """
    run, nudging = stage.nudging.run, stage.nudging
    simulation, coarse_filter, reader, _ = stage.played()
    read_velocity, unscaled = VelocityReader(stage.layer.stencil, coarse_filter), np.ones(VELOCITY_COUNT, np.float32)
    matrix, rng, dt = coarse_filter.matrix, np.random.default_rng(seed), run.dt
    strength *= dt / TICK
    free = np.flatnonzero(simulation.state.position[:, 3] > 0.0)
    begin = int(nudging.frames[0] + SETTLE / dt)
    a_tick = min(len(free), max(1, samples // max(1, nudging.learned_ticks - begin)))
    inputs, targets = [], []
    for tick in range(1, nudging.learned_ticks + 1):
        simulation.pose_body(run.poses[tick])
        simulation.step_cloth(dt, run.wind)
        state = simulation.state
        there, before = nudging.at(tick), nudging.at(tick - 1)
        reader.read(coarse_filter(state.position), state.contact)
        change = np.zeros((len(state.velocity), 3))
        if there is not None and before is not None:
            change = matrix @ (strength * ((there - state.world()) / dt + (there - before) / dt - state.velocity))
        if tick >= begin and there is not None:
            some = rng.choice(free, a_tick, replace=False)
            velocities = read_velocity(state.velocity, reader.frames, unscaled, np.inf)
            inputs.append(np.concatenate([reader.features[some], velocities[some], stage.mapping.place[some]], axis=1))
            axes = reader.frames[some].reshape(-1, 3, 3)
            targets.append(np.einsum("kij,kj->ki", axes, change[some] / dt).astype(np.float32))
        state.velocity[free] += change[free].astype(np.float32)
    width = DYNAMIC_COUNT + VELOCITY_COUNT + stage.mapping.place.shape[1]
    nothing = np.zeros((0, width), np.float32), np.zeros((0, 3), np.float32)
    return np.concatenate([nothing[0], *inputs]), np.concatenate([nothing[1], *targets])


@threadpool_limits.wrap(limits=1, user_api="blas")
def _follow_freely(stage: _Stage, start: int) -> tuple[np.ndarray, tuple[float, float]]:
    """Let the coarse garment go by itself.

    Returns:
        where it is, filtered, in the recorded frames that were kept out [m], shape (f, n, 3); means over the ticks of
        the force that the correction adds, in percent of the weight, and of its power [W/kg].
    """
    run, wanted = stage.nudging.run, set(stage.nudging.frames[stage.nudging.judged].tolist())
    simulation, coarse_filter, reader, corrector = stage.played(start)
    mass = simulation.model.mass
    found, force, power = [], 0.0, 0.0
    for tick in range(1, max(wanted) + 1):
        simulation.pose_body(run.poses[tick])
        simulation.step_cloth(run.dt, run.wind)
        state: State = simulation.state
        position = coarse_filter(state.position)
        if tick in wanted:
            found.append(position[:, :3] + state.origin)
        if corrector is not None:
            before = state.velocity.astype(float)
            reader.read(position, state.contact)
            corrector(state, reader.frames, reader.features, run.dt)
            after = state.velocity.astype(float)
            force += float(np.linalg.norm(mass @ (after - before))) / run.dt
            power += 0.5 * float(mass @ (after**2 - before**2).sum(axis=1)) / run.dt
    total = max(wanted) * mass.sum()
    return np.array(found), (100.0 * force / (G * total), power / total)


def _fitted(inputs: np.ndarray, targets: np.ndarray, seed: int) -> MotionCorrection:
    """A network that gives what was added in most states alike."""
    first, second = DYNAMIC_COUNT, DYNAMIC_COUNT + VELOCITY_COUNT
    inputs, unit = inputs.copy(), float(np.sqrt((targets**2).mean()))
    scale = (1.0 / (inputs[:, first:second].std(axis=0) + FAINT)).astype(np.float32)
    inputs[:, first:second] = np.clip(inputs[:, first:second] * scale, -CLIP, CLIP)
    middle, spread = inputs.mean(axis=0), inputs.std(axis=0) + FAINT
    inputs -= middle
    inputs /= spread
    network = Network((inputs.shape[1], *HIDDEN, 3), seed)
    nowhere = np.zeros((1, 0), np.float32)  # each sample has its place among its inputs
    network.fit(Samples(inputs, nowhere, (targets / np.float32(unit)).astype(np.float32)), epochs=EPOCHS)
    weights = network.weights[0] / spread[:, None]
    single = partial(np.ascontiguousarray, dtype=np.float32)
    return MotionCorrection(
        velocity_scale=scale,
        weights_1=single(weights[:first]),
        velocity_weights=single(weights[first:second]),
        place_weights=single(weights[second:]),
        bias_1=single(network.biases[0] - middle @ weights),
        weights_2=single(network.weights[1]),
        bias_2=single(network.biases[1]),
        weights_3=single(unit * network.weights[2]),
        bias_3=single(unit * network.biases[2]),
        most=float(np.percentile(np.linalg.norm(targets, axis=1), OUTLIERS)),
    )
