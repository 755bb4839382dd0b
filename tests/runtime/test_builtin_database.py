"""The database that comes with the package: whether the code still reads it, and draws its wrinkles."""

from __future__ import annotations

import h5py
import numpy as np

from assets.io.scene import load_scene, scene_text
from runtime.play.player import Player
from runtime.setup.playback_inputs import open_database
from runtime.viewer.opened_view import BUILTIN_DATABASE
from wrinkles.decoder import Upsampler
from wrinkles.schema import SCHEMA_VERSION

AGAIN = "`make database` learns it anew"
SECONDS = 1.0  # that are played
FAMILIAR = 0.9  # of the wrinkles that are drawn where the features are those that it was learned with
MOST_BYTES = 1_000_000


def test_it_is_small_and_of_this_layout() -> None:
    assert BUILTIN_DATABASE.stat().st_size < MOST_BYTES
    with h5py.File(BUILTIN_DATABASE) as file:
        assert file.attrs["schema_version"] == SCHEMA_VERSION, AGAIN


def test_it_was_learned_from_the_demos_scene() -> None:
    database, _ = open_database(BUILTIN_DATABASE)
    assert database.scene == scene_text(load_scene(BUILTIN_DATABASE.with_suffix(".toml"))), AGAIN


def test_its_features_are_those_of_the_code() -> None:
    """Features that mean something else look unfamiliar, and wrinkles fade."""
    database, inputs = open_database(BUILTIN_DATABASE)
    motion, dt = inputs.motions[0], 1.0 / database.frame_rate
    player = Player(database, inputs.body, motion.pose(0.0), inputs.primitives)
    smooth, drawn, high = np.zeros_like(player.vertices), [], []
    upsample = Upsampler(player.levels.subdivision)
    for frame in range(1, round(SECONDS / dt) + 1):
        player.update(motion.pose(frame * dt), dt)
        drawn.append(database.novelty.amplitude(np.log(player.predicted_error())).mean())
        upsample(player.simulation.state.position, smooth)
        high.append(np.linalg.norm(player.vertices - smooth, axis=1).mean())
    assert np.mean(drawn) > FAMILIAR, AGAIN
    assert 1e-4 < np.mean(high) < 1e-2  # [m]: wrinkles, and none that have burst
