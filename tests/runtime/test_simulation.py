"""A simulation on its own: without a body, between two steps, and in a game loop."""

from __future__ import annotations

import numpy as np
import pytest

from assets.procedural.mannequin import builtin_mannequin
from pbd import ClothMesh, Fabric, Plane, build_model
from runtime.play.game_loop import GameLoop, LiveInput
from runtime.play.simulation import Simulation, body_source
from tests.refusals import refuses

VACUUM = Fabric(air_drag=0.0)
NO_POSE = np.zeros(0)  # of a garment without a body


def square(height: float = 1.0) -> Simulation:
    mesh = ClothMesh.grid(0.2, 0.2, 4, 4, centre=(0.0, height, 0.0), level=True)
    return Simulation(build_model(mesh, VACUUM), primitives=[Plane((0.0, 0.0, 0.0))])


def test_without_a_body_it_falls_freely() -> None:
    cloth = square()
    for _ in range(12):
        cloth.step()
    assert cloth.time == pytest.approx(0.2)
    np.testing.assert_allclose(cloth.vertices[:, 1], 1.0 - 0.5 * 9.81 * 0.2**2, atol=0.002)


def test_its_colliders_stop_it() -> None:
    cloth = square(0.1)
    for _ in range(60):
        cloth.step()
    np.testing.assert_allclose(cloth.vertices[:, 1], VACUUM.thickness, atol=1e-4)


def test_vertices_lie_between_the_last_two_steps_where_that_is_asked_for() -> None:
    cloth = square()
    start = cloth.vertices
    cloth.step()
    end = cloth.vertices
    for alpha in (0.0, 0.25, 1.0):
        cloth.decode(alpha)
        np.testing.assert_allclose(cloth.vertices, (1.0 - alpha) * start + alpha * end, atol=1e-12)
    cloth.decode(0.5)
    cloth.step()
    assert np.array_equal(cloth.vertices, cloth.state.world())


def test_a_game_loop_shows_each_picture_at_its_time() -> None:
    """Free fall by pictures at 100 Hz, ticks at 60: height falls by half the square of the picture's time."""
    cloth = square()
    loop = GameLoop(cloth, lambda t: LiveInput(NO_POSE), rate_hz=100.0)
    for picture in range(1, 26):
        loop.advance(0.01)
        # Between two ticks the line lies above the parabola, by at most g tick^2 / 8 or 0.4 mm.
        assert cloth.vertices[:, 1].mean() == pytest.approx(1.0 - 0.5 * 9.81 * (0.01 * picture) ** 2, abs=0.002)


def test_a_body_needs_a_pose() -> None:
    source, model = body_source(builtin_mannequin()), square().model
    refuses("pose: a body without a pose", Simulation, model, source=source)
    on_body = Simulation(model, source=source, pose=builtin_mannequin().bind_pose())
    refuses("pose: a body without a pose", on_body.step)
