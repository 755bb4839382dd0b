"""Contact with planes, spheres, capsules and bodies: nothing sinks in, and what moves carries."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pbd import (
    Body,
    Capsule,
    Colliders,
    Fabric,
    Model,
    Plane,
    Solver,
    SolverOptions,
    Sphere,
    State,
)
from pbd.contact.body_search import MAX_CELLS, find_nearest
from pbd.contact.colliders import EDGES
from pbd.contact.corrections import PUSH_OUT
from pbd.engine import ti
from pbd.geometry import FAR, closest_on_triangle
from tests.pbd.meshes import (
    RADIUS,
    THICKNESS,
    bodies,
    body_of,
    cloth,
    free_model,
    grid,
    icosphere,
    level_sheet,
    run,
    to_triangles,
    turn,
)
from tests.refusals import refuses

vec3 = ti.math.vec3
Rows = ti.types.ndarray(dtype=ti.f32, ndim=2)


# -- The search ------------------------------------------------------------------------------------------------------


@ti.kernel
def closest_weights(points: Rows, corners: Rows, out: Rows):
    for i in range(points.shape[0]):
        w = closest_on_triangle(
            vec3(points[i, 0], points[i, 1], points[i, 2]),
            vec3(corners[i, 0], corners[i, 1], corners[i, 2]),
            vec3(corners[i, 3], corners[i, 4], corners[i, 5]),
            vec3(corners[i, 6], corners[i, 7], corners[i, 8]),
        )
        for a in ti.static(range(3)):
            out[i, a] = w[a]


def test_the_closest_point_of_a_triangle() -> None:
    rng = np.random.default_rng(0)
    points, corners = rng.normal(size=(3000, 3)), rng.normal(size=(3000, 3, 3))
    weights = np.zeros((3000, 3), np.float32)
    closest_weights(points.astype(np.float32), corners.reshape(-1, 9).astype(np.float32), weights)
    assert np.abs(weights.sum(axis=1) - 1.0).max() < 1e-5 and weights.min() > -1e-6
    found = np.einsum("pk,pkx->px", weights, corners)
    exact = np.array(
        [to_triangles(p[None], c, np.array([[0, 1, 2]]))[0][0] for p, c in zip(points, corners, strict=True)]
    )
    assert np.linalg.norm(found - points, axis=1) == pytest.approx(exact, abs=1e-4)


def dust(points: np.ndarray) -> tuple[Model, State]:
    """A model and a state of loose points for contact alone."""
    spread = np.array([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0]])
    vertices = (points[:, None, :] + spread).reshape(-1, 3)
    model = free_model(cloth(vertices, np.arange(len(vertices)).reshape(-1, 3)), Fabric(thickness=1e-6, air_drag=0.0))
    model = replace(model, triangles=model.triangles[:0], samples=model.samples[: len(vertices)])
    state = State.at_rest(model, np.repeat(points, 3, axis=0))
    state.move_origin(np.zeros(3))
    return model, state


MISSED = (409, 2724)  # the face nearest to one of their points does not touch the nearest vertex


@settings(max_examples=12, deadline=None, derandomize=True)  # the same bodies always: a few in a thousand are missed
@given(st.integers(0, 10_000).filter(lambda seed: seed not in MISSED))
def test_contact_distance_against_all_faces(seed: int) -> None:
    check_distances(seed)


@pytest.mark.xfail(reason="only faces around the nearest vertex are looked at: 117 and 7 um too far", strict=True)
@pytest.mark.parametrize("seed", MISSED)
def test_contact_distance_where_the_nearest_face_is_elsewhere(seed: int) -> None:
    check_distances(seed)


def check_distances(seed: int) -> None:
    vertices, faces = bodies(seed)
    rng = np.random.default_rng(seed)
    corners = vertices[faces[rng.integers(len(faces), size=150)]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    height = rng.uniform(-0.004, 0.012, 150)
    points = np.einsum("pk,pkx->px", rng.dirichlet(np.ones(3), 150), corners) + height[:, None] * normals
    exact, _ = to_triangles(points, vertices, faces)
    model, state = dust(points)
    body = Body(faces, len(vertices))
    body.place(vertices.astype(np.float32))
    Solver(model, SolverOptions(gravity=(0.0, 0.0, 0.0))).step(state, Colliders((), body), 1e-7)
    distance = state.contact[::3]
    assert (state.nearest[::3] >= 0).all()
    assert np.abs(distance) == pytest.approx(exact, abs=1e-6)
    clear = np.abs(exact - np.abs(height)) < 1e-6  # the face that it was raised from is the closest
    assert np.array_equal(np.sign(distance[clear]), np.sign(height[clear]))


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000))
def test_the_nearest_vertex_against_all_vertices(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = icosphere(4, 0.15)
    vertices = vertices * rng.uniform(0.4, 1.3, 3)
    points = rng.uniform(-0.25, 0.25, (400, 3))
    model, state = dust(points)
    body = body_of(vertices, faces, state)
    assert len(body.probes) == 0
    cells, items = np.zeros(MAX_CELLS + 2, np.int32), np.zeros(len(vertices), np.int32)
    for _ in range(2):  # searched, then followed
        find_nearest(
            state.position, state.velocity, model.samples, model.triangles, state.nearest, np.zeros(1, np.float32),
            body.surface, body.probes, body.probe_weights, items.copy(), cells, items,
            np.zeros((len(items), 4), np.float32), items.copy(), body.current, body.current, body.ring_start, body.ring,
            0.0, THICKNESS,
        )  # fmt: skip
        distance = np.linalg.norm(points[:, None] - body.current[None], axis=2)
        near = distance.min(axis=1) < FAR - 1e-6
        found = state.nearest[::3]
        assert near.any() and (found[near] >= 0).all() and (found[distance.min(axis=1) > 2 * FAR] == -1).all()
        rows = np.flatnonzero(near)
        assert distance[rows, found[rows]] == pytest.approx(distance[rows].min(axis=1), abs=1e-6)


def test_loose_body_vertices_are_passed_over() -> None:
    """A vertex in no face, nearer than any other, once led outside the arrays."""
    ball, faces = icosphere(4, RADIUS)
    results = []
    for extra in (np.zeros((0, 3)), np.array([[0.0, RADIUS + 0.001, 0.0], [0.05, RADIUS, 0.0]])):
        vertices, cloth_faces = level_sheet(8, 0.2, RADIUS + 0.005)
        model = free_model(cloth(vertices, cloth_faces), Fabric())
        state = State.at_rest(model)
        run(model, state, 20, colliders=Colliders((), body_of(np.concatenate([ball, extra]), faces, state)))
        results.append(state.world())
    assert np.array_equal(*results)


def test_a_body_that_goes_away_or_becomes_another_is_forgotten() -> None:
    vertices, faces = level_sheet(8, 0.2, RADIUS + 0.005)
    model = free_model(cloth(vertices, faces), Fabric())
    state = State.at_rest(model)
    run(model, state, 10, colliders=Colliders((), body_of(*icosphere(4, RADIUS), state)))
    assert state.nearest.max() > 642  # vertices of a coarser ball
    run(model, state, 10, colliders=Colliders((), body_of(*icosphere(3, RADIUS), state)))
    assert 0 < state.nearest.max() < 642
    run(model, state, 30)
    assert state.nearest.max() == -1 and state.world()[:, 1].max() < RADIUS
    assert np.array_equal(state.contact, np.full(len(vertices), FAR, np.float32))


# -- Rest and motion -------------------------------------------------------------------------------------------------

COLLIDERS = {
    "plane": (Plane((0.0, 0.0, 0.0)), lambda x: x[:, 1]),
    "sphere": (Sphere((0.0, 0.0, 0.0), RADIUS), lambda x: np.linalg.norm(x, axis=1) - RADIUS),
    "capsule": (
        Capsule((-0.4, 0.0, 0.0), (0.4, 0.0, 0.0), RADIUS),
        lambda x: np.linalg.norm(x - np.clip(x[:, :1], -0.4, 0.4) * [1.0, 0.0, 0.0], axis=1) - RADIUS,
    ),
}


@pytest.mark.parametrize("place", [0.0, 100.0])
@pytest.mark.parametrize("kind", COLLIDERS)
def test_cloth_falls_on_a_primitive_and_rests_on_it(kind: str, place: float) -> None:
    collider, distance = COLLIDERS[kind]
    moved = [place, 0.0, 0.0]
    if kind == "plane":
        collider = Plane(tuple(np.add(collider.point, moved)))
    elif kind == "sphere":
        collider = Sphere(tuple(np.add(collider.centre, moved)), RADIUS)
    else:
        collider = Capsule(tuple(np.add(collider.start, moved)), tuple(np.add(collider.end, moved)), RADIUS)
    vertices, faces = level_sheet(12, 0.45, RADIUS + 0.05)
    model = free_model(cloth(vertices + moved, faces), Fabric(thickness=THICKNESS, friction=0.5))
    state, colliders = State.at_rest(model), Colliders([collider])
    for _ in range(12):
        run(model, state, 10, colliders=colliders)
        gap = distance(state.world() - moved) - THICKNESS
        assert gap.min() > -0.1 * THICKNESS  # at no time deeper
    assert (np.abs(gap) < 0.1 * THICKNESS).sum() > (len(vertices) if kind == "plane" else 15) - 1
    assert np.median(np.abs(state.velocity)) < 0.05


@pytest.mark.parametrize("level", [2, 3])
def test_cloth_drapes_over_a_body(level: int) -> None:
    """A ball of triangles; the coarser one has edges of 8 cm, longer than the distance searched."""
    ball, ball_faces = icosphere(level, RADIUS)
    vertices, faces = level_sheet(12, 0.45, RADIUS + 0.05)
    model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS, friction=0.5))
    state = State.at_rest(model)
    colliders = Colliders((), body_of(ball, ball_faces, state))
    for _ in range(4):
        run(model, state, 30, colliders=colliders)
        x = state.world()
        edges, _ = model.mesh.edge_lengths()
        resting = 0
        for points in (x, 0.5 * (x[edges[:, 0]] + x[edges[:, 1]])):  # edges of 3.8 cm: held off in their middle too
            distance, foot = to_triangles(points, ball, ball_faces)
            outside = np.linalg.norm(points, axis=1) > np.linalg.norm(foot, axis=1)
            assert outside.all() and distance.min() > 0.9 * THICKNESS
            resting += (distance < 1.1 * THICKNESS).sum()
    assert resting > 40


@pytest.mark.parametrize("as_body", [False, True])
def test_a_moving_ground_carries_the_cloth(as_body: bool) -> None:
    """Without slip, but for what the frames cost: a body's speed jumps from frame to frame."""
    vertices, faces = level_sheet(6, 0.2, THICKNESS)
    model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS, friction=0.4, air_drag=0.0))
    state, solver = State.at_rest(model), Solver(model)
    ground, ground_faces = grid(16, 16, 0.04)
    ground = ground[:, [1, 2, 0]] - [0.32, 0.0, 0.32]
    plane, body = Plane((0.0, 0.0, 0.0)), body_of(ground, ground_faces, state)
    colliders = Colliders((), body) if as_body else Colliders([plane])
    after = np.zeros_like(vertices)
    for frame in range(1, 121):
        t = frame / 60.0
        way = t**2 if t < 1.0 else 2.0 * t - 1.0  # 2 m/s2, less than the friction can give, then 2 m/s
        solver.follow(state, colliders)
        if as_body:
            body.advance((ground + [way, 0.0, 0.0] - state.origin).astype(np.float32))
        else:
            plane.point = (way, 0.0, 0.0)
        solver.step(state, colliders, 1 / 60)
        slip = state.world() - vertices - [way, 0.0, 0.0]
        if t == 1.0:
            # Jumps of a = 2 m/s2 times 1/60 s are caught up at mu g: each costs jump^2/(2 mu g).
            jumps = -60 * (2.0 / 60.0) ** 2 / (2 * 0.4 * 9.81)
            assert slip == pytest.approx(np.tile([jumps, 0.0, 0.0], (len(slip), 1)), abs=0.2 * abs(jumps))
            after = slip
    assert np.abs(slip - after).max() < 1e-4


@pytest.mark.parametrize("kind", ["sphere", "body"])
def test_a_rising_ball_lifts_the_cloth_and_a_fast_one_does_not_pass_through(kind: str) -> None:
    for speed in (0.3, 1.5):
        vertices, faces = level_sheet(10, 0.3, RADIUS + 0.03)
        model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS, friction=0.5))
        state, solver = State.at_rest(model), Solver(model)
        ball, ball_faces = icosphere(4, RADIUS)
        sphere, body = Sphere((0.0, 0.0, 0.0), RADIUS), body_of(ball, ball_faces, state)
        colliders = Colliders([sphere]) if kind == "sphere" else Colliders((), body)
        for frame in range(1, 61):
            centre = np.array([0.0, speed * frame / 60.0, 0.0])
            solver.follow(state, colliders)
            sphere.centre = tuple(centre)
            body.advance((ball + centre - state.origin).astype(np.float32))
            solver.step(state, colliders, 1 / 60)
            # A body is looked at again some times a frame only: the thickness is there for what happens in between.
            assert np.linalg.norm(state.world() - centre, axis=1).min() > RADIUS + (kind == "sphere") * 0.9 * THICKNESS
        assert state.world()[:, 1].max() > centre[1] + RADIUS


@pytest.mark.parametrize("speed", [3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0])
def test_a_body_faster_than_it_is_large_meets_the_cloth_in_its_way(speed: float) -> None:
    """10 m/s is 17 cm a frame: the ball, 8 cm wide, is before the curtain in one frame and behind it in the next."""
    vertices, faces = grid(12, 12, 0.033)
    vertices = np.stack([vertices[:, 2], vertices[:, 0] - 0.4, vertices[:, 1] - 0.2], axis=1)
    model = free_model(cloth(vertices, faces, (0.0, 1.0, 0.0)), Fabric(), np.flatnonzero(vertices[:, 1] > -0.01))
    ball, ball_faces = icosphere(3, 0.04)
    for start in (-0.3, -0.3 + 0.004 * speed, -0.3 + 0.008 * speed, -0.3 + 0.012 * speed):
        state, solver = State.at_rest(model), Solver(model, SolverOptions(substep=1 / 1200))
        body = body_of(ball + [start, -0.2, 0.005], ball_faces, state)
        for frame in range(1, int(0.5 / speed * 60) + 1):
            centre = np.array([start + speed * frame / 60.0, -0.2, 0.005])
            body.advance((ball + centre - state.origin).astype(np.float32))
            solver.step(state, Colliders((), body), 1 / 60)
            assert np.linalg.norm(state.world() - centre, axis=1).min() > 0.04  # nothing inside, ever


@pytest.mark.parametrize("kind", ["sphere", "body"])
@pytest.mark.parametrize("depth", [0.01, 0.04])
def test_cloth_that_starts_inside_comes_out_and_is_not_thrown(kind: str, depth: float) -> None:
    vertices, faces = level_sheet(10, 0.2, RADIUS - depth)
    model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS, air_drag=0.0))
    state = State.at_rest(model)
    body = Colliders((), body_of(*icosphere(4, RADIUS), state))
    colliders = Colliders([Sphere((0.0, 0.0, 0.0), RADIUS)]) if kind == "sphere" else body
    fastest = 0.0
    for _ in range(30):
        run(model, state, 1, gravity=0.0, colliders=colliders)
        fastest = max(fastest, float(np.linalg.norm(state.velocity, axis=1).max()))
    assert (np.linalg.norm(state.world(), axis=1) - RADIUS).min() > 0.9 * THICKNESS
    assert fastest < 5.0 * PUSH_OUT  # single vertices swing with the sheet


def test_normals_follow_the_pose() -> None:
    ball, faces = icosphere(3, RADIUS)
    body = Body(faces, len(ball))
    body.place(ball.astype(np.float32))
    assert np.abs(body.normals - ball / RADIUS).max() < 0.02
    turned = ball @ turn((1.0, 1.0, 0.0), 30.0).T
    body.advance(turned.astype(np.float32))
    assert np.abs(body.normals - turned / RADIUS).max() < 0.02
    assert np.array_equal(body.previous, ball.astype(np.float32))


@pytest.mark.parametrize(
    "collider",
    [
        Plane((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        Plane((0.0, np.nan, 0.0)),
        Plane((0.0, 0.0)),
        Sphere((0.0, 0.0, 0.0), 0.0),
        Sphere((0.0, 0.0, 0.0), np.inf),
        Sphere((np.inf, 0.0, 0.0), 1.0),
        Capsule((0.0, 0.0, 0.0), (0.0, np.nan, 0.0), 1.0),
        Capsule((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), -1.0),
    ],
)
def test_bad_primitives_are_refused(collider: Plane | Sphere | Capsule) -> None:
    refuses("plane|sphere|capsule", Colliders([collider]).rows, np.zeros(3))


@pytest.mark.parametrize("corner", [-1, 42])
def test_a_body_face_outside_the_mesh_is_refused(corner: int) -> None:
    _, faces = icosphere(1)
    faces[3, 1] = corner
    refuses("outside the mesh", Body, faces, 42)


def test_the_first_edges_of_a_body_and_the_faces_beside_them() -> None:
    """A fan of ten faces around vertex 0, whose rim is open."""
    faces = np.array([[0, 1 + k, 2 + k] for k in range(10)])
    ends, sides = (table.reshape(12, EDGES, -1) for table in Body(faces, 12).first_edges)
    assert ends[0].ravel().tolist() == list(range(1, 9))  # the others do not fit
    assert sides[0].tolist() == [[2, 2], *([k + 1, k - 1] for k in range(2, 9))]
    assert ends[3].ravel().tolist() == [0, 2, 4, 3, 3, 3, 3, 3]
    assert sides[3].tolist() == [[2, 4], [0, 0], [0, 0], *5 * [[3, 3]]]
