"""Play, pause, step, slow, scrub and drag, without a window."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pbd.wind import Wind
from runtime.play.player import Player
from runtime.viewer import playback as module
from runtime.viewer.playback import Playback
from tests.refusals import refuses
from tests.runtime.players import skirt_database, skirt_stage

TICK = 1.0 / 60.0
HELD = 2


class Counting:
    """A player that counts its ticks and writes down what it is given."""

    def __init__(self) -> None:
        inverse_mass = np.array([1.0, 1.0, 0.0])
        state = SimpleNamespace(world=lambda: np.array([[0.0, 0, 0], [1, 0, 0], [1.1, 0, 0]]))
        self.simulation: Any = SimpleNamespace(model=SimpleNamespace(inverse_mass=inverse_mass), state=state)
        self.ticks, self.alpha = 0, 1.0
        self.poses: list[float] = []
        self.winds: list[Any] = []
        self.drags: list[tuple[int, Any]] = []
        self.timings: dict[str, float] = {}

    def step(self, pose: float, dt: float, wind: Any = None) -> None:
        self.ticks += 1
        self.poses.append(pose)
        self.winds.append(wind)

    def decode(self, alpha: float = 1.0) -> None:
        self.alpha = alpha

    def drag(self, vertex: int, target: Any) -> None:
        self.drags.append((vertex, target))

    def keep(self) -> Any:
        return SimpleNamespace(ticks=self.ticks, byte_count=1000)

    def go_back(self, moment: Any, pose: float) -> None:
        self.ticks, self.poses = moment.ticks, [pose]

    def interpolated(self) -> Any:
        return None


class Walk:
    name, duration, lead_in = "walk", 1.0, 0.0

    def pose(self, t: float) -> float:
        return round(60.0 * t)


@pytest.fixture
def playback() -> Playback:
    return Playback(Counting(), Walk(), TICK)


def advance(playback: Playback, pictures: int) -> None:
    for _ in range(pictures):
        playback.advance(TICK)


def test_a_second_of_the_clock_is_a_second_of_the_garment(playback: Playback) -> None:
    advance(playback, 30)
    assert playback.player.ticks == playback.tick_count == 30
    assert playback.time == pytest.approx(0.5)
    assert playback.player.poses == list(range(1, 31))


def test_slow_time_shows_pictures_between_ticks(playback: Playback) -> None:
    playback.speed = 0.25
    alphas = []
    for _ in range(4):
        playback.advance(TICK)
        alphas.append(playback.player.alpha)
    assert alphas == pytest.approx([0.25, 0.5, 0.75, 1.0])
    assert playback.tick_count == 1
    playback.advance(TICK)
    assert playback.time == pytest.approx(1.25 * TICK)


def test_a_pause_stops_time_and_makes_up_for_nothing(playback: Playback) -> None:
    playback.advance(TICK)
    playback.playing = False
    playback.advance(10.0)
    assert playback.tick_count == 1
    playback.playing = True
    playback.advance(TICK)
    assert playback.tick_count == 2


def test_the_motion_starts_again_after_its_end(playback: Playback) -> None:
    advance(playback, 60)
    assert playback.time == pytest.approx(playback.duration)
    playback.advance(TICK)
    assert playback.tick_count == playback.player.ticks == 1


def test_a_late_picture_does_not_pass_the_end(playback: Playback) -> None:
    advance(playback, 58)
    playback.advance(1.0)
    assert playback.tick_count == 60
    assert playback.player.poses[-1] == 60


def test_steps_pause_and_go_a_tick_on_and_back(playback: Playback) -> None:
    advance(playback, 10)
    playback.step(1)
    assert (playback.tick_count, playback.playing) == (11, False)
    playback.step(-1)
    assert playback.tick_count == playback.player.ticks == 10
    assert playback.player.poses == [10]


def test_a_step_ends_a_begun_tick_first(playback: Playback) -> None:
    playback.speed = 0.5
    playback.advance(TICK)
    assert playback.player.alpha == pytest.approx(0.5)
    playback.step(1)
    assert (playback.tick_count, playback.player.alpha) == (1, 1.0)
    playback.step(1)
    assert playback.tick_count == 2


def test_no_step_leads_beyond_the_ends(playback: Playback) -> None:
    playback.step(-1)
    assert playback.tick_count == 0
    playback.step(100)
    assert playback.tick_count == 60


def test_scrubbing_shows_what_was_played_and_plays_on_from_there(playback: Playback) -> None:
    advance(playback, 40)
    playback.scrub(0.25)
    assert (playback.tick_count, playback.player.ticks, playback.playing) == (15, 15, False)
    playback.playing = True
    playback.advance(TICK)
    assert playback.tick_count == playback.player.ticks == 16
    assert playback.player.poses[-1] == 16


def test_scrubbing_beyond_what_was_played_shows_the_last_kept_moment(playback: Playback) -> None:
    advance(playback, 20)
    playback.scrub(0.9)
    assert playback.tick_count == 19
    playback.scrub(-3.0)
    assert playback.tick_count == 0
    refuses("bad time", playback.scrub, float("nan"))


def test_film_takes_no_more_memory_than_it_may(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FILM_BYTES", 20_000.0)
    playback = Playback(Counting(), Walk(), TICK)
    advance(playback, 200)
    assert playback.stride == 4
    assert playback.kept_ticks == list(range(0, 60, 4))
    assert 1000 * len(playback.kept_ticks) <= 20_000
    playback.scrub(39 * TICK)
    assert playback.tick_count == playback.player.ticks == 36


def test_what_is_dragged_is_held_in_every_tick_until_it_is_let_go(playback: Playback) -> None:
    player = playback.player
    assert playback.nearest_free_vertex(np.array([1.2, 0.0, 0.0])) == 1  # the nearest one is held by the body
    playback.drag(1, np.array([2.0, 0.0, 0.0]))
    playback.advance(TICK)
    playback.drag(1, np.array([3.0, 0.0, 0.0]))
    playback.advance(TICK)
    playback.release()
    advance(playback, 2)
    assert [(vertex, None if target is None else target[0]) for vertex, target in player.drags] == [
        (1, 2.0),
        (1, 3.0),
        (1, None),
    ]


@pytest.mark.parametrize(
    ("vertex", "target", "message"),
    [
        (HELD, np.zeros(3), "no vertex to drag"),
        (3, np.zeros(3), "no vertex to drag"),
        (-1, np.zeros(3), "no vertex to drag"),
        (0, np.array([0.0, np.inf, 0.0]), "bad target"),
        (0, np.zeros(2), "bad target"),
    ],
)
def test_what_cannot_be_dragged_is_refused(playback: Playback, vertex: int, target: np.ndarray, message: str) -> None:
    refuses(message, playback.drag, vertex, target)
    assert playback.dragged is None


def test_wind_blows_from_the_next_tick_on(playback: Playback) -> None:
    playback.advance(TICK)
    playback.wind = Wind((3.0, 0.0, 0.0))
    playback.advance(TICK)
    assert [wind.velocity for wind in playback.player.winds] == [(0.0, 0.0, 0.0), (3.0, 0.0, 0.0)]


def test_a_real_player_repeats_what_it_has_played() -> None:
    """Up to the relaxation's memory, the same moment is shown again, and the same future follows."""
    stage = skirt_stage()
    motion = stage.motion()
    player = Player(skirt_database(), stage.body, motion.pose(0.0))
    playback = Playback(player, motion, TICK)
    seen = {}
    for tick in range(1, 13):
        playback.advance(TICK)
        seen[tick] = player.vertices + player.origin
    playback.scrub(8 * TICK)
    assert np.abs(player.vertices + player.origin - seen[8]).max() < 1e-4
    playback.playing = True
    advance(playback, 4)
    assert playback.tick_count == 12
    assert np.abs(player.vertices + player.origin - seen[12]).max() < 1e-4
    assert np.abs(seen[12] - seen[8]).max() > 1e-3


def test_a_moment_in_which_a_vertex_was_dragged_leaves_it_free() -> None:
    stage = skirt_stage()
    motion = stage.motion()
    player = Player(skirt_database(), stage.body, motion.pose(0.0))
    playback = Playback(player, motion, TICK)
    vertex = playback.nearest_free_vertex(np.array([0.0, 0.0, 1.0]))
    playback.drag(vertex, player.simulation.state.world()[vertex] + [0.0, 0.0, 0.05])
    playback.step(3)
    assert player.simulation.state.position[vertex, 3] == 0.0
    playback.release()
    playback.step(-1)
    assert player.simulation.state.position[vertex, 3] == player.simulation.model.inverse_mass[vertex] > 0.0
