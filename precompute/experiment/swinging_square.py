"""The swinging square, on which a solver's speed and stretch are measured, ours and other engines' alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pbd import ClothMesh, Colliders, Fabric, Model, Solver, SolverOptions, State
from pbd.mesh import lattice_faces
from precompute.experiment.measures import FRAME_RATE, TimedSteps, elongation, typical_ms
from precompute.experiment.sheets import lattice, tilted, untethered

__all__ = ["STIFF", "SquareFigures", "SquareRun", "hanging_square", "measure", "measure_steps"]

FRAMES = 300  # of a run
JUDGED = 60  # last frames, over which the median of the stretch is taken
SWING = 120  # last frames, over which the amplitude is taken: more than one swing
TILT = 30.0  # of the square from the vertical at the start [deg]
# Isotropic with E h = 1e5 N/m, no bending, no air.
STIFF = Fabric(0.2, 1e5, 1e5, 1 / 3, 3.75e4, bend_warp=0.0, bend_weft=0.0, thickness=0.001, air_drag=0.0)


class SquareFigures(NamedTuple):
    """Time, stretch and swing of a run of 300 frames.

    Stretch is elongation along warp and weft, median over the last 60 frames [-].

    Attributes:
        frame_ms: processor time of a frame, median [ms].
        mean, p99, worst: of the stretch over all faces' warp and weft.
        amplitude: of the mean forward displacement over the last 120 frames [m].
    """

    frame_ms: float
    mean: float
    p99: float
    worst: float
    amplitude: float

    def passes(self, amplitude: float) -> bool:
        """Stretch below 1, 2 and 5 %, and an amplitude within 3 % of a given one [m]. False for what is not finite."""
        stiff = self.mean < 0.01 and self.p99 < 0.02 and self.worst < 0.05
        return bool(stiff and abs(self.amplitude / amplitude - 1.0) < 0.03)


class SquareRun(NamedTuple):
    """One setting of a solver or of another engine on a square.

    Attributes:
        name: of the method or engine.
        side: vertices along a side.
        setting: substeps of a frame, or an engine's settings in words.
        measured: the result.
        passed: every limit held.
    """

    name: str
    side: int
    setting: int | str
    measured: SquareFigures
    passed: bool


def hanging_square(count: int, fabric: Fabric = STIFF) -> Model:
    """Square of 1 m at rest, hung by its upper corners and tilted about that side by 30 deg; it will swing along z.

    Args:
        count: vertices a side; the squares have one diagonal throughout.
        fabric: with its warp along the upper side.
    """
    step = 1.0 / (count - 1)
    index, *places = lattice(count, count)
    across, up = (part * step for part in places)
    held = np.flatnonzero((up > 1.0 - 1e-9) & ((across < 1e-9) | (across > 1.0 - 1e-9)))
    vertices, faces = tilted(across - 0.5, up - 1.0, TILT), lattice_faces(index, alternating=False)
    return untethered(ClothMesh.from_surface(vertices, faces, warp=(1.0, 0.0, 0.0)), fabric, held)


def measure(model: Model, options: SolverOptions) -> SquareFigures:
    """Run the square with our solver and judge it."""
    state, colliders, solver = State.at_rest(model), Colliders(), Solver(model, options)
    solver.step(state.copy(), colliders, 1.0 / FRAME_RATE)  # compiles
    return measure_steps(model, lambda: solver.step(state, colliders, 1.0 / FRAME_RATE), state.world)


def measure_steps(model: Model, step: Callable[[], None], world: Callable[[], np.ndarray]) -> SquareFigures:
    """Run the square and judge it.

    Args:
        model: of the square, at rest.
        step: advances it by a frame.
        world: where its vertices are [m], shape (n, 3).
    """
    start, inverse_flat, frame = world(), np.linalg.inv(model.mesh.flat), TimedSteps(step, ())
    stretch, forward = np.full((FRAMES, 3), np.inf), np.full(FRAMES, np.inf)
    for number in range(FRAMES):
        frame()
        vertices = world()
        if not np.isfinite(vertices).all():
            return SquareFigures(typical_ms(frame.times), *[np.inf] * 4)
        if number >= FRAMES - SWING:
            forward[number] = (vertices - start)[:, 2].mean()
        if number >= FRAMES - JUDGED:
            longer = np.maximum(elongation(vertices, model.mesh.faces, inverse_flat) - 1.0, 0.0)
            stretch[number] = longer.mean(), np.percentile(longer, 99), longer.max()
    mean, p99, worst = np.median(stretch[-JUDGED:], axis=0).tolist()
    return SquareFigures(typical_ms(frame.times), mean, p99, worst, 0.5 * float(np.ptp(forward[-SWING:])))
