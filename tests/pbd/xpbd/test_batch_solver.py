"""Many garments at once, and one garment for several threads: the bits of each alone."""

import numpy as np
import pytest

from pbd import (
    Colliders,
    InputError,
    Solver,
    SolverOptions,
    State,
)
from pbd.engine import running_threads
from pbd.xpbd.batch_solver import BatchSolver
from tests.pbd.batches import OPTIONS, Sheet, sheets, together


def alone(garments: list[Sheet], options: SolverOptions, frames: int) -> list[State]:
    for sheet in garments:
        solver = Solver(sheet.model, options)
        for frame in range(frames):
            targets = sheet.advance(frame)
            solver.step(sheet.state, sheet.colliders, 1 / 60, targets, sheet.wind)
    return [sheet.state for sheet in garments]


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
        winds = [(0.0, 0.0, 0.0), (0.0, 0.5 * frame, 2.0)]
        batch.step(states, colliders, 1 / 60, targets, winds)
        for state, own, collider, target, wind in zip(singles, solvers, colliders, targets, winds, strict=True):
            own.step(state, collider, 1 / 60, target, wind)
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
