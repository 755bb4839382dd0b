"""Bending of stiff cloth: all hinges at once."""

from dataclasses import replace

import numpy as np
import pytest

from assets.fabrics import PRESETS
from pbd import Colliders, Fabric, Model, Solver, SolverOptions, Sphere, State
from pbd.bending import border_share
from pbd.layers import layered
from pbd.mesh import hinges_of
from pbd.xpbd.stiff_bending import HEADER, THETA, bending_factor, is_stiff, pass_ratio
from tests.pbd.meshes import cloth, free_model, grid, momentum, run, turn

FELT = Fabric(0.3, 4000.0, 4000.0, 0.2, 1500.0, 2.5e-3, 2.5e-3, air_drag=0.0)
STEP = SolverOptions().substep


def strip(fabric: Fabric, held: bool = True, edges: int = 16) -> Model:
    """A level strip of 24 by 6 cm, clamped at an end."""
    vertices, faces = grid(edges, edges // 4, 0.24 / edges)
    clamp = np.flatnonzero(vertices[:, 0] < 0.24 / edges + 1e-9) if held else None
    return free_model(cloth(vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0], faces), fabric, clamp)


def unpacked(factor: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices in the order of elimination, 1/D, L and L^T without their diagonals."""
    values, places = factor[:, 0].astype(float), np.ascontiguousarray(factor[:, 1]).view(np.int32)
    count = places[1] // HEADER - 1
    triangles = np.zeros((2, count, count))
    for side, triangle in enumerate(triangles, start=1):
        for row in range(count):
            entries = slice(places[HEADER * row + side], places[HEADER * (row + 1) + side])
            triangle[row, places[entries]] = values[entries]
    heads = slice(0, HEADER * count, HEADER)
    return places[heads], values[heads], triangles[0], triangles[1]


def test_the_factor_is_that_of_mass_and_bending() -> None:
    model = strip(FELT)
    vertices, inverse, lower, upper = unpacked(bending_factor(model, model.hinge_data, STEP))
    assert np.array_equal(np.sort(vertices), np.flatnonzero(model.inverse_mass > 0))
    assert np.array_equal(lower, np.tril(lower, -1)) and np.array_equal(upper, lower.T)
    matrix = np.diag(model.mass)
    for corners, (row, (_, compliance, _, _)) in zip(model.hinges, model.hinge_data.astype(float), strict=True):
        matrix[np.ix_(corners, corners)] += THETA * STEP**2 * np.outer(row, row) / compliance
    whole = np.eye(len(lower)) + lower
    found = whole @ np.diag(1.0 / inverse) @ whole.T
    wanted = matrix[np.ix_(vertices, vertices)]
    assert found == pytest.approx(wanted, abs=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("fabric", PRESETS.values(), ids=PRESETS)
def test_cloth_of_clothes_keeps_the_pass(fabric: Fabric) -> None:
    assert not is_stiff(strip(fabric, edges=24), STEP)


def test_only_stiff_cloth_that_a_pass_would_leave_too_soft_is_solved_at_once() -> None:
    fine, coarse = strip(FELT), strip(FELT, edges=4)
    assert pass_ratio(fine, STEP) > 0.1 and is_stiff(fine, STEP)
    assert pass_ratio(coarse, STEP) < 0.1 and not is_stiff(coarse, STEP)
    assert not is_stiff(fine, 0.1 * STEP)
    assert not is_stiff(strip(replace(FELT, bend_hysteresis_warp=1e-3)), STEP)
    bent = replace(fine.mesh, rest_bends=np.full(len(hinges_of(fine.mesh.faces)), 1e-3))
    assert not is_stiff(free_model(bent, FELT), STEP)
    assert not is_stiff(layered([fine, strip(PRESETS["cotton"])]), STEP)


def test_the_sag_of_a_stiff_strip_does_not_hang_on_the_step() -> None:
    """In frames that are shorter than the longest substep, too: they take the same factor."""
    sags = []
    for substeps, rate in ((4, 60.0), (12, 60.0), (12, 1000.0)):
        model = strip(FELT)
        state = State.at_rest(model)
        solver = Solver(model, SolverOptions(substep=1.0 / (60.0 * substeps)))
        assert solver.stiff
        for _ in range(round(2.0 * rate)):
            solver.step(state, Colliders(), 1.0 / rate)
            state.velocity *= np.float32(0.9 ** (60.0 / rate))
        sags.append(state.world()[model.mesh.vertices[:, 0] > 0.24 - 1e-9, 1].mean())
    assert sags[0] < -0.1
    assert np.array(sags) == pytest.approx(np.full(3, sags[1]), rel=0.02)


@pytest.mark.parametrize("times", [1.0, 1e6])
def test_a_stiff_strip_in_free_flight_keeps_its_momentum_and_gains_no_energy(times: float) -> None:
    """It starts bent and turning."""
    bend = times * FELT.bend_warp
    model = strip(replace(FELT, bend_warp=bend, bend_weft=bend), held=False)
    state = State.at_rest(model)
    x = state.position[:, 0]
    state.position[:, 1] += 1.5 * (x - 0.12) ** 2
    state.position[:, :3] = state.position[:, :3] @ turn((1.0, 2.0, 0.5), 30.0).astype(np.float32).T
    arm = state.position[:, :3] - state.position[:, :3].mean(axis=0)
    state.velocity[:] = np.cross([0.0, 3.0, 4.0], arm) + [1.0, 0.0, 0.5]
    linear, angular = momentum(model, state)
    speeds = []
    for _ in range(4):
        run(model, state, 30, 12, gravity=0.0)
        speeds.append(float((model.mass[:, None] * state.velocity.astype(float) ** 2).sum()))
    after, turning = momentum(model, state)
    assert np.linalg.norm(after - linear) < 1e-4 * np.linalg.norm(linear)
    assert np.linalg.norm(turning - angular) < 0.05 * np.linalg.norm(angular)
    assert max(speeds) < 1.02 * speeds[0]


def test_a_stiff_sheet_comes_to_rest_on_a_ball() -> None:
    """It is damped from outside; what contact and bending did against one another would go on."""
    vertices, faces = grid(16, 16, 0.02)
    start = vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0] + [-0.16, 0.01, 0.16]
    model = free_model(cloth(start, faces), FELT)
    state = State.at_rest(model)
    colliders = Colliders([Sphere((0.0, -0.2, 0.0), 0.2)])
    solver = Solver(model, SolverOptions())
    assert solver.stiff
    for _ in range(180):
        solver.step(state, colliders, 1 / 60)
        state.velocity *= np.float32(0.9)
    x = state.world()
    assert (np.linalg.norm(x - [0.0, -0.2, 0.0], axis=1) > 0.2).all()
    assert np.abs(state.velocity).max() < 0.01
    edges, lengths = model.mesh.edge_lengths()
    strain = np.abs(np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1) / lengths - 1.0)
    assert np.percentile(strain, 95) < 0.1 and strain.max() < 0.2  # the membrane is solved by one pass


def test_hinges_at_a_free_side_make_up_for_the_missing_one() -> None:
    """Two hinges of equilateral faces bear next to no bend along the side; of the two on a square, one bears it all."""
    shares = {}
    for kind in ("equilateral", "alternating"):
        vertices, faces = grid(8, 8, 0.02, kind)
        mesh = cloth(vertices, faces)
        shares[kind] = border_share(mesh)
        middle = vertices[hinges_of(mesh.faces)].mean(axis=1) - vertices.mean(axis=0)
        assert shares[kind][(np.abs(middle) < 0.04).all(axis=1)] == pytest.approx(1.0)
        assert shares[kind].min() == pytest.approx(1.0)
    assert (shares["equilateral"] > 1.2).sum() > 20
    assert shares["alternating"].max() < 1.05
