"""Garments that wind, dashes and pulls hook through their body are put back on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from assets.io.scene import parse_scene
from assets.motion import Motion
from pbd import Body, ClothMesh, Fabric, State, build_model
from pbd.crossings import SelfCrossings
from pbd.distance import BodyDistance
from runtime.play.redressing import Redressing
from runtime.play.simulation import Simulation
from runtime.setup.scene_simulation import simulation_of

RATE = 60  # frames a second


def worn(garment: str, attach: str = "none") -> tuple[Simulation, Motion]:
    """A built-in garment on the mannequin."""
    scene = f'[[garment]]\nname = "g"\nmesh = "builtin:{garment}"\nfabric = "wool"\nattach = "{attach}"\n'
    simulation, motion = simulation_of(parse_scene(scene + '[character]\nfile = "builtin:mannequin"\nclip = "walk"\n'))
    assert motion is not None
    return simulation, motion


def longest(simulation: Simulation) -> float:
    """Length of the edge that is drawn out most, over its rest length."""
    edges, rest = simulation.model.mesh.edge_lengths()
    return float((np.linalg.norm(np.diff(simulation.vertices[edges], axis=1)[:, 0], axis=1) / rest).max())


def in_place(simulation: Simulation) -> bool:
    """Whether no edge is twice its length, and none that is drawn out is deep in the body or goes through it."""
    edges, rest = simulation.model.mesh.edge_lengths()
    ends, body = simulation.vertices[edges], simulation.body
    ends = ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 1.4 * rest]
    points = np.concatenate([ends[:, 0], ends[:, 1], ends.mean(axis=1)])
    outside = BodyDistance(body.faces).signed_distance(points, body.current + body.origin).reshape(3, -1)
    through = (outside[0] > 0.0) & (outside[1] > 0.0) & (outside[2] < -0.005)
    return longest(simulation) < 2.0 and not (through | (outside[2] < -0.012)).any()


def stand(simulation: Simulation, pose: np.ndarray, seconds: float, wind: tuple[float, ...] = (0.0, 0.0, 0.0)) -> None:
    """Hold the body in a pose."""
    for _ in range(round(seconds * RATE)):
        simulation.step(pose, 1.0 / RATE, wind)


def pull(simulation: Simulation, vertex: int, pose: np.ndarray, way: np.ndarray, seconds: float) -> None:
    """Drag a vertex along a way [m] and let it go."""
    start = simulation.vertices[vertex]
    for part in np.linspace(0.0, 1.0, round(seconds * RATE)):
        simulation.drag(vertex, start + part * way)
        simulation.step(pose, 1.0 / RATE)
    simulation.drag(vertex, None)


def test_a_skirt_that_wind_hooks_through_the_legs_is_put_back() -> None:
    """Without that its edges stay 4.7 times too long."""
    simulation, motion = worn("skirt", "top")
    pose, put_back = motion.pose(0.0), simulation.redressing
    stand(simulation, pose, 0.5)
    assert put_back.count == 0
    stand(simulation, pose, 1.0, (0.0, 0.0, 40.0))
    stand(simulation, pose, 1.0)
    assert put_back.count > 0
    assert longest(simulation) < 1.2
    assert len(SelfCrossings(simulation.model.mesh).find(simulation.vertices)) == 0


@pytest.mark.proof
def test_what_is_pulled_is_not_put_back_while_it_is_pulled() -> None:
    simulation, motion = worn("skirt", "top")
    pose, put_back = motion.pose(0.0), simulation.redressing
    assert put_back is not None
    hem = int(np.argmin(simulation.vertices[:, 1]))
    pull(simulation, hem, pose, np.array([0.0, 0.0, 3.0]), 0.5)
    simulation.drag(hem, simulation.vertices[hem])
    stand(simulation, pose, 0.5)
    assert longest(simulation) > 2.0
    assert put_back.count == 0


def test_a_garment_is_carried_on_where_the_pose_has_no_room_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation, motion = worn("skirt", "top")
    pose, put_back = motion.pose(0.0), simulation.redressing
    looks = iter([[0]] * 4)
    monkeypatch.setattr(put_back._crossings, "find", lambda vertices: next(looks, []))
    stand(simulation, pose, 0.5, (0.0, 0.0, 40.0))
    frames = 0
    while not put_back.count:
        simulation.step(pose, 1.0 / RATE)
    while put_back.step(simulation.state, simulation.body, 1.0 / RATE):
        frames += 1
    assert frames > 0.7 * RATE
    stand(simulation, pose, 0.5)
    assert longest(simulation) < 1.2
    assert len(SelfCrossings(simulation.model.mesh).find(simulation.vertices)) == 0


def test_a_garment_is_not_put_back_in_a_pose_that_has_no_room_for_it() -> None:
    """An arm that was spread in the bind pose and hangs down has the trunk's garment deep within itself."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    one, faces = np.asarray(ball.vertices), np.concatenate([ball.faces, ball.faces + len(ball.vertices)])
    mesh = ClothMesh.grid(0.05, 0.05, 4, 4, level=True)
    mesh = replace(mesh, vertices=mesh.vertices + [0.0, 0.13, 0.0])
    model = build_model(mesh, Fabric())
    bind = np.concatenate([one, one + [0.5, 0.0, 0.0]])
    for away, is_put_back in ((0.5, True), (0.0, False)):  # where the second ball stands from the first [m]
        put_back, state = Redressing(model, bind, faces), State.at_rest(model)
        body = Body(faces, len(bind))
        body.place(np.concatenate([one, one + [away, 0.21, 0.0]]))
        state.position[0, 1] += 1.0
        assert any(put_back.step(state, body, 1.0 / RATE) for _ in range(RATE)) == is_put_back


@pytest.mark.proof
@pytest.mark.parametrize("garment", ["skirt", "trousers", "tshirt", "shirt", "circle_skirt"])
@pytest.mark.parametrize("seed", range(6))
def test_garments_hold_whatever_is_done_to_them(garment: str, seed: int) -> None:
    """Gusts of up to 40 m/s, dashes of up to 10 m/s, pulls of up to a metre; 3.5 s later all is in its place."""
    rng = np.random.default_rng(seed)
    simulation, motion = worn(garment, ("none", "top")[seed % 2])
    at, moment = np.zeros(3), 0.0

    def pose(step: np.ndarray) -> np.ndarray:
        at[:] += step
        moved = motion.pose(moment).copy()
        moved[:, :, 3] += at
        return moved

    for _ in range(6):
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        kind, moment = rng.integers(3), moment + rng.uniform(0.0, 0.5)
        if kind == 0:
            stand(simulation, pose(np.zeros(3)), 0.5, tuple(rng.uniform(20.0, 40.0) * way))
        elif kind == 1:
            speed = rng.uniform(3.0, 10.0)
            for _ in range(12):
                simulation.step(pose(speed / RATE * way * (1.0, 0.0, 1.0)), 1.0 / RATE)
        else:
            vertex = int(rng.choice(np.flatnonzero(simulation.model.inverse_mass > 0.0)))
            pull(simulation, vertex, pose(np.zeros(3)), rng.uniform(0.3, 1.0) * way, 0.3)
        stand(simulation, pose(np.zeros(3)), 1.0)
        assert longest(simulation) < 2.0
        if not in_place(simulation):  # it is noticed after at most 2.5 s, and put back in 0.4 s
            stand(simulation, pose(np.zeros(3)), 2.5)
        assert in_place(simulation)
