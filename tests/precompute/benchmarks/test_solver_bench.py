"""Time against stretch: what is measured, what passes, what is written."""

import csv
import importlib.util
from pathlib import Path

import numpy as np
import pytest

from pbd import Colliders, InputError, Solver, SolverOptions, State
from precompute.benchmarks import solver_bench
from precompute.benchmarks.constraint_cost import constraint_costs
from precompute.benchmarks.solver_bench import (
    SolverBench,
    bench_rows,
    bench_solver,
    bench_verdict,
    write_bench,
)
from precompute.experiment.engines import accurate, bench_engines
from precompute.experiment.swinging_square import SquareFigures, SquareRun, hanging_square, measure
from runtime.cli import command

GOOD = SquareFigures(1.0, 0.005, 0.01, 0.03, 0.24)


def test_the_square_is_the_scene_that_was_asked_for() -> None:
    model = hanging_square(12)
    assert len(model.mesh.vertices) == 144
    assert model.mass.sum() == pytest.approx(0.2, rel=2e-3)
    vertices = model.mesh.vertices
    assert vertices[model.held] == pytest.approx(np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]), abs=1e-9)
    lowest = vertices[vertices[:, 1].argmin()]
    assert np.degrees(np.arctan2(lowest[2], -lowest[1])) == pytest.approx(30.0)
    assert len(model.tethers) == 0


def test_stretch_and_amplitude_are_those_of_the_vertices(monkeypatch: pytest.MonkeyPatch) -> None:
    """A square whose warp is 10 % too long and that swings by 0.3 m."""
    scene = hanging_square(6)
    start = scene.mesh.vertices
    frames = []

    def step(self: Solver, state: State, colliders: Colliders, dt: float) -> None:
        frames.append(dt)
        moved = start * [1.1, 1.0, 1.0] + 0.3 * np.sin(len(frames)) * np.array([0.0, 0.0, 1.0])
        state.position[:, :3] = moved - state.origin

    monkeypatch.setattr(Solver, "step", step)
    found = measure(scene, SolverOptions())
    assert len(frames) == 301 and set(frames) == {1 / 60}
    assert found.mean == pytest.approx(0.05, rel=1e-4) and found.worst == pytest.approx(0.1, rel=1e-4)
    assert found.p99 == pytest.approx(0.1, rel=1e-4) and found.amplitude == pytest.approx(0.3, rel=1e-3)


def test_every_limit_counts() -> None:
    assert GOOD.passes(0.24) and GOOD.passes(0.235)
    assert not GOOD.passes(0.25)
    for limit in ({"mean": 0.011}, {"p99": 0.021}, {"worst": 0.051}, {"amplitude": np.inf}, {"worst": np.nan}):
        assert not GOOD._replace(**limit).passes(0.24)


def test_a_run_that_is_lost_passes_nothing() -> None:
    scene = hanging_square(6)
    scene.triangle_data[:] = np.nan
    assert not measure(scene, SolverOptions()).passes(0.24)


def test_more_substeps_stretch_less() -> None:
    scene = hanging_square(10)
    few, many = (measure(scene, SolverOptions(substep=1 / (60 * n))) for n in (4, 12))
    assert many.worst < 0.5 * few.worst and many.mean < 0.5 * few.mean
    assert 0.15 < many.amplitude < 0.35


def test_the_cheapest_that_passes_is_found_and_written(tmp_path: Path) -> None:
    runs = [
        SquareRun("small steps", 64, 8, GOOD._replace(frame_ms=1.0, worst=0.2), False),
        SquareRun("small steps", 64, 20, GOOD._replace(frame_ms=3.0), True),
        SquareRun("small steps", 64, 40, GOOD._replace(frame_ms=6.0), True),
    ]
    bench = SolverBench(runs, {64: 0.24}, {"distance_constraint_ns": 5.0, "scalar_limit_constraint_ns": 4.0})
    figures = bench.figures()
    assert figures["time_to_accuracy_ms_64"] == 3.0 and figures["distance_constraint_ns"] == 5.0
    assert figures["rival_blender_ms_64"] == 21.87 and "rival_blender_ms_32" not in figures
    assert figures["rival_taichi_mass_spring_ms_64"] == 32.29
    assert "time_to_accuracy_ms_64" not in SolverBench(runs[:1], {64: 0.24}, bench.costs).figures()
    assert "3.00 ms" in bench_verdict(bench) and "Blender, 21.87 ms" in bench_verdict(bench)
    write_bench(tmp_path, bench)
    with open(tmp_path / "solver.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["frame_ms"]) for row in rows] == [1.0, 3.0, 6.0] and all(row["cpu"] for row in rows)
    page = (tmp_path / "solver.html").read_text(encoding="utf-8")
    assert page.count("Newton XPBD") > 0 and "hollow: quoted from elsewhere" in page


def test_the_command_measures_and_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver_bench, "SIDES", (32,))
    monkeypatch.setattr(solver_bench, "constraint_costs", lambda: {"distance_constraint_ns": 5.0})
    monkeypatch.setattr(solver_bench, "self_collision_cost", lambda: {"self_collision_ms_64": 2.0})
    monkeypatch.setattr(solver_bench, "measure", lambda scene, options: GOOD)
    assert command.main(["bench", "solver", "-o", str(tmp_path / "new"), "--json", str(tmp_path / "out.json")]) == 0
    assert (tmp_path / "new" / "solver.html").exists() and (tmp_path / "new" / "solver.csv").exists()
    assert '"time_to_accuracy_ms_32": 1.0' in (tmp_path / "out.json").read_text(encoding="utf-8")


def test_constraints_cost_something() -> None:
    costs = constraint_costs()
    assert set(costs) >= {"scalar_limit_constraint_ns", "membrane_constraint_ns", "hinge_constraint_ns"}
    assert all(0.1 < cost < 1e5 for cost in costs.values())


def test_rows_are_the_runs() -> None:
    bench = bench_solver(())
    assert bench_rows(bench) == [] and bench.cheapest(32) is None


def test_a_measured_rival_takes_the_place_of_a_quoted_one(tmp_path: Path) -> None:
    dear, cheap = GOOD._replace(frame_ms=30.0), GOOD._replace(frame_ms=20.0)
    failed = GOOD._replace(frame_ms=10.0, worst=0.06)
    baselines = [
        SquareRun("Newton XPBD", 64, words, run, accurate(run))
        for words, run in (("a", dear), ("b", cheap), ("c", failed))
    ]
    runs = [SquareRun("small steps", 64, 20, GOOD, True)]
    bench = SolverBench(runs, {64: 0.24}, {"distance_constraint_ns": 5.0}, baselines)
    assert bench.figures()["rival_newton_xpbd_ms_64"] == 20.0
    assert "cheapest measured: Newton XPBD, 20 ms with 100 % of the swing." in bench_verdict(bench)
    write_bench(tmp_path, bench)
    with open(tmp_path / "solver.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["method"] for row in rows[1:]] == [f"Newton XPBD ({words})" for words in "abc"]
    assert [row["passed"] for row in rows[1:]] == ["True", "True", "False"]


def test_engines_that_are_not_installed_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="gube\\[rivals\\]"):
        bench_engines()
