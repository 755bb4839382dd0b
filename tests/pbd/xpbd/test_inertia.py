"""How much a garment feels of the motion of what carries it; local damping."""

import numpy as np
import pytest

from pbd import Colliders, Fabric, Solver, SolverOptions, State
from tests.pbd.meshes import cloth, free_model, grid, momentum, turn, wavy

AIRLESS = Fabric(air_drag=0.0)
NO_WEIGHT = (0.0, 0.0, 0.0)


def shaken(**options: float) -> float:
    """How far a sheet held by two sides is from its holders' motion after half a second of shaking and turning [m]."""
    vertices, faces = grid(10, 10, 0.03)
    held = np.flatnonzero((vertices[:, 0] < 1e-9) | (vertices[:, 1] < 1e-9))
    model = free_model(cloth(vertices, faces), AIRLESS, held)
    state, solver = State.at_rest(model), Solver(model, SolverOptions(gravity=NO_WEIGHT, **options))
    for frame in range(1, 31):
        t = frame / 60
        there = vertices @ turn((0.2, 1.0, 0.4), 120.0 * t * t).T + [0.3 * np.sin(9.0 * t), 1.0 * t * t, 0.0]
        solver.follow(state, Colliders())
        solver.step(state, Colliders(), 1 / 60, there[held])
    return float(np.linalg.norm(state.world() - there, axis=1).max())


def test_what_feels_nothing_goes_along_unmoved() -> None:
    assert shaken(linear_inertia=0.0, angular_inertia=0.0) < 3e-4
    assert shaken(linear_inertia=0.0) > 5e-3  # the turning is felt
    assert shaken(angular_inertia=0.0) > 5e-3  # the shaking is
    assert shaken() > 0.01


def test_a_part_is_felt() -> None:
    """Holders that begin to move at 1 m/s: their cloth is left behind by the part of that speed that it feels."""
    vertices, faces = grid(4, 4, 0.1)
    held = np.flatnonzero(vertices[:, 0] < 1e-9)
    model = free_model(cloth(vertices, faces), AIRLESS, held)
    for part in (0.0, 0.25, 1.0):
        state = State.at_rest(model)
        solver = Solver(model, SolverOptions(gravity=NO_WEIGHT, linear_inertia=part))
        solver.step(state, Colliders(), 1 / 60, vertices[held] + [0.0, 0.0, 1 / 60])
        assert state.velocity[-1, 2] == pytest.approx(1.0 - part, abs=1e-3)  # a corner far from the holders


def test_local_damping_leaves_momenta_alone() -> None:
    model = free_model(cloth(*wavy()), AIRLESS)
    state = State.at_rest(model)
    rng = np.random.default_rng(0)
    spin = np.cross([0.0, 3.0, 1.0], state.world())
    state.velocity[:] = [1.0, 0.5, 0.0] + spin + rng.normal(0.0, 0.3, spin.shape)
    before, left = momentum(model, state), state.copy()
    solver = Solver(model, SolverOptions(gravity=NO_WEIGHT, local_damping=60.0))
    solver._prepare(state, Colliders(), 1 / 60, None, (0.0, 0.0, 0.0))  # damps, and does nothing else
    after = momentum(model, state)
    assert after[0] == pytest.approx(before[0], rel=1e-5)
    assert after[1] == pytest.approx(before[1], rel=1e-4)
    noise = [np.linalg.norm(one.velocity - state.velocity.mean(axis=0)) for one in (left, state)]
    assert noise[1] < noise[0]
    change = np.linalg.norm(state.velocity - left.velocity)
    state.velocity[:] = left.velocity
    solver._prepare(state, Colliders(), 1.0, None, (0.0, 0.0, 0.0))  # for good
    assert change == pytest.approx((1.0 - np.exp(-1.0)) * np.linalg.norm(state.velocity - left.velocity), rel=1e-4)


def test_memory_of_the_carrier_moves_with_the_origin() -> None:
    model = free_model(cloth(*wavy()), AIRLESS)
    state = State.at_rest(model)
    state.carrier[:] = np.random.default_rng(0).normal(size=(3, 4))
    at = lambda: state.carrier[:, :3] @ (np.array([0.3, 2.0, 1.0]) - state.origin) + state.carrier[:, 3]  # noqa: E731
    before = at()
    state.move_origin(np.array([3.0, -2.0, 8.0]))
    assert at() == pytest.approx(before)
