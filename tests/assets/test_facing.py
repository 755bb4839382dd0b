import numpy as np
import pytest

from assets.facing import standing_frame
from assets.sewing.body import StandingBody
from tests.assets.shell_figure import moved, shell_figure


def heading(body: StandingBody) -> tuple[float, np.ndarray]:
    frame = standing_frame(body.vertices, body.faces)
    return float(np.degrees(np.arctan2(frame.rotation[0, 2], frame.rotation[2, 2]))), frame.origin


@pytest.mark.parametrize("arms", [0.0, 45.0])
@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, 180.0, -120.0])
def test_a_body_is_found_wherever_it_stands(arms: float, degrees: float) -> None:
    body = moved(shell_figure(arms), (1.0, 0.3, -2.0), degrees)
    angle, origin = heading(body)
    assert (angle - degrees + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.01)
    local = standing_frame(body.vertices, body.faces).local(body.vertices)
    np.testing.assert_allclose(local[:, 1], body.vertices[:, 1], atol=1e-12)
    assert local[:, 0].min() == pytest.approx(-local[:, 0].max(), abs=1e-4)
    np.testing.assert_allclose(standing_frame(body.vertices, body.faces).world(local), body.vertices, atol=1e-12)


def test_a_lifted_leg_turns_the_frame_little() -> None:
    body = shell_figure()
    v = body.vertices.copy()
    leg = (v[:, 0] < -0.03) & (v[:, 1] < 0.7)
    v[leg, 2] += 0.6 * (0.7 - v[leg, 1])  # the right foot goes ahead and up
    v[leg, 1] += 0.1 * (0.7 - v[leg, 1])
    angle, _ = heading(moved(StandingBody("walking", v, body.faces), (0.0, 0.0, 0.0), 150.0))
    assert angle == pytest.approx(150.0, abs=3.0)


def test_a_body_without_feet_looks_to_the_side_of_z() -> None:
    body = shell_figure()
    pegs = body.vertices.copy()
    low = pegs[:, 1] < 0.12
    pegs[low, 2] = np.clip(pegs[low, 2], -0.03, 0.0)
    assert heading(moved(StandingBody("pegs", pegs, body.faces), (0.0, 0.0, 0.0), 60.0))[0] == pytest.approx(
        60.0, abs=0.1
    )
    assert heading(moved(StandingBody("pegs", pegs, body.faces), (0.0, 0.0, 0.0), 120.0))[0] == pytest.approx(
        -60.0, abs=0.1
    )
