"""Motion: free fall, momentum, hanging, pauses. Digits must not depend on where in the world a garment is."""

import numpy as np
import pytest

from pbd import Colliders, Fabric, Plane, Solver, SolverOptions, Sphere, State
from tests.pbd.meshes import body_of, cloth, free_model, grid, icosphere, momentum, run, turn, wavy

GRAVITY = 9.81
PLACES = [0.0, 8.0, 100.0]  # from the origin [m]
VACUUM = {"air_drag": 0.0}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("substeps", [20, 80])
def test_free_fall(place: float, substeps: int) -> None:
    vertices, faces = grid(12, 10, 0.04, "equilateral")
    vertices = vertices @ turn((1.0, 2.0, 0.5), 40.0).T + [place, place, 0.0]
    model = free_model(cloth(vertices, faces), Fabric(**VACUUM))
    state = State.at_rest(model)
    start = state.world()
    run(model, state, 60, substeps, GRAVITY)
    assert np.abs(state.velocity - [0.0, -GRAVITY, 0.0]).max() < 1e-5 * GRAVITY  # each vertex after 1 s
    symplectic = 0.5 * GRAVITY * (1.0 + 1.0 / (60.0 * substeps))
    assert np.abs(state.world() - start + [0.0, symplectic, 0.0]).max() < 1e-5 * symplectic


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("substeps", [20, 80])
@pytest.mark.parametrize("stiffness", [2e3, 2e4])
def test_hanging_stretch(place: float, substeps: int, stiffness: float) -> None:
    """Tip displacement: rho_A g L^2/(2 E h), and no more on top than the law of one pass: g h^2 N^2/2 (n = 1).

    That is the law without patches; with them, see test_multigrid.
    """
    edges, length, step = 20, 1.0, 1.0 / (60.0 * substeps)
    vertices, faces = grid(edges, 4, length / edges)
    vertices = np.stack([vertices[:, 1], -vertices[:, 0], vertices[:, 2]], axis=1) + [place, place, 0.0]
    fabric = Fabric(stretch_warp=stiffness, stretch_weft=stiffness, shear=stiffness / 2, poisson=0.0, **VACUUM)
    model = free_model(cloth(vertices, faces, (0.0, 1.0, 0.0)), fabric, np.flatnonzero(vertices[:, 1] > place - 1e-9))
    state = State.at_rest(model)
    run(model, state, 120, substeps, GRAVITY, keep=0.9, sweeps=0)
    tip = vertices[:, 1] < place - length + 1e-9
    stretch = (vertices[tip, 1] - state.world()[tip, 1]).mean() / length
    elastic = fabric.areal_density * GRAVITY * length / (2.0 * stiffness)
    law = GRAVITY * step**2 * edges**2 / (2.0 * length)
    # The law is that of inextensible edges: cloth that gives way by itself reaches less of it.
    assert (0.85 if elastic < 0.1 * law else 0.5) * law < stretch - elastic < 1.03 * law
    assert np.abs(state.world()[:, 2]).max() < 1e-6 and np.abs(state.velocity).max() < 5e-4


@pytest.mark.parametrize("place", [0.0, 100.0])
@pytest.mark.parametrize("substeps", [20, 80])
def test_linear_momentum_of_a_deformed_spinning_cloth(place: float, substeps: int) -> None:
    vertices, faces = wavy(place)
    model = free_model(cloth(vertices, faces), Fabric(**VACUUM))
    state = State.at_rest(model, vertices + 0.02 * (vertices - vertices.mean(axis=0)) * [1.0, -0.5, 1.0])
    state.velocity[:] = np.cross([1.0, 3.0, -2.0], vertices - vertices.mean(axis=0)) + [0.5, 0.2, -0.1]
    before, _ = momentum(model, state)
    centre = (model.mass @ state.world()) / model.mass.sum()
    run(model, state, 60, substeps, gravity=0.0)
    after, _ = momentum(model, state)
    assert np.abs(after - before).max() < 1e-6 * np.linalg.norm(before)
    moved = (model.mass @ state.world()) / model.mass.sum() - centre
    assert moved == pytest.approx(before / model.mass.sum(), abs=1e-6)


@pytest.mark.parametrize("substeps", [20, 80])
@pytest.mark.parametrize("spin", [1.0, 4.0])
def test_angular_momentum_decays_as_implicit_euler_must_and_no_more(substeps: int, spin: float) -> None:
    """Forces act at the end of a substep with the arms of its start: a rate of h omega^2. Nothing else is lost."""
    vertices, faces = wavy()
    model = free_model(cloth(vertices, faces), Fabric(**VACUUM))
    state = State.at_rest(model)
    arm = vertices - (model.mass @ vertices) / model.mass.sum()
    # About the axis of the greatest moment of inertia, where a free body turns steadily.
    inertia = np.einsum(
        "n,nij->ij", model.mass, (arm**2).sum(1)[:, None, None] * np.eye(3) - arm[:, :, None] * arm[:, None, :]
    )
    axis = np.linalg.eigh(inertia)[1][:, 2]
    state.velocity[:] = np.cross(spin * axis, arm)
    _, before = momentum(model, state)
    run(model, state, 60, substeps, gravity=0.0, sweeps=0)  # patches lose less
    _, after = momentum(model, state)
    law = np.exp(-(spin**2) / (60.0 * substeps))
    assert np.linalg.norm(after) / np.linalg.norm(before) == pytest.approx(law, abs=0.1 * (1.0 - law) + 1e-4)
    assert np.linalg.norm(after / law - before) < (0.1 * (1.0 - law) + 2e-4) * np.linalg.norm(before)


@pytest.mark.parametrize("place", PLACES)
def test_at_rest_without_forces_nothing_moves(place: float) -> None:
    vertices, faces = wavy(place)
    model = free_model(cloth(vertices, faces), Fabric(**VACUUM))
    state = State.at_rest(model)
    before = state.world()
    run(model, state, 300, 20, gravity=0.0)
    # The sheet is curved and bends itself flat about its centre; the centre stays.
    drift = model.mass @ (state.world() - before) / model.mass.sum()
    assert np.abs(drift).max() < 1e-7
    flat_vertices, faces = grid(12, 10, 0.04, "equilateral")
    flat = free_model(cloth(flat_vertices + [place, place, 0.0], faces), Fabric(**VACUUM))
    state = State.at_rest(flat)
    before = state.world()
    run(flat, state, 300, 20, gravity=0.0)
    assert np.abs(state.world() - before).max() < 1e-6


def test_held_vertices_reach_their_targets_and_carry_the_cloth() -> None:
    vertices, faces = grid(6, 6, 0.05)
    held = np.flatnonzero(vertices[:, 1] > 0.3 - 1e-9)
    model = free_model(cloth(vertices, faces), Fabric(), held)
    state, solver, colliders = State.at_rest(model), Solver(model), Colliders()
    for frame in range(1, 121):
        targets = vertices[held] + [0.02 * frame, 0.0, 0.01 * frame]
        solver.follow(state, colliders)
        solver.step(state, colliders, 1 / 60, targets)
        assert np.abs(state.world()[held] - targets).max() < 1e-6
        assert state.velocity[held] == pytest.approx(np.tile([1.2, 0.0, 0.6], (len(held), 1)), abs=1e-4)
    assert np.abs((state.world() - vertices).mean(axis=0) - [2.4, 0.0, 1.2]).max() < 0.2


def test_drag_brings_a_sheet_to_its_terminal_speed() -> None:
    """rho_A g = rho_air C_d v^2/2 for a sheet that falls flat."""
    vertices, faces = grid(6, 6, 0.05)
    fabric = Fabric(air_drag=1.3)
    model = free_model(cloth(vertices[:, [1, 2, 0]], faces, (0.0, 0.0, 1.0)), fabric)
    state = State.at_rest(model)
    run(model, state, 180)
    terminal = np.sqrt(fabric.areal_density * GRAVITY / (0.5 * 1.2 * fabric.air_drag))
    # Substep: a first-order integrator settles a little above.
    assert -state.velocity[:, 1].mean() == pytest.approx(terminal, rel=1e-2)


def test_wind_carries_a_sheet_that_faces_it() -> None:
    vertices, faces = grid(6, 6, 0.05)
    model = free_model(cloth(vertices, faces), Fabric(air_drag=2.0))
    state = State.at_rest(model)
    solver = Solver(model, SolverOptions(gravity=(0.0, 0.0, 0.0)))
    for _ in range(600):
        solver.step(state, Colliders(), 1 / 60, wind=(0.0, 0.0, 3.0))
    speed = state.velocity[:, 2].mean()
    factor = 0.5 * 1.2 * 2.0 / 0.15
    assert speed == pytest.approx(3.0 - 3.0 / (1.0 + factor * 3.0 * 10.0), rel=5e-3)  # dv/dt = -k v^2 after 10 s


@pytest.mark.parametrize("pause", [0.1, 0.5, 2.0])
def test_a_long_pause_leaves_the_cloth_whole(pause: float) -> None:
    vertices, faces = grid(10, 10, 0.03)
    lying = vertices[:, [1, 2, 0]] - [0.15, -0.12, 0.15]
    model = free_model(cloth(lying, faces, (0.0, 0.0, 1.0)), Fabric(), np.array([0, 10]))
    state = State.at_rest(model)
    sphere, sphere_faces = icosphere(3, 0.1)
    body = body_of(sphere, sphere_faces, state)
    solver, colliders = Solver(model), Colliders([Plane((0.0, -0.3, 0.0)), Sphere((0.3, -0.1, 0.0), 0.1)], body)
    for frame in range(60):
        body.advance((sphere + [0.002 * frame, 0.0, 0.0] - state.origin).astype(np.float32))
        solver.step(state, colliders, pause if frame == 20 else 1 / 60)
        edges, lengths = model.mesh.edge_lengths()
        x = state.world()
        stretch = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) / lengths
        assert np.isfinite(state.velocity).all() and stretch.max() < 1.2


@pytest.mark.parametrize("squeezed", [(0.0, 1.0, 0.0), (0.0, 0.0, 0.0)], ids=["line", "point"])
def test_cloth_squeezed_to_nothing_opens(squeezed: tuple[float, float, float]) -> None:
    """Held by nothing, without gravity or air: it comes back to its own size and gains no speed."""
    vertices, faces = grid(8, 8, 0.05)
    model = free_model(cloth(vertices, faces), Fabric(**VACUUM))
    state = State.at_rest(model, vertices * squeezed)
    run(model, state, 180, gravity=0.0, keep=0.97)
    x = state.world()
    edges, rest = model.mesh.edge_lengths()
    strain = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) / rest - 1.0
    assert np.median(np.abs(strain)) < 0.02 and strain.max() < 0.1
    assert np.linalg.norm(momentum(model, state)[0]) < 1e-4 * model.mass.sum()
    centre = model.mass @ (x - vertices * squeezed) / model.mass.sum()
    assert np.linalg.norm(centre) < 2.0 * model.fabric.thickness  # by half a thickness a frame it is put aside
