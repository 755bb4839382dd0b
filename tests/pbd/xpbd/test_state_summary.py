"""What a solver has to know of all vertices of a state at once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pbd.xpbd.state_summary import StateSummary


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_means_are_those_of_numpy_and_one_bad_number_is_found(bad: float) -> None:
    rng, found = np.random.default_rng(7), StateSummary()
    for count in (1, 2, 9, 130, 2000):
        position, velocity = (rng.normal(size=(count, width)).astype(np.float32) for width in (4, 3))
        state: Any = SimpleNamespace(position=position, velocity=velocity)
        found.read(state)
        assert np.array_equal(found.centre, position[:, :3].mean(axis=0)) and found.is_finite
        assert np.array_equal(found.drift, velocity.mean(axis=0))
        for array in (position, velocity):
            row, column = rng.integers(count), rng.integers(array.shape[1])
            kept, array[row, column] = array[row, column], bad
            found.read(state)
            assert not found.is_finite
            array[row, column] = kept
    state = SimpleNamespace(position=np.full((4, 4), 3e38, np.float32), velocity=np.full((4, 3), -3e38, np.float32))
    found.read(state)
    assert found.is_finite  # though their sum is not
