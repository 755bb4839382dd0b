"""Stitches between panels: they pull them together, keep momentum and then carry like whole cloth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbd import ClothMesh, Colliders, Fabric, InputError, Solver, SolverOptions, State
from tests.assets.panels import two_panels
from tests.pbd.meshes import cloth, free_model, grid, run


def sewn(vertices: np.ndarray, faces: np.ndarray, seams) -> ClothMesh:
    return replace(cloth(vertices, faces), stitches=seams.vertices, stitch_weights=seams.weights)


def gaps(mesh: ClothMesh, positions: np.ndarray) -> np.ndarray:
    (v, a, b), w = mesh.stitches.T, mesh.stitch_weights[:, None]
    return np.linalg.norm(positions[v] - (1.0 - w) * positions[a] - w * positions[b], axis=1)


@pytest.mark.parametrize("second", [6, 4])
def test_panels_that_were_pulled_apart_come_together(second: int) -> None:
    vertices, faces, seams = two_panels(second=second)
    mesh = sewn(vertices, faces, seams)
    model = free_model(mesh, Fabric(air_drag=0.0))
    apart = vertices + np.where(vertices[:, :1] > 0.24 - 1e-9, 0.02, 0.0) * [1.0, 0.5, 1.0]
    apart[: len(apart) - 7 * (second + 1)] = vertices[: len(apart) - 7 * (second + 1)]
    state = State.at_rest(model, apart)
    assert gaps(mesh, state.world()).min() > 0.02
    run(model, state, 5, gravity=0.0, keep=0.7)
    assert gaps(mesh, state.world()).max() < 2e-4
    momentum = (model.mass[:, None] * state.velocity).sum(axis=0)
    assert np.abs(momentum).max() < 1e-5 * model.mass.sum()


def test_a_stitched_strip_hangs_as_a_whole_one() -> None:
    """Hung by one end, it is longer by its own weight; the seam passes the pull on without giving."""
    fabric = Fabric(areal_density=0.5, stretch_warp=60.0, stretch_weft=60.0, air_drag=0.0)
    lengths = []
    for stitched in (True, False):
        if stitched:
            vertices, faces, seams = two_panels(6, 6, 4)
            mesh = sewn(vertices[:, [1, 0, 2]] * [1, -1, 1], faces, seams)
        else:
            vertices, faces = grid(12, 6, 0.04)
            mesh = cloth(vertices[:, [1, 0, 2]] * [1, -1, 1], faces)
        held = np.flatnonzero(mesh.vertices[:, 1] > -1e-9)
        model = free_model(mesh, fabric, held)
        state = State.at_rest(model)
        run(model, state, 90, substeps=40, keep=0.8)
        low = mesh.vertices[:, 1] < mesh.vertices[:, 1].min() + 1e-9
        lengths.append(-state.world()[low, 1].mean())
        if stitched:
            assert gaps(mesh, state.world()).max() < 1e-4
    assert lengths[1] > 0.48 * 1.01  # or nothing is shown
    assert lengths[0] - 0.48 == pytest.approx(lengths[1] - 0.48, rel=0.03)


def test_stitches_of_vertices_that_do_not_exist_are_refused() -> None:
    vertices, faces, seams = two_panels()
    mesh = sewn(vertices, faces, seams)
    with pytest.raises(InputError, match=r"stitches.*received 999"):
        replace(mesh, stitches=np.array([[0, 1, 999]], np.int32), stitch_weights=np.array([0.5]))


def test_what_is_sewn_together_shares_its_mass() -> None:
    vertices, faces, seams = two_panels(6, 6, 4)
    mesh = sewn(vertices, faces, seams)
    apart, model = (free_model(one, Fabric()) for one in (cloth(vertices, faces), mesh))
    assert model.mass.sum() == pytest.approx(apart.mass.sum(), rel=1e-12)
    sewn_up = np.unique(mesh.stitches)
    assert model.mass[sewn_up].min() > 1.2 * apart.mass[sewn_up].min()  # corners
    far = np.setdiff1d(np.arange(len(vertices)), mesh.stitches)
    assert np.array_equal(model.mass[far], apart.mass[far])
    (v, a, b), w = mesh.stitches.T, mesh.stitch_weights
    off = [np.abs(one.mass[v] - (1.0 - w) * one.mass[a] - w * one.mass[b]).sum() for one in (apart, model)]
    assert off[1] < 0.5 * off[0]


def test_a_vertex_that_is_sewn_to_several_panels_holds_them_all() -> None:
    """Three strips sewn to one held one at the same line, and pulled apart by the wind."""
    vertices, faces = grid(4, 4, 0.05)
    count, strips = len(vertices), [vertices + [0.2 * (k > 0), 0.0, 0.0] for k in range(4)]
    end, start = np.flatnonzero(vertices[:, 0] > 0.19), np.flatnonzero(vertices[:, 0] < 0.01)
    stitches = [
        (s + k * count, e + j * count, e + j * count + 1)
        for k, j in ((1, 0), (2, 0), (3, 0))
        for s, e in zip(start[:-1].tolist(), end[:-1].tolist(), strict=True)
    ]
    stitches += [(s + 1 * count, s + 2 * count, s + 2 * count + 1) for s in start[:-1].tolist()]
    mesh = replace(
        cloth(np.concatenate(strips), np.concatenate([faces + k * count for k in range(4)])),
        stitches=np.array(stitches, np.int32),
        stitch_weights=np.zeros(len(stitches)),
    )
    model = free_model(mesh, Fabric(), np.flatnonzero(mesh.vertices[:, 0] < 0.01)[:5])
    state, air = State.at_rest(model), np.zeros((4 * count, 3))
    for k, blow in ((1, 15.0), (2, -15.0)):
        air[k * count : (k + 1) * count, 2] = blow
    solver = Solver(model)
    for _ in range(60):
        solver.step(state, Colliders(), 1 / 60, wind=air)
    assert np.ptp(state.world()[:, 2]) > 0.2
    assert gaps(mesh, state.world()).max() < 1e-3


def test_open_stitches_close_as_they_are_told_to() -> None:
    vertices, faces, seams = two_panels()
    model = free_model(sewn(vertices, faces, seams), Fabric(air_drag=0.0))
    apart = vertices.copy()
    apart[49:, 0] += 0.1  # the second panel
    state, solver = State.at_rest(model, apart), Solver(model, SolverOptions(gravity=(0.0, 0.0, 0.0)))
    (v, a, b), w = model.stitches.T, model.stitch_weights[:, None]

    def widest() -> float:
        x = state.world()
        return float(np.linalg.norm(x[v] - (1.0 - w) * x[a] - w * x[b], axis=1).max())

    assert widest() == pytest.approx(0.1)
    for before, after in ((0.2, 0.15), (0.15, 0.11)):  # wider than they are open: nothing moves
        solver.step(state, Colliders(), 1 / 60, stitch_gaps=(np.full(len(v), before), np.full(len(v), after)))
    assert widest() == pytest.approx(0.1, abs=1e-5)
    for before, after in zip(np.linspace(0.1, 0.02, 9)[:-1], np.linspace(0.1, 0.02, 9)[1:], strict=True):
        solver.step(state, Colliders(), 1 / 60, stitch_gaps=(np.full(len(v), before), np.full(len(v), after)))
        assert widest() < after + 5e-4
    assert widest() > 0.01
    for _ in range(10):
        solver.step(state, Colliders(), 1 / 60)
    assert widest() < 5e-4
