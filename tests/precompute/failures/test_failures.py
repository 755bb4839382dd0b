"""The list of known failures: the default solver comes through all of them, and what does fail is called so."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbd import Colliders, InputError, Plane, Solver, State
from pbd.models.newton import StepError
from precompute.experiment.error_classes import ErrorClass
from precompute.experiment.sheets import square
from precompute.failures import failure_comparisons, failure_play
from precompute.failures.failure_comparisons import comparisons
from precompute.failures.failure_play import FailureOutcome, FailureScene, play
from precompute.failures.failure_scenes import HUNG, scenes
from precompute.failures.failures import all_failure_rows, failure_rows, failure_table, write_failures
from runtime.cli.command import main
from tests.data import ROOT

SLOW = ("sheet in folds over a ball", "three sheets of 1 mm on the ground", "two arms of triangles")
SCENES = {scene.name: scene for scene in scenes()}
COMPARISONS = {name: run for _, name, _, run in comparisons()}


def slow(name: str) -> bool:
    return name.startswith(SLOW)


def held_together(outcome: FailureOutcome) -> None:
    assert outcome.worst[0] < ErrorClass.VISIBLE, outcome
    assert outcome.recovered_s <= 1.0, outcome


@pytest.mark.parametrize("name", [name for name in SCENES if not slow(name)])
def test_the_default_solver_comes_through(name: str) -> None:
    held_together(play(SCENES[name]))


@pytest.mark.proof
@pytest.mark.parametrize("name", [name for name in SCENES if slow(name)])
def test_the_default_solver_comes_through_what_is_slow(name: str) -> None:
    held_together(play(SCENES[name]))


@pytest.mark.parametrize("name", [name for name in COMPARISONS if name != "two threads"])
def test_the_default_solver_does_not_differ(name: str) -> None:
    held_together(COMPARISONS[name]("default"))


@pytest.mark.proof
def test_threads_do_not_differ() -> None:
    assert COMPARISONS["two threads"]("default").figures == {"position_px": 0.0}


def test_every_line_of_the_list_is_there() -> None:
    path = ROOT.parent / "shared" / "physics.md"
    if not path.exists():
        pytest.skip("physics.md is not here")
    text = path.read_text(encoding="utf-8").split("suite has them all)")[1].split("##")[0]
    wanted = [" ".join(line.split()) for line in text.replace("\n", " ").strip().rstrip(".").split(";")]
    assert len(wanted) == 26
    assert set(wanted) == {scene.line for scene in SCENES.values()} | {line for line, *_ in comparisons()}


# -- What is told from what --------------------------------------------------------------------------------------------


def broken(monkeypatch: pytest.MonkeyPatch, what: Any) -> None:
    """The default solver does something to the positions about the origin instead of a step."""
    begin: list[np.ndarray] = []

    def step(self: Solver, state: State, colliders: Colliders, dt: float, *rest: Any) -> None:
        begin.append(state.position[:, :3].copy())
        state.position[:, :3] = what(begin[0], len(begin))

    monkeypatch.setattr(Solver, "step", step)


@pytest.mark.parametrize(
    ("what", "expected", "by"),
    [
        (lambda x, frame: x, "IMPERCEPTIBLE", ""),
        (lambda x, frame: x * 1.05, "ACCEPTED", "edge_strain"),
        (lambda x, frame: x * 1.3, "VISIBLE", "edge_strain"),
        (lambda x, frame: x * 2.5, "CATASTROPHIC", ""),
        (lambda x, frame: x * np.nan, "CATASTROPHIC", "not_finite"),
    ],
)
def test_classes(what: Any, expected: str, by: str, monkeypatch: pytest.MonkeyPatch) -> None:
    broken(monkeypatch, what)
    outcome = play(FailureScene("", "", *HUNG[:1], held=HUNG[1]))
    assert outcome.worst[0].name == expected and by in outcome.worst[1]
    assert outcome.recovered_s == (0.0 if expected in ("IMPERCEPTIBLE", "ACCEPTED") else np.inf)


def test_recovery_is_counted_from_the_end_of_the_disturbance(monkeypatch: pytest.MonkeyPatch) -> None:
    broken(monkeypatch, lambda x, frame: x * (1.3 if frame <= 42 else 1.0))
    outcome = play(FailureScene("", "", HUNG[0], held=HUNG[1], quiet=0.5))
    assert outcome.recovered_s == pytest.approx(0.2) and outcome.worst[0] is ErrorClass.IMPERCEPTIBLE


def test_cloth_that_stays_under_the_ground_or_through_a_layer_is_catastrophic(monkeypatch: pytest.MonkeyPatch) -> None:
    broken(monkeypatch, lambda x, frame: x)
    scene = FailureScene("", "", square(4), colliders=lambda: Colliders([Plane((0.0, -0.4, 0.0), (0.0, 2.0, 0.0))]))
    outcome = play(scene)
    assert outcome.figures["penetration_thicknesses"] == pytest.approx(0.1 / 0.003, rel=1e-3)
    assert outcome.worst == (ErrorClass.CATASTROPHIC, "penetration_s") and outcome.recovered_s == np.inf
    assert play(replace(scene, colliders=Colliders)).worst[0] is ErrorClass.IMPERCEPTIBLE
    assert play(replace(scene, colliders=Colliders, through=lambda x: True)).worst[0] is ErrorClass.CATASTROPHIC


@pytest.mark.proof
def test_a_classic_solver_fails_where_it_is_known_to() -> None:
    """Position-based dynamics without compliance stiffens with its steps (Mueller et al. 2007, 3.3)."""
    assert COMPARISONS["hung cloth with four times the substeps"]("pbd").worst[0] > ErrorClass.IMPERCEPTIBLE


# -- The table ---------------------------------------------------------------------------------------------------------


def test_rows_and_the_table(tmp_path: Path) -> None:
    line = "resolution sweep"
    rows = failure_rows("default", lines=[line])
    assert [row["scene"] for row in rows] == ["2 edges", "4 edges", "8 edges", "16 edges", "32 edges"]
    worse = {**rows[0], "solver": "pbd", "class": "catastrophic"}
    assert failure_table([*rows, worse]).splitlines() == [
        "line | default | pbd",
        f"{line} | imperceptible | catastrophic",
    ]
    write_failures(tmp_path / "failures.csv", rows)
    with open(tmp_path / "failures.csv", encoding="utf-8") as file:
        read = list(csv.DictReader(file))
    assert [row["class"] for row in read] == [row["class"] for row in rows] and all(row["cpu"] for row in read)
    with pytest.raises(InputError, match="nothing to write"):
        write_failures(tmp_path / "none.csv", [])


def test_a_run_that_is_too_slow_is_judged_by_what_it_came_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(failure_play, "MAX_RUN_S", 0.0)
    row, *_ = failure_rows("default", lines=["resolution sweep"])
    assert "(judged up to 0.033 of 2 s: slow)" in row["by"] and row["class"] == "imperceptible"


def test_a_comparison_that_is_too_slow_is_judged_by_what_it_came_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(failure_comparisons, "MAX_RUN_S", 1e-9)
    outcome = COMPARISONS["hung cloth at 25 and 75 Hz"]("default")
    assert "(judged up to 0.04 of 3 s: slow)" in outcome.note and np.isfinite(outcome.figures["edge_strain_max"])


@pytest.mark.proof
def test_lines_in_several_processes_come_in_order() -> None:
    told: list[str] = []
    rows = all_failure_rows(["default"], 2, told.append)
    assert [row["scene"] for row in rows] == [row["scene"] for row in failure_rows("default")]
    assert len(told) == len({row["line"] for row in rows})


def test_a_step_that_fails_is_catastrophic_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def step(*rest: Any) -> None:
        raise StepError("no descent")

    monkeypatch.setattr(Solver, "step", step)
    (row, *_) = failure_rows("default", lines=["resolution sweep"])
    assert row["class"] == "catastrophic" and row["by"] == "no descent" and row["recovered_s"] == np.inf


def test_the_command_refuses_unknown_solvers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "failures", "--solver", "best", "-o", str(tmp_path / "x.csv")]) == 2
    assert "no such solver" in capsys.readouterr().err
