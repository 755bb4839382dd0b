from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from precompute.workers import Workers


def square(number: int) -> int:
    return number * number


def process(number: int) -> int:
    time.sleep(0.3)  # long enough for the other worker to take the next
    return os.getpid()


def blas_threads(number: int) -> int:
    assert np.ones((2, 2)).sum() == 4.0  # numpy is there, and its BLAS with it
    return max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")


def refuse(path: Path) -> None:
    if path.name == "bad":
        raise ValueError("refused")
    time.sleep(0.2)
    path.touch()


def test_results_are_in_order_for_any_number_of_workers() -> None:
    for count in (1, 2):
        done: list[int] = []
        with Workers(count) as workers:
            assert workers.map(square, range(7), done.append) == [0, 1, 4, 9, 16, 25, 36]
        assert done[-1] == 7 and done == sorted(done)


def test_one_worker_is_this_process() -> None:
    with Workers(1) as workers:
        assert set(workers.map(process, range(2))) == {os.getpid()}
        assert workers.processor_s == 0.0


def test_workers_live_on_from_one_work_to_the_next_and_their_time_counts() -> None:
    with Workers(2) as workers:
        first = set(workers.map(process, range(4)))
        before = workers.processor_s
        second = set(workers.map(process, range(4)))
        assert first == second and len(first) == 2 and os.getpid() not in first
        assert workers.map(blas_threads, range(4)) == [1, 1, 1, 1]
        assert 0.0 < before <= workers.processor_s


def test_an_error_ends_the_work(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a", "bad", *"cdefghijklmnop")]
    with Workers(2) as workers, pytest.raises(ValueError, match="refused"):
        workers.map(refuse, paths)
    assert len(list(tmp_path.iterdir())) < len(paths) - 1
