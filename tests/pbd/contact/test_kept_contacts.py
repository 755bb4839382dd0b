"""Contact points that are kept from frame to frame are those that a search from nothing finds."""

from collections.abc import Callable

import numpy as np
import pytest

from pbd import Body, Colliders, Fabric, Solver, State
from pbd.geometry import FAR
from tests.pbd.meshes import THICKNESS, body_of, cloth, free_model, grid, icosphere, turn

DT = 1.0 / 60.0
BALL, BALL_FACES = icosphere(3, 0.12)


def gliding(frame: int) -> np.ndarray:
    """A ball that rolls and swings under the cloth at up to 0.4 m/s."""
    rolled = BALL @ turn((0.0, 0.0, 1.0), 2.0 * frame).T
    return rolled + [0.05 * np.sin(0.13 * frame), 0.01 * np.sin(0.2 * frame), 0.0]


def dashing(frame: int) -> np.ndarray:
    """The same ball; at frame 20 it is 5 cm further to the side, which is 3 m/s."""
    return gliding(frame) + [0.0, 0.0, 0.05 if frame >= 20 else 0.0]


def leaving(frame: int) -> np.ndarray:
    """The same ball; from frame 20 on it is 5 cm lower, and the sheet falls on it."""
    return gliding(frame) - [0.0, 0.05 if frame >= 20 else 0.0, 0.0]


class Sheet:
    """A sheet that lies on the ball, stepped from nothing or from the contacts of the frame before."""

    def __init__(self) -> None:
        vertices, faces = grid(12, 12, 0.025)
        lying = vertices[:, [1, 2, 0]] + [-0.15, 0.12 + THICKNESS, -0.15]
        self.model = free_model(cloth(lying, faces), Fabric(thickness=THICKNESS, friction=0.3))
        self.state, self.solver = State.at_rest(self.model), Solver(self.model)
        self.body: Body = body_of(gliding(0), BALL_FACES, self.state)

    def step(self, vertices: np.ndarray) -> tuple[State, State]:
        """The states after a frame: with the faces that are known, and with none; the first goes on."""
        self.body.advance((vertices - self.state.origin).astype(np.float32))
        anew = self.state.copy()
        anew.contact_faces[:] = -1
        for state in (anew, self.state):
            self.solver.step(state, Colliders((), self.body), DT)
        return self.state, anew


@pytest.mark.parametrize("motion", [gliding, dashing, leaving])
def test_kept_contacts_are_those_of_a_search_from_nothing(motion: Callable[[int], np.ndarray]) -> None:
    sheet = Sheet()
    kept_faces = 0
    for frame in range(40):
        before = sheet.state.contact_faces.copy()
        kept, anew = sheet.step(motion(frame))
        touching = (anew.contact < 0.005) & (kept.contact < FAR)
        kept_faces += int((before == kept.contact_faces).all(axis=1)[kept.contact_faces[:, 0] >= 0].sum())
        # A sample keeps its face while it slides 1.5 mm, over edges too, where faces differ by some 10 degrees.
        assert np.abs(kept.contact - anew.contact)[touching].max(initial=0.0) < 3e-4
        # Further away the distance is an estimate: over the plane of the face that was below.
        near = (anew.contact < FAR) & (kept.contact < FAR)
        assert np.abs(kept.contact - anew.contact)[near].max(initial=0.0) < 3e-3
        assert np.abs(kept.world() - anew.world()).max() < 5e-4
    assert kept_faces > 1000  # otherwise nothing was tested


def test_a_dash_that_leaves_the_kept_faces_behind_is_searched_anew() -> None:
    sheet = Sheet()
    for frame in range(20):
        sheet.step(dashing(frame))
    before = sheet.state.contact_faces.copy()
    touched = (before[:, 0] >= 0) & (sheet.state.nearest >= 0)
    after, _ = sheet.step(dashing(20))
    stayed = (after.contact_faces == before).all(axis=1)[touched]
    assert touched.sum() > 50 and stayed.mean() < 0.2
