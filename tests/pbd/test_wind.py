"""Turbulent wind, and air of another velocity at each vertex."""

import numpy as np
import pytest

from pbd import Colliders, Fabric, Solver, SolverOptions, State
from pbd.wind import Wind
from tests.pbd.meshes import cloth, free_model, grid
from tests.refusals import refuses

POINTS = np.random.default_rng(0).uniform(0.0, 40.0, (20_000, 3))


def test_eddies_have_the_speed_that_was_asked_for() -> None:
    wind = Wind((6.0, 0.0, 8.0), turbulence=0.2, length=2.0)
    eddies = wind.at(POINTS, 3.0) - wind.velocity
    assert np.abs(eddies.mean(axis=0)).max() < 0.1
    assert np.sqrt((eddies**2).mean()) == pytest.approx(2.0, rel=0.03)  # of all three components together
    assert np.sqrt((eddies**2).mean(axis=0)) == pytest.approx(2.0, rel=0.25)


def test_the_flow_has_no_divergence() -> None:
    wind, step = Wind((5.0, 0.0, 0.0), turbulence=0.3), 1e-4
    slopes = [wind.at(POINTS[:50] + step * axis, 1.0) - wind.at(POINTS[:50] - step * axis, 1.0) for axis in np.eye(3)]
    divergence = sum(slope[:, c] for c, slope in enumerate(slopes)) / (2 * step)
    assert np.abs(divergence).max() < 1e-4 * np.abs(slopes).max() / (2 * step)


def test_eddies_go_with_the_wind() -> None:
    wind = Wind((5.0, 1.0, 0.0), turbulence=0.1)
    here, later = wind.at(POINTS, 0.0), wind.at(POINTS + 0.02 * np.array(wind.velocity), 0.02)
    stayed = wind.at(POINTS, 0.02)
    off = [np.sqrt(((a - here) ** 2).mean()) for a in (later, stayed)]
    assert off[0] < 0.2 * off[1]


def test_without_turbulence_it_is_uniform() -> None:
    wind = Wind((5.0, 1.0, 0.0), gust=(0.0, 0.0, 2.0))
    assert wind.at(POINTS, 7.0).tolist() == [5.0, 1.0, 2.0]


def test_each_vertex_feels_its_own_air() -> None:
    vertices, faces = grid(6, 6, 0.05)
    model = free_model(cloth(vertices, faces), Fabric())
    state = State.at_rest(model)
    air = np.where(vertices[:, :1] < 0.14, [0.0, 0.0, 4.0], [0.0, 0.0, -4.0])
    Solver(model, SolverOptions(gravity=(0.0, 0.0, 0.0))).step(state, Colliders(), 1 / 60, wind=air)
    assert (state.velocity[vertices[:, 0] < 0.05, 2] > 0.1).all()
    assert (state.velocity[vertices[:, 0] > 0.25, 2] < -0.1).all()
    refuses(r"wind.*\(49, 3\)", Solver(model).step, state, Colliders(), 1 / 60, wind=air[:5])


@pytest.mark.parametrize(
    "values",
    [{"velocity": (1.0, np.inf, 0.0)}, {"turbulence": -0.1}, {"length": 0.0}, {"gust": (1.0, 2.0)}],
)
def test_bad_wind(values: dict) -> None:
    refuses(next(iter(values)), Wind, **{"velocity": (1.0, 0.0, 0.0)} | values)
