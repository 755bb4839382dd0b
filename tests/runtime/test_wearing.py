"""Garments of an outfit that are taken off and put on while it is played."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from assets.io.scene import parse_scene
from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from pbd import Fabric, State
from pbd.layers import layered
from runtime.play.dressing import Stay, take_over
from runtime.play.game_loop import GameLoop, LiveInput
from runtime.play.player import Player
from runtime.play.simulation import Simulation
from runtime.setup.garment_setup import GarmentSetup
from tests.pbd.meshes import cloth, free_model, grid
from tests.refusals import refuses
from tests.runtime.players import OUTFIT, outfit_database, random_database
from wrinkles.database_file import read_database, write_database
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
    refuses("no such simulated vertex", player.drag, last, np.zeros(3))


@pytest.mark.proof
def test_creases_stay_in_what_stays_on() -> None:
    """A skirt with internal friction over trousers without it; what is put on again has creases of its own."""
    fabric = "fabric = { bend_hysteresis_warp = 1e-3, bend_hysteresis_weft = 1e-3 }"
    text = OUTFIT.replace('attach = "top"', f'attach = "top"\n{fabric}')
    body = builtin_mannequin()
    motion = ClipMotion(body, "walk")
    player = Player(random_database(GarmentSetup.of(parse_scene(text, "outfit.toml"))), body, motion.pose(0.0))
    for frame in range(1, 25):
        player.update(motion.pose(frame / 60), 1 / 60)
    before = creases(player, "skirt")
    assert np.count_nonzero(before) > 100
    for names in (["skirt"], ["trousers", "skirt"]):
        player.wear(names)
        np.testing.assert_array_equal(creases(player, "skirt"), before)
    player.wear(["trousers"])
    player.wear(["trousers", "skirt"])
    assert not np.array_equal(creases(player, "skirt"), before)


def creases(player: Player, name: str) -> np.ndarray:
    """Of the hinges of a garment, in the order of their vertices."""
    model, number = player.simulation.model, player.worn.index(name)
    mine = model.layer[model.hinges[:, 0]] == number
    order = np.lexsort(model.hinges[mine].T)
    return player.simulation.state.plastic_bends[model.hinge_numbers[mine][order]]


def test_creases_and_shears_go_over_by_vertices() -> None:
    """From two layers of which one has internal friction to that one alone, and back."""
    fabric = Fabric(bend_hysteresis_warp=1e-3, shear_hysteresis=1.0)
    rubs, free = (free_model(cloth(*grid(4, 4, 0.05)), one) for one in (fabric, Fabric()))
    both, count = layered([free, rubs]), rubs.vertex_count
    alone, outer = np.arange(count), np.arange(count) + count
    before, now = (SimpleNamespace(model=model, state=State.at_rest(model)) for model in (rubs, both))
    for simulation in (before, now):
        simulation.body, simulation.colliders, simulation.time = None, None, 0.0
    before.state.plastic_bends[rubs.hinge_numbers] = 1.0 + np.arange(len(rubs.hinges))
    before.state.plastic_shears[rubs.triangle_numbers] = 1.0 + np.arange(len(rubs.triangles))
    kept = before.state.copy()
    now.state.plastic_bends[:] = -1.0  # of an earlier time
    none = alone[:0]
    take_over(cast(Simulation, before), cast(Simulation, now), Stay(outer, alone, none, none, alone))
    assert sorted(now.state.plastic_bends[now.state.plastic_bends != 0.0]) == sorted(kept.plastic_bends)
    assert sorted(now.state.plastic_shears[now.state.plastic_shears != 0.0]) == sorted(kept.plastic_shears)
    before.state = State.at_rest(rubs)
    take_over(cast(Simulation, now), cast(Simulation, before), Stay(alone, outer, none, none, none))
    np.testing.assert_array_equal(before.state.plastic_bends, kept.plastic_bends)
    np.testing.assert_array_equal(before.state.plastic_shears, kept.plastic_shears)


def test_a_vertex_that_was_dragged_is_free_when_its_garment_is_worn_again() -> None:
    body = builtin_mannequin()
    player = Player(outfit_database(), body)
    model = player.simulation.model
    trousers = int(np.flatnonzero((model.layer == 0) & (model.inverse_mass > 0.0))[0])
    player.drag(trousers, player.simulation.state.world()[trousers])
    player.wear(["trousers"])
    player.drag(trousers, player.simulation.state.world()[trousers])
    player.wear(["trousers", "skirt"])
    np.testing.assert_array_equal(player.simulation.state.position[:, 3], player.simulation.model.inverse_mass)
    player.wear(["trousers"])
    np.testing.assert_array_equal(player.simulation.state.position[:, 3], player.simulation.model.inverse_mass)


def test_garments_that_an_outfit_lacks_are_refused() -> None:
    player = Player(outfit_database(), builtin_mannequin())
    for names in ([], ["hat"], ["hat", "skirt"]):
        refuses("trousers, skirt", player.wear, names)
    assert player.worn == ("trousers", "skirt")


def test_what_is_left_of_an_outfit_is_a_database(tmp_path: Path) -> None:
    database = outfit_database()
    of_skirt = database.layers.layer[database.coarse_faces[:, 0]] == 1
    texture = np.zeros((len(of_skirt), 3, 2), np.float32)
    texture[~of_skirt] = np.nan
    database = replace(database, texture=texture)
    skirt = with_garments(database, ["skirt"])
    assert skirt.texture is not None and skirt.texture.shape == (of_skirt.sum(), 3, 2) and not skirt.texture.any()
    assert with_garments(database, ["trousers"]).texture is None
    assert skirt.layers is None and skirt.garment_name == "skirt" and len(skirt.coarse_vertices) == 624
    write_database(tmp_path / "skirt.h5", skirt)
    read = read_database(tmp_path / "skirt.h5")
    np.testing.assert_array_equal(read.coarse_faces, skirt.coarse_faces)
    body = builtin_mannequin()
    player = Player(read, body)
    both = Player(database, body)
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
