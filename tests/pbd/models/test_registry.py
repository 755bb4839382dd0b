"""Every solver by its name: each hangs a strip, each can be put in the default's place."""

import numpy as np
import pytest

from pbd import ClothMesh, Colliders, Fabric, Model, Plane, Solver, State
from pbd.models import SOLVERS, ClothSolver, Options, make_solver
from tests.pbd.meshes import cloth, free_model, grid
from tests.refusals import refuses

FABRIC = Fabric(stretch_warp=20.0, stretch_weft=20.0, poisson=1 / 3, shear=7.5, bend_warp=1e-3, bend_weft=1e-3)


def strip() -> Model:
    vertices, faces = grid(3, 2, 0.05)
    hung = np.stack([vertices[:, 1], -vertices[:, 0], vertices[:, 2]], axis=1)
    return free_model(cloth(hung, faces, (0.0, 1.0, 0.0)), FABRIC, np.flatnonzero(hung[:, 1] > -1e-9))


@pytest.mark.parametrize("name", SOLVERS)
def test_each_hangs_a_strip(name: str) -> None:
    model = strip()
    solver, state = make_solver(name, model), State.at_rest(model)
    for _ in range(2):
        solver.step(state, Colliders(), 1 / 60, wind=(0.0, 0.0, 0.1))
        solver.follow(state, Colliders())
    fallen = model.mesh.vertices - state.world()
    assert np.isfinite(state.position).all()
    assert np.abs(fallen[model.held]).max() < 1e-6
    tip = fallen[model.mesh.vertices[:, 1] < -0.15 + 1e-9, 1]
    assert np.all((tip > 1e-4) & (tip < 0.01))


def test_the_default_is_among_them_and_takes_the_shared_options() -> None:
    solver = make_solver("default", strip(), Options(substep=0.002, gravity=(0.0, -1.0, 0.0)))
    assert isinstance(solver, Solver)
    assert solver.options.substep == 0.002 and solver.options.gravity == (0.0, -1.0, 0.0)
    assert isinstance(make_solver("default", strip()), Solver)


def test_an_unknown_name_and_a_mesh_that_a_model_cannot_take_are_refused() -> None:
    refuses(r"no such solver.*fem-stvk/verlet", make_solver, "fem-stvk/bdf3", strip())
    model = free_model(cloth(*grid(2, 2, 0.1, "equilateral")), FABRIC)
    refuses("no square lattice", make_solver, "springs-square/symplectic-euler", model)


def test_stitches_hold_panels_together() -> None:
    """Two panels, one below the other; the lower one hangs by stitches to the middles of the upper one's edges."""
    vertices, faces = grid(2, 4, 0.05)
    upper = np.stack([vertices[:, 1], -vertices[:, 0], vertices[:, 2]], axis=1)
    lower = upper - [0.0, 0.1, 0.0]
    bottom, top = np.flatnonzero(upper[:, 1] < -0.1 + 1e-9), np.flatnonzero(upper[:, 1] > -1e-9)
    stitches = np.stack([top + len(upper), bottom, np.roll(bottom, -1)], axis=1)
    flat = cloth(np.concatenate([upper, lower]), np.concatenate([faces, faces + len(upper)]), (0.0, 1.0, 0.0))
    weights = np.zeros(len(stitches))
    mesh = ClothMesh(flat.vertices, flat.faces, flat.flat, stitches.astype(np.int32), weights)
    model = free_model(mesh, FABRIC, top)
    solver, state = make_solver("fem-stvk/implicit-euler", model), State.at_rest(model)
    assert isinstance(solver, ClothSolver)
    for _ in range(10):
        solver.step(state, Colliders([Plane((0.0, -5.0, 0.0))]), 1 / 60)
    x = solver.position
    assert np.linalg.norm(x[top + len(upper)] - x[bottom], axis=1).max() < 1e-3
