from __future__ import annotations

import pytest

from precompute.learning.pipeline import Precomputed, precompute
from tests.precompute.miniature import OPTIONS, scene


@pytest.fixture(scope="session")
def reports() -> list[str]:
    """Lines that `learned` reported while it was made."""
    return []


@pytest.fixture(scope="session")
def learned(tmp_path_factory: pytest.TempPathFactory, reports: list[str]) -> Precomputed:
    """The miniature's database, its recorded runs beside it; modules that ask for it run in one process."""
    folder = tmp_path_factory.mktemp("learned")
    return precompute(scene(), folder / "skirt.h5", workers=1, options=OPTIONS, report=reports.append)
