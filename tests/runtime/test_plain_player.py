"""Plain cloth from a database: it is played where it is the better choice, and dragged and refused as wrinkles are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pbd import InputError
from runtime.cli import command
from runtime.play.game_loop import GameLoop, LiveInput
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.plain_cloth import PlainCloth, middle_levels, plain_choice
from runtime.play.player import Player, player_of
from runtime.play.simulation import body_source, poses_of
from tests.runtime.players import skirt_database, skirt_stage
from wrinkles.database import CHOICE, WrinkleDatabase
from wrinkles.database_file import write_database
from wrinkles.surface import Subdivision

TWICE = skirt_database(subdivisions=2)
COUNTS = [
    len(TWICE.coarse_vertices),
    *(Subdivision.of(TWICE.coarse_faces, len(TWICE.coarse_vertices), cuts).fine_count for cuts in (1, 2)),
]


def judged(cuts: int, ratio: float = 0.5, at_least: float = 0.0, passes: int = 0) -> WrinkleDatabase:
    """A database with a comparison's figures."""
    figures = dict(zip(CHOICE, (ratio, at_least, 2.0, 5.0, float(COUNTS[cuts]), float(passes)), strict=True))
    return skirt_database(subdivisions=2, quality=figures)


@pytest.fixture(scope="module")
def poses() -> np.ndarray:
    stage = skirt_stage()
    return poses_of(stage.motion(stage.scene.training.held_out[0]), 1.0 / 60.0, 0.5)


def test_plain_cloth_is_chosen_where_it_is_cheaper_and_as_good() -> None:
    assert plain_choice(TWICE) is None
    assert [plain_choice(judged(cuts)) for cuts in range(3)] == [PlainCloth(cuts, 5) for cuts in range(3)]
    assert plain_choice(judged(1, passes=1)) == PlainCloth(1, 5, passes=1)
    assert plain_choice(judged(1, ratio=1.0)) is None
    assert plain_choice(judged(1, at_least=1.0)) is None


def test_the_choice_is_not_that_of_another_fabric() -> None:
    database = judged(1)
    quality = {**database.quality, "normal_skill": 0.5}
    both = skirt_database(subdivisions=2, quality=quality, other_fabrics={"denim": database.fabric})
    assert plain_choice(both.in_fabric("denim")) is None
    assert both.in_fabric("denim").quality == {"normal_skill": 0.5}
    assert plain_choice(both.in_fabric(both.fabric_name)) == PlainCloth(1, 5)


@pytest.mark.parametrize("cuts", [0, 1, 2])
def test_it_starts_as_the_smooth_garment_and_stays_attached(cuts: int, poses: np.ndarray) -> None:
    body, database = skirt_stage().body, judged(cuts)
    player, wrinkled = player_of(database, body, poses[0]), Player(database, body, poses[0])
    assert player.cloth == PlainCloth(cuts, 5)
    assert player.simulation.model.vertex_count == COUNTS[cuts]
    substep = player.simulation.solver.options.substep
    assert substep == pytest.approx(1.0 / (60.0 * 5))
    np.testing.assert_allclose(player.smooth(), wrinkled.smooth(), atol=1e-3)  # not yet moved
    for pose in poses[1:]:
        player.update(pose, 1.0 / 60.0)
    np.testing.assert_allclose(np.linalg.norm(player.normals, axis=1), 1.0, atol=1e-5)
    targets = player.levels.fine_attachment.targets(player.body_vertices)
    assert np.linalg.norm(player.vertices[player.levels.fine_held] - targets, axis=1).max() < 1e-3
    assert player.timings["frame"] == pytest.approx(sum(t for part, t in player.timings.items() if part != "frame"))


@pytest.mark.parametrize("cuts", [0, 1])
def test_its_fine_mesh_comes_to_rest(cuts: int, poses: np.ndarray) -> None:
    body, database = skirt_stage().body, judged(cuts)
    smooth, rested = (Player(database, body, poses[0], cloth=PlainCloth(cuts, 5, passes)) for passes in (0, 4))
    for pose in poses[1:]:
        smooth.update(pose, 1.0 / 60.0)
        rested.update(pose, 1.0 / 60.0)
    assert smooth.simulation.state.hash() == rested.simulation.state.hash()  # what is shown does not act back
    edges, lengths = rested.levels.fine.edge_lengths()

    def stretch(player: Player) -> float:
        sides = player.vertices[edges[:, 0]] - player.vertices[edges[:, 1]]
        return float(np.abs(np.linalg.norm(sides, axis=1) / lengths - 1.0).mean())

    assert stretch(rested) < 0.6 * stretch(smooth)
    simulated = middle_levels(database, body_source(body)) if cuts else rested.levels
    assert simulated is not None
    targets = simulated.fine_attachment.targets(rested.body_vertices)
    np.testing.assert_allclose(rested.vertices[simulated.fine_held], targets, rtol=0.0, atol=1e-7)  # float32


def test_a_kept_moment_comes_back_with_its_rest(poses: np.ndarray) -> None:
    cloth, body = PlainCloth(1, 4, 1), skirt_stage().body
    player, other = (Player(TWICE, body, poses[0], cloth=cloth) for _ in range(2))
    for pose in poses[1:4]:
        player.update(pose, 1.0 / 60.0)
        other.update(pose, 1.0 / 60.0)
    moment = player.keep()
    for pose in poses[4:9]:
        player.update(pose, 1.0 / 60.0)
    player.go_back(moment, poses[3])
    other.decode()  # as often as the one that went back
    np.testing.assert_array_equal(player.vertices, other.vertices)
    for one, two in zip(player.keep().memory, other.keep().memory, strict=True):
        np.testing.assert_array_equal(one, two)


def test_the_wrinkles_are_played_where_they_are_asked_for(poses: np.ndarray) -> None:
    assert player_of(judged(1), skirt_stage().body, poses[0], wrinkles=True).cloth is None


def test_warming_up_leaves_no_trace(poses: np.ndarray) -> None:
    one, other = (player_of(judged(1), skirt_stage().body, poses[0]) for _ in range(2))
    assert one.simulation.time == 0.0
    for pose in poses[1:4]:
        one.update(pose, 1.0 / 60.0)
        other.update(pose, 1.0 / 60.0)
    assert one.simulation.state.hash() == other.simulation.state.hash()


def test_a_game_loop_plays_it_between_ticks(poses: np.ndarray) -> None:
    player = player_of(judged(1), skirt_stage().body, poses[0])
    loop = GameLoop(player, lambda t: LiveInput(poses[round(60.0 * t)]), 120.0)
    loop.advance(1.0 / 60.0)
    before = player.vertices.copy()
    loop.advance(1.0 / 120.0)
    between = player.vertices.copy()
    loop.advance(1.0 / 120.0)
    np.testing.assert_allclose(between, 0.5 * (before + player.vertices), atol=1e-5)


def test_bad_input_is_refused(poses: np.ndarray) -> None:
    body = skirt_stage().body
    wrong = (3, 5), (-1, 5), (1, 0), (1, 5, -1), (2, 5, 1)
    for cloth in (PlainCloth(*values) for values in wrong):
        with pytest.raises(InputError, match="plain cloth"):
            Player(TWICE, body, poses[0], cloth=cloth)
    player = Player(TWICE, body, poses[0], cloth=PlainCloth(1, 4))
    state = player.simulation.state.hash()
    for pose, dt, match in ((poses[0][1:], 0.01, "pose"), (poses[0], -1.0, "time"), (poses[0] * np.nan, 0.01, "pose")):
        with pytest.raises(InputError, match=match):
            player.step(pose, dt)
    with pytest.raises(InputError, match="simulated vertex"):
        player.drag(COUNTS[1], np.zeros(3))
    assert player.simulation.state.hash() == state


def test_it_leaves_ticks_and_passes_out(poses: np.ndarray) -> None:
    cloth, body = PlainCloth(1, 4, 2), skirt_stage().body
    player, full = (Player(TWICE, body, poses[0], cloth=cloth) for _ in range(2))
    assert player.detail == player.full == LevelOfDetail(1, 4, 0, 2)
    for one in (player, full):
        one.update(poses[1], 1.0 / 60.0)
    shown = player.vertices.copy()
    player.change(LevelOfDetail(2, 8, 0, 0))
    np.testing.assert_array_equal(player.vertices, shown)  # nothing pops
    for number in range(2, 6):
        before = player.simulation.state.hash()
        player.update(poses[number], 1.0 / 60.0)
        full.update(poses[number], 1.0 / 60.0)
        assert (player.simulation.state.hash() == before) == (number % 2 == 1)
        assert np.abs(player.vertices - full.vertices).max() < 0.02
    with pytest.raises(InputError, match="no such mesh"):
        player.change(LevelOfDetail(1, 4, 0, 0, level=1))


def test_a_coarse_vertex_is_dragged_by_its_number(poses: np.ndarray) -> None:
    player = Player(TWICE, skirt_stage().body, poses[0], cloth=PlainCloth(1, 4))
    vertex = int(np.setdiff1d(np.arange(COUNTS[0]), TWICE.held)[-1])
    target = player.simulation.state.world()[vertex] + [0.0, 0.03, 0.0]
    player.drag(vertex, target)
    for pose in poses[1:10]:
        player.update(pose, 1.0 / 60.0)
    np.testing.assert_allclose(player.simulation.state.world()[vertex], target, atol=1e-5)


def test_gube_play_says_and_shows_what_it_plays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "skirt.h5"
    write_database(path, judged(1))
    arguments = ["play", str(path), "--seconds", "0.4", "-o", str(tmp_path / "out")]
    assert command.main(arguments) == 0
    played = f"({COUNTS[1]:,} points in 5 steps) is as good and takes"
    assert played in (out := capsys.readouterr().out) and "--wrinkles plays the learned folds." in out
    assert command.main(["play", str(path), "--loop", "0.2"]) == 0
    assert command.main(["bake", str(path), "--seconds", "0.1", "-o", str(tmp_path / "skirt.obj")]) == 0
    assert capsys.readouterr().out.count(played) == 2
    assert command.main([*arguments, "--wrinkles"]) == 0
    assert "\nHere the learned folds are played.\n" in capsys.readouterr().out
