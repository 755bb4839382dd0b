"""Lines of the list of known failures that compare two runs, or that must be refused before any run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from pbd import ClothMesh, Colliders, Fabric, InputError, Solver, State, build_model
from pbd.engine import ensure_initialized
from pbd.models.registry import make_solver
from pbd.models.stepping import ClothSolver, Options
from precompute.experiment.measures import FRAME_RATE, TimedSteps, edge_strain, typical_ms
from precompute.experiment.sheets import square
from precompute.failures.failure_play import MAX_RUN_S, FailureOutcome
from precompute.failures.failure_scenes import HUNG
from precompute.workers import worker_pool

__all__ = ["Case", "comparisons"]

# Line, name, whether it is the default solver's alone, and a function that runs it with a solver.
Case = tuple[str, str, bool, Callable[[str], FailureOutcome]]

# Stretches by 7 % under its own weight.
SOFT = Fabric(stretch_warp=20.0, stretch_weft=20.0, shear=6.0, air_drag=0.0)
SECONDS = 3.0  # of which strains are averaged over the last two thirds
FACES = "slivers, duplicate and non-manifold faces"
TWICE, THREE = [[0, 1, 2], [1, 3, 2], [0, 1, 4], [0, 1, 2]], [[0, 1, 2], [1, 0, 3], [0, 1, 4]]


def comparisons() -> Sequence[Case]:
    """All of them, in the order of the list."""
    quarter, rates = ((FRAME_RATE, 1.0), (FRAME_RATE, 0.25)), ((25.0, 1.0), (75.0, 1.0))
    return [
        ("multipliers reset every iteration (stiffness lost)", "hung cloth with four times the substeps", False,
         partial(_softness, pair=quarter)),
        ("softness that changes with frame rate", "hung cloth at 25 and 75 Hz", False, partial(_softness, pair=rates)),
        (FACES, "a face given twice is refused", True, partial(_refused, faces=TWICE)),
        (FACES, "three faces at an edge are refused", True, partial(_refused, faces=THREE)),
        ("thread count (results must not depend on it)", "two threads", True, _threads),
    ]  # fmt: skip


def _softness(name: str, pair: Sequence[tuple[float, float]]) -> FailureOutcome:
    """Difference of the strains of hanging cloth at two rates of frames [Hz], each with a factor on the substep."""
    mesh, held = square(10), np.flatnonzero(square(10).vertices[:, 1] > -1e-9)
    model = build_model(mesh, SOFT, held, bend_factor=1 / 3)
    own = make_solver(name, model)
    substep = own.substep if isinstance(own, ClothSolver) else Solver(model).options.substep
    runs = [
        (rate, State.at_rest(model), TimedSteps(make_solver(name, model, Options(substep=substep * factor)).step))
        for rate, factor in pair
    ]
    strains, slower = [], min(rate for rate, _ in pair)
    while len(strains) < round(SECONDS * slower) and sum(sum(steps.times) for *_, steps in runs) < MAX_RUN_S:
        for rate, state, steps in runs:  # side by side, for the same time
            for _ in range(round(rate / slower)):
                if not steps(state, Colliders(), 1.0 / rate):
                    return FailureOutcome({"not_finite": 1.0}, np.inf, 0.0, steps.problem)
        strains.append([edge_strain(state.world()[None], *mesh.edge_lengths())[0] for _, state, _ in runs])
    found = np.mean(strains[len(strains) // 3 :], axis=0)
    off = np.abs(found[0] - found[1])
    worst = float(off.max())
    figures = {"edge_strain_p95": float(np.percentile(off, 95)), "edge_strain_max": worst, "edge_strain_beyond": worst}
    outcome = FailureOutcome(figures, 0.0, typical_ms([time for *_, steps in runs for time in steps.times]))
    reached = len(strains) / slower
    return outcome if reached > SECONDS - 1e-9 else outcome.cut(reached, SECONDS)


def _refused(name: str, faces: list[list[int]]) -> FailureOutcome:
    """A mesh that may not come as far as a solver."""
    vertices = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 0.1, 0.0], [0.0, 0.0, 0.1]])
    try:
        build_model(ClothMesh.from_surface(vertices, np.array(faces), warp=(1.0, 0.2, 0.0)), Fabric())
    except InputError:
        return FailureOutcome({"not_finite": 0.0}, 0.0, 0.0)
    return FailureOutcome({"not_finite": 1.0}, np.inf, 0.0, "taken")


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
    state, steps = State.at_rest(model), TimedSteps(Solver(model).step)
    for _ in range(30):
        steps(state, Colliders(), 1.0 / FRAME_RATE)
    return state.hash(), state.world(), typical_ms(steps.times)
