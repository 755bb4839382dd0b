"""Fast surroundings: frames are cut finer for them, and what is put elsewhere takes its garment along."""

import numpy as np
import pytest

from pbd import Capsule, Colliders, DistanceField, Fabric, Plane, Solver, SolverOptions, Sphere, State
from pbd.xpbd.rigid_motion import detect_teleport, max_displacement
from tests.pbd.meshes import body_of, cloth, free_model, grid, icosphere, turn

DT = 1.0 / 60.0
STILL = np.zeros(3)


def moved(before: list, after: list) -> np.ndarray:
    """Rows of primitives that were somewhere else a frame ago."""
    colliders = Colliders(before)
    colliders.rows(STILL)
    colliders.primitives = after
    return colliders.rows(STILL)


def test_the_max_displacement_is_that_of_each_kind_against_the_cloth() -> None:
    none, no_fields = np.zeros((0, 3)), np.zeros((0, 25))
    ball = moved([Sphere((0.0, 0.0, 0.0), 0.1)], [Sphere((0.3, 0.4, 0.0), 0.1)])
    assert max_displacement(ball, no_fields, none, none, STILL) == pytest.approx(0.5)
    assert max_displacement(ball, no_fields, none, none, np.array([0.3, 0.4, 0.0])) == pytest.approx(0.0, abs=1e-6)
    arm = moved([Capsule((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.1)], [Capsule((0.0, 0.0, 0.0), (1.0, 0.2, 0.0), 0.1)])
    assert max_displacement(arm, no_fields, none, none, STILL) == pytest.approx(0.2)
    ground = moved([Plane((0.0, 0.0, 0.0))], [Plane((5.0, 0.1, 0.0))])  # along itself it goes nowhere
    assert max_displacement(ground, no_fields, none, none, STILL) == pytest.approx(0.1)
    nothing = np.zeros((0, 14))
    held = max_displacement(nothing, no_fields, np.zeros((1, 3)), np.full((1, 3), 0.1), STILL)
    assert held == pytest.approx(0.03**0.5)


def test_of_a_distance_field_the_fastest_corner_counts() -> None:
    """A stick of 1 m by 2 cm that turns about its end: the other end goes a radius times the angle."""
    none, nothing = np.zeros((0, 3)), np.zeros((0, 14))
    stick = DistanceField(np.ones((3, 3, 101)), (-0.01, -0.01, 0.0), 0.01)
    colliders = Colliders([stick])
    assert max_displacement(nothing, colliders.fields(STILL)[0], none, none, STILL) == 0.0
    stick.rotation, stick.position = turn((0.0, 1.0, 0.0), 30.0), (0.0, 0.3, 0.0)
    found = max_displacement(nothing, colliders.fields(STILL)[0], none, none, STILL)
    assert found == pytest.approx(np.hypot(0.3, np.pi / 6 * np.hypot(1.0, 0.01)), rel=1e-5)
    assert max_displacement(nothing, colliders.fields(STILL)[0], none, none, STILL) == 0.0


def test_a_rigid_jump_is_found_and_nothing_else() -> None:
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (200, 3))
    rotation = turn((1.0, 2.0, 0.0), 70.0)
    after = points @ rotation.T + [3.0, 1.0, 0.0]
    carry = detect_teleport(points, after, STILL, DT)
    assert carry is not None and carry.points(points) == pytest.approx(after)
    assert np.linalg.det(carry.rotation) == pytest.approx(1.0)
    assert detect_teleport(points, points + [0.4, 0.0, 0.0], STILL, DT) is None  # 24 m/s: a dash
    assert (
        detect_teleport(points, points + [3.0, 0.0, 0.0], np.array([180.0, 0.0, 0.0]), DT) is None
    )  # the cloth flies along
    one = points.copy()
    one[0] += [3.0, 0.0, 0.0]
    assert detect_teleport(points, one, STILL, DT) is None and detect_teleport(points[:2], one[:2], STILL, DT) is None
    assert detect_teleport(points[:0], points[:0], STILL, DT) is None


@pytest.mark.parametrize("worn", ["held", "body"])
def test_a_garment_is_carried_along_as_it_is(worn: str) -> None:
    """One that swings and falls is 5 m further and turned, and does not know."""
    vertices, faces = grid(8, 8, 0.04)
    held = np.flatnonzero(vertices[:, 1] > 0.31) if worn == "held" else None
    model = free_model(cloth(vertices, faces), Fabric(air_drag=0.0), held)
    rotation, way = turn((0.0, 1.0, 0.0), 90.0), np.array([5.0, 1.0, 0.0])
    ball, ball_faces = icosphere(3, 0.1)
    ends = []
    for jumps in (False, True):
        state = State.at_rest(model)
        solver, body = Solver(model), body_of(ball + [0.1, -0.2, 0.05], ball_faces, state)
        colliders, targets = Colliders((), body if worn == "body" else None), state.world()[model.held]
        for frame in range(14):
            if frame == 10 and jumps:
                targets = targets @ rotation.T + way
                body.advance((ball + [0.1, -0.2, 0.05]) @ rotation.T.astype(np.float32) + way - body.origin)
            else:
                body.advance(body.current.copy())
            solver.step(state, colliders, DT, targets if worn == "held" else None)
        ends.append((state.world(), state.velocity.copy()))
    (x, v), (moved_x, moved_v) = ends
    assert moved_x == pytest.approx(x @ rotation.T + way, abs=1e-3)
    assert moved_v == pytest.approx(v @ rotation.T, abs=0.1)


def test_a_ball_faster_than_it_is_large_takes_the_curtain_along() -> None:
    """20 m/s is 33 cm a frame; the ball, 20 cm wide, stops beyond the curtain's plane."""
    vertices, faces = grid(16, 16, 0.05)
    vertices = np.stack([vertices[:, 1] - 0.4, vertices[:, 0] - 0.8, 0.0 * vertices[:, 0]], axis=1)
    model = free_model(cloth(vertices, faces), Fabric(), np.flatnonzero(vertices[:, 1] > -0.01))
    state, solver = State.at_rest(model), Solver(model, SolverOptions())
    ball = Sphere((0.01, -0.4, -1.0), 0.1)
    colliders = Colliders([ball])
    for frame in range(60):
        solver.step(state, colliders, DT)
        ball.centre = (0.01, -0.4, min(-1.0 + 20.0 * (frame + 1) * DT, 0.15))
    distance = np.linalg.norm(state.world() - ball.centre, axis=1)
    assert distance.min() > 0.1
    assert (state.world()[distance < 0.13, 2] > 0.1).sum() > 8  # it lies on the ball's far side
