"""How the tests are shared out to processes (`pytest -n 2 --dist loadfile`, as `make test` runs them)."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

from pbd import ensure_initialized
from runtime import report

ROOT = Path(__file__).parent.parent

report.FIRST_WAIT = 60.0  # a busy machine shows no line of progress that an idle one does not
ensure_initialized()  # here rather than in a fixture: test modules may make arrays while they are collected


@cache
def _asks_for_learned(file: str) -> bool:
    return "learned: Precomputed" in (ROOT / file).read_text(encoding="utf-8")


class _LearnedTogether(LoadFileScheduling):
    """Files stay whole; those that ask for `learned` go to one process, so that it is made once."""

    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return "learned" if _asks_for_learned(file) else file


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadFileScheduling | None:
    return _LearnedTogether(config, log) if config.getoption("dist") == "loadfile" else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first, so that no process ends alone on one: those that run programs, learn and compare."""
    first = [ROOT / "tests" / name for name in ("test_examples.py", "test_wheel.py", "precompute", "runtime")]
    items.sort(key=lambda item: [not item.path.is_relative_to(place) for place in first])
