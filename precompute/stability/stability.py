"""The largest stable time step of a garment on a moving body, by bisection."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pbd import SolverOptions
from pbd.wind import Air
from runtime.simulation import BodySource, Simulation

__all__ = ["MAX_SUBSTEP", "MIN_SUBSTEP", "StabilityLimit", "largest_stable_step", "real_substep"]

MIN_SUBSTEP, MAX_SUBSTEP = 1.0 / 2000.0, 1.0 / 10.0  # substeps between which the limit is looked for [s]
BISECTIONS = 7  # bisections: the limit is known to 4 %
FRAME = 1.0 / 60.0  # a frame [s]; longer substeps make longer frames
UNJUDGED_S = 0.5  # the first seconds of a run are not judged [s]
EXCESS_STRAIN = 1.0  # of any edge over the most that it sees in the reference [-]


@dataclass(frozen=True)
class StabilityLimit:
    """The longest substep that one garment is stable with.

    Attributes:
        name: of the setting.
        dt_max: longest substep found stable [s]; 0 if even the shortest tried is not.
        first_to_go: the first failure at the shortest step found unstable: "not finite", "strain" or "speed"; empty if
            none was.
        unstable: shortest substep found unstable [s]; infinite if none was.
    """

    name: str
    dt_max: float
    first_to_go: str
    unstable: float


def largest_stable_step(
    name: str,
    simulation: Callable[[SolverOptions], Simulation],
    options: SolverOptions,
    poses: np.ndarray,
    dt: float,
    wind: Air = (0.0, 0.0, 0.0),
) -> StabilityLimit:
    """Bisect, on a logarithmic scale, for the longest substep that is no catastrophe.

    A catastrophe is a state that is not finite, an edge stretched by 100 % of its length more than it ever is in the
    reference, or a speed over 3 sqrt(2 g H) and the body's own fastest, with the garment's height H. The reference is
    the same garment with substeps of 1/2000 s.

    Args:
        name: of the setting.
        simulation: makes one at the first pose, with the solver's options.
        options: of the solver; the substep is replaced.
        poses: of the body, one every ``dt`` [s].
        dt: [s].
        wind: velocity of the air [m/s].
    """
    start = simulation(options)
    assert start.source is not None  # garments of a database are on a body
    edges, rest = start.model.mesh.edge_lengths()
    height = float(np.ptp(start.model.mesh.vertices[:, 1]))
    gravity = float(np.linalg.norm(options.gravity))
    speed_limit = 3.0 * np.sqrt(2.0 * gravity * height) + _fastest(start.source, poses, dt)

    def attempt(substep: float, allowed: np.ndarray | None) -> tuple[str, np.ndarray]:
        one = simulation(replace(options, substep=substep))
        return _fate(one, poses, dt, substep, wind, edges, rest, speed_limit, allowed)

    fate, most = attempt(MIN_SUBSTEP, None)
    if fate:
        return StabilityLimit(name, 0.0, fate, MIN_SUBSTEP)
    allowed = most + EXCESS_STRAIN
    low, high = real_substep(MIN_SUBSTEP), MAX_SUBSTEP
    fates = {low: "", high: attempt(high, allowed)[0]}
    if not fates[high]:
        return StabilityLimit(name, MAX_SUBSTEP, "", float("inf"))
    for _ in range(BISECTIONS):
        # Several substeps asked for come to the same whole number a frame.
        middle = real_substep(float(np.sqrt(low * high)))
        if middle not in fates:
            fates[middle] = attempt(middle, allowed)[0]
        if fates[middle]:
            high = middle
        else:
            low = middle
    return StabilityLimit(name, low, fates[high], high)


def real_substep(substep: float) -> float:
    """The substep that the solver takes for one asked for: a whole number of them fill a frame [s]."""
    frame = max(FRAME, substep)
    return frame / max(1, int(np.ceil(frame / substep - 1e-6)))


def _fate(
    simulation: Simulation,
    poses: np.ndarray,
    dt: float,
    substep: float,
    wind: Air,
    edges: np.ndarray,
    rest: np.ndarray,
    speed_limit: float,
    allowed: np.ndarray | None,
) -> tuple[str, np.ndarray]:
    """The first failure (empty if there was none), and the largest strain of every edge after the start."""
    frame = max(FRAME, substep)
    most = np.zeros(len(edges))
    for number in range(1, int((len(poses) - 1) * dt / frame + 1e-6) + 1):
        simulation.step(_pose_at(poses, number * frame / dt), frame, wind)
        position, velocity = simulation.state.position[:, :3], simulation.state.velocity
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
            return "not finite", most
        if number * frame < UNJUDGED_S:
            continue
        strain = np.linalg.norm(position[edges[:, 1]] - position[edges[:, 0]], axis=1) / rest - 1.0
        if allowed is not None and np.any(strain > allowed):
            return "strain", most
        if np.linalg.norm(velocity, axis=1).max() > speed_limit:
            return "speed", most
        np.maximum(most, strain, out=most)
    return "", most


def _pose_at(poses: np.ndarray, place: float) -> np.ndarray:
    """Pose between two neighbours: over a sixtieth of a second a straight line is near enough to a turn."""
    first = min(int(place), len(poses) - 2)
    share = min(place - first, 1.0)
    return (1.0 - share) * poses[first] + share * poses[first + 1]


def _fastest(source: BodySource, poses: np.ndarray, dt: float) -> float:
    """Largest speed of a body's vertices [m/s]."""
    origin = np.zeros(3)
    before = np.zeros((len(source.vertices), 3), np.float32)
    after = before.copy()
    source.skin(poses[0], origin, before)
    found = 0.0
    for pose in poses[1:]:
        source.skin(pose, origin, after)
        found = max(found, float(np.linalg.norm(after - before, axis=1).max()) / dt)
        before, after = after, before
    return found
