"""Folds of a freely running garment change as fast as true ones. `pytest -s -m proof`."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from precompute.learning.evaluation import free_figures, play_freely
from precompute.learning.pipeline import scene_run
from precompute.learning.truth import truth_of
from precompute.wrinkle_comparison.realism import PatchStatistics, realism
from runtime.setup.garment_setup import GarmentSetup, scene_of
from tests.data import ROOT
from wrinkles.database_file import read_database
from wrinkles.temporal_sharpening import TemporalSharpening

RUNS = 4
OCTAVES = 4  # the shortest ones


@pytest.mark.proof
@pytest.mark.parametrize("name", ["demo/skirt", "sewn_tshirt"])
def test_folds_change_as_fast_as_true_ones(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Databases as `make demo` and `gube precompute docs/scenes/sewn_tshirt.toml -o out/sewn_tshirt.h5` learn them."""
    path = ROOT / "out" / f"{name}.h5"
    if not path.exists():
        pytest.skip(f"no {path}")
    database = read_database(path)
    scene = scene_of(database)
    stage = GarmentSetup.of(scene)
    run = scene_run(stage, scene, stage.motion(scene.training.held_out[0]))
    truth = truth_of(run, path.parent / ".gube-cache", 2)
    statistics = PatchStatistics(stage.levels.fine)
    of_truth, changes = statistics(truth.frames), truth.bands.energy(np.diff(truth.frames, axis=0)).mean(axis=0)
    told: dict[str, np.ndarray] = {}
    slow = 0.0
    for how in ("sharpened", "not"):
        if how == "not":
            monkeypatch.setattr(TemporalSharpening, "__call__", lambda self, position, alpha=1.0: position)
        runs = [play_freely(database, run.body, run, start).frames for start in range(RUNS)]
        told[how] = np.array([realism(statistics, of_truth, statistics(frames)).auc for frames in runs])
        figures = [free_figures(truth, frames) for frames in runs]
        mean = {figure: float(np.mean([one[figure] for one in figures])) for figure in figures[0]}
        bias = truth.low_frequency(runs).bias
        octaves = [f"{mean[one]:.2f}" for one in mean if one.startswith("band_ratio")][:OCTAVES]
        moved = np.mean([truth.bands.energy(np.diff(frames, axis=0)).mean(axis=0) for frames in runs], axis=0) / changes
        sys.stdout.write(
            f"\n{name}, {how}: energy {mean['bending_energy_ratio']:.3f}, octaves {' '.join(octaves)}, "
            f"their changes {' '.join(f'{ratio:.2f}' for ratio in moved[:OCTAVES])}, "
            f"normals {mean['free_normal_error_deg']:.1f} deg, bias {bias:.2f}, "
            f"realism {told[how].mean():.3f} +- {told[how].std(ddof=1):.3f}\n"
        )
        if how == "sharpened":
            assert abs(mean["bending_energy_ratio"] - 1.0) < 0.12 and mean["octave_error_max"] < 0.2
            slow = float(np.abs(moved[:OCTAVES] - 1.0).max())
        else:
            assert slow < float(np.abs(moved[:OCTAVES] - 1.0).max())
    gained = told["not"] - told["sharpened"]  # the coarse garment is the same in both
    assert gained.mean() > 2.0 * gained.std(ddof=1) / np.sqrt(RUNS)
