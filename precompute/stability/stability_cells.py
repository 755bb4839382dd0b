"""One cell of a stability map: a short run of a method, beside a converged run of the same scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pbd import Colliders, Solver, SolverOptions, State, build_model
from pbd.mesh import hinges_of
from pbd.models import AnySolver, Options, make_solver
from precompute.experiment.error_classes import ErrorClass, Recorded, classify, deviations
from precompute.experiment.measures import GRAVITY, TimedSteps, deepest, mechanical_energy, typical_ms
from precompute.stability.stability_maps import CellScene, StabilityMap

__all__ = ["Cell", "Frames", "breaks", "judge", "lattice_of", "reference_of", "run_cell"]

SECONDS = 1.0  # of a run
KEPT = 1.0 / 60.0  # frames nearer to each other than this are left out of what is judged [s]
REFERENCE_STEP = 1.0 / 5760.0  # substep of the reference; the one that it is held against takes twice that [s]
REFERENCE_FRAME = 1.0 / 480.0  # [s]
BREAKING_FRAMES = 150  # frames in which an unstable step shows
MIN_FALL = 0.01  # the unit of energies is at least a fall by this part of the cloth's size [-]
# What went, by the figures that say so, the gravest first.
WENT = {
    "not_finite": "not finite",
    "through_percent": "tunnelling",
    "edge_strain_beyond": "stretch",
    "energy_growth": "energy growth",
    "speed_over_limit": "speed",
    "box_ratio": "size",
    "edge_strain_max": "stretch",
    "edge_strain_p95": "stretch",
    "folded_percent": "inversion",
    "penetration_s": "penetration",
    "penetration_thicknesses": "penetration",
    "position_px": "position",
    "velocity_rms": "velocity",
    "energy_error": "energy",
}


@dataclass(frozen=True)
class Frames:
    """Frames of a run about what drives the scene: where that goes is taken away.

    Attributes:
        times: [s], shape (t,).
        position, velocity: [m], [m/s], float32, shape (t, n, 3).
        frame_ms: processor time of a frame, median [ms].
        message: what the solver said when it gave up.
        floor_px: of a reference, the distance to the same run with substeps twice as long, p95 [px].
        chaotic: of a reference, whether the two do not agree to what is accepted of a run: the answer is not unique.
    """

    times: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    frame_ms: float = 0.0
    message: str = ""
    floor_px: float = 0.0
    chaotic: bool = False

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities at other times, between neighbours."""
        place = np.clip(times / self.times[1], 0.0, len(self.times) - 1.0)
        first = np.minimum(place.astype(int), len(self.times) - 2)
        share = (place - first)[:, None, None]
        position = (1.0 - share) * self.position[first] + share * self.position[first + 1]
        return position, (1.0 - share) * self.velocity[first] + share * self.velocity[first + 1]


@dataclass(frozen=True)
class Cell:
    """What one run came to.

    Attributes:
        map, x, y, method: which.
        error_class: of the worst figure.
        went: which figure that is, in a word; empty where nothing went.
        figures: of :func:`precompute.experiment.error_classes.deviations`.
        frame_ms: processor time of a frame, median [ms].
        dt: of a frame [s].
        failed_s: when the first catastrophic limit was passed [s]; not a number where none was.
        message: what the solver said when it gave up.
        floor_px: of the reference.
        chaotic: whether the answer is not unique.
    """

    map: str
    x: float
    y: float
    method: str
    error_class: ErrorClass
    went: str
    figures: dict[str, float]
    frame_ms: float
    dt: float
    failed_s: float
    message: str
    floor_px: float
    chaotic: bool


def lattice_of(method: str) -> str:
    """The lattice that a method's maps are on: "squares" where its springs need them."""
    return "squares" if method.startswith("springs-square") else "triangles"


def _solver(method: str, scene: CellScene, substep: float | None = None) -> AnySolver:
    """The default solver splits a frame as it does, and has its tethers; all others take it as it is.

    Where passes are varied, one is an iteration if the method has any that matter to it, else a substep.
    """
    if substep is not None:
        return Solver(scene.model, SolverOptions(substep=substep))
    if method == "default":
        cloth, passes = scene.model, scene.passes
        tethered = build_model(cloth.mesh, cloth.fabric, cloth.held, bend_factor=cloth.bend_factor)
        return Solver(tethered, SolverOptions() if passes is None else SolverOptions(substep=scene.dt / passes))
    steps = ("symplectic-euler", "verlet", "midpoint", "implicit-euler", "bdf2")
    if scene.passes is not None and method.endswith(steps):
        return make_solver(method, scene.model, Options(scene.dt / scene.passes))
    return make_solver(method, scene.model, Options(scene.dt, iterations=scene.passes))


def _simulate(scene: CellScene, solver: AnySolver, dt: float, seconds: float = SECONDS, kept: float = KEPT) -> Frames:
    """Run until it ends or is not finite; frames that were not reached are not numbers."""
    model = scene.model
    state = State.at_rest(model, scene.start)
    stride = max(1, round(kept / dt))
    count = max(1, math.ceil(seconds / dt / stride - 1e-6))
    drift = np.array([scene.speed, 0.0, 0.0])
    position = np.full((count + 1, model.vertex_count, 3), np.nan, np.float32)
    velocity = position.copy()
    position[0], velocity[0] = scene.start, -drift
    post = None if scene.post is None else replace(scene.post)
    colliders = Colliders([] if post is None else [post])
    if post is not None:
        colliders.rows(state.origin)  # so that the first frame knows that it moves
    steps, message = TimedSteps(solver.step), ""
    for frame in range(1, count * stride + 1):
        way = frame * dt * drift
        if post is not None and scene.post is not None:
            post.start, post.end = (tuple(np.asarray(end) + way) for end in (scene.post.start, scene.post.end))
        targets = scene.start[model.held] + way if scene.speed else None
        if not steps(state, colliders, dt, targets):
            message = steps.problem
            break
        if not (np.isfinite(state.position).all() and np.isfinite(state.velocity).all()):
            message = "positions or velocities are not finite"
            break
        if frame % stride == 0:
            position[frame // stride] = state.world() - way
            velocity[frame // stride] = state.velocity - drift
        solver.follow(state, colliders)
    times = dt * stride * np.arange(count + 1)
    return Frames(times, position, velocity, typical_ms(steps.times), message)


def reference_of(scene: CellScene, seconds: float = SECONDS) -> Frames:
    """The default solver with many short substeps, without tethers."""
    plain = replace(scene, passes=None)
    fine, coarse = (
        _simulate(plain, _solver("default", plain, step), REFERENCE_FRAME, seconds + 0.2, REFERENCE_FRAME)
        for step in (REFERENCE_STEP, 2.0 * REFERENCE_STEP)
    )
    if fine.message or coarse.message:
        return replace(fine, floor_px=math.inf, chaotic=True)
    stride = round(KEPT / REFERENCE_FRAME)
    times = fine.times[::stride]
    runs = [Recorded(run.position[::stride], run.velocity[::stride], times[1]) for run in (coarse, fine)]
    edges, lengths = scene.model.mesh.edge_lengths()
    figures = deviations(runs[0], runs[1], edges, lengths, scene.model.fabric.thickness)
    chaotic = classify({"position_px": figures["position_px"]})["position_px"] > ErrorClass.ACCEPTED
    return replace(fine, floor_px=figures["position_px"], chaotic=chaotic)


def breaks(scene: CellScene, method: str) -> bool:
    """Whether a run of ``BREAKING_FRAMES`` frames ends in numbers or a speed that are not finite."""
    return bool(_simulate(scene, _solver(method, scene), scene.dt, BREAKING_FRAMES * scene.dt).message)


def judge(scene: CellScene, run: Frames, reference: Frames, until: int | None = None) -> dict[str, float]:
    """Figures of a run beside the reference.

    Args:
        scene: of both.
        run: of a method.
        reference: of the scene.
        until: frames that count; None for all.
    """
    model, frames = scene.model, slice(0, until)
    truth_position, truth_velocity = reference.at(run.times[frames])
    position, velocity = run.position[frames], run.velocity[frames]
    energy = truth_energy = scale = None
    if not scene.speed and np.isfinite(position).all():
        mass = model.mass * (model.inverse_mass > 0.0)
        energy, _ = mechanical_energy(mass, position, velocity)
        truth_energy, kinetic = mechanical_energy(mass, truth_position, truth_velocity)
        size = float(np.ptp(scene.start, axis=0).max())
        scale = max(
            float(kinetic.max()), float(np.ptp(truth_energy)), MIN_FALL * GRAVITY * size * float(model.mass.sum())
        )
    depth = None if scene.post is None else deepest([scene.post], position)
    return deviations(
        Recorded(position, velocity, run.times[1], energy, depth, through=_through(scene, position)),
        Recorded(truth_position, truth_velocity, run.times[1], truth_energy),
        *model.mesh.edge_lengths(),
        model.fabric.thickness,
        scene.speed,
        chaotic=reference.chaotic,
        energy_scale=scale,
        hinges=hinges_of(model.mesh.faces),
    )


def _through(scene: CellScene, position: np.ndarray) -> np.ndarray | None:
    """Rings that no longer go around the post's axis once, of each frame [%]."""
    if scene.post is None:
        return None
    around = position[:, scene.rings][..., [0, 2]] - np.asarray(scene.post.start)[[0, 2]]
    angle = np.arctan2(around[..., 1], around[..., 0])
    turn = np.angle(np.exp(1j * (np.roll(angle, -1, axis=2) - angle))).sum(axis=2) / (2.0 * math.pi)
    return 100.0 * np.mean(np.abs(np.abs(turn) - 1.0) > 0.5, axis=1)


def run_cell(
    one: StabilityMap, x: float, y: float, method: str, reference: Frames | None = None, *, seconds: float = SECONDS
) -> Cell:
    """Run and class one cell; the reference is made where it is not given.

    Raises:
        InputError: a method that cannot take the scene.
    """
    scene = one.scene(x, y, lattice_of(method))
    reference = reference or reference_of(scene, seconds)
    run = _simulate(scene, _solver(method, scene), scene.dt, seconds)
    figures = judge(scene, run, reference)
    classes = classify(figures)
    worst = max(classes.values())
    went = next((words for name, words in WENT.items() if classes.get(name) == worst), "") if worst else ""
    failed = math.nan
    if worst is ErrorClass.CATASTROPHIC:
        low, high = 1, len(run.times)  # it is not catastrophic over `low` frames, but over `high`
        while high - low > 1:
            middle = (low + high) // 2
            lost = max(classify(judge(scene, run, reference, middle)).values()) is worst
            low, high = (low, middle) if lost else (middle, high)
        failed = float(run.times[high - 1])
    known = reference.floor_px, reference.chaotic
    return Cell(one.name, x, y, method, worst, went, figures, run.frame_ms, scene.dt, failed, run.message, *known)
