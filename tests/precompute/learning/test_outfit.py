"""An outfit is learned as one garment is: all of it in one file, played in layers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from pbd import InputError
from precompute.learning.pipeline import precompute
from runtime.plain_player import PlainCloth, PlainPlayer
from runtime.player import Player
from tests.precompute.miniature import OPTIONS, SCENE, scene
from wrinkles.database import WrinkleDatabase, read_database, write_database
from wrinkles.worn_garments import with_garments

FEW_TRIES = replace(OPTIONS, shear_scales=(1.0,), bend_scales=(1.0,))
TROUSERS = """
[[garment]]
name = "trousers"
mesh = "builtin:trousers"
fabric = "denim"
subdivisions = 1
"""


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> WrinkleDatabase:
    path = tmp_path_factory.mktemp("outfit") / "outfit.h5"
    text = TROUSERS + SCENE.replace("end = 1.2", "end = 0.6")
    precompute(scene(text), path, workers=1, options=FEW_TRIES)
    return read_database(path)


def test_the_file_has_all_garments(database: WrinkleDatabase) -> None:
    layers = database.layers
    assert database.garment_name == "trousers + skirt" and database.fabric_name == "denim"
    assert layers is not None and np.bincount(layers.layer).tolist() == [1131, 624]
    figures = database.quality
    assert 0.0 <= figures["crossed_layers_percent"] < 2.0
    assert 0.0 <= figures["truth_crossed_layers_percent"] < 2.0 and "crossed_layers_at_end_percent" in figures


def test_the_player_moves_all_garments_in_layers(database: WrinkleDatabase) -> None:
    body = builtin_mannequin()
    motion = ClipMotion(body, "walk")
    wrinkled = Player(database, body, motion.pose(0.0))
    plain = PlainPlayer(database, body, PlainCloth(0, 4, 1), motion.pose(0.0))
    for player in (wrinkled, plain):
        assert player.simulation.model.layer.max() == 1
        for frame in range(1, 13):
            player.update(motion.pose(frame / 60), 1 / 60)
        layers = database.layers
        assert layers is not None
        layer = layers.subdivided(player.levels.subdivision).layer
        moved = np.linalg.norm(player.vertices + player.origin - player.levels.fine.vertices, axis=1)
        for number in (0, 1):
            assert 0.001 < np.median(moved[layer == number]) < 0.5
        assert np.isfinite(player.normals).all()


def test_garments_are_taken_off_and_put_on_without_a_jump(database: WrinkleDatabase) -> None:
    body = builtin_mannequin()
    motion = ClipMotion(body, "walk")
    player = Player(database, body, motion.pose(0.0))

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


def test_garments_that_an_outfit_lacks_are_refused(database: WrinkleDatabase) -> None:
    player = Player(database, builtin_mannequin())
    for names in ([], ["hat"], ["hat", "skirt"]):
        with pytest.raises(InputError, match="trousers, skirt"):
            player.wear(names)
    assert player.worn == ("trousers", "skirt")


def test_what_is_left_of_an_outfit_is_a_database(database: WrinkleDatabase, tmp_path: Path) -> None:
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
