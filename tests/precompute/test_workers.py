"""Worker processes: results in order, one thread each, an end when a job fails or the parent is killed."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from functools import partial
from multiprocessing import active_children
from pathlib import Path

import pytest

import precompute.workers
from pbd.errors import InputError
from precompute.workers import Workers, run_jobs
from tests.data import ROOT


def _late(seconds: float, value: int) -> tuple[int, int]:
    time.sleep(seconds)
    return value, os.getpid()


def _refused() -> None:
    raise InputError("refused", key="job")


def _marked(path: Path) -> None:
    path.touch()
    time.sleep(0.2)


def _threads() -> tuple[str, set[int]]:
    import scipy.linalg  # noqa: F401  (brings a BLAS of its own)
    from threadpoolctl import threadpool_info

    return os.environ["GUBE_THREADS"], {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_jobs(workers: int) -> None:
    counts, ends = [], []
    jobs = [partial(_late, 0.4, 0), partial(_late, 0.0, 1), partial(_late, 0.0, 2)]
    results = run_jobs(jobs, workers, done=lambda count, result: (counts.append(count), ends.append(result[0])))
    assert [value for value, _ in results] == [0, 1, 2]
    assert counts == [1, 2, 3] and sorted(ends) == [0, 1, 2]
    assert all((process == os.getpid()) == (workers == 1) for _, process in results)
    assert run_jobs([], workers) == []


def test_a_job_that_fails_gives_up_those_that_wait(tmp_path: Path) -> None:
    waiting = [partial(_marked, tmp_path / str(k)) for k in range(40)]
    with pytest.raises(InputError, match="refused"):
        run_jobs([_refused, *waiting], 2)
    assert len(list(tmp_path.iterdir())) < 40


def test_a_worker_has_one_thread() -> None:
    threads, blas = run_jobs([_threads, _threads], 2)[0]
    assert threads == "1" and blas == {1}


def test_workers_live_on_from_one_work_to_the_next_and_their_time_counts() -> None:
    jobs = [partial(_late, 0.3, k) for k in range(4)]  # long enough for the other worker to take the next
    with Workers(2) as workers:
        first = {process for _, process in workers.run(jobs)}
        before = workers.processor_s
        second = {process for _, process in workers.run(jobs)}
        assert first == second and len(first) == 2 and os.getpid() not in first
        assert 0.0 < before <= workers.processor_s
        with Workers.of(workers) as same:
            assert same is workers
    with Workers.of(1) as alone:
        assert {process for _, process in alone.run(jobs[:2])} == {os.getpid()} and alone.processor_s == 0.0


def test_a_worker_does_not_outlive_a_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(
        "import os, time\n"
        "from precompute.workers import worker_pool\n"
        "if __name__ == '__main__':\n"
        "    with worker_pool(1) as pool:\n"
        "        print(pool.submit(os.getpid).result(), flush=True)\n"
        "        pool.submit(time.sleep, 600)\n"
        "        time.sleep(600)\n"
    )
    parent = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert parent.stdout is not None
    worker = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()
    for _ in range(200):
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        if Path(f"/proc/{worker}/stat").exists() and " Z " in Path(f"/proc/{worker}/stat").read_text():
            return  # ended, and nobody has taken notice yet
        time.sleep(0.05)
    os.kill(worker, 9)
    pytest.fail("the worker lives on")


def test_who_is_ended_ends_its_processes_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precompute.workers, "GLANCE", 0.1)
    before, began = set(active_children()), []

    def interrupted() -> None:
        if set(active_children()) - before:
            began.append(time.monotonic())
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_jobs([partial(_late, 300.0, 0), partial(_late, 300.0, 1)], 2, meanwhile=interrupted)
    assert time.monotonic() - began[0] < 60.0
    assert not set(active_children()) - before  # those of an earlier test may have ended in between
