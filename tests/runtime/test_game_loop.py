import math
import time
import tracemalloc
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from runtime.play.game_loop import GameLoop, LiveInput, ScriptedInput
from runtime.play.player import Player
from tests.refusals import refuses
from tests.runtime.players import skirt_database

TICK = 1.0 / 60.0
POSE = np.zeros((1, 3, 4))
READING = 1e-6  # what one look at the fake clock takes [s]


class FakeClock:
    def __init__(self) -> None:
        self.now = 1000.0
        self.slept: list[float] = []

    def __call__(self) -> float:
        self.now += READING
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


class FakePlayer:
    """Writes down what it is told; takes the fake time that `cost` says for each decode."""

    def __init__(self, clock: FakeClock | None = None, cost: Any = lambda frame: 0.0) -> None:
        self.calls: list[tuple] = []
        self.alphas: list[float] = []
        self._clock, self._cost = clock, cost

    def step(self, pose: np.ndarray, dt: float, wind: tuple = (0.0, 0.0, 0.0)) -> None:
        self.calls.append(("step", pose[0, 0, 3], dt, wind))

    def decode(self, alpha: float = 1.0) -> None:
        if self._clock is not None:
            self._clock.now += self._cost(len(self.alphas))
        self.alphas.append(alpha)

    def drag(self, vertex: int, target: np.ndarray | None) -> None:
        self.calls.append(("drag", vertex, None if target is None else tuple(target)))


def live(t: float) -> LiveInput:
    """A pose that tells its time, wind in the second half second, vertex 3 held for 0.2 s, then at once vertex 4."""
    pose = POSE.copy()
    pose[0, 0, 3] = t
    drag = None
    if 0.2 <= t < 0.6:
        drag = (3 if t < 0.4 else 4, np.array([t, 1.0, 2.0]))
    return LiveInput(pose, (2.0, 0.0, 0.0) if t >= 0.5 else (0.0, 0.0, 0.0), drag)


def played(rate_hz: float, seconds: float = 1.0, cost: Any = lambda frame: 0.0, **options: Any) -> tuple:
    clock = FakeClock()
    player = FakePlayer(clock, cost)
    loop = GameLoop(player, live, rate_hz, clock=clock, sleep=clock.sleep, **options)
    loop.run(seconds)
    return loop, player, clock


@pytest.mark.parametrize("rate_hz", [24.0, 30.0, 50.0, 75.0, 144.0])
def test_ticks_do_not_depend_on_the_frame_rate(rate_hz: float) -> None:
    _, at_60, _ = played(60.0)
    loop, player, _ = played(rate_hz)
    assert loop.tick_count == 60
    assert player.calls == at_60.calls


@pytest.mark.parametrize(("rate_hz", "ticks"), [(60.0, 1), (30.0, 2)])
def test_every_frame_has_the_same_number_of_ticks_and_shows_the_last(rate_hz: float, ticks: int) -> None:
    loop, player, _ = played(rate_hz, 20.0)
    assert loop.frames_of_ticks[ticks] == 20.0 * rate_hz == loop.frames_of_ticks.sum()
    assert set(player.alphas) == {1.0}


def test_input_is_asked_for_the_end_of_each_tick() -> None:
    _, player, _ = played(30.0, 0.1)
    assert [call[1:3] for call in player.calls] == [(k * TICK, TICK) for k in range(1, 7)]


def test_pictures_between_ticks_are_made_for_the_time_of_the_frame() -> None:
    clock, player = FakeClock(), FakePlayer()
    loop = GameLoop(player, live, 144.0, clock=clock, sleep=clock.sleep)
    shown = []
    loop.run(0.5, show=lambda: shown.append((loop.tick_count - 1.0 + loop.alpha) * TICK))
    np.testing.assert_allclose(shown, np.arange(1, 73) / 144.0, atol=1e-9)
    assert len(player.alphas) == 72 and len(set(np.round(player.alphas, 6))) > 3


def test_a_drag_is_applied_and_let_go() -> None:
    _, player, _ = played(60.0)
    drags = [call[1:] for call in player.calls if call[0] == "drag"]
    held_3, held_4 = range(12, 24), range(24, 36)
    assert drags == [
        *((3, (k * TICK, 1.0, 2.0)) for k in held_3),
        (3, None),
        *((4, (k * TICK, 1.0, 2.0)) for k in held_4),
        (4, None),
    ]


def test_wind_reaches_the_player() -> None:
    _, player, _ = played(60.0)
    winds = [call[3] for call in player.calls if call[0] == "step"]
    assert winds[:29] == [(0.0, 0.0, 0.0)] * 29 and winds[29:] == [(2.0, 0.0, 0.0)] * 31


def test_a_hiccup_is_made_up_for_by_max_ticks_at_most() -> None:
    ticks: list[int] = []
    clock = FakeClock()
    player = FakePlayer(clock, lambda frame: 0.5 if frame == 10 else 0.001)
    loop = GameLoop(player, live, 60.0, clock=clock, sleep=clock.sleep)
    figures = loop.run(2.0, show=lambda: ticks.append(loop.tick_count))
    assert np.diff(ticks).tolist()[9:13] == [1, 4, 1, 1]
    assert figures["missed_deadlines"] == 30.0  # half a second without a picture
    # Frame 11 is shown 31 periods after its start instead of one.
    assert figures["dropped_time_s"] == pytest.approx(31 * TICK - 4 * TICK)
    assert figures["frames_of_4_ticks"] == 1.0
    assert loop.tick_count * TICK + figures["dropped_time_s"] == pytest.approx(2.0)


def test_a_short_hiccup_is_made_up_for_in_full() -> None:
    loop, player, _ = played(60.0, 1.0, lambda frame: 2.5 * TICK if frame == 10 else 0.0)
    assert (loop.dropped_time, loop.missed_deadlines, loop.tick_count) == (0.0, 2, 60)
    assert loop.frames_of_ticks.tolist() == [0, 57, 0, 1, 0]


def test_frames_that_always_take_too_long_slow_the_garment_but_do_not_pile_up() -> None:
    """Each tick of simulated time costs two of real time."""
    clock = FakeClock()

    class SlowPlayer(FakePlayer):
        def step(self, pose: np.ndarray, dt: float, wind: tuple = (0.0, 0.0, 0.0)) -> None:
            clock.now += 2.0 * TICK
            super().step(pose, dt, wind)

    loop = GameLoop(SlowPlayer(), live, 60.0, clock=clock, sleep=clock.sleep)
    figures = loop.run(10.0)
    assert clock.now - 1000.0 < 10.0 + 9.0 * TICK
    # Every frame is late; every one of the 600 periods, and what the last frame reaches past them, is one or the other.
    assert figures["missed_deadlines"] > figures["frame_count"] > 60
    assert 600 <= figures["frame_count"] + figures["missed_deadlines"] < 609
    assert figures["dropped_time_s"] == pytest.approx(5.0, abs=0.5)


def test_deadlines_are_kept_on_the_grid_of_the_start() -> None:
    """No drift: what one wait is late, the next makes up."""
    clock = FakeClock()
    begun: list[float] = []

    class Player(FakePlayer):
        def decode(self, alpha: float = 1.0) -> None:
            begun.append(clock.now)
            clock.now += 0.004

    loop = GameLoop(Player(), live, 60.0, clock=clock, sleep=lambda seconds: clock.sleep(seconds + 0.0007))
    figures = loop.run(5.0)
    late = np.array(begun) - 1000.0 - np.arange(300) * TICK
    assert late.min() > 0.0 and late.max() < 10 * READING
    assert figures["missed_deadlines"] == 0.0
    assert figures["frame_ms_p50"] == pytest.approx(4.0, abs=0.01)


def test_waiting_sleeps_all_but_the_last_millisecond() -> None:
    _, _, clock = played(60.0, 1.0, lambda frame: 0.005)
    np.testing.assert_allclose(clock.slept, TICK - 0.005 - 0.001, atol=1e-4)


def test_waking_after_the_deadline_is_a_missed_deadline() -> None:
    clock = FakeClock()
    naps = iter([0.0, 0.0, 0.05] + [0.0] * 100)
    loop = GameLoop(FakePlayer(), live, 60.0, clock=clock, sleep=lambda s: clock.sleep(s + next(naps)))
    figures = loop.run(1.0)
    assert figures["missed_deadlines"] == 2.0 and loop.tick_count == 60


def test_no_time_changes_nothing() -> None:
    player = FakePlayer()
    loop = GameLoop(player, live)
    loop.advance(1.3 * TICK)
    before = list(player.calls), list(player.alphas), loop.alpha
    assert loop.advance(0.0) == 0
    loop.paused = True
    assert loop.advance(0.7) == 0
    assert (player.calls, player.alphas, loop.alpha) == before
    loop.paused = False
    assert loop.advance(TICK) == 1  # what passed during the pause is not made up for
    assert loop.dropped_time == 0.0


def test_a_pause_during_a_run_makes_no_ticks() -> None:
    clock, player = FakeClock(), FakePlayer()
    loop = GameLoop(player, live, 60.0, clock=clock, sleep=clock.sleep)
    frames = iter(range(60))

    def show() -> None:
        loop.paused = 19 <= next(frames) < 39

    figures = loop.run(1.0, show)
    assert (loop.tick_count, figures["frames_of_0_ticks"], figures["dropped_time_s"]) == (40, 20.0, 0.0)
    assert [call[1] for call in player.calls if call[0] == "step"] == [k * TICK for k in range(1, 41)]


def test_elapsed_times_that_waver_make_the_ticks_of_their_sum() -> None:
    rng = np.random.default_rng(0)
    player = FakePlayer()
    loop = GameLoop(player, live)
    total = 0.0
    for elapsed in rng.uniform(0.0, 0.03, 500):
        loop.advance(elapsed)
        total += elapsed
        assert (loop.tick_count - 1.0 + loop.alpha) * TICK == pytest.approx(total, abs=1e-7)
    assert [call[:3] for call in player.calls if call[0] == "step"] == [
        ("step", k * TICK, TICK) for k in range(1, math.ceil(total / TICK) + 1)
    ]


def test_figures_of_a_run_that_was_broken_off() -> None:
    clock = FakeClock()
    loop = GameLoop(FakePlayer(clock, lambda frame: 0.002), live, clock=clock, sleep=clock.sleep)
    frames = iter(range(5))
    with pytest.raises(StopIteration):
        loop.run(10.0, show=lambda: next(frames))
    assert loop.figures()["frame_count"] == 5.0
    assert loop.figures()["frame_ms_p99"] == pytest.approx(2.0, abs=0.01)


def test_a_frame_allocates_no_arrays() -> None:
    class NoPlayer(FakePlayer):
        def step(self, pose: np.ndarray, dt: float, wind: tuple = (0.0, 0.0, 0.0)) -> None: ...

        def decode(self, alpha: float = 1.0) -> None: ...

    still = LiveInput(POSE)
    loop = GameLoop(NoPlayer(), lambda t: still)
    loop.advance(TICK)
    tracemalloc.start()
    try:
        for _ in range(1000):
            loop.advance(TICK)
        kept, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 1000 and most < 2000  # [bytes]


def test_the_clock_of_this_machine() -> None:
    """Without a clock that is given, frames wait for the time of this one."""
    loop = GameLoop(FakePlayer(), live, 60.0)
    began = time.perf_counter()
    figures = loop.run(0.1)
    assert time.perf_counter() - began >= 0.1
    assert figures["frame_count"] + figures["missed_deadlines"] >= 6 and figures["frame_ms_p50"] > 0.0


@pytest.mark.parametrize(
    ("key", "options"),
    [
        ("rate_hz", {"rate_hz": 0.0}),
        ("rate_hz", {"rate_hz": math.nan}),
        ("tick", {"tick": -TICK}),
        ("tick", {"tick": math.inf}),
        ("max_ticks", {"max_ticks": 0}),
        ("max_ticks", {"rate_hz": 30.0, "max_ticks": 1}),
    ],
)
def test_bad_settings_are_refused(key: str, options: dict[str, Any]) -> None:
    refuses(key, GameLoop, FakePlayer(), live, **options)


@pytest.mark.parametrize("elapsed", [-1e-3, math.nan, math.inf])
def test_bad_elapsed_times_are_refused(elapsed: float) -> None:
    refuses("elapsed", GameLoop(FakePlayer(), live).advance, elapsed)


@pytest.mark.parametrize("seconds", [0.0, -1.0, 0.001, math.nan, math.inf])
def test_bad_lengths_are_refused(seconds: float) -> None:
    refuses("seconds", GameLoop(FakePlayer(), live).run, seconds)


@pytest.fixture(scope="module")
def motion() -> ClipMotion:
    character = builtin_mannequin()
    return ClipMotion(character, character.clips["twirl"], blend=0.0)


def scripted_run(motion: ClipMotion, rate_hz: float, slow: bool = False) -> tuple:
    """The real player, by a clock that stands still while it works."""
    seconds = 0.7
    player = Player(skirt_database(), builtin_mannequin(), motion.pose(0.0))
    clock, hashes = FakeClock(), {}
    loop = GameLoop(player, ScriptedInput(player.simulation, motion, seconds), rate_hz, clock=clock, sleep=clock.sleep)

    def show() -> None:
        hashes[loop.tick_count] = player.simulation.state.hash()
        if slow and loop.tick_count == 30:
            clock.now += 2.2 * TICK

    loop.run(seconds, show)
    assert loop.tick_count == 42 and loop.dropped_time == 0.0
    return player, hashes


def test_the_garment_is_the_same_at_30_and_60_hz(motion: ClipMotion) -> None:
    """Also where pictures between two ticks are decoded, and where a frame is late."""
    at_60, hashes = scripted_run(motion, 60.0)
    assert len(set(hashes.values())) == 42
    at_30, hashes_30 = scripted_run(motion, 30.0)
    assert len(hashes_30) == 21 and hashes_30.items() <= hashes.items()
    np.testing.assert_array_equal(at_30.vertices, at_60.vertices)
    _, hashes_100 = scripted_run(motion, 100.0, slow=True)
    assert 35 < len(hashes_100) < 42 and hashes_100.items() <= hashes.items()


def test_the_scripted_gust_and_drag_move_the_garment(motion: ClipMotion) -> None:
    player = Player(skirt_database(), builtin_mannequin(), motion.pose(0.0))
    simulation = player.simulation
    script = ScriptedInput(simulation, motion, 0.6)
    model, vertex = simulation.model, script.vertex
    assert model.mesh.vertices[vertex, 1] < model.mesh.vertices[:, 1].min() + 0.05
    assert model.mesh.vertices[vertex, 2] > model.mesh.vertices[:, 2].mean()
    loop = GameLoop(player, script)
    targets, gaps = {}, []
    for tick in range(1, 61):
        before = simulation.state.world()[vertex]
        t = tick * TICK
        loop.advance(TICK)
        held = simulation.state.position[vertex, 3] == 0.0
        begin, end = script.drag_time
        assert held == (begin <= t < end)
        if held:
            targets[tick] = simulation.state.world()[vertex]
            gaps.append(np.linalg.norm(targets[tick] - before))
    assert max(gaps) < 0.1  # taken where it is and moved without jumps
    assert len(targets) == 30
    assert simulation.state.position[vertex, 3] == model.inverse_mass[vertex]
    assert np.isfinite(player.vertices).all()


@pytest.fixture
def four_vertices() -> Any:
    """A held vertex and three free ones, moved 3 m along from where they were made."""
    rest = np.array([[0.0, 1.0, 0.0], [0.0, 0.5, 0.1], [0.0, 0.0, 0.2], [0.0, 0.0, 0.1]])
    world = rest + [3.0, 0.0, 0.0]
    model = SimpleNamespace(mesh=SimpleNamespace(vertices=rest), inverse_mass=np.array([0.0, 1.0, 1.0, 1.0]))
    return SimpleNamespace(model=model, state=SimpleNamespace(world=lambda: world))


def test_the_script_says_the_same_again(motion: ClipMotion, four_vertices: Any) -> None:
    script = ScriptedInput(four_vertices, motion, 5.0, gust=(0.0, 0.0, 4.0), pull=0.2)
    times = np.arange(0.0, 5.0, TICK)
    first, second = [script(t) for t in times], [script(t) for t in times]
    for a, b in zip(first, second, strict=True):
        assert a.wind == b.wind and (a.drag is None) == (b.drag is None)
        np.testing.assert_array_equal(a.pose, b.pose)
        if a.drag is not None and b.drag is not None:
            np.testing.assert_array_equal(a.drag[1], b.drag[1])


def test_the_scripted_gust_swells_and_ebbs_in_the_middle(motion: ClipMotion, four_vertices: Any) -> None:
    script = ScriptedInput(four_vertices, motion, 5.0, gust=(0.0, 0.0, 4.0))
    times = np.arange(0.0, 5.0, TICK)
    blowing = np.array([script(t).wind[2] for t in times])
    np.testing.assert_array_equal(blowing > 0.0, (times > 2.0) & (times < 3.0))
    assert blowing.max() == pytest.approx(4.0, rel=1e-2)
    assert np.abs(np.diff(blowing)).max() < 0.3  # [m/s] a tick


def test_the_scripted_drag_takes_a_vertex_where_it_is_and_draws_it_outwards(four_vertices: Any) -> None:
    still: Any = SimpleNamespace(pose=lambda t: np.tile(np.eye(3, 4), (2, 1, 1)))
    script = ScriptedInput(four_vertices, still, 5.0, pull=0.2)
    drags = [script(t).drag for t in np.arange(0.0, 5.0, TICK)]
    assert [drag is not None for drag in drags] == [210 <= k < 240 for k in range(300)]
    held = [drag for drag in drags if drag is not None]
    assert {vertex for vertex, _ in held} == {2}
    targets = np.array([target for _, target in held])
    np.testing.assert_allclose(targets[0], [3.0, 0.0, 0.2], atol=1e-12)
    np.testing.assert_allclose(targets[-1], [3.0, 0.0, 0.4], atol=2e-3)
    assert (np.diff(targets[:, 2]) > 0.0).all()
    four_vertices.state.world()[2] = [5.0, 1.0, 1.0]  # taken again, it is taken where it is by then
    again = script(script.drag_time[0]).drag
    np.testing.assert_allclose(again[1], [5.0, 1.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("of", ["character", "sequence"])
def test_the_scripted_drag_goes_along_with_the_body(of: str, four_vertices: Any) -> None:
    def pose(t: float) -> np.ndarray:
        """A body that walks at 1 m/s along Z."""
        if of == "sequence":
            return np.array([[0.0, 0.0, t], [0.0, 1.0, t]])
        matrices = np.tile(np.eye(3, 4), (2, 1, 1))
        matrices[:, 2, 3] = t
        return matrices

    walking: Any = SimpleNamespace(pose=pose)
    script = ScriptedInput(four_vertices, walking, 5.0, pull=0.0)
    first, last = script(3.5).drag, script(3.9).drag
    np.testing.assert_allclose(last[1] - first[1], [0.0, 0.0, 0.4], atol=1e-12)
