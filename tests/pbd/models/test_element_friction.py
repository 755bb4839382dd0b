"""Internal friction in the finite elements: derivatives, loops, what the state keeps, which solvers have it."""

from dataclasses import replace

import numpy as np
import pytest

from pbd import Colliders, ModelOptions, State, build_model
from pbd.models import Options, make_solver
from pbd.models.friction import CurvatureFriction, FrictionElements, friction_elements
from pbd.models.membrane import Membrane, continuum_membrane
from pbd.models.registry import cloth_energy
from tests.pbd.meshes import cloth, grid, turn
from tests.pbd.models.sheets import FABRIC, differences
from tests.refusals import refuses

RUBBING = replace(FABRIC, bend_hysteresis_warp=0.4, bend_hysteresis_weft=0.1, shear_hysteresis=30.0, air_drag=0.0)
MODEL = build_model(cloth(*grid(4, 3, 0.05, "alternating")), RUBBING, None, options=ModelOptions(tether_slack=0.0))


def elements(kind: str, seed: int = 0) -> FrictionElements:
    """Elements that have slipped before: their plastic strains are anything."""
    sheet = continuum_membrane(MODEL.mesh, RUBBING, "stvk")
    assert isinstance(sheet, Membrane)
    found = friction_elements(MODEL, sheet)[("shear", "bending").index(kind)]
    assert isinstance(found, FrictionElements)
    spread = 0.2 if kind == "shear" else 20.0
    found.plastic = np.random.default_rng(seed).normal(0.0, spread, found.plastic.shape)
    return found


def crumpled(energy: FrictionElements) -> np.ndarray:
    x = np.concatenate([MODEL.mesh.vertices, np.zeros((energy.vertex_count - MODEL.vertex_count, 3))])
    rest = cloth_energy(MODEL, "fem-stvk", "morley").completed(MODEL.mesh.vertices)
    x = rest if len(x) == len(rest) else x
    return (x + np.random.default_rng(3).normal(0.0, 0.005, x.shape)) @ turn((1.0, 2.0, 0.5), 70.0).T


@pytest.mark.parametrize("kind", ["shear", "bending"])
def test_derivatives_against_finite_differences(kind: str) -> None:
    """First and second, of elements of which some stick and some slip."""
    energy = elements(kind)
    x = crumpled(energy)
    before = energy.plastic.copy()
    energy.slip(x)
    moved = np.any(energy.plastic != before, axis=1)
    assert 0.1 < moved.mean() < 1.0
    energy.plastic = before
    gradient = energy.gradient(x)
    measured = differences(energy.energy, x, 1e-6).reshape(x.shape)
    assert np.abs(measured - gradient).max() < 1e-6 * np.abs(gradient).max()
    hessian = energy.hessian(x).toarray()
    measured = differences(lambda y: energy.gradient(y).ravel(), x, 1e-6)
    assert np.abs(measured - hessian).max() < 1e-5 * np.abs(hessian).max()
    eigenvalues = np.linalg.eigvalsh(energy.hessian(x, positive=True).toarray())
    assert eigenvalues.min() > -1e-10 * eigenvalues.max()


@pytest.mark.parametrize("kind", ["shear", "bending"])
def test_moving_and_turning_cost_nothing(kind: str) -> None:
    energy = elements(kind)
    x = crumpled(energy)
    assert energy.energy(x @ turn((0.3, 1.0, 2.0), 130.0).T + [5.0, -3.0, 8.0]) == pytest.approx(
        energy.energy(x), rel=1e-9
    )


@pytest.mark.parametrize("kind", ["shear", "bending"])
def test_slipping_keeps_the_force(kind: str) -> None:
    """The return mapping: after it the element is at the force at which it slips, or where it was."""
    energy = elements(kind)
    x = crumpled(energy)
    before = energy.gradient(x)
    energy.slip(x)
    assert energy.gradient(x) == pytest.approx(before, rel=1e-9, abs=1e-12)
    plastic = energy.plastic.copy()
    energy.slip(x)
    assert energy.plastic == pytest.approx(plastic, rel=1e-9, abs=1e-12)


def test_until_it_slips_bending_is_four_times_as_stiff_along_both_axes() -> None:
    """Three times by friction, whatever the other axis' hysteresis is."""
    energy = elements("bending")
    assert isinstance(energy, CurvatureFriction)
    moments, stiffness = np.array([0.2, 0.05]), np.array([FABRIC.bend_warp, FABRIC.bend_weft])
    for axis in (0, 1):
        slips_at = moments[axis] / (3.0 * stiffness[axis])
        off = np.zeros((3, 3))
        off[:, axis] = np.array([0.5, 1.0, 4.0]) * slips_at * energy.scale[axis]
        force, slid = energy.forces(off)
        assert energy.scale[axis] * force[:, axis] == pytest.approx(moments[axis] * np.array([0.5, 1.0, 1.0]))
        assert slid == pytest.approx([0.0, 0.0, 3.0 * slips_at * energy.scale[axis]], abs=1e-12)


def rolled(vertices: np.ndarray, curvature: float, angle: float) -> np.ndarray:
    """A level sheet on a cylinder with its axis at right angles to a direction [m]."""
    along, up = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([0.0, 0.0, 1.0])
    s = vertices @ along
    if curvature == 0.0:
        return vertices
    move = (np.sin(curvature * s) / curvature - s)[:, None] * along
    return vertices + move + ((1.0 - np.cos(curvature * s)) / curvature)[:, None] * up


def test_hidden_points_stand_where_they_cost_least_whatever_was_asked_before() -> None:
    """They start where they were the last time, which must not show in cloth that has slipped."""
    random = np.random.default_rng(5)
    used, places = cloth_energy(MODEL, "fem-stvk", "morley"), []
    for _ in range(4):
        places.append(MODEL.mesh.vertices @ turn((1.0, 2.0, 0.5), 50.0).T + random.normal(0.0, 0.005, (20, 3)))
    for x in (*places, places[-1]):
        fresh = cloth_energy(MODEL, "fem-stvk", "morley")
        for energy in (used, fresh):
            (rubbing,) = (part for part in energy.parts if isinstance(part, CurvatureFriction))
            rubbing.plastic = np.random.default_rng(1).normal(0.0, 20.0, rubbing.plastic.shape)
        points = used.completed(x)
        assert points == pytest.approx(fresh.completed(x), abs=1e-9)
        bent = [part for part in used.parts if part.elements.max() >= len(x)]
        forces = [part.gradient(points)[len(x) :] for part in bent]
        assert len(bent) == 2 and np.abs(forces[0]).max() > 0.01
        assert np.abs(forces[0] + forces[1]).max() < 1e-6 * np.abs(forces[0]).max()
    assert not np.isfinite(used.completed(np.full((20, 3), np.nan))).any()
    assert used.completed(places[0]) == pytest.approx(fresh.completed(places[0]), abs=1e-9)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0, 90.0])
def test_a_sheet_on_cylinders_rubs_as_the_fabric_says(degrees: float) -> None:
    """All vertices are led; moments of the faces that do not lie at a border, whose ends are free of moments."""
    fabric = replace(RUBBING, shear_hysteresis=0.0, bend_hysteresis_warp=0.04, bend_hysteresis_weft=0.02)
    angle = np.radians(degrees)
    model = build_model(cloth(*grid(8, 8, 0.01, "alternating")), fabric, None, options=ModelOptions(tether_slack=0.0))
    energy = cloth_energy(model, "fem-stvk", "morley")
    (rubbing,) = (part for part in energy.parts if isinstance(part, CurvatureFriction))
    flat = model.mesh.vertices - model.mesh.vertices.mean(axis=0)
    inside = (np.abs(flat[model.mesh.faces]) < 0.031).all(axis=(1, 2))
    cosine, sine = np.cos(angle), np.sin(angle)
    along = np.array([cosine**2, sine**2, 2.0 * cosine * sine])
    found = []
    for curvature in np.concatenate([np.arange(0.0, 20.5, 1.0), np.arange(19.0, 0.5, -1.0)]):
        points = energy.completed(rolled(flat, curvature, angle))
        found.append(float((rubbing.moments(points)[inside] @ along).mean()))
        rubbing.slip(points)
    warp, weft = fabric.bend_hysteresis_warp, fabric.bend_hysteresis_weft
    moment = 0.5 * (warp * cosine**2 + weft * sine**2)
    assert found[20] == pytest.approx(moment, rel=0.02) and found[-1] == pytest.approx(-moment, rel=0.02)


def test_what_friction_holds_is_kept_in_the_state() -> None:
    """A strip between two clamps, bent, sheared and brought back; a new solver that takes the state goes on from it."""
    start = MODEL.mesh.vertices
    held = np.flatnonzero((start[:, 0] < 0.051) | (start[:, 0] > 0.149))
    model = build_model(MODEL.mesh, RUBBING, held, options=ModelOptions(tether_slack=0.0))
    far = start[:, :1] > 0.149
    turned = (start - [0.15, 0.0, 0.0]) @ turn((0.0, 1.0, 0.0), 80.0).T + [0.15, 0.05, 0.0]
    moved = np.where(far, turned, start)
    state, solver = State.at_rest(model), make_solver("fem-stvk/quasi-static", model, Options())
    for target in (moved, start):
        solver.step(state, Colliders(), 1 / 60, target[held])
    assert np.abs(state.plastic_curvatures).max() > 1.0 and np.abs(state.plastic_shears).max() > 0.03
    other, again = state.copy(), make_solver("fem-stvk/quasi-static", model, Options())
    for some, used in ((state, solver), (other, again)):
        used.step(some, Colliders(), 1 / 60, (0.5 * (start + moved))[held])
    assert other.plastic_curvatures == pytest.approx(state.plastic_curvatures, rel=1e-4, abs=1e-3)
    assert other.world() == pytest.approx(state.world(), abs=1e-6)
    unlike = State.at_rest(build_model(MODEL.mesh, FABRIC))
    refuses("state of another model", solver.step, unlike, Colliders(), 1 / 60)


@pytest.mark.parametrize(
    "name", ["springs-triangle/implicit-euler", "fem-stvk+isometric/verlet", "xpbd", "projective-dynamics"]
)
def test_solvers_without_friction_say_so(name: str) -> None:
    refuses("no internal friction", make_solver, name, MODEL)
