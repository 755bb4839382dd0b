"""Which coarse mesh at how many substeps: a table and `out/mesh-and-substeps-*.png`.

`pytest -s -m proof`, for databases of one garment as `gube precompute` learned them from several meshes:
out/meshes/skirt*.h5 and out/meshes/tshirt*.h5.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from precompute.learning.evaluation import free_figures, mean_figures
from precompute.learning.pipeline import default_cache, scene_run
from precompute.learning.truth import Truth, truth_of
from precompute.reporting.cost_charts import Chart, Point, draw_charts, write_png
from precompute.workers import Workers
from precompute.wrinkle_comparison.baselines import PlayerTurn, take_turns
from runtime.play.player import Player
from runtime.setup.garment_setup import GarmentSetup, scene_of
from tests.data import ROOT
from wrinkles.database import WrinkleDatabase
from wrinkles.database_file import read_database

SUBSTEPS = (6, 12, 24, 48)
RUNS = 3
AXIS = "processor time of a frame [ms], with 6, 12, 24 and 48 substeps from left to right"
FIGURES = {
    "low_frequency_bias": "distance from the true runs' mean [spreads]",
    "free_normal_error_deg": "error of normals [deg]",
    "octave_error_max": "error of the worst octave but the shortest [-]",
    "energy_error": "error of bending energy [-]",
}


def rows_of(database: WrinkleDatabase, truth: Truth) -> list[dict[str, float | str]]:
    """Figures of all ways to play a database on one motion; times are processor times, all played in turn."""
    run, keep, turns = truth.run, truth.recording.frames, {}
    for substeps in SUBSTEPS:
        players = [Player(database, run.body, run.poses[0], run.primitives) for _ in range(RUNS)]
        turns[substeps] = [
            PlayerTurn(database, run, keep, replace(player.full, substeps=substeps), player, start=start)
            for start, player in enumerate(players)
        ]
    take_turns([turn for some in turns.values() for turn in some], run.frame_count)
    rows = []
    for substeps, some in turns.items():
        for way in ("wrinkles", "smooth"):
            runs = [turn.played if way == "wrinkles" else turn.smooth for turn in some]
            frames = [one.frames for one in runs]
            figures = mean_figures(truth, frames, [free_figures(truth, one) for one in frames])
            figures["energy_error"] = abs(figures["bending_energy_ratio"] - 1.0)
            words = {"way": way, "vertices": len(database.coarse_vertices), "substeps": substeps}
            rows.append(words | {"ms": float(np.median([one.frame_ms for one in runs]))} | figures)
    return rows


@pytest.mark.proof
@pytest.mark.parametrize("garment", ["skirt", "tshirt"])
def test_mesh_and_substeps(garment: str) -> None:
    paths = sorted((ROOT / "out" / "meshes").glob(f"{garment}*.h5"))
    if not paths:
        pytest.skip(f"no out/meshes/{garment}*.h5")
    jobs, motions = [], []
    for path in paths:
        database = read_database(path)
        scene = scene_of(database)
        stage = GarmentSetup.of(scene)
        for motion in map(stage.motion, scene.training.held_out[: 2 if garment == "skirt" else 1]):
            truth = truth_of(scene_run(stage, scene, motion), default_cache(path), 2)
            jobs.append(partial(rows_of, database, truth))
            motions.append(motion.name)
    rows: dict[str, list[dict[str, float | str]]] = {}
    with Workers.of(2) as workers:
        for motion, found in zip(motions, workers.run(jobs), strict=True):
            rows.setdefault(motion, []).extend(found)
    charts = {}
    for motion, some in rows.items():
        for row in some:
            values = ", ".join(f"{name} {row[name]:.3g}" for name in row if name != "way" and "chance" not in name)
            sys.stdout.write(f"\n{garment}, {motion}, {row['way']}: {values}")
        for name, words in FIGURES.items():
            points = [
                Point(
                    float(row["ms"]),
                    float(row[name]),
                    f"{row['vertices']} vertices, {row['way']}",
                    str(row["substeps"]),
                )
                for row in some
            ]
            charts[f"{motion}: {words}"] = Chart(points, AXIS, words)
    write_png(ROOT / "out" / f"mesh-and-substeps-{garment}.png", draw_charts(charts, 7.0, 4.5))
    assert all(np.isfinite(float(row["low_frequency_bias"])) for some in rows.values() for row in some)
