"""What a solver has to know of all vertices of a state at once."""

from __future__ import annotations

import numpy as np
import pytest

from pbd.engine import ensure_initialized
from pbd.xpbd.state_summary import SUMMARY, summarize


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_means_are_those_of_numpy_and_one_bad_number_is_found(bad: float) -> None:
    ensure_initialized()
    rng, found = np.random.default_rng(7), np.zeros(SUMMARY, np.float32)
    for count in (1, 2, 9, 130, 2000):
        position, velocity = (rng.normal(size=(count, width)).astype(np.float32) for width in (4, 3))
        summarize(position, velocity, found)
        assert np.array_equal(found[:3], position[:, :3].mean(axis=0)) and found[6] == 0.0
        assert np.array_equal(found[3:6], velocity.mean(axis=0))
        for array in (position, velocity):
            row, column = rng.integers(count), rng.integers(array.shape[1])
            kept, array[row, column] = array[row, column], bad
            summarize(position, velocity, found)
            assert found[6] != 0.0
            array[row, column] = kept
    summarize(np.full((4, 4), 3e38, np.float32), np.full((4, 3), -3e38, np.float32), found)
    assert found[6] == 0.0  # finite, though their sum is not
