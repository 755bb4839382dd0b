"""Pressure of the air behind the cloth."""

from dataclasses import replace

import numpy as np
import pytest

from pbd import Fabric, ModelOptions, State, build_model
from pbd.layers import layered
from tests.pbd.meshes import cloth, icosphere, run, turn

BALLOON = Fabric(stretch_warp=100.0, stretch_weft=100.0, poisson=0.3, shear=100.0 / 2.6, air_drag=0.0)


def blown_up(pressure: float, radius: float = 0.2) -> tuple:
    vertices, faces = icosphere(3, radius)
    options = ModelOptions(tether_slack=0.0, pressure=pressure)
    mesh = cloth(vertices, faces)
    model = build_model(mesh, BALLOON, options=options, bend_factor=1 / 3)
    return model, State.at_rest(model, vertices @ turn((1.0, 0.0, 2.0), 30.0).T)


@pytest.mark.parametrize("pressure", [10.0, 30.0])
def test_a_balloon_is_stretched_as_laplace_says(pressure: float) -> None:
    """N = p r/2 in both directions, strain N (1 - nu)/(E h), on the sphere's stretched radius."""
    model, state = blown_up(pressure)
    before = np.linalg.norm(state.world(), axis=1).mean()
    run(model, state, 90, substeps=120, gravity=0.0, keep=0.9)
    centre = state.world().mean(axis=0)
    radius = np.linalg.norm(state.world() - centre, axis=1).mean()
    strain = 0.5 * pressure * radius * (1.0 - BALLOON.poisson) / BALLOON.stretch_warp
    assert radius / before - 1.0 == pytest.approx(strain, rel=0.03)
    assert np.linalg.norm(centre) < 1e-4  # a closed surface does not push itself away
    assert np.abs(state.velocity).max() < 1e-2


def test_layers_keep_their_own_pressure() -> None:
    models = [blown_up(pressure, radius)[0] for pressure, radius in ((0.0, 0.1), (20.0, 0.4))]
    both = layered(models)
    state = State.at_rest(both)
    run(both, state, 30, gravity=0.0, keep=0.9)
    sizes = [np.linalg.norm(part, axis=1).mean() for part in np.split(state.world(), [models[0].vertex_count])]
    starts = [np.linalg.norm(model.mesh.vertices, axis=1).mean() for model in models]
    assert sizes[0] == pytest.approx(starts[0], rel=1e-4)
    assert sizes[1] > 1.01 * starts[1]
    plain = [replace(model, pressure=models[0].pressure) for model in models]
    assert len(layered(plain).pressure) == 0
