"""Lines of the list of known failures that compare two runs, or that must be refused before any run."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from pbd import ClothMesh, Colliders, Fabric, InputError, Solver, State, build_model
from pbd.engine import ensure_initialized
from pbd.models.newton import StepError
from pbd.models.registry import make_solver
from pbd.models.stepping import ClothSolver, Options
from precompute.failures.failure_play import MAX_RUN_S, FailureOutcome
from precompute.failures.failure_scenes import HUNG, square
from precompute.mechanics import FRAME_RATE
from precompute.workers import worker_pool

__all__ = ["comparisons"]

# Stretches by 7 % under its own weight.
SOFT = Fabric(stretch_warp=20.0, stretch_weft=20.0, shear=6.0, air_drag=0.0)
SECONDS = 3.0  # of which strains are averaged over the last two thirds


def comparisons() -> Sequence[tuple[str, str, bool, Callable[[str], FailureOutcome]]]:
    """Line, name, whether it is the default solver's alone, and a function that runs it with a solver."""
    return [
        (
            "multipliers reset every iteration (stiffness lost)",
            "hung cloth with four times the substeps",
            False,
            lambda solver: _softness(solver, (FRAME_RATE, 1.0), (FRAME_RATE, 0.25)),
        ),
        (
            "softness that changes with frame rate",
            "hung cloth at 25 and 75 Hz",
            False,
            lambda solver: _softness(solver, (25.0, 1.0), (75.0, 1.0)),
        ),
        ("slivers, duplicate and non-manifold faces", "a face given twice is refused", True, _twice),
        ("slivers, duplicate and non-manifold faces", "three faces at an edge are refused", True, _three_at_an_edge),
        ("thread count (results must not depend on it)", "two threads", True, _threads),
    ]


def _softness(name: str, first: tuple[float, float], second: tuple[float, float]) -> FailureOutcome:
    """Difference of the strains of hanging cloth at two rates of frames [Hz] and factors on the substep."""
    mesh, held = square(10), np.flatnonzero(square(10).vertices[:, 1] > -1e-9)
    model = build_model(mesh, SOFT, held, bend_factor=1 / 3)
    own = make_solver(name, model)
    substep = own.substep if isinstance(own, ClothSolver) else Solver(model).options.substep
    edges, rest = mesh.edge_lengths()
    solvers = [make_solver(name, model, Options(substep=substep * factor)) for _, factor in (first, second)]
    states, strains, costs = [State.at_rest(model) for _ in solvers], [], []
    slower = min(first[0], second[0])
    while len(strains) < round(SECONDS * slower) and sum(costs) < MAX_RUN_S:  # side by side, for the same time
        strains.append([])
        for solver, state, (rate, _) in zip(solvers, states, (first, second), strict=True):
            for _ in range(round(rate / slower)):
                begin = time.process_time()
                try:
                    solver.step(state, Colliders(), 1.0 / rate)
                except StepError as error:
                    return FailureOutcome({"not_finite": 1.0}, np.inf, 0.0, error.problem)
                costs.append(time.process_time() - begin)
            x = state.world()
            strains[-1].append(np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1) / rest - 1.0)
    found = np.mean(strains[len(strains) // 3 :], axis=0)
    off = np.abs(found[0] - found[1])
    worst = float(off.max())
    figures = {"edge_strain_p95": float(np.percentile(off, 95)), "edge_strain_max": worst, "edge_strain_beyond": worst}
    outcome = FailureOutcome(figures, 0.0, 1e3 * float(np.median(costs)))
    reached = len(strains) / slower
    if reached < SECONDS - 1e-9:
        return replace(outcome, note=f"{outcome.worst[1]} (judged up to {reached:.2g} of {SECONDS:g} s: slow)")
    return outcome


def _refused(faces: list[list[int]]) -> FailureOutcome:
    """A mesh that may not come as far as a solver."""
    vertices = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 0.1, 0.0], [0.0, 0.0, 0.1]])
    try:
        build_model(ClothMesh.from_surface(vertices, np.array(faces), warp=(1.0, 0.2, 0.0)), Fabric())
    except InputError:
        return FailureOutcome({"not_finite": 0.0}, 0.0, 0.0)
    return FailureOutcome({"not_finite": 1.0}, np.inf, 0.0, "taken")


def _twice(name: str) -> FailureOutcome:
    return _refused([[0, 1, 2], [1, 3, 2], [0, 1, 4], [0, 1, 2]])


def _three_at_an_edge(name: str) -> FailureOutcome:
    return _refused([[0, 1, 2], [1, 0, 3], [0, 1, 4]])


def _threads(name: str) -> FailureOutcome:
    """The default solver in a process of one thread and in one of two, 30 frames: the distance in pixels at 3 m."""
    ends = []
    for threads in (1, 2):
        with worker_pool(1, partial(ensure_initialized, threads=threads)) as pool:
            ends.append(pool.submit(_hang).result())
    (one, first, frame_ms), (other, second, _) = ends
    off = 0.0 if one == other else max(float(np.abs(first - second).max()) / 2.02e-3, 1.01)
    return FailureOutcome({"position_px": off}, 0.0, frame_ms)


def _hang() -> tuple[str, np.ndarray, float]:
    """Hash and vertices [m] of cloth that has hung for 30 frames, and the median time of a frame [ms]."""
    mesh, held = HUNG
    model = build_model(mesh, Fabric(), np.array(held), bend_factor=1 / 3)
    solver, state, times = Solver(model), State.at_rest(model), []
    for _ in range(30):
        begin = time.process_time()
        solver.step(state, Colliders(), 1.0 / FRAME_RATE)
        times.append(time.process_time() - begin)
    return state.hash(), state.world(), 1e3 * float(np.median(times))
