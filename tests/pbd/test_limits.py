"""Painted limits: how far vertices may go from where a body carries them."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from pbd import Colliders, Fabric, InputError, Limits, Solver, SolverOptions, State, build_model
from pbd.limits import NONE, LimitTargets, SkinnedTargets
from tests.pbd.meshes import cloth, grid, icosphere, turn
from tests.refusals import refuses

AIRLESS = Fabric(air_drag=0.0)
UP = (0.0, 1.0, 0.0)


def level(limits: Limits, fabric: Fabric = AIRLESS) -> tuple:
    """A level sheet, its state and its targets, which stand still."""
    vertices, faces = grid(10, 10, 0.03)
    vertices = vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    model = build_model(cloth(vertices, faces), fabric, limits=limits, bend_factor=1 / 3)
    there = vertices[limits.vertices]
    return model, State.at_rest(model), LimitTargets(there, there, np.tile(UP, (len(there), 1)))


def limits(count: int, distance: float = NONE, backstop: float = NONE, stiffness: float = 0.0) -> Limits:
    return Limits(np.arange(count), *(np.full(count, value) for value in (distance, backstop, stiffness)))


def settle(model, state: State, targets: LimitTargets, frames: int = 60, keep: float = 0.9) -> None:
    solver = Solver(model, SolverOptions())
    for _ in range(frames):
        solver.step(state, Colliders(), 1 / 60, limit_targets=targets)
        state.velocity *= np.float32(keep)


def test_a_spring_of_each_area_gives_way_by_its_weight() -> None:
    stiffness = 400.0
    model, state, targets = level(limits(121, stiffness=stiffness))
    start = state.world()
    settle(model, state, targets, 240, 0.97)
    sag = AIRLESS.areal_density * 9.81 / stiffness
    assert start[:, 1] - state.world()[:, 1] == pytest.approx(sag, rel=2e-3)  # whatever area each vertex has


def test_maximum_distance_is_never_passed() -> None:
    model, state, targets = level(limits(121, distance=0.05))
    start = state.world()
    for shift in np.linspace(0.0, 0.5, 31)[1:]:  # places run away at 1 m/s
        targets = LimitTargets(targets.end, start + [shift, 0.0, 0.0], targets.normals)
        Solver(model, SolverOptions()).step(state, Colliders(), 1 / 60, limit_targets=targets)
        off = np.linalg.norm(state.world() - targets.end, axis=1)
        assert off.max() < 0.05 + 1e-6
    assert off.min() > 0.049  # gravity and drag leave it at the sphere's rim


def test_only_what_is_painted_is_limited() -> None:
    painted = np.arange(0, 121, 11)  # one edge of the sheet
    some = Limits(painted, np.zeros(11), np.full(11, NONE), np.zeros(11))
    model, state, targets = level(some)
    start = state.world()
    settle(model, state, targets)
    moved = np.linalg.norm(state.world() - start, axis=1)
    assert moved[painted].max() < 1e-6
    assert moved[10::11].min() > 0.1  # the other edge hangs down


def test_backstop_stops_what_goes_under_the_place() -> None:
    model, state, targets = level(limits(121, backstop=0.02))
    start = state.world()
    settle(model, state, targets)
    assert start[:, 1] - state.world()[:, 1] == pytest.approx(0.02, abs=1e-5)
    state.velocity[:] = (0.0, 3.0, 0.0)
    settle(model, state, targets, 6, 1.0)
    assert (state.world()[:, 1] > start[:, 1] + 0.1).all()  # nothing holds it on the other side


def test_without_targets_limits_hold_nothing() -> None:
    model, state, _ = level(limits(121, distance=0.0))
    Solver(model).step(state, Colliders(), 1 / 60)
    assert state.velocity[:, 1] == pytest.approx(-9.81 / 60, rel=1e-3)


def test_a_body_carries_targets_and_normals() -> None:
    ball, faces = icosphere(3, 0.2)
    shirt, cut = icosphere(2, 0.21)
    some = limits(20, distance=0.01)
    carried = SkinnedTargets(some, shirt, cut, ball, faces)
    rotation, way = turn((1.0, 2.0, 3.0), 50.0), np.array([0.3, 1.0, -0.2])
    before, after = ball.astype(np.float32), (ball @ rotation.T + way).astype(np.float32)
    targets = carried.targets(before, after, np.array([4.0, 0.0, 0.0]))
    assert targets.start == pytest.approx(shirt[:20] + [4.0, 0.0, 0.0], abs=1e-6)
    assert targets.end == pytest.approx(shirt[:20] @ rotation.T + way + [4.0, 0.0, 0.0], abs=1e-6)
    radial = (shirt[:20] / 0.21) @ rotation.T
    assert np.einsum("ij,ij->i", targets.normals, radial).min() > 0.99
    assert np.linalg.norm(targets.normals, axis=1) == pytest.approx(1.0, abs=1e-6)


def test_points_between_limited_vertices_are_limited() -> None:
    some = Limits([0, 1, 3], [0.1, 0.3, NONE], [NONE, NONE, 0.2], [0.0, 50.0, 50.0])
    matrix = csr_matrix([[0.5, 0.5, 0.0, 0.0], [0.0, 0.5, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]])
    between = some.between(matrix)
    assert between.vertices.tolist() == [0, 2, 3]
    assert between.maximum_distance == pytest.approx([0.2, NONE, NONE])
    assert between.backstop == pytest.approx([NONE, NONE, 0.2])
    assert between.stiffness == pytest.approx([0.0, 50.0, 50.0])


def test_limits_of_a_stand_in() -> None:
    some = Limits([1, 4], [0.1, 0.3], [NONE, 0.0], [0.0, 50.0])
    taken = some.taken(np.array([4, 2, 1, 7]))
    assert taken.vertices.tolist() == [0, 2]
    assert taken.maximum_distance == pytest.approx([0.3, 0.1])
    assert len(Limits.none().taken(np.array([4, 2])).vertices) == 0


@pytest.mark.parametrize(
    ("values", "key"),
    [
        (([0, 0], [1.0, 1.0], [1.0, 1.0], [0.0, 0.0]), "vertices"),
        (([0, 1], [1.0], [1.0, 1.0], [0.0, 0.0]), "maximum_distance"),
        (([0, 1], [1.0, 1.0], [1.0, -1.0], [0.0, 0.0]), "backstop"),
        (([0, 1], [1.0, 1.0], [1.0, 1.0], [0.0, np.inf]), "stiffness"),
    ],
)
def test_bad_limits(values: tuple, key: str) -> None:
    refuses(key, Limits, *values)


def test_limits_of_other_models_and_targets_of_other_limits() -> None:
    vertices, faces = grid(2, 2, 0.1)
    with pytest.raises(InputError, match="limited vertex outside the mesh"):
        build_model(cloth(vertices, faces), AIRLESS, limits=Limits([9], [1.0], [1.0], [1.0]))
    model, state, targets = level(limits(121, distance=0.1))
    with pytest.raises(InputError, match="limit_targets.start"):
        Solver(model).step(state, Colliders(), 1 / 60, limit_targets=targets._replace(start=targets.start[:3]))
