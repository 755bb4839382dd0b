"""How the tests are shared out to processes (`pytest -n 2 --dist loadfile`, as `make test` runs them)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

from pbd import ensure_initialized
from runtime.output import report

ROOT = Path(__file__).parent.parent

# Files that ask for `learned`: they go to one process, so that it is made once. (The groups of pytest-xdist 3.8 have no
# effect under pytest 9.2, which does not read the names of tests that it changes.)
LEARNED = {
    f"tests/precompute/{name}.py"
    for name in (
        "test_demo",
        "test_wardrobe",
        "learning/test_faults",
        "learning/test_kept",
        "learning/test_pipeline",
        "planning/test_cost_table",
        "wrinkle_comparison/test_wrinkle_comparison",
    )
}

report.FIRST_WAIT = 60.0  # a busy machine shows no line of progress that an idle one does not
ensure_initialized()  # here rather than in a fixture: test modules may make arrays while they are collected


class _LearnedTogether(LoadFileScheduling):
    """Files stay whole; those of :data:`LEARNED` are one."""

    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return "learned" if file in LEARNED else file


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadFileScheduling | None:
    return _LearnedTogether(config, log) if config.getoption("dist") == "loadfile" else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first, so that no process ends alone on one: those that run programs, learn and compare."""
    asking = {item.nodeid.partition("::")[0] for item in items if "learned" in getattr(item, "fixturenames", ())}
    if asking - LEARNED:
        raise pytest.UsageError(f"LEARNED in tests/conftest.py lacks {', '.join(sorted(asking - LEARNED))}")
    first = [ROOT / "tests" / name for name in ("test_examples.py", "test_wheel.py", "precompute", "runtime")]
    items.sort(key=lambda item: [not item.path.is_relative_to(place) for place in first])
