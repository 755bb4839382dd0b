"""Cloth between two sides of a body that are nearer than two thicknesses: it rests, and it is free again afterwards."""

import numpy as np
import pytest

from pbd import Body, Colliders, Fabric, Solver, State
from tests.pbd.meshes import body_of, cloth, free_model, grid, icosphere

DT = 1.0 / 60.0
RADIUS, THICKNESS = 0.12, 0.003
BALL, BALL_FACES = icosphere(4, RADIUS)


def balls(gap: float) -> tuple[np.ndarray, np.ndarray]:
    """A ball about the origin, and one above it at a distance [m]; one body."""
    vertices = np.concatenate([BALL, BALL + [0.0, 2.0 * RADIUS + gap, 0.0]])
    return vertices, np.concatenate([BALL_FACES, BALL_FACES + len(BALL)])


class Pinch:
    """A sheet that hangs over one ball while another comes down on it."""

    def __init__(self) -> None:
        vertices, faces = grid(24, 24, 0.0125)
        lying = vertices[:, [1, 2, 0]] + [-0.146, RADIUS + THICKNESS, -0.153]
        self.model = free_model(cloth(lying, faces), Fabric(thickness=THICKNESS, friction=0.4))
        self.state, self.solver = State.at_rest(self.model), Solver(self.model)
        self.body: Body = body_of(*balls(0.05), self.state)

    def step(self, gap: float) -> np.ndarray:
        """A frame at whose end the balls are so far apart [m]; vertices in the world [m]."""
        self.body.advance((balls(gap)[0] - self.state.origin).astype(np.float32))
        self.solver.step(self.state, Colliders((), self.body), DT)
        return self.state.world()


@pytest.mark.parametrize("gap", [0.005, 0.002, -0.002])
def test_pinched_cloth_does_not_tremble(gap: float) -> None:
    pinch = Pinch()
    for frame in range(150):
        pinch.step(max(gap, 0.05 - 0.001 * frame))
    frames = np.array([pinch.step(gap) for _ in range(31)])
    steps = np.diff(frames, axis=0)
    sign = (-1.0) ** np.arange(len(steps))
    to_and_fro = np.linalg.norm((sign[:, None, None] * steps).mean(axis=0), axis=1)
    inside = np.hypot(frames[-1][:, 0], frames[-1][:, 2]) < 0.02
    assert inside.sum() > 5
    assert to_and_fro.max() < 2e-5
    assert to_and_fro[inside].max() < 1e-6


def test_cloth_in_a_narrow_valley_rests() -> None:
    """A sheet hangs into the valley of two balls that overlap; its sides' normals have a cosine of -0.6."""
    away = (RADIUS + THICKNESS) * np.sqrt(0.8)
    vertices, faces = grid(24, 24, 0.0125)
    lying = vertices[:, [1, 2, 0]] + [-0.1487, RADIUS + 0.01, -0.152]
    model = free_model(cloth(lying, faces), Fabric(thickness=THICKNESS, friction=0.3))
    state, solver = State.at_rest(model), Solver(model)
    both = np.concatenate([BALL - [away, 0.0, 0.0], BALL + [away, 0.0, 0.0]])
    body = body_of(both, np.concatenate([BALL_FACES, BALL_FACES + len(BALL)]), state)
    frames = []
    for _ in range(180):
        body.advance(body.current.copy())
        solver.step(state, Colliders((), body), DT)
        frames.append(state.world())
    steps = np.diff(np.array(frames[-31:]), axis=0)
    to_and_fro = np.linalg.norm(((-1.0) ** np.arange(30)[:, None, None] * steps).mean(axis=0), axis=1)
    assert np.abs(frames[-1][:, 0]).min() < 0.005 and to_and_fro.max() < 2e-5


def test_cloth_is_free_again_where_the_pinch_opens() -> None:
    pinch = Pinch()
    for frame in range(100):
        pinch.step(max(-0.002, 0.05 - 0.001 * frame))
    for frame in range(90):
        after = pinch.step(min(-0.002 + 0.002 * frame, 0.1))
    height = np.linalg.norm(after, axis=1) - RADIUS
    assert height.min() > 0.5 * THICKNESS
    on_top = np.hypot(after[:, 0], after[:, 2]) < 0.04
    assert np.abs(height[on_top] - THICKNESS).max() < 1e-3
