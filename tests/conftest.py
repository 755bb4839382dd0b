"""How the tests are shared out to processes (`pytest -n 2 --dist loadgroup`, as `make test` runs them)."""

from __future__ import annotations

from pathlib import Path

import pytest

from pbd import ensure_initialized

ROOT = Path(__file__).parent.parent

ensure_initialized()  # here rather than in a fixture: test modules may make arrays while they are collected


@pytest.hookimpl(tryfirst=True)  # before the groups are read
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files stay whole; those that ask for `learned` go to one process, so that it is made once.

    Long files first, so that no process ends alone on one: those that run programs, learn and compare.
    """
    learned = {item.path for item in items if "learned" in getattr(item, "fixturenames", ())}
    for item in items:
        item.add_marker(pytest.mark.xdist_group("learned" if item.path in learned else str(item.path)))
    first = [ROOT / "tests" / name for name in ("test_examples.py", "test_wheel.py", "precompute", "runtime")]
    items.sort(key=lambda item: [not item.path.is_relative_to(place) for place in first])
