"""Many databases: one that fails does not stop the others, what is there is kept, the page shows the worst first."""

from __future__ import annotations

import shutil
from concurrent.futures import BrokenExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import precompute.wardrobe_learning
from assets.io.scene import Scene, scene_text
from pbd.errors import InputError
from precompute.learning.pipeline import Precomputed
from precompute.wardrobe_learning import GarmentOutcome, learn_wardrobe, wardrobe_rows, wardrobe_text, write_wardrobe
from precompute.workers import Workers
from tests.precompute.miniature import OPTIONS, scene
from wrinkles.database_file import read_database


def test_one_that_fails_does_not_stop_the_others(
    learned: Precomputed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Learning itself is replaced by a copy of a database, since it is tested elsewhere."""
    first = scene()
    refused = replace(first, garments=(replace(first.garments[0], name="refused"),))
    broken = replace(first, garments=(replace(first.garments[0], name="broken"),))
    begun: list[str] = []

    def copied(of: Scene, path: Path, **other: Any) -> Precomputed:
        begun.append(of.garments[0].name)
        if of is refused:
            raise InputError("refused", key="garment")
        if of is broken:
            raise ZeroDivisionError("broken")
        shutil.copy(learned.path, path)
        return learned

    monkeypatch.setattr(precompute.wardrobe_learning, "precompute", copied)
    scenes, output, lines = {"no": refused, "bad": broken, "good": first}, tmp_path / "made", []
    with Workers(1) as workers:
        found = learn_wardrobe(scenes, output, tmp_path / "cache", workers, lines.append, OPTIONS)
        assert [one.name for one in found] == ["no", "bad", "good"]
        assert "refused" in found[0].problem and "ZeroDivisionError" in found[1].problem and not found[2].problem
        assert [path.name for path in output.iterdir()] == ["good.h5"]
        assert read_database(output / "good.h5").scene == scene_text(first)
        assert any("databases: 3 of 3" in line for line in lines)
        begun.clear()
        again = learn_wardrobe(scenes, output, tmp_path / "cache", workers, lines.append, OPTIONS)
    assert begun == ["refused", "broken"] and again[2].figures == found[2].figures


def test_without_workers_it_ends(learned: Precomputed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*given: Any, **named: Any) -> None:
        raise BrokenExecutor("gone")

    monkeypatch.setattr(precompute.wardrobe_learning, "precompute", lost)
    with Workers(1) as workers, pytest.raises(BrokenExecutor, match="gone"):
        learn_wardrobe({"one": scene()}, tmp_path, tmp_path / "cache", workers, lambda line: None, OPTIONS)


@pytest.mark.parametrize("sees_files", [True, False])
def test_whole_ones_are_dealt_only_to_workers_that_see_the_files(
    sees_files: bool, learned: Precomputed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared: list[Any] = []

    def copied(of: Scene, path: Path, *, workers: Workers | int, **other: Any) -> Precomputed:
        shared.append(workers)
        shutil.copy(learned.path, path)
        return learned

    class Dealt(Workers):
        def run(self, jobs: Any, *, done: Any = None, meanwhile: Any = None) -> list:
            for number, job in enumerate(jobs, 1):
                done(number, job())
            return []

    monkeypatch.setattr(precompute.wardrobe_learning, "precompute", copied)
    with Dealt(2) as workers:
        workers.sees_files = sees_files
        scenes = {name: scene() for name in ("one", "two")}
        learn_wardrobe(scenes, tmp_path / "made", tmp_path / "cache", workers, lambda line: None, OPTIONS)
        assert shared == ([1, 1] if sees_files else [workers, workers])


def test_the_worst_come_first(tmp_path: Path) -> None:
    name = "spectrum_band_error_max"
    assert "not judged" in wardrobe_text([GarmentOutcome("alone", minutes=2.0)])
    outcomes = [
        GarmentOutcome("fair", figures={name: 0.3}), GarmentOutcome("good", figures={name: 0.1}),
        GarmentOutcome("none", "<b> cannot be\nread"), GarmentOutcome("bad", figures={name: 0.9}),
    ]  # fmt: skip
    assert [row["database"] for row in wardrobe_rows(outcomes)] == ["none", "bad", "fair", "good"]
    assert wardrobe_text(outcomes).splitlines()[0] == "none  read"
    write_wardrobe(tmp_path / "page.html", outcomes)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "3 of 4 databases" in page and "&lt;b&gt;" in page and page.index("bad") < page.index("good")
