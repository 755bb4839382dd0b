"""An outfit is learned as one garment is: all of it in one file, played in layers."""

from __future__ import annotations

import numpy as np
import pytest

from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from precompute.learning.pipeline import precompute
from runtime.play.plain_cloth import PlainCloth
from runtime.play.player import Player
from tests.precompute.miniature import OPTIONS, SCENE, scene
from tests.runtime.players import TROUSERS
from wrinkles.database import WrinkleDatabase
from wrinkles.database_file import read_database

pytestmark = pytest.mark.proof  # a minute and a half: the fine layers are simulated
LAYERS_ALONE = "[solver]\nself_collision = false"  # of one another: what is learned is the same, in half the time


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> WrinkleDatabase:
    path = tmp_path_factory.mktemp("outfit") / "outfit.h5"
    text = TROUSERS + SCENE.replace("end = 1.2", "end = 0.6").replace("[solver]", LAYERS_ALONE)
    precompute(scene(text), path, workers=1, options=OPTIONS)
    return read_database(path)


def test_the_file_has_all_garments(database: WrinkleDatabase) -> None:
    layers = database.layers
    assert database.garment_name == "trousers + skirt" and database.fabric_name == "denim"
    assert layers is not None and np.bincount(layers.layer).tolist() == [1131, 624]
    figures = database.quality
    assert 0.0 <= figures["crossed_layers_percent"] < 2.0
    assert 0.0 <= figures["truth_crossed_layers_percent"] < 2.0 and "crossed_layers_at_end_percent" in figures
    for garment in ("trousers", "skirt"):
        assert 0.1 < figures[f"{garment}_bending_energy_ratio"] < 10.0
        assert {f"{garment}_spectrum_band_error_max", f"floor_{garment}_spectrum_band_error_max"} <= figures.keys()


def test_the_player_moves_all_garments_in_layers(database: WrinkleDatabase) -> None:
    body = builtin_mannequin()
    motion = ClipMotion(body, "walk")
    wrinkled = Player(database, body, motion.pose(0.0))
    plain = Player(database, body, motion.pose(0.0), cloth=PlainCloth(0, 4, 1))
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
