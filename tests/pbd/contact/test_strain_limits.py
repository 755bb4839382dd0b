"""Edges that contact may not draw out: how far, how fast they come back, and not under the body."""

from dataclasses import replace

import numpy as np
import pytest

from pbd import Colliders, Fabric, Model, Plane, Solver, SolverOptions, State
from pbd.contact.strain_limits import MAX_STRETCH, limit_rows, near_limits, solve_strain_limits, strain_limits
from pbd.distance import BodyDistance
from pbd.engine import ensure_initialized, ti
from pbd.geometry import Int1, Vec3, Vec4, Vec4Rows
from pbd.xpbd.views import ClothArrays, ContactWork
from tests.pbd.meshes import body_of, cloth, free_model, grid, icosphere

ON = SolverOptions(self_collision=True)
LIMP = Fabric(stretch_warp=0.1, stretch_weft=0.1, shear=0.03)


def worst_edge(state: State, model: Model) -> float:
    """Greatest length of an edge over its rest length."""
    edges, lengths = model.mesh.edge_lengths()
    return float((np.linalg.norm(np.diff(state.world()[edges], axis=1)[:, 0], axis=1) / lengths).max())


def test_edges_are_drawn_out_no_further_than_their_limit() -> None:
    """A sheet that hangs stretches by rho_A g L/(E h) = 1.8."""
    mesh = cloth(*grid(6, 6, 0.02))
    model = free_model(mesh, replace(LIMP, air_drag=20.0), np.flatnonzero(mesh.vertices[:, 1] > 0.119))
    drawn = {}
    for on in (False, True):
        solver, state = Solver(model, SolverOptions(self_collision=on)), State.at_rest(model)
        for _ in range(60):
            solver.step(state, Colliders(), 1 / 60)
        drawn[on] = worst_edge(state, model)
    assert drawn[False] > 2.5
    assert drawn[True] < 1.52


def test_bands_hold_where_the_cloth_does_not_collide_with_itself() -> None:
    """The left half of a sheet that hangs is a band, up to what is held; the other half stretches by its weight.

    A band that is held itself needs no limit.
    """
    mesh = cloth(*grid(6, 6, 0.02))
    left = (mesh.vertices[mesh.faces][:, :, :2].max(axis=1) < (0.061, 0.101)).all(axis=1)
    banded = replace(mesh, max_stretch=np.where(left, 1.01, MAX_STRETCH))
    model = free_model(banded, replace(LIMP, air_drag=20.0), np.flatnonzero(mesh.vertices[:, 1] > 0.119))
    solver, state = Solver(model, SolverOptions()), State.at_rest(model)
    for _ in range(60):
        solver.step(state, Colliders(), 1 / 60)
    edges, lengths = banded.edge_lengths()
    stretch = np.linalg.norm(np.diff(state.world()[edges], axis=1)[:, 0], axis=1) / lengths
    tight = banded.edge_limits(MAX_STRETCH) < MAX_STRETCH
    assert len(solver._arguments["strain_limits"]) == tight.sum()
    everywhere = free_model(replace(mesh, max_stretch=np.full(len(left), 1.01)), LIMP, model.held)
    assert len(Solver(everywhere, SolverOptions())._arguments["strain_limits"]) == 0
    limits, _ = strain_limits(everywhere.mesh, LIMP.thickness, everywhere.held)
    np.testing.assert_allclose(limits[:, 2], MAX_STRETCH * lengths, rtol=1e-6)
    assert tight.sum() > 30 and stretch[tight].max() < 1.03 and stretch[~tight].max() > 1.5


def test_what_is_drawn_back_keeps_its_momentum() -> None:
    model = free_model(cloth(*grid(6, 6, 0.02)), replace(LIMP, air_drag=0.0))
    solver, state = Solver(model, replace(ON, gravity=(0.0, 0.0, 0.0))), State.at_rest(model)
    state.position[:, :2] *= np.float32(2.0)
    state.velocity[:] = 0.3, -0.2, 0.1
    momentum = model.mass @ state.velocity
    for _ in range(5):
        solver.step(state, Colliders(), 1 / 60)
    assert worst_edge(state, model) < 1.52
    assert model.mass @ state.velocity == pytest.approx(momentum, rel=1e-4)


def test_what_starts_far_over_its_limit_does_not_fly_off() -> None:
    """A limp sheet stretched threefold over a ball of triangles."""
    flat, faces = grid(8, 8, 0.02)
    flat = flat[:, [1, 2, 0]] - [0.08, 0.0, 0.08]
    model = free_model(cloth(flat, faces), replace(LIMP, thickness=0.001))
    ball, triangles = icosphere(4)
    state, distance = State.at_rest(model), BodyDistance(triangles)
    stretched = np.where([True, False, True], 2.2 * flat, 0.06)
    state.position[:, :3] = 0.102 * stretched / np.linalg.norm(stretched, axis=1, keepdims=True)
    assert worst_edge(state, model) > 3.0
    colliders = Colliders(body=body_of(0.1 * ball, triangles, state))
    solver, heights = Solver(model, ON), []
    for _ in range(20):
        solver.step(state, colliders, 1 / 60)
        heights.append(distance.signed_distance(state.world(), 0.1 * ball))
    assert worst_edge(state, model) < MAX_STRETCH + 0.02
    assert np.min(heights) > -5e-5
    # 0.36 to 0.40 in nine starts, 0.29 to 0.35 if its folds go through one another; unbounded 0.8 after five frames.
    assert np.max(heights) < 0.45


@ti.kernel
def limit(
    position: Vec4,
    velocity: Vec3,
    delta: Vec4,
    gain: Vec4,
    limits: Vec4,
    work: Int1,
    passes: ti.i32,
    h: ti.f32,
    nearest: Int1,
    points: Vec4Rows,
):
    ti.loop_config(serialize=True)
    for _ in range(1):
        cloth = ClothArrays(position=position, velocity=velocity, position_delta=delta, velocity_delta=gain)
        contact = ContactWork(nearest=nearest, contact_points=points)
        solve_strain_limits(cloth, contact, limits, work, near_limits(cloth, limits) * passes, h, 0.0)


@pytest.mark.parametrize("touches", [False, True])
@pytest.mark.parametrize("held", [False, True])
def test_edges_shorten_along_the_body_unless_they_are_held(touches: bool, held: bool) -> None:
    """One end lies on a floor that the other end, under it, has not found."""
    position = np.array([[0.0, 0.001, 0.0, 1.0], [0.3, -0.4, 0.0, 0.0 if held else 1.0]], np.float32)
    delta, zero = np.zeros((2, 4), np.float32), np.zeros((2, 4), np.float32)
    points = np.zeros((2, 3, 4), np.float32)
    points[:, 2, 1] = 1.0
    nearest = np.array([0 if touches else -1, -1], np.int32)
    ensure_initialized()
    limits, work = limit_rows(np.array([[0, 1]]), np.array([0.3]), 2)
    limit(position, np.zeros((2, 3), np.float32), delta, zero, limits, work, 1, 1.0, nearest, points)
    height = float(position[0, 1] + delta[0, 1])
    if touches and not held:
        assert height == pytest.approx(0.0, abs=1e-7)
        assert delta[0, 0] > 0.05  # along the floor it goes all the way
    else:
        assert height < -0.05
        length = np.linalg.norm(np.diff(position[:, :3] + delta[:, :3], axis=0))
        assert length == pytest.approx(0.3, abs=1e-5)


def test_length_that_is_taken_from_one_edge_goes_to_its_neighbours() -> None:
    """One edge of a chain is far too long. The passes reach edges in other blocks."""
    count = 60
    position = np.zeros((count, 4), np.float32)
    position[:, 0], position[:, 3] = np.arange(count) * 0.01 * MAX_STRETCH * 0.79, 1.0
    position[count // 2 :, 0] += 0.08
    delta, zero = np.zeros((2, count, 4), np.float32)
    edges = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    limits, work = limit_rows(edges, np.full(len(edges), 0.01 * MAX_STRETCH), count)
    nearest, points = np.full(count, -1, np.int32), np.zeros((count, 3, 4), np.float32)
    ensure_initialized()
    limit(position, np.zeros((count, 3), np.float32), delta, zero, limits, work, 2000, 1.0, nearest, points)
    x = position[:, 0] + delta[:, 0]
    assert np.diff(x).max() == pytest.approx(limits[0, 2], rel=1e-3)
    assert np.all(np.abs(delta[count // 2 - 12 : count // 2 + 12, 0]) > 1e-4)
    assert x.mean() == pytest.approx(position[:, 0].mean(), rel=1e-4)


def test_limits_that_hold_nothing_back_change_nothing() -> None:
    flat, faces = grid(8, 8, 0.02)
    model = free_model(cloth(flat[:, [1, 2, 0]] + [0.0, 0.01, 0.0], faces), Fabric())
    state, colliders = State.at_rest(model), Colliders([Plane((0.0, 0.0, 0.0))])
    ends = []
    for longest in (None, 1e3):
        solver, after = Solver(model, ON), state.copy()
        if longest is not None:
            solver._collisions.pairs.strain_limits[:, 2] *= longest
        for _ in range(10):
            solver.step(after, colliders, 1 / 60)
        ends.append(after.world())
    assert np.array_equal(*ends)
