"""Integrators: orders of convergence, conservation, each its own damping, failures that are reported."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from pbd import Colliders, Fabric, Model, State
from pbd.models import Options, StepError, make_solver
from pbd.models.elements import QuadraticElements, Sum
from pbd.models.integrators import ImplicitEuler, Midpoint, QuasiStatic, Verlet, highest
from pbd.models.linear import FreeOrder
from pbd.models.newton import minimise
from pbd.models.stepping import ClothSolver
from tests.pbd.meshes import body_of, cloth, free_model, grid, icosphere, turn
from tests.pbd.models.sheets import INTEGRATORS, integrated
from tests.refusals import refuses

SOFT = Fabric(
    stretch_warp=40.0, stretch_weft=20.0, poisson=0.2, shear=8.0, bend_warp=1e-4, bend_weft=1e-4, air_drag=0.0
)
FALL = (0.0, -9.81, 0.0)


def solver_of(name: str, model: Model, options: Options | None = None) -> ClothSolver:
    solver = make_solver(name, model, options)
    assert isinstance(solver, ClothSolver)
    return solver


def flag(held: bool = True, fabric: Fabric = SOFT) -> Model:
    vertices, faces = grid(4, 3, 0.05)
    return free_model(cloth(vertices, faces), fabric, np.flatnonzero(vertices[:, 0] < 1e-9) if held else None)


def swung(model: Model) -> State:
    """A state with smooth velocities and without stress."""
    state = State.at_rest(model)
    state.velocity[:, 2] = 4.0 * model.mesh.vertices[:, 0]
    return state


def moved(name: str, substep: float, seconds: float) -> np.ndarray:
    model = flag()
    solver, state = integrated(name, model, Options(substep=substep, gravity=FALL)), swung(model)
    solver.step(state, Colliders(), seconds)
    return solver.position


@pytest.mark.parametrize(
    ("name", "order"),
    [("symplectic-euler", 1), ("verlet", 2), ("midpoint", 2), ("implicit-euler", 1), ("bdf2", 2)],
)
def test_order_of_convergence_in_time(name: str, order: int) -> None:
    """Slope of the error of positions against the substep, from 1.2 to 0.6 ms."""
    seconds = 0.024
    exact = moved("verlet", seconds / 240, seconds)
    errors = [np.abs(moved(name, seconds / n, seconds) - exact).max() for n in (20, 40)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25)


@pytest.mark.parametrize(
    ("name", "share"), [("symplectic-euler", 1), ("verlet", 0), ("midpoint", 0), ("implicit-euler", 1)]
)
def test_free_fall(name: str, share: int) -> None:
    """First-order integrators fall g h t/2 too far, the others exactly; 100 m from the origin as at it."""
    vertices, faces = grid(4, 3, 0.05)
    model = free_model(cloth(vertices + [100.0, 0.0, 0.0], faces), SOFT)
    solver, state = integrated(name, model, Options(substep=0.002)), State.at_rest(model)
    start = state.world()
    for _ in range(4):
        solver.step(state, Colliders(), 0.02)
    fallen, speed = (model.mass @ value / model.mass.sum() for value in (solver.position - start, solver.velocity))
    assert fallen == pytest.approx([0.0, -0.5 * 9.81 * 0.08 * (0.08 + share * 0.002), 0.0], abs=1e-10)
    assert speed == pytest.approx([0.0, -9.81 * 0.08, 0.0], abs=1e-9)
    assert state.world() == pytest.approx(solver.position, abs=1e-7)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_momentum(name: str) -> None:
    """A crumpled sheet without forces from outside: 1e-6, angular momentum where the integrator keeps it."""
    model = flag(held=False)
    x = model.mesh.vertices + np.random.default_rng(0).normal(0.0, 0.004, (20, 3))
    state = State.at_rest(model, x)
    state.velocity[:] = [1.0, 2.0, -0.5] + np.cross([3.0, -2.0, 4.0], x)
    start = state.velocity.astype(float)
    solver = integrated(name, model, Options(substep=0.001, gravity=(0.0, 0.0, 0.0)))
    solver.step(state, Colliders(), 0.01)
    mass = model.mass[:, None]
    before, after = (mass * start).sum(axis=0), (mass * solver.velocity).sum(axis=0)
    assert np.abs(after - before).max() < 1e-6 * np.linalg.norm(before)
    turning = [(mass * np.cross(p, v)).sum(axis=0) for p, v in ((x, start), (solver.position, solver.velocity))]
    if name in ("symplectic-euler", "verlet", "midpoint"):
        assert np.abs(turning[1] - turning[0]).max() < 1e-6 * np.linalg.norm(turning[0])


def oscillation(solver_class: type[ClothSolver], z: float, steps: int) -> float:
    """Amplitude after steps of omega h = z of one mode of a sheet, over what it was."""
    model = flag(held=False)
    omega = 50.0
    # Every vertex hangs on a spring without length to the origin: one frequency for all.
    springs = QuadraticElements(np.arange(20)[:, None], 20, (model.mass * omega**2)[:, None, None])
    springs.slopes = lambda corners: springs.matrices * corners
    solver = solver_class(model, Sum([springs]), Options(substep=z / omega, gravity=(0.0, 0.0, 0.0)), "springs")
    state = State.at_rest(model)
    energy = lambda x, v: (omega**2 * x**2 + v**2).sum()  # noqa: E731
    first = energy(state.world(), state.velocity.astype(float))
    for _ in range(steps):
        solver.step(state, Colliders(), z / omega)
    return float(np.sqrt(energy(solver.position, solver.velocity) / first))


@pytest.mark.parametrize("z", [0.05, 0.3, 2.0])
def test_damping_of_each_integrator_is_its_own_law(z: float) -> None:
    """Implicit Euler keeps 1/sqrt(1 + z^2) a step, the midpoint rule all."""
    assert oscillation(ImplicitEuler, z, 10) == pytest.approx((1 + z**2) ** -5, rel=1e-6)
    assert oscillation(Midpoint, z, 10) == pytest.approx(1.0, rel=1e-6)


def test_the_highest_frequency_bounds_the_explicit_step() -> None:
    model = flag(held=False)
    solver = solver_of("fem-stvk/verlet", model, Options(gravity=(0.0, 0.0, 0.0)))
    omega = highest(model, solver.energy)
    dense = solver.energy.completed(model.mesh.vertices)
    hessian = solver.energy.hessian(dense).toarray()
    n, hidden = 60, hessian[60:, 60:]
    condensed = hessian[:n, :n] - hessian[:n, n:] @ np.linalg.solve(hidden, hessian[n:, :n])
    root = 1 / np.sqrt(np.repeat(model.mass, 3))
    assert omega**2 == pytest.approx(np.linalg.eigvalsh(root[:, None] * condensed * root)[-1], rel=1e-2)
    for share, stays in ((0.98, True), (1.05, False)):
        careful = Verlet(model, solver.energy, Options(substep=share * 2 / omega, gravity=(0.0, 0.0, 0.0)), "verlet")
        state = State.at_rest(model)
        state.velocity[:] = 1e-6 * np.random.default_rng(0).normal(size=(20, 3))
        if stays:
            careful.step(state, Colliders(), 60 * share * 2 / omega)
            assert np.abs(careful.velocity).max() < 1e-4
        else:  # grows by (1.05 + sqrt(1.05^2 - 1))^2 a step
            with pytest.raises(StepError, match="unstable"):
                careful.step(state, Colliders(), 60 * share * 2 / omega)


@pytest.mark.parametrize("method", ["fem-stvk/verlet", "springs-square/symplectic-euler"])
def test_an_explicit_step_that_is_too_long_is_reported_and_leaves_the_state(method: str) -> None:
    model = flag()
    solver, state = solver_of(method, model, Options(substep=1 / 60)), swung(model)
    before = state.copy()
    with pytest.raises(StepError, match=rf"{method}: .*(unstable|not finite).*substep \d+ of 60"):
        solver.step(state, Colliders(), 1.0)
    assert state.hash() == before.hash()


def test_a_linear_system_without_a_solution_is_reported() -> None:
    """Nothing holds the sheet: it has no equilibrium."""
    model = flag(held=False)
    with pytest.raises(StepError, match="linear solve failed"):
        solver_of("fem-stvk/quasi-static", model).step(State.at_rest(model), Colliders(), 1 / 60)


class Odd:
    """A function whose gradient, or whose curvature, is not its own."""

    def __init__(self, slope: float, curvature: float) -> None:
        self.slope, self.curvature = slope, curvature
        self.true = QuadraticElements(np.array([[0, 1]]), 2, np.array([[[1.0, -1.0], [-1.0, 1.0]]]))

    def energy(self, x: np.ndarray) -> float:
        return self.true.energy(x) + (0.0 if np.isfinite(self.slope) else np.nan)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return self.slope * self.true.gradient(x)

    def hessian(self, x: np.ndarray, positive: bool = False) -> csr_matrix:
        return self.curvature * self.true.hessian(x)


@pytest.mark.parametrize(
    ("slope", "curvature", "iterations", "problem"),
    [
        (-1.0, 1.0, 50, "line search stuck"),
        (1.0, -1.0, 50, "linear solve failed"),
        (np.nan, 1.0, 50, "not finite"),
        (1.0, 50.0, 3, "no minimum in 3"),
    ],
)
def test_minimisation_reports_every_way_to_fail(slope: float, curvature: float, iterations: int, problem: str) -> None:
    odd = Odd(slope, curvature)
    with pytest.raises(StepError, match=problem):
        minimise(odd, np.array([[1.0, 0, 0], [0, 0, 0]]), FreeOrder([odd.true], np.array([0])), 1e-9, iterations)


def test_an_equilibrium_that_is_no_minimum_is_told() -> None:
    """A strip clamped upright, straight: below the load of self-buckling (Gamma 7.84) it is stable, above it is not."""
    vertices, faces = grid(11, 2, 0.02)
    upright = np.stack([vertices[:, 1], vertices[:, 0] - 0.02, vertices[:, 2]], axis=1)
    for gamma, stable in ((6.5, True), (9.0, False)):
        bend = 0.2 * 9.81 * 0.2**3 / gamma
        fabric = Fabric(0.2, 3e3, 3e3, 0.0, 1.2e3, bend, bend, air_drag=0.0)
        model = free_model(cloth(upright, faces, (0.0, 1.0, 0.0)), fabric, np.flatnonzero(upright[:, 1] < 1e-9))
        solver = solver_of("fem-stvk/quasi-static", model)
        assert isinstance(solver, QuasiStatic)
        solver.step(State.at_rest(model), Colliders(), 1 / 60)
        assert solver.stable == stable


def test_it_goes_on_from_its_own_numbers_and_takes_over_what_was_changed() -> None:
    model = flag()
    whole, parts = swung(model), swung(model)
    one, other = (integrated("bdf2", model, Options(substep=0.002)) for _ in range(2))
    one.step(whole, Colliders(), 0.04)
    for _ in range(2):
        other.step(parts, Colliders(), 0.02)
    assert other.position == pytest.approx(one.position, abs=1e-12)
    parts.move_origin(parts.origin + [1.0, 0.0, 0.0])
    other.step(parts, Colliders(), 0.02)
    one.step(whole, Colliders(), 0.02)
    assert other.position == pytest.approx(one.position, abs=1e-12)
    parts.velocity[:] = 0.0
    kept = other.position.copy()
    other.step(parts, Colliders(), 1e-5)
    assert np.abs(other.position - kept).max() < 1e-5
    turned = State.at_rest(model, model.mesh.vertices @ turn((0.0, 0.0, 1.0), 90.0).T)
    other.step(turned, Colliders(), 1e-5, targets=turned.world()[model.held])
    assert other.position == pytest.approx(turned.world(), abs=1e-5)


def test_held_vertices_follow_their_targets() -> None:
    model = flag()
    for name in INTEGRATORS:
        solver, state = integrated(name, model), State.at_rest(model)
        targets = state.world()[model.held] + [0.0, 0.0, 0.01]
        solver.step(state, Colliders(), 1 / 60, targets=targets)
        assert solver.position[model.held] == pytest.approx(targets)
        assert solver.velocity[model.held] == pytest.approx(np.tile([0.0, 0.0, 0.6], (4, 1)))


def test_air_brings_a_sheet_to_the_wind() -> None:
    model = flag(held=False, fabric=Fabric(areal_density=0.05))
    solver = solver_of("fem-stvk/implicit-euler", model, Options(gravity=(0.0, 0.0, 0.0), substep=0.025))
    state = State.at_rest(model)
    for _ in range(20):
        solver.step(state, Colliders(), 0.05, wind=(0.0, 0.0, 3.0))
    # v' = k (w - v)^2 with k = rho_air C_d/(2 rho_A).
    law = 3.0 * (1.0 - 1.0 / (1.0 + 3.0 * 0.5 * 1.2 / 0.05))
    assert solver.velocity.mean(axis=0) == pytest.approx([0.0, 0.0, law], abs=0.02)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"dt": -1.0}, "dt"),
        ({"dt": np.nan}, "dt"),
        ({"targets": np.zeros((1, 3))}, "targets"),
        ({"wind": (0.0, np.inf, 0.0)}, "wind"),
    ],
)
def test_bad_arguments_are_refused(change: dict, problem: str) -> None:
    model = flag()
    arguments = {"state": State.at_rest(model), "colliders": Colliders(), "dt": 1 / 60, **change}
    refuses(problem, integrated("bdf2", model).step, **arguments)


def test_other_states_and_bodies_are_refused() -> None:
    model = flag()
    solver = integrated("bdf2", model)
    other = State.at_rest(free_model(cloth(*grid(2, 2, 0.1)), SOFT))
    refuses("another model", solver.step, other, Colliders(), 1 / 60)
    state = State.at_rest(model)
    refuses("colliders.body", solver.step, state, Colliders((), body_of(*icosphere(1), state)), 1 / 60)
    state.velocity[0] = np.nan
    refuses("not finite", solver.step, state, Colliders(), 1 / 60)


def test_bad_options_are_named_at_once() -> None:
    text = refuses("", Options, substep=0.0, gravity=(0.0, np.nan, 0.0), iterations=0, tolerance=-1.0, bend_poisson=1.0)
    assert all(name in text for name in ("substep", "gravity", "iterations", "tolerance", "bend_poisson"))
