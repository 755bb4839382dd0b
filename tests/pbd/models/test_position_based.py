"""Position-based methods and the modern rivals: what stiffness hangs on, and where iterations lead."""

from collections.abc import Callable

import numpy as np
import pytest

from pbd import Colliders, Fabric, Model, State
from pbd.models import ClothSolver, Options, make_solver
from pbd.models.elements import Sum
from pbd.models.integrators import ImplicitEuler
from pbd.models.membrane import CorotationalStrain, Membrane, continuum_membrane
from pbd.models.plate import angle_bending, isometric_bending
from pbd.models.springs import triangle_springs
from tests.pbd.meshes import cloth, free_model, grid

STIFF = 40.0
FABRIC = Fabric(stretch_warp=STIFF, stretch_weft=STIFF, poisson=0.0, shear=STIFF / 2, bend_warp=2e-4, bend_weft=2e-4)


def hung(kind: str = "equilateral") -> Model:
    vertices, faces = grid(3, 2, 0.05, kind)
    return free_model(cloth(vertices, faces), FABRIC, np.flatnonzero(vertices[:, 0] < 1e-9))


def stepped(solver: ClothSolver, model: Model, steps: int = 3) -> np.ndarray:
    """Positions after some steps of 1/120 s from a bent start."""
    x = model.mesh.vertices.copy()
    x[:, 2] += 2.0 * x[:, 0] ** 2
    state = State.at_rest(model, x)
    for _ in range(steps):
        solver.step(state, Colliders(), 1 / 120)
    return solver.position


def by_name(name: str, iterations: int, model: Model) -> np.ndarray:
    solver = make_solver(name, model, Options(substep=1 / 120, iterations=iterations))
    assert isinstance(solver, ClothSolver)
    return stepped(solver, model)


PATCHES = np.diag([STIFF, STIFF, STIFF / 2])


@pytest.mark.parametrize(
    ("name", "energies", "iterations", "error", "share"),
    [
        (
            "vertex-block-descent",
            lambda model: [continuum_membrane(model.mesh, FABRIC, "stvk"), isometric_bending(model)],
            *((5, 40), 2e-5, 0.2),
        ),
        (  # |F - R|^2 is linear elasticity without Poisson's ratio: two formulations of one energy
            "projective-dynamics",
            lambda model: [Membrane(model.mesh, CorotationalStrain(), PATCHES), isometric_bending(model)],
            *((60, 300), 2e-6, 0.1),
        ),
        (  # not to all digits: its multipliers follow each constraint's slope where it was, not where it ends
            "xpbd",
            lambda model: [triangle_springs(model.mesh, FABRIC), *angle_bending(model)],
            *((1, 60), 2e-4, 0.2),
        ),
    ],
)
def test_iterations_lead_to_implicit_euler_of_the_same_energy(
    name: str, energies: Callable[[Model], list], iterations: tuple[int, int], error: float, share: float
) -> None:
    model = hung()
    exact = stepped(ImplicitEuler(model, Sum(energies(model)), Options(substep=1 / 120), "reference"), model)
    few, many = (np.abs(by_name(name, count, model) - exact).max() for count in iterations)
    assert many < error and many < share * few


def stretch(name: str, iterations: int, substep: float, stiffness: float = 8.0) -> float:
    """Stretch of a hanging strip under its own weight over its length [-]."""
    vertices, faces = grid(5, 2, 0.04)
    down = np.stack([vertices[:, 1], -vertices[:, 0], vertices[:, 2]], axis=1)
    fabric = Fabric(stretch_warp=stiffness, stretch_weft=stiffness, poisson=0.0, bend_warp=0.0, bend_weft=0.0)
    model = free_model(cloth(down, faces, (0.0, 1.0, 0.0)), fabric, np.flatnonzero(down[:, 1] > -1e-9))
    solver, state = make_solver(name, model, Options(substep=substep, iterations=iterations)), State.at_rest(model)
    for _ in range(20):
        solver.step(state, Colliders(), 1 / 60)
        state.velocity *= np.float32(0.7)
    tip = down[:, 1] < -0.2 + 1e-9
    return float((down - state.world())[tip, 1].mean() / 0.2)


def test_stiffness_of_pbd_hangs_on_iterations_and_step_and_on_no_fabric() -> None:
    usual = stretch("pbd", 2, 1 / 60)
    assert usual > 1.1 * stretch("pbd", 8, 1 / 60)
    assert usual > 2.5 * stretch("pbd", 2, 1 / 120)
    assert usual == pytest.approx(stretch("pbd", 2, 1 / 60, stiffness=80.0), rel=1e-6)


def test_strain_based_dynamics_knows_no_fabric_either() -> None:
    usual = stretch("strain-based", 4, 1 / 60)
    assert usual == pytest.approx(stretch("strain-based", 4, 1 / 60, stiffness=80.0), rel=1e-6)
    assert usual > 2.5 * stretch("strain-based", 4, 1 / 120)


def test_stiffness_of_xpbd_hangs_on_the_fabric_alone() -> None:
    """Once converged; within a sixth of rho_A g L/(2 E h), what the lattice's clamped row adds."""
    usual = stretch("xpbd", 20, 1 / 60)
    assert usual == pytest.approx(stretch("xpbd", 40, 1 / 60), rel=0.03)
    assert usual == pytest.approx(stretch("xpbd", 20, 1 / 120), rel=0.03)
    assert usual == pytest.approx(0.15 * 9.81 * 0.2 / (2 * 8.0), rel=0.2)
    assert stretch("xpbd", 40, 1 / 120, stiffness=80.0) == pytest.approx(0.1 * usual, rel=0.2)
