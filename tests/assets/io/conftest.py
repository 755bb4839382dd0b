"""USD files that tests write themselves are sound: reading each in another process first takes a second."""

from __future__ import annotations

import pytest

import assets.io.usd
from assets.io.usd_guard import require_sound


@pytest.fixture(autouse=True)
def unguarded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assets.io.usd, "require_sound", lambda path: None)


@pytest.fixture
def guarded(unguarded: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Undoes `unguarded`."""
    monkeypatch.setattr(assets.io.usd, "require_sound", require_sound)
