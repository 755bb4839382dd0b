"""Many garments at once, and one garment for several threads: the bits of each alone."""

import numpy as np
import pytest

from pbd import (
    BatchSolver,
    Body,
    Capsule,
    Colliders,
    Fabric,
    InputError,
    Solver,
    SolverOptions,
    State,
    build_model,
)
from pbd.engine import running_threads
from tests.pbd.meshes import body_of, cloth, grid, icosphere

OPTIONS = SolverOptions(substep=1 / 240, coarse_sweeps=2)


class Sheet:
    """A sheet held by one side, which moves, over a ball and a rod; its edges are tested for contact in their middle.

    Args:
        along, across: its edges.
        shift: of the ball [m].
    """

    def __init__(self, along: int, across: int, shift: float, with_body: bool = True) -> None:
        flat, faces = grid(along, across, 0.04)
        self.start = flat[:, [0, 2, 1]]
        held = np.flatnonzero(flat[:, 0] < 1e-9)
        self.model = build_model(cloth(self.start, faces), Fabric(stretch_warp=1e5, stretch_weft=1e5), held)
        self.ball, self.ball_faces = icosphere(3, 0.15)
        self.ball = self.ball + [0.2, -0.153, 0.2 + shift]
        self.with_body = with_body
        self.state = State.at_rest(self.model)
        self.body: Body | None = body_of(self.ball, self.ball_faces, self.state) if with_body else None
        self.rod = Capsule((0.3, -0.05, -1.0), (0.3, -0.05, 1.0), 0.03)
        self.colliders = Colliders([self.rod], self.body)
        self.wind = (0.0, -2.0, shift)

    def advance(self, frame: int) -> np.ndarray:
        """Move what moves it; where the held vertices go."""
        up = 0.02 * np.sin(frame)
        if self.body is not None:
            self.body.advance((self.ball + [0.0, up, 0.0] - self.state.origin).astype(np.float32))
        self.rod.start, self.rod.end = (0.3, up - 0.05, -1.0), (0.3, up - 0.05, 1.0)
        return self.start[self.model.held] + [0.0, up, 0.0]


def sheets() -> list[Sheet]:
    return [Sheet(10, 12, 0.0), Sheet(7, 9, 0.03), Sheet(9, 9, 0.01, with_body=False)]


def alone(garments: list[Sheet], options: SolverOptions, frames: int) -> list[State]:
    for sheet in garments:
        solver = Solver(sheet.model, options)
        for frame in range(frames):
            targets = sheet.advance(frame)
            solver.step(sheet.state, sheet.colliders, 1 / 60, targets, sheet.wind)
    return [sheet.state for sheet in garments]


def together(garments: list[Sheet], options: SolverOptions, frames: int, threads_each: int = 1) -> list[State]:
    batch = BatchSolver([Solver(sheet.model, options) for sheet in garments], threads_each)
    states, colliders = [sheet.state for sheet in garments], [sheet.colliders for sheet in garments]
    for frame in range(frames):
        targets = [sheet.advance(frame) for sheet in garments]
        batch.step(states, colliders, 1 / 60, targets, [sheet.wind for sheet in garments])
    return states


def test_a_batch_has_the_bits_of_each_alone() -> None:
    expected = alone(sheets(), OPTIONS, 8)
    assert np.count_nonzero(expected[0].contact < 0.01) > 3
    found = together(sheets(), OPTIONS, 8)
    assert [state.hash() for state in found] == [state.hash() for state in expected]


def test_threads_that_share_a_garment_do_not_change_a_bit() -> None:
    """Few steps: where other programs run, the threads wait for each other long."""
    if running_threads() < 2:
        pytest.skip("Taichi has one thread here")
    options = SolverOptions(substep=1 / 120, coarse_sweeps=1)
    expected = alone([Sheet(10, 12, 0.0)], options, 2)
    assert np.count_nonzero(expected[0].contact < 0.01) > 3
    found = together([Sheet(10, 12, 0.0)], options, 2, threads_each=2)
    assert found[0].hash() == expected[0].hash()


def test_one_solver_may_stand_for_several_garments_and_bodies_may_change() -> None:
    """The first garment loses its body after two frames, the second gets one."""
    first, second = Sheet(7, 9, 0.0), Sheet(7, 9, 0.02)
    solver = Solver(first.model, OPTIONS)
    batch, states = BatchSolver([solver, solver]), [first.state, second.state]
    singles, solvers = [state.copy() for state in states], [Solver(first.model, OPTIONS) for _ in states]
    for frame in range(4):
        targets = [first.advance(frame), second.advance(frame)]
        bodies = (first.body, None) if frame < 2 else (None, second.body)
        colliders = [Colliders(body=body) for body in bodies]
        batch.step(states, colliders, 1 / 60, targets)
        for state, own, collider, target in zip(singles, solvers, colliders, targets, strict=True):
            own.step(state, collider, 1 / 60, target)
    assert [state.hash() for state in states] == [state.hash() for state in singles]
    assert states[0].hash() != states[1].hash()


def test_no_time_does_nothing() -> None:
    sheet = Sheet(7, 9, 0.0)
    before = sheet.state.hash()
    BatchSolver([Solver(sheet.model, OPTIONS)]).step([sheet.state], [sheet.colliders], 0.0)
    assert sheet.state.hash() == before


def test_bad_batches_are_refused() -> None:
    sheet = Sheet(7, 9, 0.0)
    solver = Solver(sheet.model, OPTIONS)
    with pytest.raises(InputError, match="without garments"):
        BatchSolver([])
    for threads in (0, running_threads() + 1):
        with pytest.raises(InputError, match="threads_each"):
            BatchSolver([solver], threads)
    batch = BatchSolver([solver, solver])
    with pytest.raises(InputError, match="colliders"):
        batch.step([sheet.state, sheet.state], [sheet.colliders], 1 / 60)
    with pytest.raises(InputError, match="dt"):
        batch.step([sheet.state, sheet.state], [sheet.colliders] * 2, -1.0)
    with pytest.raises(InputError, match="targets"):
        batch.step([sheet.state, sheet.state], [sheet.colliders] * 2, 1 / 60, [None, np.zeros((1, 3))])
