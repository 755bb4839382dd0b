from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pbd import ModelOptions, SolverOptions
from precompute.learning import calibration
from precompute.learning.calibration import CoarseModel, calibrate, filtered
from precompute.learning.decoding import decode_recording
from precompute.learning.recording import Run, poses_of, record_runs
from precompute.learning.training import build_layer
from precompute.workers import Workers
from runtime.garment_setup import GarmentSetup, fabric_of
from tests.precompute.miniature import OPTIONS, scene
from tests.wrinkles.databases import placed, small_database
from wrinkles.coarse_filter import CoarseFilter


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recorded runs: the coarse models that are tried are the same whichever is looked for."""
    return tmp_path_factory.mktemp("runs")


@pytest.mark.parametrize(("stiff", "shear"), [(1.0, 1.0), (30.0, 1.0), (1.0, 0.1)])
def test_the_model_whose_decoded_garment_folds_as_the_fine_one_is_chosen(
    stiff: float, shear: float, cache: Path
) -> None:
    stage = GarmentSetup.of(scene())
    layer = build_layer(stage.levels)
    small, count = small_database(), len(stage.levels.coarse.vertices)
    place = 0.01 * np.random.default_rng(0).standard_normal((count, small.mapping.place_bias.shape[1]))
    still = np.zeros((stage.levels.subdivision.fine_count, 3), np.float32)
    atoms = replace(small.atoms, vertex_mean=still)
    mapping = placed(small.mapping, place)
    solver = SolverOptions(substep=1.0 / 240.0)
    poses = poses_of(stage.motion(scene().training.held_out[0]), 1.0 / 60.0, 1.0)
    fine = Run(
        "walk", stage.levels, True, stage.body, poses, 1.0 / 60.0, fabric_of(stage.settings), ModelOptions(), solver
    )
    coarse = replace(fine, fine=False, options=ModelOptions(shear_scale=shear, bend_scale=stiff), bend_factor=0.3)
    run = filtered(record_runs([coarse], cache, 1)[0], CoarseFilter(stage.levels).matrix)
    # What this coarse garment looks like when it is decoded is given out as the fine run.
    told = replace(run, positions=decode_recording(layer, mapping.predict, atoms, coarse, run)[1])
    found = calibrate(layer, mapping, atoms, [fine], [told], CoarseModel(solver, 0.3), cache, Workers(1), OPTIONS)
    assert found.options == coarse.options
    told_of = lambda key: {(row["bend_scale"], row["shear_scale"]): row[key] for row in found.rows}  # noqa: E731
    errors = told_of("spectrum_error")
    assert errors[stiff, shear] < 1e-2 < 0.1 < errors[31.0 - stiff, shear]
    apart = told_of("apart_mm")
    assert apart[stiff, shear] < 1e-3 < 1.0 < apart[31.0 - stiff, shear]
    assert apart[1.0, 0.1 if shear == 1.0 else 1.0] > 0.1
    assert all(row["error"] >= row["spectrum_error"] for row in found.rows)
    assert found.mismatch_after == pytest.approx(0.0, abs=1e-3)  # its own statistics, but for rounding


def test_another_model_than_the_fabric_itself_must_be_better_by_more_than_chance(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def judged(_: object, model: ModelOptions) -> dict[str, float]:
        error = told[model.bend_scale, model.shear_scale]
        return {"apart_mm": 0.0, "normal_error_deg": 0.0, "spectrum_error": error, "shift": error, "mismatch": 0.0}

    monkeypatch.setattr(calibration, "_judge", judged)
    monkeypatch.setattr(calibration._Bench, "of", lambda *_: None)
    solver = SolverOptions(substep=1.0 / 240.0)
    stage = GarmentSetup.of(scene())
    poses = poses_of(stage.motion(scene().training.held_out[0]), 1.0 / 60.0, 1.0)
    fine = Run(
        "walk", stage.levels, True, stage.body, poses, 1.0 / 60.0, fabric_of(stage.settings), ModelOptions(), solver
    )
    for least, chosen in ((0.85, 1.0), (0.75, 0.1)):
        told = {(1.0, 1.0): 1.0, (30.0, 1.0): 2.0, (1.0, 0.1): least, (30.0, 0.1): 1.5}
        small = small_database()
        found = calibrate(
            build_layer(stage.levels), small.mapping, small.atoms, [fine], [], CoarseModel(solver, 0.3), cache,
            Workers(1), OPTIONS,
        )  # fmt: skip
        assert (found.options.bend_scale, found.options.shear_scale) == (1.0, chosen)
        assert (found.shift_before, found.shift_after) == (1.0, least if chosen < 1.0 else 1.0)
