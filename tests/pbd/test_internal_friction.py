"""Internal friction: loops of bending and shear, what is left of a bend, what a swing loses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pbd import (
    Colliders,
    Fabric,
    Model,
    ModelOptions,
    Solver,
    SolverOptions,
    State,
    build_model,
)
from pbd.bending import bends_of, friction_share
from pbd.layers import layered
from pbd.mesh import ClothMesh
from pbd.xpbd.constraints import FRICTION_STIFFNESS
from precompute.experiment.sheets import level
from precompute.validation.friction_rows import rolled, unordered
from precompute.validation.trial import Specimen, strip
from tests.refusals import refuses

HYSTERESIS = 1.2e-3  # of cotton broadcloth, Kawabata's 2HB [N]
BEND = 11.6e-6  # [N m]
COTTON = Fabric(
    0.15, 2000.0, 2000.0, 0.2, 300.0, BEND, BEND, air_drag=0.0,
    bend_hysteresis_warp=HYSTERESIS, bend_hysteresis_weft=HYSTERESIS,
)  # fmt: skip
SMOOTH = replace(COTTON, bend_hysteresis_warp=0.0, bend_hysteresis_weft=0.0)
RUBBED = 1.0  # of a cotton cloth, Kawabata's 2HG [N/m]
SHEARED = replace(SMOOTH, shear=40.0, shear_hysteresis=RUBBED)
KNIT = {"stiffening_warp_10": 3.0, "stiffening_warp_20": 8.0, "stiffening_weft_10": 2.0, "stiffening_weft_20": 4.0}
WEIGHTLESS = SolverOptions(gravity=(0.0, 0.0, 0.0), coarse_sweeps=0)


def model_of(specimen: Specimen, fabric: Fabric, held: np.ndarray | None = None) -> Model:
    mesh = ClothMesh.from_pattern(level(specimen.flat), specimen.faces, specimen.flat[specimen.faces])
    return build_model(mesh, fabric, held, options=ModelOptions(tether_slack=0.0))


def moments(specimen: Specimen, fabric: Fabric, angle: float, path: np.ndarray) -> np.ndarray:
    """Moment per width [N] of cloth that is laid on one cylinder after the other, curvatures [1/m], shape (k,).

    The cloth is so heavy that it stays where it is laid. The moment is the work by which its hinges resist a change of
    the curvature, over that change and the area.
    """
    model = model_of(specimen, replace(fabric, areal_density=1e9))
    state, solver = State.at_rest(model), Solver(model, replace(WEIGHTLESS, substep=1 / 60))
    order, found = model.hinge_numbers, []
    softness, slips_at = model.hinge_data[:, 1, 1].astype(float), model.hinge_data[:, 1, 3].astype(float)
    for curvature in path:
        state.position[:, :3] = rolled(specimen, curvature, angle) - state.origin
        state.velocity[:] = 0.0
        solver.step(state, Colliders(), 1 / 60)
        places = np.stack([rolled(specimen, c, angle) for c in (curvature, curvature + 0.1)])
        bends, more = bends_of(model.mesh, places)[:, order]
        rubbing = FRICTION_STIFFNESS * (bends - state.plastic_bends[order]) if model.plastic_count else 0.0 * bends
        assert (np.abs(rubbing) <= 1.001 * slips_at + 1e-6).all()
        found.append((((bends + rubbing) / softness) @ (more - bends)) / 0.1 / model.mesh.face_areas.sum())
    return np.array(found)


def shear_forces(specimen: Specimen, fabric: Fabric, path: np.ndarray) -> np.ndarray:
    """Shear force per width [N/m] of cloth so heavy that it stays where it is laid, angles [rad], shape (k,)."""
    model = model_of(specimen, replace(fabric, areal_density=1e9))
    state, solver = State.at_rest(model), Solver(model, replace(WEIGHTLESS, substep=1 / 60))
    flat, found = level(specimen.flat), []
    for angle in path:
        # Weft turns against the warp and keeps its length, so that nothing but the shear is strained.
        state.position[:, 0] = flat[:, 0] - np.sin(angle) * flat[:, 2] - state.origin[0]
        state.position[:, 2] = np.cos(angle) * flat[:, 2] - state.origin[2]
        state.velocity[:] = 0.0
        solver.step(state, Colliders(), 1 / 60)
        rubbing = FRICTION_STIFFNESS * (np.sin(angle) - state.plastic_shears) if model.plastic_shear_count else 0.0
        force = fabric.shear * (np.sin(angle) + rubbing)
        assert np.ptp(force) < 1e-3 * fabric.shear * 0.14  # the same in all triangles
        found.append(float(np.mean(force)))
    return np.array(found)


@pytest.mark.parametrize(
    ("specimen", "mean", "each"), [(unordered(0.04, 400), 0.03, 0.08), (strip(0.04, 0.04, 16, 0), 0.03, 0.35)]
)
def test_bending_to_and_fro_makes_a_loop_as_wide_as_the_fabric_says(
    specimen: Specimen, mean: float, each: float
) -> None:
    """Kawabata's test in eight directions: to 2.5 /cm and back; the loop's width is read at 1 /cm.

    On a lattice of equal triangles it hangs on the direction, for all edges of one direction slip at once.
    """
    steps = np.linspace(0.0, 250.0, 26)
    path = np.concatenate([steps, steps[::-1][1:], -steps[1:], -steps[::-1][1:], steps[1:]])
    assert path[-16] == path[40] == 100.0 and path[50] == 0.0
    widths = []
    for angle in np.arange(8) * np.pi / 8:
        found = moments(specimen, COTTON, angle, path)
        widths.append(found[-16] - found[40])
        assert -found[50] == pytest.approx(0.5 * widths[-1], rel=0.1)  # on the way back, flat cloth is held bent
    assert np.mean(widths) == pytest.approx(HYSTERESIS, rel=mean)
    assert np.abs(np.array(widths) / HYSTERESIS - 1.0).max() < each


@pytest.mark.parametrize("knit", [False, True])
def test_shear_to_and_fro_makes_a_loop_as_wide_as_the_fabric_says(knit: bool) -> None:
    """Kawabata's test: to 8 deg and back to -8 deg; widths at 0.5 and 5 deg, slope from 0.5 to 2.5 deg."""
    steps = np.radians(np.arange(0.0, 8.25, 0.25))
    path = np.concatenate([steps, steps[::-1][1:], -steps[1:], -steps[::-1][1:], steps[1:]])
    found = shear_forces(unordered(0.04, 200), replace(SHEARED, **KNIT) if knit else SHEARED, path)
    back, forth = found[32:97], found[96:]  # from 8 deg to -8 deg and up again
    going = back[::-1]
    for degrees in (0.5, 2.5, 5.0, -0.5, -5.0):
        place = round((degrees + 8.0) / 0.25)
        assert forth[place] - going[place] == pytest.approx(RUBBED, rel=1e-3)
    slope = (forth[42] - forth[34]) / (np.sin(np.radians(2.5)) - np.sin(np.radians(0.5)))
    assert slope == pytest.approx(SHEARED.shear, rel=1e-3)
    # Before it slips the element adds its own stiffness to the cloth's.
    start = shear_forces(strip(0.04, 0.04, 8, 0), SHEARED, np.array([0.004, 0.005]))
    own = SHEARED.shear * np.sin([0.004, 0.005])
    assert start == pytest.approx(own + np.minimum(FRICTION_STIFFNESS * own, 0.5 * RUBBED), rel=1e-3)
    smooth = shear_forces(strip(0.04, 0.04, 8, 0), SMOOTH, path[:66])
    assert smooth == pytest.approx(SMOOTH.shear * np.sin(path[:66]), rel=1e-6)


def sheared_strip(fabric: Fabric, seconds: float) -> np.ndarray:
    """A strip clamped along one long side, sheared by 4 deg, and let go without weight; shear of its other side [-]."""
    specimen = strip(0.05, 0.1, 10, 0)
    x = specimen.flat[:, 0]
    heavy, model = (
        model_of(specimen, some, np.flatnonzero(x < 1e-9)) for some in (replace(fabric, areal_density=1e9), fabric)
    )
    state, solver = State.at_rest(heavy), Solver(heavy, replace(WEIGHTLESS, substep=1 / 60))
    far = x > 0.05 - 1e-9
    for angle in np.radians(np.linspace(0.0, 4.0, 20)):  # it is sheared slowly, so that friction follows
        state.position[:, 2] = level(specimen.flat)[:, 2] + np.sin(angle) * x - state.origin[2]
        state.velocity[:] = 0.0
        solver.step(state, Colliders(), 1 / 60)
    state.position[:, 3], state.velocity[:] = model.inverse_mass, 0.0
    found, solver = [], Solver(model, replace(WEIGHTLESS, substep=1 / 2400))
    for _ in range(round(seconds * 240)):
        solver.step(state, Colliders(), 1 / 240)
        found.append(float((state.world() - level(specimen.flat))[far, 2].mean() / 0.05))
    return np.array(found)


def test_what_was_sheared_comes_back_only_in_part() -> None:
    rubbed = sheared_strip(replace(SHEARED, shear_hysteresis=5.0), 0.5)
    smooth = sheared_strip(replace(SHEARED, shear_hysteresis=0.0), 0.5)
    # It comes to rest where the cloth and the element, which has slipped this far, pull as strongly.
    slipped = np.sin(np.radians(4.0)) - 2.5 / (FRICTION_STIFFNESS * SHEARED.shear)
    assert rubbed[60:] == pytest.approx(FRICTION_STIFFNESS / (1.0 + FRICTION_STIFFNESS) * slipped, rel=0.05)
    assert smooth.min() < -0.5 * np.radians(4.0)


def test_without_hysteresis_there_is_no_loop() -> None:
    path = np.array([0.0, 50.0, 100.0, 150.0, 100.0, 50.0, 0.0])
    found = moments(strip(0.04, 0.04, 16, 0), SMOOTH, 0.4, path)
    assert found[:3] == pytest.approx(found[:3:-1], rel=1e-6) and found[3] > found[2] > found[1] > 0.0


def test_the_share_of_friction_hardly_hangs_on_the_mesh() -> None:
    """Equilateral triangles: bends are cos^2 of the direction, half of the area's in the mean, three hinges a face."""
    for edges in (8, 16, 32):
        mesh = model_of(strip(0.1, 0.1, edges, 0), COTTON).mesh
        assert friction_share(mesh) == pytest.approx(2.0 / 3.0, rel=0.15)


def bent_strip(fabric: Fabric, seconds: float, curl: float = 60.0) -> list[float]:
    """A strip that is rolled up, held at one end and let go without weight; heights of its tip [m]."""
    specimen = strip(0.06, 0.02, 12, 1)
    held = np.flatnonzero(specimen.flat[:, 0] < 1e-9)
    model = model_of(specimen, fabric, held)
    state, solver = State.at_rest(model), Solver(model, replace(WEIGHTLESS, substep=1 / 2400, local_damping=0.0))
    tip = specimen.flat[:, 0] > 0.06 - 1e-9
    for target in np.linspace(0.0, curl, 30)[1:]:  # it is rolled slowly, so that friction follows
        state.position[:, :3] = rolled(specimen, target, 0.0) - state.origin
        state.position[held, :3] = level(specimen.flat)[held] - state.origin
        state.velocity[:] = 0.0
        solver.step(state, Colliders(), 1 / 2400)
    heights = []
    for _ in range(round(seconds * 240)):
        solver.step(state, Colliders(), 1 / 240)
        heights.append(float(state.world()[tip, 1].mean()))
    return heights


def test_what_was_bent_stays_bent_and_cloth_without_friction_does_not() -> None:
    creased, smooth = (np.array(bent_strip(fabric, 2.0)[240:]) for fabric in (COTTON, SMOOTH))
    assert creased.mean() > 0.01 and creased.min() > -0.002  # it swings about a bent shape
    assert smooth.min() < -0.03 and smooth.max() > 0.03  # this one to both sides
    assert creased.std() < 0.4 * smooth.std()  # and has lost of its swing what friction takes


@pytest.mark.parametrize(("fabric", "kind"), [(COTTON, "bend"), (SHEARED, "shear")])
def test_friction_is_kept_in_the_state_and_costs_nothing_where_there_is_none(
    fabric: Fabric, kind: str, tmp_path: Path
) -> None:
    models = [model_of(strip(0.06, 0.02, 12, 1), one) for one in (fabric, SMOOTH)]
    states = [State.at_rest(model) for model in models]
    counts = [model.plastic_count if kind == "bend" else model.plastic_shear_count for model in models]
    plastic, of_none = (getattr(state, f"plastic_{kind}s") for state in states)
    assert [len(plastic), len(of_none)] == counts == [counts[0] if kind == "bend" else len(models[0].triangles), 0]
    plastic[:] = 0.001
    assert counts[0] > 0 and states[0].hash() != State.at_rest(models[0]).hash()
    states[0].save(str(tmp_path / "a.npz"))
    assert State.load(str(tmp_path / "a.npz")).hash() == states[0].hash()
    refuses("state of another model", Solver(models[1]).step, states[0], Colliders(), 1 / 60)


@pytest.mark.parametrize("more", [(False, False), (True, False), (False, True), (True, True)])
def test_a_layer_shears_as_it_does_alone(more: tuple[bool, bool]) -> None:
    """Whichever of both stiffens, too: the rows of data of both kinds stand beside one another."""
    specimen = strip(0.06, 0.06, 6, 0)
    fabrics = [
        replace(fabric, **KNIT) if knit else fabric for fabric, knit in zip((SMOOTH, SHEARED), more, strict=True)
    ]
    free, rubs = (model_of(specimen, fabric) for fabric in fabrics)
    both = layered([free, rubs])
    assert len(both.triangle_data) == 13 + 4 * any(more)
    assert both.plastic_shear_count == 2 * len(rubs.triangles)
    assert np.array_equal(np.sort(both.triangle_numbers), np.arange(both.plastic_shear_count))
    state = State.at_rest(both, np.concatenate([free.mesh.vertices + [0, 0.1, 0], rubs.mesh.vertices]))
    alone = State.at_rest(rubs)
    for some in (state, alone):
        some.position[:, 0] -= 0.1 * some.position[:, 2]
    Solver(both, WEIGHTLESS).step(state, Colliders(), 1 / 60)
    Solver(rubs, WEIGHTLESS).step(alone, Colliders(), 1 / 60)
    count = len(rubs.triangles)
    assert np.abs(alone.plastic_shears).max() > 1e-3
    assert state.plastic_shears[count:] == pytest.approx(alone.plastic_shears, abs=1e-4)
    assert (state.position[len(free.mesh.vertices) :, 0] - alone.position[:, 0]) == pytest.approx(0.0, abs=1e-5)


def test_layers_keep_their_own_friction() -> None:
    """Beside a larger layer without friction, whose hinges have places of their own."""
    specimens = strip(0.06, 0.06, 12, 3), strip(0.06, 0.02, 12, 1)
    fabrics = SMOOTH, replace(COTTON, bend_hysteresis_warp=1e-4, bend_hysteresis_weft=1e-4)
    free, rubs = (model_of(specimen, fabric) for specimen, fabric in zip(specimens, fabrics, strict=True))
    both = layered([free, rubs, rubs])
    assert len(np.unique(both.hinge_numbers)) == len(both.hinges) > 2 * len(rubs.hinges) + rubs.plastic_count
    assert both.hinge_numbers.max() < both.plastic_count
    large, small = (rolled(specimen, 60.0, 0.0) for specimen in specimens)
    state = State.at_rest(both, np.concatenate([large + [0, 0.2, 0], small, small - [0, 0.2, 0]]))
    alone = State.at_rest(rubs, small)
    Solver(both, WEIGHTLESS).step(state, Colliders(), 1 / 60)
    Solver(rubs, WEIGHTLESS).step(alone, Colliders(), 1 / 60)
    assert np.abs(alone.plastic_bends).max() > 1e-4
    kept = state.plastic_bends[-2 * rubs.plastic_count :].reshape(2, -1)
    for layer in kept:
        assert layer == pytest.approx(alone.plastic_bends, abs=1e-6)
    assert not state.plastic_bends[: -2 * rubs.plastic_count].any()
