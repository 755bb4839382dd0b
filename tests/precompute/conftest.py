from __future__ import annotations

import pytest

from precompute.learning.pipeline import Precomputed, precompute
from tests.precompute.miniature import OPTIONS, scene


@pytest.fixture(scope="session")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Precomputed:
    """The miniature's database, its recorded runs beside it."""
    return precompute(scene(), tmp_path_factory.mktemp("learned") / "skirt.h5", workers=1, options=OPTIONS)
