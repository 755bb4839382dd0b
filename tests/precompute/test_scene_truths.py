"""The fine runs of all scenes of `docs/scenes` are free of crossings. `pytest -s -m proof` prints a table.

Runs are kept in `out/.gube-cache`, where `gube precompute docs/scenes/NAME.toml -o out/NAME.h5` finds them.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from assets.io.scene import load_scene
from precompute.learning.crossed import crossed_jobs, joined_crossed
from precompute.learning.pipeline import scene_run
from precompute.learning.run_recording import record_runs
from precompute.workers import Workers
from runtime.setup.garment_setup import GarmentSetup
from tests.data import ROOT, data_path

SCENES = sorted((ROOT / "docs" / "scenes").glob("*.toml"))


@pytest.mark.proof
@pytest.mark.parametrize("path", SCENES, ids=[path.stem for path in SCENES])
def test_the_fine_runs_of_a_scene_go_through_nothing(path: Path) -> None:
    data_path("characters/mh_female_bandai_NC.glb")
    scene = load_scene(path)
    if any(isinstance(garment.mesh, Path) and not garment.mesh.exists() for garment in scene.garments):
        pytest.skip("`make scenes` has not sewn its garments")
    stage = GarmentSetup.of(scene)
    motions = [*stage.training_motions(), *(stage.motion(motion) for motion in scene.training.held_out[:1])]
    runs, crossed = [scene_run(stage, scene, motion) for motion in motions], []
    with Workers.of(2) as workers:
        recordings = record_runs(runs, ROOT / "out" / ".gube-cache", workers)
        for run, recording in zip(runs, recordings, strict=True):
            shares = joined_crossed(
                workers.run(crossed_jobs(run.levels.fine, run.levels.fine_layer, recording.positions))
            )
            faces = np.rint(0.01 * shares[:, 0] * len(run.levels.fine.faces)).astype(int)
            crossed.append(faces.max())
            seconds = (
                f"{len(run.poses) * run.dt:.1f} s, {len(faces)} frames looked at, {recording.step_ms:.0f} ms a frame"
            )
            sys.stdout.write(
                f"\n{path.stem}: {run.name}: {seconds}: of {len(run.levels.fine.faces):,} faces {faces.max()} cross in "
                f"the worst frame, {100.0 * (faces == 0).mean():.1f} % of frames are free"
            )
    assert max(crossed) == 0
