"""A frame against another checkout: both are played in turns, and a folder that plays nothing is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pbd import InputError
from precompute.benchmarks.frame_turns import FRAMES, LAYOUTS, FrameComparison, compare_frames
from runtime.cli.command import main
from tests.data import ROOT
from tests.runtime.players import skirt_database
from wrinkles.database_file import write_database


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("turns") / "skirt.h5"
    write_database(path, skirt_database())
    return path


@pytest.mark.proof
def test_both_checkouts_play_as_many_frames_in_turns(path: Path) -> None:
    lines = []
    found = compare_frames(path, ROOT, 0.5, lines.append)
    parts = {"skin", "coarse", "decode", "relax", "normals", "frame", "without_network"}
    assert set(found.here) == set(found.other) == parts
    turns = len(lines) - 1
    assert turns >= 2 and all(row.shape == (turns, FRAMES) for row in (*found.here.values(), *found.other.values()))
    for times in (found.here, found.other):
        assert (times["coarse"] > 0.0).all() and (times["without_network"] <= times["frame"]).all()


def test_a_ratio_is_the_median_of_the_turns_ratios() -> None:
    other, here = (
        np.array([[1.0, 1.0, 9.0], [2.0, 2.0, 2.0], [4.0, 4.0, 4.0]]),
        np.array([3 * [2.0], 3 * [2.0], 3 * [2.0]]),
    )
    comparison = FrameComparison({"frame": other}, {"frame": here})
    assert comparison.figures() == {
        "frame_other_ms": 2.0,
        "frame_here_ms": 2.0,
        "frame_ratio": 1.0,
        "frame_least_ratio": 0.5,
        "frame_greatest_ratio": 2.0,
    }
    assert comparison.text().splitlines()[1].split() == ["frame", "2.000", "2.000", "1.000", "0.50-2.00"]


def test_a_folder_that_plays_nothing_is_refused(path: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--against.*runtime/"):
        compare_frames(path, tmp_path, 0.5)
    for name in LAYOUTS[-1]:
        module = tmp_path / f"{name.replace('.', '/')}.py"
        module.parent.mkdir(exist_ok=True)
        module.write_text("")
    with pytest.raises(InputError, match="does not play the database"):
        compare_frames(path, tmp_path, 0.5)


def test_the_other_checkout_plays_a_database_of_its_own(path: Path, tmp_path: Path) -> None:
    """Here the one that it is given is none, while that of this checkout is good."""
    with pytest.raises(InputError, match="does not play the database"):
        compare_frames(path, ROOT, 0.5, other_path=tmp_path / "none.h5")


def test_a_database_for_no_other_checkout_is_refused(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "frame", str(path), "--against-database", str(path)]) == 2
    assert "--against-database" in capsys.readouterr().err
