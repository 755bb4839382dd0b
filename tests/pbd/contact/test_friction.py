"""Friction and slopes: Coulomb's law to a fifth of a degree, and no creep."""

import numpy as np
import pytest

from pbd import Colliders, Fabric, Plane, Solver, SolverOptions, State
from tests.pbd.meshes import body_of, cloth, free_model, grid, icosphere, turn

THICKNESS = 0.003


class Incline:
    """A sheet that lies on a slope of atan(friction) + ``excess`` degrees: a plane, or the same plane as a body.

    Args:
        friction: Coulomb coefficient.
        excess: steeper than the angle of friction by [deg].
        body_edge: edge of the body's triangles [m]; None for the plane itself.
        place: distance from the origin [m].
    """

    def __init__(self, friction: float, excess: float, body_edge: float | None, place: float = 0.0) -> None:
        self.angle = np.arctan(friction) + np.radians(excess)
        rotation = turn((0.0, 0.0, 1.0), np.degrees(self.angle))
        self.down, self.normal = rotation @ [-1.0, 0.0, 0.0], rotation @ [0.0, 1.0, 0.0]
        vertices, faces = grid(6, 6, 0.033)
        lying = vertices[:, [1, 2, 0]] + [-0.1, THICKNESS, -0.1]
        start = lying @ rotation.T + [place, 0.0, 0.0]
        fabric = Fabric(friction=friction, thickness=THICKNESS, air_drag=0.0)
        self.model = free_model(cloth(start, faces, tuple(rotation[:, 0])), fabric)
        self.state = State.at_rest(self.model)
        self.start = self.state.world()
        self.colliders = Colliders([Plane((place, 0.0, 0.0), tuple(self.normal))])
        self.slope, self.body = np.zeros((0, 3)), None
        if body_edge is not None:
            slope, slope_faces = grid(round(0.5 / body_edge), round(1.2 / body_edge), body_edge)
            self.slope = (slope[:, [1, 2, 0]] - [0.8, 0.0, 0.25]) @ rotation.T + [place, 0.0, 0.0]
            self.body = body_of(self.slope, slope_faces, self.state)
            self.colliders = Colliders((), self.body)

    def slide(self, seconds: float, substeps: int) -> np.ndarray:
        """Way down the slope of each vertex [m], shape (n,)."""
        solver = Solver(self.model, SolverOptions(substep=1.0 / (60.0 * substeps)))
        for _ in range(round(60 * seconds)):
            solver.follow(self.state, self.colliders)
            if self.body is not None:
                self.body.advance((self.slope - self.state.origin).astype(np.float32))
            solver.step(self.state, self.colliders, 1 / 60)
        moved = self.state.world() - self.start
        assert np.abs(moved @ self.normal).max() < 0.02 * THICKNESS  # it stays on the slope
        return moved @ self.down


GROUNDS = [None, 0.03, 0.15]  # the plane, a fine body, a body whose triangles are larger than the cloth's


@pytest.mark.parametrize("body_edge", GROUNDS)
@pytest.mark.parametrize("substeps", [20, 80])
@pytest.mark.parametrize("friction", [0.1, 0.8])
def test_it_slips_above_the_angle_of_friction_and_holds_below(
    friction: float, substeps: int, body_edge: float | None
) -> None:
    assert np.abs(Incline(friction, -0.2, body_edge).slide(1.0, substeps)).max() < 1e-4
    steep = Incline(friction, 0.2, body_edge)
    way = steep.slide(1.0, substeps)
    acceleration = 9.81 * (np.sin(steep.angle) - friction * np.cos(steep.angle))
    assert way == pytest.approx(np.full(len(way), 0.5 * acceleration), rel=0.01)


@pytest.mark.parametrize("body_edge", GROUNDS)
@pytest.mark.parametrize("substeps", [10, 20, 80])
def test_no_creep(substeps: int, body_edge: float | None) -> None:
    """5 s, half a degree below the angle of friction, 8 m from the origin."""
    assert np.abs(Incline(0.4, -0.5, body_edge, place=8.0).slide(5.0, substeps)).max() < 1e-5


@pytest.mark.proof
@pytest.mark.parametrize("body_edge", GROUNDS)
def test_no_creep_in_a_minute(body_edge: float | None) -> None:
    assert np.abs(Incline(0.4, -1.0, body_edge, place=8.0).slide(60.0, 20)).max() < 1e-4


def test_without_friction_it_slides_as_it_falls() -> None:
    slope = Incline(1e-9, 20.0, None)
    law = 0.5 * 9.81 * np.sin(slope.angle)
    assert slope.slide(1.0, 20) == pytest.approx(np.full(49, law), rel=2e-3)


def test_edges_with_one_end_held_rub_like_the_others() -> None:
    """A row of cloth that lies on a rail with nothing but the middles of its edges, one end of each held."""
    vertices, faces = grid(4, 1, 0.05)
    vertices = vertices[:, [1, 2, 0]] + [0.0, THICKNESS, 0.3]
    soft = Fabric(stretch_warp=1.0, stretch_weft=1.0, shear=0.5, friction=0.8, thickness=THICKNESS)
    model = free_model(cloth(vertices, faces), soft, np.flatnonzero(vertices[:, 0] < 1e-9))
    state, solver = State.at_rest(model), Solver(model)
    rail, rail_faces = icosphere(4)
    body = body_of(rail * [0.01, 0.01, 2.0] + [0.025, -0.01, 0.4], rail_faces, state)
    for _ in range(120):
        solver.step(state, Colliders((), body), 1 / 60)
    free = vertices[:, 0] > 1e-9
    # What is held once had no memory of where it stood, and friction pushed the cloth about.
    assert np.abs((state.world() - vertices)[free]).max() < 2e-3


@pytest.mark.parametrize("pressure", [100.0, 1000.0, 5000.0])
def test_thickness_gives_way_to_pressure_by_van_wyks_law(pressure: float) -> None:
    """A sheet pressed onto a plate by its own weight in a strong field: T = T0 (1 + P/p_c)^(-1/3)."""
    fabric = Fabric(thickness=0.003, compression=2000.0, air_drag=0.0)
    vertices, faces = grid(6, 6, 0.01)
    model = free_model(cloth(vertices[:, [1, 2, 0]] + [0.0, fabric.thickness, 0.0], faces), fabric)
    state = State.at_rest(model)
    solver = Solver(model, SolverOptions(gravity=(0.0, -pressure / fabric.areal_density, 0.0)))
    for _ in range(30):
        solver.step(state, Colliders([Plane((0.0, 0.0, 0.0))]), 1.0 / 60.0)
        state.velocity *= np.float32(0.5)
    expected = 0.003 * (1.0 + pressure / 2000.0) ** (-1.0 / 3.0)
    assert state.position[:, 1] == pytest.approx(expected, rel=2e-4)
