from __future__ import annotations

from functools import partial
from unittest.mock import patch

import numpy as np
import pytest

from precompute.learning.pipeline import Precomputed
from precompute.learning.recording import Recording
from precompute.wrinkle_comparison import ablations
from precompute.wrinkle_comparison.ablation_experiment import Experiment
from precompute.wrinkle_comparison.ablations import (
    ABLATIONS,
    COLUMNS,
    Ablation,
    _atoms,
    _before,
    _ring,
    _without_body,
    _without_gravity,
    ablate_file,
    table,
)
from runtime import command
from tests.precompute.wrinkle_comparison.small import small_comparison

SMALL = (
    *(one for one in ABLATIONS if one.name in (
        "", "C: both run independently", "ridge regression", "nearest patch alone", "no pass",
        "previous coefficients, learned from its own", "off: squeeze 1, bending 1",
    )),
    Ablation("dictionary", "2 atoms", partial(_atoms, count=2)),
)  # fmt: skip


def test_every_row_is_judged_and_kept(learned: Precomputed, capsys: pytest.CaptureFixture[str]) -> None:
    with small_comparison(), patch.object(ablations, "ABLATIONS", SMALL):
        rows = ablate_file(learned.path)
        assert [(row["group"], row["name"]) for row in rows] == [(one.group, one.name) for one in SMALL]
        assert all(np.isfinite([float(row[name]) for name in COLUMNS]).all() for row in rows)
        with patch.object(Experiment, "judge", side_effect=AssertionError("judged again")):
            assert ablate_file(learned.path) == rows
            assert command.main(["bench", "wrinkles", str(learned.path)]) == 0
    assert table(rows) in capsys.readouterr().out
    by_name = {row["name"]: row for row in rows}
    full = by_name[""]
    assert by_name["off: squeeze 1, bending 1"]["normal_error_deg"] == full["normal_error_deg"]  # given: no coarse run
    assert by_name["no pass"]["normal_error_deg"] != full["normal_error_deg"]
    assert by_name["2 atoms"]["rmse_skill"] != full["rmse_skill"]


def test_a_row_is_kept_for_one_database_and_one_way() -> None:
    one, other = ABLATIONS[:2]
    assert len({one.key(b"a"), one.key(b"b"), other.key(b"a")}) == 3
    assert one.key(b"a") == one.key(b"a")


def test_what_is_left_out_is_what_is_told() -> None:
    offsets, gravity, distances = np.arange(72), np.arange(72, 75), np.arange(75, 84)
    column, row = np.divmod(np.delete(np.arange(25), 12), 5)  # 5 by 5 points without the one in the middle
    reach = np.repeat(np.maximum(abs(column - 2), abs(row - 2)), 3)
    np.testing.assert_array_equal(_ring(1), [*offsets[reach == 1], *gravity, *distances])
    seen = []
    with patch.object(ablations, "_seeing", lambda experiment, kept: seen.append(kept)):
        _without_gravity(None)
        _without_body(None)
    np.testing.assert_array_equal(seen[0], [*offsets, *distances])
    np.testing.assert_array_equal(seen[1], [*offsets, *gravity])


def test_the_past_is_the_frame_before_in_the_same_run() -> None:
    class Runs:
        recordings = [_recording(np.arange(2, 12, 2)), _recording(np.arange(2, 8, 2))]
        learned = [recordings[0].where(slice(1, None, 2)), recordings[1].where(slice(0, None, 2))]

    told = _before(Runs(), [np.arange(5)[:, None], 10 + np.arange(3)[:, None]])
    np.testing.assert_array_equal(told[:, 0], [0, 2, 10, 11])  # the first frame of a run knows only itself


def _recording(frames: np.ndarray) -> Recording:
    empty = np.zeros((len(frames), 0))
    return Recording("run", frames, empty, empty, empty, empty, 1.0)
