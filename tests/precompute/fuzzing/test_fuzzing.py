"""Broken files: how they are made, how readers answer, and that nothing gets through."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assets.loading import load_garment
from assets.patterns.load import load_pattern
from pbd import Fabric, InputError, State, build_model
from pbd.mesh import ClothMesh
from precompute.fuzzing import fuzzing
from precompute.fuzzing.fuzzing import fuzz
from precompute.fuzzing.mutations import mutated
from precompute.fuzzing.readers import READERS, write_good_files
from tests.wrinkles.databases import small_database
from tests.wrinkles.meshes import flat_sheet
from wrinkles.database_file import write_database


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Small good files of every kind, a database too."""
    folder = tmp_path_factory.mktemp("good")
    files = write_good_files(folder)
    files.append(folder / "small.h5")
    write_database(files[-1], small_database())
    return files


def test_every_good_file_is_read(good: list[Path]) -> None:
    """By one reader of its ending or more: else a mutation would only change what is refused anyway."""
    for path in good:
        answers = [fuzzing._answer(reader, path) for reader in READERS[path.suffix]]
        assert set(answers) <= {"", "refused"} and "" in answers, (path.name, answers)


def test_mutations_come_again_and_keep_the_structure(good: list[Path]) -> None:
    for path in good:
        data = path.read_bytes()
        made = [[mutated(data, path.suffix, random.Random(seed)) for seed in range(12)] for _ in range(2)]
        assert made[0] == made[1]
        assert sum(one != data for one in made[0]) >= 9
        if path.suffix in (".npz", ".h5"):
            assert sum(one[:4] == data[:4] for one in made[0]) >= 8  # not one zip file after the other cut in two


@dataclass
class Holder:
    values: dict[str, Any]


def test_answers_of_readers_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzzing, "CASE_SECONDS", 0.2)
    before = fuzzing.signal.signal(fuzzing.signal.SIGALRM, fuzzing._too_long)

    def refuse(path: Path) -> None:
        raise InputError("no")

    def fall(path: Path) -> None:
        raise KeyError("x")

    try:
        answers = [
            fuzzing._answer(reader, tmp_path)
            for reader in (
                refuse, fall, lambda path: time.sleep(2.0), lambda path: Holder({"a": [np.array([0.0, np.nan])]}),
                lambda path: Holder({"a": [np.array([np.inf, 1.0])]}),
            )
        ]  # fmt: skip
    finally:
        fuzzing.signal.signal(fuzzing.signal.SIGALRM, before)
    assert answers == [
        "refused",
        "KeyError in test_fuzzing.py:fall",
        "takes over 0.2 s",
        "a value that is no number",
        "",
    ]


def test_what_nothing_reads_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(InputError, match="nothing reads this"):
        fuzz([tmp_path / "a.txt"], tmp_path / "out", seconds=1.0)


def run(good: list[Path], output: Path, seconds: float, workers: int, seed: int) -> None:
    found = fuzz(good, output, seconds=seconds, workers=workers, seed=seed)
    assert found.escapes == {}
    assert set(found.cases) == {path.suffix for path in good}
    assert found.cases.total() > 20 * seconds
    assert len(found.lines) > 1650  # the good files alone reach 1,620
    assert 0.5 < found.refused / found.cases.total() < 0.999
    assert not list(output.glob("worker_*"))


@pytest.mark.proof
def test_nothing_gets_through_in_some_seconds(good: list[Path], tmp_path: Path) -> None:
    run(good, tmp_path, 10.0, 1, seed=0)


@pytest.mark.proof
def test_nothing_gets_through_in_half_an_hour(good: list[Path], tmp_path: Path) -> None:
    """Each run has a seed of its own: what gets through is in the folder that the message names."""
    run(good, tmp_path, 1800.0, 2, seed=int(time.time()))


@pytest.mark.parametrize("box", ["0 0 -inf 60", "0 0 - 60", "e e e e"])
def test_a_drawing_whose_box_has_words_is_read_or_refused(tmp_path: Path, box: str) -> None:
    """Found by `gube fuzz`: a ValueError."""
    drawn = '<path id="a" d="M0 0 L40 0 L40 60 Z"/>'
    text = f'<svg xmlns="http://www.w3.org/2000/svg" width="40cm" viewBox="{box}">{drawn}</svg>'
    (tmp_path / "a.svg").write_text(text)
    assert fuzzing._answer(load_pattern, tmp_path / "a.svg") in ("", "refused")
    assert fuzzing._answer(load_garment, tmp_path / "a.svg") == "refused"


def test_a_state_of_arrays_without_length_is_refused(tmp_path: Path) -> None:
    """Found by `gube fuzz`: a TypeError; and states that are not finite were read."""
    state = State.at_rest(build_model(ClothMesh.from_surface(*flat_sheet(3, 0.2)), Fabric(), bend_factor=1 / 3))
    for name, value in (("position", np.float32(1.0)), ("velocity", np.full_like(state.velocity, np.nan))):
        changed = state.copy()
        setattr(changed, name, value)
        np.savez(tmp_path / "a.npz", **{one: getattr(changed, one) for one in State._names})
        with pytest.raises(InputError):
            State.load(str(tmp_path / "a.npz"))


def test_a_drawing_whose_library_fails_is_refused(tmp_path: Path, good: list[Path]) -> None:
    """Found by `gube fuzz`: ezdxf raises ValueError, IndexError, OverflowError and StopIteration."""
    drawing = next(path for path in good if path.suffix == ".dxf").read_bytes()
    for number, broken in enumerate((drawing[:40], drawing.replace(b"$ACADVER", b"9"), drawing[:400])):
        (tmp_path / f"{number}.dxf").write_bytes(broken)
        assert fuzzing._answer(load_pattern, tmp_path / f"{number}.dxf") == "refused"
