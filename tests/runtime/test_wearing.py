"""Garments of an outfit that are taken off and put on while it is played."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from assets.io.scene import parse_scene
from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from pbd import InputError
from runtime.game_loop import GameLoop, LiveInput
from runtime.garment_setup import GarmentSetup
from runtime.player import Player
from tests.runtime.players import OUTFIT, outfit_database, random_database
from wrinkles.database import read_database, write_database
from wrinkles.worn_garments import with_garments


def test_garments_are_taken_off_and_put_on_without_a_jump() -> None:
    body = builtin_mannequin()
    motion = ClipMotion(body, "walk")
    player = Player(outfit_database(), body, motion.pose(0.0))

    def play(first: int, last: int) -> None:
        for frame in range(first, last):
            player.update(motion.pose(frame / 60), 1 / 60)

    def world(name: str) -> np.ndarray:
        if player.worn == (name,):
            return player.vertices + player.origin
        layers = player.database.layers
        assert layers is not None
        fine = layers.subdivided(player.levels.subdivision).layer
        return (player.vertices + player.origin)[fine == layers.names.index(name)]

    play(1, 25)
    before, speeds = world("trousers"), player.simulation.state.velocity[:1131].copy()
    player.wear(["trousers"])
    assert player.worn == ("trousers",) and len(player.vertices) == len(before)
    assert np.abs(world("trousers") - before).max() < 1e-5  # what is shown goes on from there
    np.testing.assert_array_equal(player.simulation.state.velocity, speeds)
    play(25, 26)
    moved = np.linalg.norm(world("trousers") - before, axis=1)
    assert 0.0 < np.median(moved) < 0.05
    play(26, 50)
    before = world("trousers")
    player.wear(["skirt", "trousers"])
    assert player.worn == ("trousers", "skirt")
    assert np.abs(world("trousers") - before).max() < 1e-5
    edges = player.simulation.model.mesh.edge_lengths()[0]
    skirt = edges[player.simulation.model.layer[edges[:, 0]] == 1]
    position = player.simulation.state.world()
    lengths = np.linalg.norm(position[skirt[:, 0]] - position[skirt[:, 1]], axis=1)
    rest = player.levels.coarse.vertices
    at_rest = np.linalg.norm(rest[skirt[:, 0]] - rest[skirt[:, 1]], axis=1)
    assert np.percentile(lengths / at_rest, [1, 99]) == pytest.approx([1.0, 1.0], abs=0.35)
    play(50, 75)
    assert np.isfinite(player.vertices).all()
    again = player.vertices.copy()
    player.wear(["trousers"])
    player.wear(["trousers", "skirt"])
    assert len(player.vertices) == len(again)


def test_a_game_loop_lets_go_of_a_vertex_that_went_with_its_garment() -> None:
    body = builtin_mannequin()
    motion, drag = ClipMotion(body, "walk"), [True]
    player = Player(outfit_database(), body, motion.pose(0.0))
    last = player.simulation.model.vertex_count - 1

    def live(t: float) -> LiveInput:
        return LiveInput(motion.pose(t), (0.0, 0.0, 0.0), (last, np.zeros(3)) if drag[0] else None)

    loop = GameLoop(player, live)
    loop.advance(1 / 60)
    player.wear(["skirt"])
    assert last >= player.simulation.model.vertex_count
    drag[0] = False
    loop.advance(1 / 60)
    with pytest.raises(InputError, match="no such simulated vertex"):
        player.drag(last, np.zeros(3))


def test_garments_that_an_outfit_lacks_are_refused() -> None:
    player = Player(outfit_database(), builtin_mannequin())
    for names in ([], ["hat"], ["hat", "skirt"]):
        with pytest.raises(InputError, match="trousers, skirt"):
            player.wear(names)
    assert player.worn == ("trousers", "skirt")


def test_what_is_left_of_an_outfit_is_a_database(tmp_path: Path) -> None:
    database = outfit_database()
    skirt = with_garments(database, ["skirt"])
    assert skirt.layers is None and skirt.garment_name == "skirt" and len(skirt.coarse_vertices) == 624
    write_database(tmp_path / "skirt.h5", skirt)
    read = read_database(tmp_path / "skirt.h5")
    np.testing.assert_array_equal(read.coarse_faces, skirt.coarse_faces)
    body = builtin_mannequin()
    player = Player(read, body)
    both = Player(database, body)
    assert both.levels.layers is not None
    fine = both.levels.layers.subdivided(both.levels.subdivision).layer == 1
    np.testing.assert_allclose(both.levels.fine.vertices[fine], player.levels.fine.vertices, atol=1e-6)


def test_a_fastening_that_was_opened_stays_open_when_garments_change() -> None:
    text = OUTFIT.replace('attach = "top"', 'fasten = "top"')
    player = Player(random_database(GarmentSetup.of(parse_scene(text, "outfit.toml"))), builtin_mannequin())
    player.fasten("skirt", closed=False)
    player.wear(["skirt"])
    player.wear(["trousers", "skirt"])
    assert player.simulation.any_open
    player.fasten("skirt")
    player.wear(["trousers"])
    player.wear(["trousers", "skirt"])
    assert not player.simulation.any_open
