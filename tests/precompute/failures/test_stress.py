"""Runs that break cloth engines: the default solver ends all of them well, and what fails is called so."""

import numpy as np
import pytest

from pbd import Colliders, InputError, Solver, State
from precompute.failures.stress import QUOTED, RUNS, stress_rows

HARD = ("E h 1e8 N/m", "frames of 1/10 s", "a pinned corner jumps by 1 m", "starts on a line")


def test_there_are_as_many_runs_as_others_were_judged_by() -> None:
    assert len(RUNS) == 14 and all(sum(counts) == 14 for counts in QUOTED.values())


def test_the_default_solver_stands_the_hardest_runs() -> None:
    rows = stress_rows(names=HARD, seconds=3.0)
    assert [row["run"] for row in rows] == list(HARD)
    assert {row["verdict"] for row in rows} == {"ok"}
    assert all(0.001 < row["worst_stretch"] < 0.2 for row in rows)


@pytest.mark.proof
def test_the_default_solver_stands_all_runs_within_the_frame() -> None:
    rows = stress_rows()
    assert [row["verdict"] for row in rows] == 14 * ["ok"]
    assert all(row["frame_ms"] < row["budget_ms"] for row in rows)


@pytest.mark.parametrize(("scale", "verdict"), [(1.3, "stretched"), (30.0, "exploded"), (np.nan, "exploded")])
def test_what_does_not_hold_is_told(scale: float, verdict: str, monkeypatch: pytest.MonkeyPatch) -> None:
    start: list[np.ndarray] = []

    def step(self: Solver, state: State, colliders: Colliders, dt: float, targets: np.ndarray | None = None) -> None:
        start.append(state.position[:, :3].copy())
        state.position[:, :3] = scale * start[0]

    monkeypatch.setattr(Solver, "step", step)
    (row,) = stress_rows(names=["E h 1e5 N/m"], seconds=1.0)
    assert row["verdict"] == verdict and row["frame_ms"] >= 0.0
    assert row["worst_stretch"] == (pytest.approx(0.3, abs=1e-5) if verdict == "stretched" else np.inf)


def test_other_solvers_take_the_same_runs() -> None:
    (row,) = stress_rows("pbd", ["frames of 1/30 s"], seconds=0.1)
    assert row["solver"] == "pbd" and row["verdict"] in ("ok", "stretched")


def test_unknown_runs_and_solvers_are_refused() -> None:
    with pytest.raises(InputError, match="no such run"):
        stress_rows(names=["frames of 1/9 s"])
    with pytest.raises(InputError, match="no such solver"):
        stress_rows("best", ["E h 1e5 N/m"])
