"""Where tests find real garments, characters and fabrics."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

__all__ = ["ROOT", "data_path"]

ROOT = Path(__file__).resolve().parent.parent


def data_path(name: str) -> Path:
    """Path of a file in the data folder (``GUBE_DATA``, default ``../shared/data``); skips the test without it."""
    path = Path(os.environ.get("GUBE_DATA", ROOT.parent / "shared" / "data")) / name
    if not path.exists():
        pytest.skip(f"no {path}; set GUBE_DATA")
    return path
