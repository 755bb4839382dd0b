"""What a USD file does to the process that reads it, it does to another one."""

from __future__ import annotations

from pathlib import Path

import pytest

from assets.io import usd_guard
from pbd.errors import InputError
from tests.refusals import refuses

USDA = "#usda 1.0\n"


@pytest.fixture(autouse=True)
def forgotten() -> None:
    usd_guard._problem.cache_clear()


def test_a_sound_file_passes(tmp_path: Path) -> None:
    (tmp_path / "a.usda").write_text(USDA)
    usd_guard.require_sound(tmp_path / "a.usda")


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("import os; os.abort()", "reading it ends the process"),
        ("import time; time.sleep(30)", "reading it takes more than 1 s"),
        ("raise MemoryError('too much')", "MemoryError: too much"),
    ],
)
def test_what_befalls_the_other_process_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, message: str
) -> None:
    (tmp_path / "a.usda").write_text(USDA)
    monkeypatch.setattr(usd_guard, "_SCRIPT", script)
    monkeypatch.setattr(usd_guard, "_SECONDS", 0.5)
    for _ in range(2):
        refuses(rf"a\.usda: no USD, truncated or damaged: {message}", usd_guard.require_sound, tmp_path / "a.usda")


def test_a_file_that_changed_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.usda"
    path.write_text(USDA)
    monkeypatch.setattr(usd_guard, "_SCRIPT", "import sys; sys.exit('unlike' in open(sys.argv[1]).read())")
    usd_guard.require_sound(path)
    path.write_text(USDA + "# unlike before\n")
    with pytest.raises(InputError):
        usd_guard.require_sound(path)
