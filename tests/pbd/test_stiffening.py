"""Stiffening in tension in the default solver: hanging cloth, energy, layers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from pbd import Colliders, Fabric, Model, ModelOptions, Solver, SolverOptions, State, build_model
from pbd.fabric import stiffening_stress
from pbd.layers import layered
from pbd.mesh import ClothMesh
from pbd.models.elements import Sum
from pbd.models.membrane import continuum_membrane
from precompute.experiment.sheets import level
from precompute.validation.trial import Trial, TrialSetting, strip

# At 20 % it bears six times the tension of a straight line.
KNIT = Fabric(
    0.2, 20.0, 20.0, 0.0, 10.0, 1e-6, 1e-6, air_drag=0.0, stiffening_warp_10=3.0, stiffening_warp_20=6.0,
    stiffening_weft_10=2.0, stiffening_weft_20=4.0,
)  # fmt: skip
STRAIGHT = replace(KNIT, **{f"stiffening_{axis}_{e}": 1.0 for axis in ("warp", "weft") for e in (10, 20)})


def model_of(fabric: Fabric, height: float = 0.0) -> Model:
    specimen = strip(0.3, 0.1, 9, 0)
    held = np.flatnonzero(specimen.flat[:, 0] < 1e-9)
    start = level(specimen.flat) + [0.0, height, 0.0]
    mesh = ClothMesh.from_pattern(start, specimen.faces, specimen.flat[specimen.faces])
    return build_model(mesh, fabric, held, options=ModelOptions(tether_slack=0.0), bend_factor=1 / 3)


def test_a_hanging_knit_is_as_long_as_its_curve_says() -> None:
    """Its tip: the sum of the strains at which E h (e + s(e)) bears what hangs below; 14 % where the cloth is held."""
    length = 1.0
    specimen = strip(length, 0.2, 20, clamp=0)
    x = specimen.flat[:, 0]
    start = np.stack([specimen.flat[:, 1], -x, np.zeros_like(x)], axis=1)
    trial = Trial(specimen, start, KNIT, x < 1e-9, TrialSetting(substeps=96))
    trial.settle(np.sqrt(length / 9.81), still=1e-5)
    law = KNIT.stiffening()[0]
    tension = lambda e: KNIT.stretch_warp * (e + stiffening_stress(np.array(e), law)[1])  # noqa: E731
    below = KNIT.areal_density * 9.81 * (length - (np.arange(50) + 0.5) / 50)
    exact = np.mean([brentq(lambda e, load=load: tension(e) - load, 0.0, 1.0) for load in below])
    found = (start[:, 1] - trial.world()[:, 1])[x > length - 1e-9].mean() / length
    assert exact < 0.8 * 0.5 * KNIT.areal_density * 9.81 * length / KNIT.stretch_warp  # of a straight line
    assert found == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("substeps", [4, 48])
def test_a_knit_that_is_let_go_gains_no_energy(substeps: int) -> None:
    """Stretched by 18 %, without weight; elastic and kinetic energy over ten swings."""
    model = model_of(KNIT)
    state = State.at_rest(model, model.mesh.vertices * [1.18, 1.0, 1.0])
    solver = Solver(model, SolverOptions(substep=1 / (60 * substeps), gravity=(0.0, 0.0, 0.0), local_damping=0.0))
    elastic = Sum([continuum_membrane(model.mesh, KNIT, "corotational")])
    energies = [elastic.energy(state.world())]
    for _ in range(60):
        solver.step(state, Colliders(), 1 / 60)
        motion = 0.5 * float(model.mass @ (state.velocity.astype(float) ** 2).sum(axis=1))
        energies.append(elastic.energy(state.world()) + motion)
    assert max(energies) < 1.02 * energies[0]


def test_a_layer_stiffens_as_it_does_alone() -> None:
    """To rounding, beside a layer that does not stiffen."""
    options = SolverOptions(coarse_sweeps=0)
    models = [model_of(KNIT), model_of(STRAIGHT, 1.0)]
    alone, both = [State.at_rest(model) for model in models], layered(models)
    assert both.triangle_data.shape[0] == models[0].triangle_data.shape[0] > models[1].triangle_data.shape[0]
    solver, layers = Solver(both, options), State.at_rest(both)
    solvers = [Solver(model, options) for model in models]
    for _ in range(20):
        solver.step(layers, Colliders(), 1 / 60)
        for one, state in zip(solvers, alone, strict=True):
            one.step(state, Colliders(), 1 / 60)
    apart = np.concatenate([state.world() for state in alone])
    assert np.abs(layers.world() - apart).max() < 1e-4
    assert np.abs(alone[0].world() - (alone[1].world() - [0.0, 1.0, 0.0])).max() > 1e-3
