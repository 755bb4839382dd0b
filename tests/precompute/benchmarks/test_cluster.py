"""A simulated cluster: its work is done, and takes no less than it must."""

from __future__ import annotations

import numpy as np

from precompute.benchmarks.cluster import cluster_row, durations, listed


def test_a_worker_takes_the_next_as_soon_as_it_is_free() -> None:
    assert listed([3.0, 1.0, 1.0, 1.0, 2.0], 2) == 5.0
    assert listed([3.0], 4) == 3.0


def test_a_real_scheduler_adds_something() -> None:
    times = durations(10.0, 12)
    assert times.shape == (12,) and 300.0 <= times.min() < times.max() <= 900.0
    row = cluster_row(times, 4, 1000)
    assert row["least_h"] == listed(times, 4) / 3600.0 and row["moved_mb"] == 0.012
    assert row["added_s"] > 0.0 and np.isclose(row["makespan_h"], row["least_h"] + row["added_s"] / 3600.0)
    assert np.isclose(row["busy_percent"], 100.0 * times.sum() / (4 * 3600.0 * row["makespan_h"]))
