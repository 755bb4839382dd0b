"""Contact with distance fields: what the primitives do, whatever the pose, and the motion of the touched point."""

from typing import Any

import numpy as np
import pytest

from pbd import Colliders, DistanceField, Fabric, InputError, Solver, SolverOptions, Sphere, State
from pbd.contact.distance_field import field_rows
from pbd.contact.response import interpolated
from pbd.engine import ti
from pbd.geometry import Float1, Float2
from pbd.models import make_solver
from tests.pbd.meshes import RADIUS, THICKNESS, cloth, free_model, grid, level_sheet, run, turn

SPACING = 0.01
DT = 1.0 / 60.0


def field_of(distance: Any, low: tuple, high: tuple, spacing: float = SPACING) -> DistanceField:
    """Of a function of points, shape (..., 3), over a box."""
    axes = [a + spacing * np.arange(round((b - a) / spacing) + 1) for a, b in zip(low, high, strict=True)]
    return DistanceField(distance(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)), low, spacing)


def ball(radius: float = RADIUS) -> DistanceField:
    reach = radius + 0.03
    return field_of(lambda x: np.linalg.norm(x, axis=-1) - radius, (-reach,) * 3, (reach,) * 3)


def block(half: tuple, around: float = 0.02) -> DistanceField:
    """A box about its middle."""

    def distance(x: np.ndarray) -> np.ndarray:
        out = np.abs(x) - half
        return np.linalg.norm(np.maximum(out, 0.0), axis=-1) + np.minimum(out.max(axis=-1), 0.0)

    reach = np.add(half, around)
    return field_of(distance, tuple(-reach), tuple(reach))


@ti.kernel
def interpolate(values: Float1, size: ti.math.ivec3, places: Float2, out: Float2):
    for i in range(places.shape[0]):
        found = interpolated(values, 1, size, ti.math.vec3(places[i, 0], places[i, 1], places[i, 2]))
        for a in ti.static(range(4)):
            out[i, a] = found[a]


def test_the_interpolant_and_its_gradient() -> None:
    """Values at grid points, also the last; in a cell the slopes of its value."""
    rng = np.random.default_rng(0)
    values = rng.normal(size=(4, 3, 5)).astype(np.float32)

    def at(places: np.ndarray) -> np.ndarray:
        out = np.zeros((len(places), 4), np.float32)
        stored = np.concatenate([[np.float32(9.0)], values.ravel()])
        interpolate(stored, values.shape, places.astype(np.float32), out)
        return out

    points = np.stack(np.meshgrid(*map(np.arange, values.shape), indexing="ij"), axis=-1).reshape(-1, 3)
    assert at(points)[:, 3] == pytest.approx(values.ravel(), abs=1e-6)
    places = rng.uniform(0.1, 0.9, (200, 3)) + rng.integers(0, np.array(values.shape) - 1, (200, 3))
    found = at(places)
    for axis in range(3):
        move = 0.1 * np.eye(3)[axis]  # linear along each axis
        slope = (at(places + move)[:, 3] - at(places - move)[:, 3]) / 0.2
        assert found[:, axis] == pytest.approx(slope, abs=3e-5)


@pytest.mark.parametrize("angle", [1e-9, 0.3, 3.0, np.pi])
def test_a_turn_is_taken_by_the_least_angle(angle: float) -> None:
    before, after = ball(), ball()
    before.rotation = turn((0.0, 0.0, 1.0), 40.0)
    after.rotation = turn((1.0, 2.0, -1.0), np.degrees(angle)) @ before.rotation
    spin = field_rows(after.row()[None], before.row()[None])[0, 22:]
    axis = np.array([1.0, 2.0, -1.0]) / np.sqrt(6.0)
    assert np.abs(spin) == pytest.approx(np.abs(angle * axis), abs=1e-7)
    assert spin @ axis > 0 or angle == np.pi


@pytest.mark.parametrize("place", [0.0, 100.0])
def test_cloth_drapes_over_the_field_of_a_ball_as_over_the_ball(place: float) -> None:
    """Between grid points the field of a ball stands up to s^2/(4 r) = 0.2 mm too high: so much deeper it may lie."""
    moved, ends = np.array([place, 0.0, 0.0]), []
    for kind in ("sphere", "field"):
        field = ball()
        field.position, field.rotation = moved, turn((1.0, 2.0, 0.5), 37.0)
        colliders = Colliders([field if kind == "field" else Sphere(tuple(moved), RADIUS)])
        vertices, faces = level_sheet(12, 0.45, RADIUS + 0.02)
        model = free_model(cloth(vertices + moved, faces), Fabric(thickness=THICKNESS, friction=0.8))
        state = State.at_rest(model)
        for _ in range(5):
            run(model, state, 12, colliders=colliders)
            gap = np.linalg.norm(state.world() - moved, axis=1) - RADIUS - THICKNESS
            assert gap.min() > -0.1 * THICKNESS - SPACING**2 / (4.0 * RADIUS)
        assert (np.abs(gap) < 3e-4).sum() > 15
        ends.append(state.world())
    assert np.median(np.linalg.norm(ends[0] - ends[1], axis=1)) < SPACING


@pytest.mark.parametrize("motion", ["shift", "turn"])
def test_a_moving_field_carries_the_cloth(motion: str) -> None:
    """At constant speed from the start, which friction has to give the cloth first; then without slip."""
    vertices, faces = level_sheet(6, 0.2, 0.05 + THICKNESS)
    model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS, friction=0.6, air_drag=0.0))
    state, solver, table = State.at_rest(model), Solver(model), block((0.3, 0.05, 0.3))
    colliders, offset, slip = Colliders([table]), np.zeros_like(vertices), []
    for frame in range(1, 91):
        rotation = turn((0.0, 1.0, 0.0), 2.0 * frame if motion == "turn" else 20.0)
        table.rotation = rotation
        table.position = (0.01 * frame * (motion == "shift"), 0.0, 0.0)
        solver.follow(state, colliders)
        solver.step(state, colliders, DT)
        own = (state.world() - table.position) @ rotation
        if frame == 30:
            offset = own
        slip.append(np.abs(own - offset).max())
    assert max(slip[30:]) < 1e-4
    assert np.abs(own[:, 1] - 0.05 - THICKNESS).max() < 1e-5
    assert np.linalg.norm(offset - vertices, axis=1).max() > 0.01  # it slid until it had the speed


@pytest.mark.parametrize("friction", [0.35, 0.38])
def test_a_tilted_field_holds_cloth_below_the_angle_of_friction_only(friction: float) -> None:
    """20 degrees: tan is 0.364. What sticks does not creep; what slides keeps Coulomb's law."""
    rotation = turn((0.0, 0.0, 1.0), 20.0)
    flat, faces = level_sheet(6, 0.2, 0.05 + THICKNESS)
    start = (flat + [0.2, 0.0, 0.0]) @ rotation.T
    model = free_model(cloth(start, faces), Fabric(thickness=THICKNESS, friction=friction, air_drag=0.0))
    table = block((0.5, 0.05, 0.2))
    table.rotation = rotation
    state = State.at_rest(model)
    run(model, state, 30, colliders=Colliders([table]))
    settled = state.world()
    run(model, state, 90, colliders=Colliders([table]))
    if friction > np.tan(np.radians(20.0)):
        assert np.abs(state.world() - start).max() < 1e-4
        assert np.abs(state.world() - settled).max() < 1e-5
    else:
        way = -((state.world() - start) @ rotation)[:, 0]
        angle = np.radians(20.0)
        assert way == pytest.approx(
            np.full(len(way), 0.5 * 9.81 * 4.0 * (np.sin(angle) - 0.35 * np.cos(angle))), rel=0.02
        )


@pytest.mark.parametrize("speed", [5.0, 20.0])
def test_a_fast_field_takes_the_curtain_along(speed: float) -> None:
    """20 m/s is 33 cm a frame; the ball, 20 cm wide, stops beyond the curtain's plane."""
    vertices, faces = grid(16, 16, 0.05)
    vertices = np.stack([vertices[:, 1] - 0.4, vertices[:, 0] - 0.8, 0.0 * vertices[:, 0]], axis=1)
    model = free_model(cloth(vertices, faces), Fabric(), np.flatnonzero(vertices[:, 1] > -0.01))
    state, solver, field = State.at_rest(model), Solver(model, SolverOptions()), ball(0.1)
    colliders = Colliders([field])
    for frame in range(60):
        field.position = (0.01, -0.4, min(-1.0 + speed * frame * DT, 0.15))
        solver.step(state, colliders, DT)
        assert np.linalg.norm(state.world() - field.position, axis=1).min() > 0.1 - SPACING**2 / 0.4
    distance = np.linalg.norm(state.world() - field.position, axis=1)
    assert (state.world()[distance < 0.13, 2] > 0.1).sum() > 8  # it lies on the ball's far side


def test_cloth_inside_the_grid_s_box_but_clear_of_the_surface_keeps_its_bits() -> None:
    hashes = []
    for colliders in (Colliders(), Colliders([ball()])):
        vertices, faces = level_sheet(6, 0.1, RADIUS + 0.025)
        model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS))
        state = State.at_rest(model)
        run(model, state, 3, colliders=colliders)
        assert np.linalg.norm(state.world(), axis=1).min() > RADIUS + THICKNESS
        hashes.append(state.hash())
    assert hashes[0] == hashes[1]


def test_fields_that_turn_may_be_exchanged() -> None:
    """By a solver that goes on and by a new one for every frame: two fields lift the cloth, and one becomes larger."""
    vertices, faces = level_sheet(8, 0.25, RADIUS + 0.005)
    model = free_model(cloth(vertices, faces), Fabric(thickness=THICKNESS))
    solver, ends = Solver(model), []
    for goes_on in (True, False):
        box = block((0.2, 0.1, 0.2))
        box.position = (0.0, 0.06, 0.0)
        state, colliders = State.at_rest(model), Colliders([ball(), box])
        for frame in range(8):
            if frame == 4:
                colliders.primitives[0] = ball(0.155)
            for field in colliders.primitives:
                assert isinstance(field, DistanceField)
                field.position = (0.0, field.position[1] + 0.002, 0.0)
                field.rotation = turn((0.0, 1.0, 0.2), 3.0 * frame)
            (solver if goes_on else Solver(model)).step(state, colliders, DT)
        assert state.velocity[:, 1].max() > 0.05  # lifted
        ends.append(state.hash())
    assert ends[0] == ends[1]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"values": np.zeros((3, 3))}, "2 x 2 x 2"),
        ({"values": np.zeros((3, 1, 3))}, "2 x 2 x 2"),
        ({"values": np.full((2, 2, 2), np.nan)}, "not finite"),
        ({"spacing": 0.0}, "spacing"),
        ({"origin": (0.0, 0.0)}, "origin"),
        ({"position": (0.0, np.inf, 0.0)}, "position"),
        ({"rotation": 2.0 * np.eye(3)}, "rotation"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "rotation"),
    ],
)
def test_bad_fields_are_refused(change: dict, text: str) -> None:
    with pytest.raises(InputError, match=text):
        Colliders(
            [DistanceField(**({"values": np.ones((2, 2, 2)), "origin": (0, 0, 0), "spacing": 0.1} | change))]
        ).fields(np.zeros(3))


def test_float64_solvers_refuse_fields() -> None:
    vertices, faces = level_sheet(3, 0.1, 0.3)
    model = free_model(cloth(vertices, faces), Fabric())
    with pytest.raises(InputError, match="planes, spheres and capsules"):
        make_solver("springs-triangle/symplectic-euler", model).step(State.at_rest(model), Colliders([ball()]), DT)
