"""The workers of a Dask cluster do what processes of this machine do."""

from __future__ import annotations

import asyncio
import heapq
import logging
import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import dask.config
import numpy as np
import pytest
from distributed import Client, LocalCluster, Scheduler, Worker

from pbd.errors import InputError
from precompute import cluster
from precompute.cluster import ClusterWorkers, cache_here, local_cluster, workers_of
from precompute.learning.pipeline import scene_run
from precompute.learning.run_recording import Run, record_runs
from precompute.workers import Workers, run_jobs
from runtime.setup.garment_setup import GarmentSetup
from tests.precompute.miniature import scene


@pytest.fixture(scope="module")
def two() -> Iterator[LocalCluster]:
    with local_cluster(2) as two:
        yield two


@pytest.fixture
def workers(two: LocalCluster) -> Iterator[Workers]:
    with ClusterWorkers(two.scheduler_address) as workers:
        yield workers


def _late(seconds: float, value: int) -> tuple[int, int, str | None]:
    time.sleep(seconds)
    return value, os.getpid(), os.environ.get("GUBE_THREADS")


def _sum(shared: np.ndarray, own: float) -> float:
    return float(shared.sum()) + own


def _refused() -> None:
    raise InputError("refused", key="job")


def _full() -> None:
    raise OSError(28, "No space left on device", "chunk.npz")


def _dies_once(marker: Path, shared: np.ndarray) -> float:
    """Ends its process the first time."""
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return float(shared.sum())


def test_results_come_in_the_order_of_the_jobs(workers: Workers) -> None:
    counts = []
    jobs = [partial(_late, 0.3, 0), partial(_late, 0.0, 1), partial(_late, 0.0, 2)]
    results = run_jobs(jobs, workers, done=lambda count, result: counts.append(count))
    assert [value for value, *_ in results] == [0, 1, 2] and counts == [1, 2, 3]
    assert len({process for _, process, _ in results}) == 2 and os.getpid() not in {one for _, one, _ in results}
    assert {threads for *_, threads in results} == {"1"}
    assert 0.0 < workers.processor_s and workers.run([]) == []


def test_arguments_that_jobs_share_are_sent_once(workers: ClusterWorkers) -> None:
    shared = np.arange(200_000.0)
    equal = shared.copy()
    for _ in range(3):
        found = workers.run([partial(_sum, shared, k) for k in (1.0, 2.0)] + [partial(_sum, equal, 3.0)])
        assert found == [shared.sum() + k for k in (1.0, 2.0, 3.0)]
    assert len(workers._sent) == 1


def test_an_error_of_a_job_comes_back_as_it_was(workers: Workers) -> None:
    with pytest.raises(InputError, match="refused"):
        workers.run([_refused, partial(_late, 0.0, 1)])
    with pytest.raises(OSError, match="No space left"):
        workers.run([_full])
    assert workers.run([partial(_late, 0.0, 1)])[0][0] == 1


@pytest.mark.proof
def test_a_job_whose_process_is_killed_runs_again_elsewhere(workers: Workers, tmp_path: Path) -> None:
    """What other jobs still need may have lain on the process that ended."""
    shared = np.arange(300_000.0)
    jobs = [partial(_dies_once, tmp_path / str(k), shared) for k in range(2)] + [partial(_sum, shared, 0.0)] * 6
    assert workers.run(jobs) == [shared.sum()] * 8


def test_steps_follow_each_other(workers: ClusterWorkers) -> None:
    seen: dict[int, list[float]] = {0: [], 1: []}

    def after(number: int, result: float) -> partial[float] | None:
        seen[number].append(result)
        return partial(_sum, np.full(2, result), 1.0) if len(seen[number]) < 4 else None

    workers.run_in_steps([partial(_sum, np.zeros(1), 1.0), partial(_sum, np.ones(1), 1.0)], after)
    assert seen == {0: [1.0, 3.0, 7.0, 15.0], 1: [2.0, 5.0, 11.0, 23.0]}


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    small = scene()
    stage = GarmentSetup.of(small)
    motion = stage.training_motions()[0]
    run = scene_run(stage, small, motion)
    coarse = replace(run, fine=False, solver=small.solver.options())
    return [replace(coarse, poses=coarse.poses[first : first + 100]) for first in (0, 10)]


@pytest.mark.proof
def test_runs_are_the_same_bits_and_go_on_from_what_is_there(workers: Workers, runs: list[Run], tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    expected = record_runs(runs, here, 1)
    assert runs[0].chunk_count == 2
    (there / runs[1].key()).mkdir(parents=True)
    first = f"{runs[1].key()}/chunk_0000.npz"
    (there / first).write_bytes((here / first).read_bytes())
    told = (there / first).stat().st_mtime_ns
    for one, other in zip(expected, record_runs(runs, there, workers), strict=True):
        for name in ("frames", "positions", "contact", "nearest", "coarse"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert (there / first).stat().st_mtime_ns == told


def test_the_cache_is_used_where_it_is_seen_and_another_where_it_is_not(two: LocalCluster, tmp_path: Path) -> None:
    seen, hidden = tmp_path / "seen", tmp_path / "hidden"
    with ClusterWorkers(two.scheduler_address, seen) as workers:
        assert workers.run([partial(cache_here, seen)]) == [seen] and workers.sees_files
    assert not list(seen.iterdir())
    with ClusterWorkers(two.scheduler_address, hidden) as workers:
        next(hidden.iterdir()).unlink()  # as on a machine that has another folder of this name, or none
        (found,) = workers.run([partial(cache_here, hidden)])
        assert found != hidden and found.name == "gube-cache" and found.parent != tmp_path
        assert not workers.sees_files


def test_a_worker_with_other_code_is_refused(workers: Workers, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_version", lambda: "other")
    with pytest.raises(InputError, match="other code"):
        workers.run([partial(_late, 0.0, 1)])


@pytest.mark.parametrize(
    ("address", "problem"),
    [("tcp://127.0.0.1:9", "no scheduler answers"), ("nonsense", "no address"), ("what://x:1", "no address")],
)
def test_no_scheduler_is_an_error_that_names_the_address(address: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem) as error, workers_of(address, 2):
        pass
    assert address in str(error.value)


def test_workers_with_several_threads_are_refused() -> None:
    with LocalCluster(n_workers=1, threads_per_worker=2, host="127.0.0.1", dashboard_address="127.0.0.1:0") as wide:
        with pytest.raises(InputError, match="with 2 threads"), ClusterWorkers(wide.scheduler_address):
            pass


@pytest.mark.proof
def test_a_scheduler_that_ends_is_told() -> None:
    with local_cluster(1) as one:
        with ClusterWorkers(one.scheduler_address) as workers:
            with pytest.raises(BrokenExecutor, match="scheduler"):
                workers.run(
                    [partial(_late, 0.0, 1), partial(_late, 60.0, 2)], done=lambda count, result: one.close(timeout=5)
                )


# A hundred workers in one process would otherwise spend it on watching themselves.
UNWATCHED = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "1h",
    "distributed.admin.tick.limit": "1h",
    "distributed.comm.timeouts.connect": "600s",
    "distributed.comm.timeouts.tcp": "600s",
}
LOOPBACK: dict[str, Any] = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}


def _last_end(durations: np.ndarray, workers: int) -> float:
    """When the last job ends if each worker takes the next one as soon as it is free, without any delay [s]."""
    free = [0.0] * workers
    for one in durations:
        heapq.heapreplace(free, free[0] + one)
    return max(free)


async def _asleep(seconds: float, size: int) -> bytes:
    """A database's learning, as the scheduler sees it."""
    await asyncio.sleep(seconds)
    return bytes(size)


async def _slept(durations: np.ndarray, workers: int, size: int) -> float:
    """Time until a real scheduler's workers, which are all in this process, have slept so long [s]."""
    async with Scheduler(**LOOPBACK, port=0) as scheduler:
        one: dict[str, Any] = {"nthreads": 1, "memory_limit": 0, "silence_logs": logging.CRITICAL, **LOOPBACK}
        crew = [Worker(scheduler.address, **one) for _ in range(workers)]
        await asyncio.gather(*(worker.start() for worker in crew))
        client: Any = Client(scheduler.address, asynchronous=True, set_as_default=False)
        async with client:
            began = time.monotonic()
            await client.gather([client.submit(_asleep, float(one), size, pure=False) for one in durations])
            found = time.monotonic() - began
        await asyncio.gather(*(worker.close(nanny=False) for worker in crew))
    return found


def _added(durations: np.ndarray, workers: int, size: int) -> float:
    """What a scheduler adds to jobs of such lengths, while each worker sleeps for 10 s in all instead [s].

    It does not shrink with the jobs, so that it is taken in seconds as they come.
    """
    scaled = durations * (10.0 * workers / durations.sum())
    with dask.config.set(UNWATCHED):
        return asyncio.run(_slept(scaled, workers, size)) - _last_end(scaled, workers)


def test_a_worker_takes_the_next_job_as_soon_as_it_is_free() -> None:
    assert _last_end(np.array([3.0, 1.0, 1.0, 1.0, 2.0]), 2) == 5.0
    assert _last_end(np.array([3.0]), 4) == 3.0


@pytest.mark.proof
def test_a_scheduler_adds_less_than_a_twentieth_at_a_hundred_workers() -> None:
    """To a thousand databases of 11.3 minutes in the mean and 0.35 MB, as the sewn T-shirt's."""
    durations, workers = 60.0 * 11.3 * np.random.default_rng(0).uniform(0.5, 1.5, 1000), 100
    with Workers(2) as fresh:  # a second cluster in one process does not start
        (added,) = fresh.run([partial(_added, durations, workers, 350_000)])
    assert 0.0 < added < 0.05 * _last_end(durations, workers)
