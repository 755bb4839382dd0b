"""Realism is calibrated before it judges: what nobody tells from the truth it does not tell. `pytest -s -m proof`."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from pbd import ClothMesh
from pbd.opening import neighbour_means
from precompute.learning.decoding import by_patches, decoded_frames
from precompute.learning.evaluation import play_freely
from precompute.learning.pipeline import scene_run
from precompute.learning.training import build_layer, coefficients_of
from precompute.learning.truth import truth_of
from precompute.wrinkle_comparison.realism import PatchStatistics, realism
from runtime.setup.garment_setup import GarmentSetup, scene_of
from tests.data import ROOT
from wrinkles.database_file import read_database

AT_MOST = {"again": 0.55, "true coefficients": 0.60, "smoothed once": 0.70}
AT_LEAST = {"smooth surface": 0.95}


def smoothed(frames: np.ndarray, mesh: ClothMesh, times: int) -> np.ndarray:
    """Frames of which every vertex moved half-way to the mean of its neighbours so many times."""
    mean, _ = neighbour_means(mesh.faces, len(mesh.vertices))
    for _ in range(times):
        frames = 0.5 * frames + 0.5 * np.stack([mean @ frame for frame in frames]).astype(np.float32)
    return frames


@pytest.mark.proof
@pytest.mark.parametrize("name", ["demo/skirt", "sewn_tshirt"])
def test_realism_tells_what_is_seen(name: str) -> None:
    """Databases as `make demo` and `gube precompute docs/scenes/sewn_tshirt.toml -o out/sewn_tshirt.h5` learn them."""
    path = ROOT / "out" / f"{name}.h5"
    if not path.exists():
        pytest.skip(f"no {path}")
    database, cache = read_database(path), path.parent / ".gube-cache"
    scene = scene_of(database)
    stage = GarmentSetup.of(scene)
    run, layer = scene_run(stage, scene, stage.motion(scene.training.held_out[0])), build_layer(stage.levels)
    truth, mesh = truth_of(run, cache, 2, count=2), stage.levels.fine
    frames, recording = truth.frames, truth.recording
    coefficients = iter(coefficients_of(layer, [recording], database.atoms))
    given = by_patches(layer, lambda features: next(coefficients), database.atoms)
    both = [(smooth.copy(), drawn.copy()) for smooth, drawn, _ in decoded_frames(layer, given, run, recording)]
    free = play_freely(database, run.body, run)
    rows = {
        "again": truth.others[0],
        "finer": truth.floor,
        "true coefficients": np.array([drawn for _, drawn in both]),
        "smoothed once": smoothed(frames, mesh, 1),
        "smoothed three times": smoothed(frames, mesh, 3),
        "smooth surface": np.array([smooth for smooth, _ in both]),
        "ours": free.frames,
        "ours, smooth": free.smooth,
    }
    statistics = PatchStatistics(mesh)
    of_truth = statistics(frames)
    told = {row: realism(statistics, of_truth, statistics(those)).auc for row, those in rows.items()}
    sys.stdout.write("\n" + name + ": " + ", ".join(f"{row} {auc:.3f}" for row, auc in told.items()) + "\n")
    assert {row: told[row] for row, most in AT_MOST.items() if told[row] > most} == {}
    assert {row: told[row] for row, least in AT_LEAST.items() if told[row] < least} == {}
