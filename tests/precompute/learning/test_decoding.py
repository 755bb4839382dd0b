from __future__ import annotations

from dataclasses import replace

import numpy as np

from pbd import Fabric, ModelOptions, SolverOptions
from precompute.learning.decoding import decode_recording, with_vertex_mean
from precompute.learning.run_recording import Recording, Run
from precompute.learning.training import build_layer, features_of
from runtime.play.simulation import poses_of
from runtime.setup.garment_setup import GarmentSetup
from tests.precompute.miniature import scene
from tests.wrinkles.databases import placed, small_database
from wrinkles.vertex_mean import MEAN_STEP, turned

FRAMES = 6


def test_the_mean_is_of_what_decoding_lacks() -> None:
    stage, rng, small = GarmentSetup.of(scene()), np.random.default_rng(0), small_database()
    layer = build_layer(stage.levels)
    coarse, fine_count = layer.levels.coarse.vertices, layer.levels.subdivision.fine_count
    place = 0.1 * rng.standard_normal((len(coarse), small.mapping.place_bias.shape[1]))
    mapping = placed(small.mapping, place)
    poses = poses_of(stage.motion(scene().training.held_out[0]), 1.0 / 60.0, 1.0)
    run = Run("sway", layer.levels, True, stage.body, poses, 1.0 / 60.0, Fabric(), ModelOptions(), SolverOptions())
    swaying = (coarse + 0.002 * rng.standard_normal((FRAMES, *coarse.shape))).astype(np.float32)
    contact, nearest = np.full((FRAMES, len(coarse)), 0.02, np.float32), np.zeros((FRAMES, len(coarse)), np.int32)
    nothing = np.zeros((FRAMES, fine_count, 3), np.float32)
    recording = Recording("sway", np.arange(FRAMES), nothing, swaying, contact, nearest, 1.0)
    atoms = replace(small.atoms, vertex_mean=nothing[0])
    _, decoded = decode_recording(layer, mapping.predict, atoms, run, recording)
    mean = 0.003 * rng.standard_normal((fine_count, 3))
    lacking = np.array([turned(layer.patches.turning, at, mean) for at in features_of(layer, recording)[1]])
    told = replace(recording, positions=(decoded + lacking).astype(np.float32))
    found = with_vertex_mean(layer, mapping.predict, replace(atoms, vertex_mean=nothing[0] + 1.0), [run], [told])
    np.testing.assert_allclose(found.vertex_mean, mean, atol=MEAN_STEP)
    assert np.array_equal(found.shapes, atoms.shapes) and not atoms.vertex_mean.any()
