"""Garments in layers: one model of several, and which lies outside."""

from dataclasses import replace

import numpy as np
import pytest

from pbd import Colliders, Fabric, Limits, ModelOptions, Solver, SolverOptions, Sphere, State, build_model
from pbd.crossings import crossings
from pbd.distance import BodyDistance
from pbd.layers import layered, parts_of
from pbd.mesh import hinges_of
from tests.pbd.meshes import body_of, cloth, free_model, icosphere, level
from tests.refusals import refuses


def step(model, state: State, frames: int, colliders: Colliders) -> None:
    solver = Solver(model, SolverOptions(coarse_sweeps=0))
    for _ in range(frames):
        solver.follow(state, colliders)
        solver.step(state, colliders, 1 / 60)


def test_garments_that_never_meet_move_as_they_do_alone() -> None:
    fabrics = Fabric(), Fabric(areal_density=0.3, stretch_warp=800.0, bend_warp=4e-5)
    placed = level(6, 6, 0.04, 0.0), level(5, 5, 0.05, 0.5)
    models = [
        free_model(cloth(*sheet), fabric, np.array([0, 3])) for sheet, fabric in zip(placed, fabrics, strict=True)
    ]
    both = layered(models)
    assert both.layer.tolist() == [0] * 49 + [1] * 36
    assert both.held.tolist() == [0, 3, 49, 52]
    together = State.at_rest(both)
    step(both, together, 20, Colliders())
    start = 0
    for model in models:
        alone = State.at_rest(model)
        step(model, alone, 20, Colliders())
        end = start + model.vertex_count
        assert np.abs(together.world()[start:end] - alone.world()).max() < 1e-4
        start = end


@pytest.mark.parametrize("gap", [0.004, -0.004])
def test_the_outer_garment_ends_outside_even_if_it_starts_inside(gap: float) -> None:
    inner, outer = (free_model(cloth(*level(14, 14, 0.02, y)), Fabric(friction=0.3)) for y in (0.31, 0.31 + gap))
    model, colliders = layered([inner, outer]), Colliders([Sphere((0.0, 0.0, 0.0), 0.3)])
    state = State.at_rest(model)
    if gap < 0:
        colliders = Colliders()
    step(model, state, 18, colliders)
    world = state.world()
    assert len(crossings(world, model.mesh.faces)) == 0
    assert np.mean(world[225:, 1] - world[:225, 1]) > 0.002


def test_the_numbering_of_the_vertices_does_not_matter() -> None:
    """Vertices of both garments in turn, as a subdivided outfit has them, with limits and stitches of both."""
    placed = [cloth(*level(6, 6, 0.04, y)) for y in (0.0, 0.02)]
    sewn = [
        replace(sheet, stitches=np.array([[0, 5, 6]], np.int32), stitch_weights=np.array([0.5])) for sheet in placed
    ]
    limits = Limits([3, 8], [0.05, 0.02], [1e6, 0.01], [0.0, 300.0])
    fabrics = Fabric(), Fabric(areal_density=0.3, stretch_warp=800.0, bend_warp=4e-5)
    models = [
        build_model(sheet, fabric, np.array([2, 40]), bend_factor=1 / 3, limits=limits)
        for sheet, fabric in zip(sewn, fabrics, strict=True)
    ]
    count = models[0].vertex_count
    numbers = [np.arange(count) * 2, np.arange(count) * 2 + 1]
    in_turn, plain = layered(models, numbers), layered(models)
    assert in_turn.held.tolist() == [4, 5, 80, 81] and in_turn.limits.vertices.tolist() == [6, 7, 16, 17]
    assert in_turn.layer.tolist() == [0, 1] * count
    for (part, vertices), sheet, number in zip(parts_of(in_turn.mesh, in_turn.layer), sewn, numbers, strict=True):
        np.testing.assert_array_equal(vertices, number)
        for name in ("vertices", "faces", "flat", "stitches", "stitch_weights"):
            np.testing.assert_array_equal(getattr(part, name), getattr(sheet, name))
    states = [State.at_rest(model) for model in (plain, in_turn)]
    for model, state in zip((plain, in_turn), states, strict=True):
        step(model, state, 10, Colliders([Sphere((0.0, -0.31, 0.0), 0.3)]))
    for half, number in zip(np.split(states[0].world(), 2), numbers, strict=True):
        assert np.abs(states[1].world()[number] - half).max() < 1e-3


def test_a_part_keeps_its_rest_shape_and_its_seams() -> None:
    sheets = [cloth(*level(4, 4, 0.05, y)) for y in (0.0, 0.1)]
    mesh = layered([free_model(sheet, Fabric()) for sheet in sheets]).mesh
    hinges = hinges_of(mesh.faces)
    bends = np.arange(len(hinges)) * 1e-4
    marked = replace(mesh, rest_bends=bends, max_stretch=np.linspace(1.01, 1.2, len(mesh.faces)))
    layer = np.repeat([0, 1], 25)
    (first, _), (second, vertices) = parts_of(marked, layer)
    assert first.rest_bends is not None and second.rest_bends is not None and second.max_stretch is not None
    np.testing.assert_array_equal(np.concatenate([first.rest_bends, second.rest_bends]), bends)
    np.testing.assert_array_equal(hinges_of(second.faces), hinges[len(first.rest_bends) :] - vertices[0])
    np.testing.assert_array_equal(second.max_stretch, np.linspace(1.01, 1.2, len(mesh.faces))[len(mesh.faces) // 2 :])


def test_layers_share_momentum() -> None:
    inner, outer = (free_model(cloth(*level(8, 8, 0.02, y)), Fabric(air_drag=0.0)) for y in (0.0, 0.01))
    model = layered([inner, outer])
    state = State.at_rest(model)
    state.velocity[81:, 1] = -1.0
    solver = Solver(model, SolverOptions(gravity=(0.0, 0.0, 0.0), coarse_sweeps=0))
    before = (model.mass[:, None] * state.velocity).sum(axis=0)
    for _ in range(10):
        solver.step(state, Colliders(), 1 / 60)
    after = (model.mass[:, None] * state.velocity).sum(axis=0)
    assert state.velocity[:81, 1].mean() < -0.2
    assert np.abs(after - before).max() < 1e-5 * np.abs(before).max()


def test_layers_that_differ_where_they_must_not_are_refused() -> None:
    sheet = cloth(*level(3, 3, 0.05, 0.0))
    soft = build_model(sheet, Fabric(), options=ModelOptions(compression_compliance_scale=4.0), bend_factor=1 / 3)
    refuses("compression_compliance_scale", layered, [soft, free_model(sheet, Fabric())])
    refuses("no garment", layered, [])


def test_what_lies_on_a_layer_does_not_push_it_into_the_body() -> None:
    """A light layer under one of two hundred times its weight, on a ball of triangles."""
    light, heavy = Fabric(areal_density=0.05), Fabric(areal_density=10.0)
    placed = (0.105, light), (0.11, heavy)
    model = layered([free_model(cloth(*level(12, 12, 0.02, y)), fabric) for y, fabric in placed])
    ball, faces = icosphere(3)
    state, deepest = State.at_rest(model), 0.0
    body = body_of(0.1 * ball, faces, state)
    solver, distance = Solver(model, SolverOptions(coarse_sweeps=0)), BodyDistance(faces)
    for _ in range(60):
        solver.follow(state, Colliders(body=body))
        solver.step(state, Colliders(body=body), 1 / 60)
        deepest = min(deepest, float(distance.signed_distance(state.world(), 0.1 * ball).min()))
    assert deepest > -5e-5
