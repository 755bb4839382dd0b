"""A precompute that is killed, starved or fed with broken cache files gives the same database when it goes on.

`python -m pytest -m proof tests/precompute/learning/test_faults.py` lets 326 faults happen.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import pytest

from precompute.learning.pipeline import Precomputed, default_cache
from tests.data import ROOT
from tests.precompute.miniature import same
from wrinkles.database import WrinkleDatabase
from wrinkles.database_file import read_database

pytestmark = pytest.mark.proof

PRECOMPUTE = """
import sys
from pathlib import Path
from precompute.cluster import workers_of
from precompute.learning.pipeline import default_cache, precompute
from tests.precompute.miniature import OPTIONS, scene

if __name__ == "__main__":
    output = Path(sys.argv[1])
    with workers_of(sys.argv[3] if sys.argv[3:] else None, int(sys.argv[2]), default_cache(output)) as workers:
        precompute(scene(), output, workers=workers, options=OPTIONS)
"""
FULL_DISK = """
import errno, os

replace, left = os.replace, [int(os.environ["WRITES"])]

def full(*names):
    left[0] -= 1
    if left[0] < 0:
        raise OSError(errno.ENOSPC, "No space left on device")
    replace(*names)

os.replace = full
"""
JUMPING_CLOCK = """
import os, time

def jumping(clock=time.time, began=time.monotonic()):
    return clock() + float(os.environ["JUMP"]) * (int(time.monotonic() - began) % 2)

time.time = jumping
"""


def begin(
    output: Path,
    workers: int = 2,
    *,
    first: str = "",
    address: str | None = None,
    prepare: Callable[[], None] | None = None,
    **environment: str,
) -> subprocess.Popen[bytes]:
    script = output.with_suffix(".py")
    script.parent.mkdir(parents=True, exist_ok=True)
    script.write_text(first + PRECOMPUTE, encoding="utf-8")
    paths = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    return subprocess.Popen(
        [sys.executable, str(script), str(output), str(workers), *([address] if address else [])],
        cwd=ROOT, env=paths, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        preexec_fn=prepare,
    )  # fmt: skip


def finish(output: Path, expected: WrinkleDatabase) -> None:
    """Go on to the end; all that was learned and measured is the same, but times."""
    assert begin(output).wait(timeout=600) == 0
    same(read_database(output), expected)
    assert not list(output.parent.glob(".*.part"))


def children(process: int) -> list[int]:
    listed = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process)], capture_output=True, text=True).stdout
    return [int(word) for word in listed.split()]


@pytest.mark.parametrize("seed", range(20))
def test_killed_at_any_moment_it_goes_on_to_the_same(seed: int, learned: Precomputed, tmp_path: Path) -> None:
    """Five kills each, of the first process, of a worker, or a polite end."""
    chance, output = random.Random(seed), tmp_path / "skirt.h5"
    for _ in range(5):
        process = begin(output)
        time.sleep(chance.uniform(1.0, 30.0))
        victims = [process.pid, *children(process.pid)]
        kind = chance.choice(("first", "worker", "term"))
        victim = victims[0] if kind != "worker" else chance.choice(victims)
        if process.poll() is None:
            os.kill(victim, signal.SIGTERM if kind == "term" else signal.SIGKILL)
        process.wait(timeout=600)
        if process.returncode != 0:
            assert not output.exists()
        output.unlink(missing_ok=True)
    finish(output, learned.database)


@contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, dict[str, int]]]:
    """A scheduler and two workers: its address, and the process of each by its name."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{one.getsockname()[1]}"
    dask, paths = [sys.executable, "-m", "dask"], os.environ | {"PYTHONPATH": str(ROOT), "GUBE_THREADS": "1"}
    host = ["--host", "127.0.0.1", "--no-dashboard"]
    commands = {"scheduler": [*dask, "scheduler", *host, "--port", address.rpartition(":")[2]]}
    for name in ("first", "second"):
        commands[name] = [*dask, "worker", address, *host, "--nthreads", "1", "--local-directory", str(folder / name)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    started = {name: subprocess.Popen(words, env=paths, **quiet) for name, words in commands.items()}
    try:
        yield address, {name: process.pid for name, process in started.items()}
    finally:
        for process in started.values():
            for one in (*children(process.pid), process.pid):
                with suppress(ProcessLookupError):
                    os.kill(one, signal.SIGKILL)
            process.wait()


@pytest.mark.parametrize("seed", range(10))
def test_killed_on_a_cluster_it_goes_on_to_the_same(seed: int, learned: Precomputed, tmp_path: Path) -> None:
    """Five kills each, of the process that asked, of the scheduler, of a worker, or of a worker with what minds it."""
    chance, output = random.Random(seed), tmp_path / "skirt.h5"
    for number in range(5):
        with cluster(tmp_path / str(number)) as (address, processes):
            process = begin(output, address=address)
            time.sleep(chance.uniform(4.0, 34.0))
            kind = chance.choice(("client", "scheduler", "worker", "nanny"))
            victim = process.pid if kind == "client" else processes[kind if kind == "scheduler" else "first"]
            if kind == "worker":
                victim = next(iter(children(victim)), victim)
            if process.poll() is None:
                os.kill(victim, signal.SIGKILL)
            process.wait(timeout=600)
            if kind in ("worker", "nanny"):
                assert process.returncode == 0  # the other one does the work
            if process.returncode == 0:
                same(read_database(output), learned.database)
            else:
                assert not output.exists()
            output.unlink(missing_ok=True)
    finish(output, learned.database)


@pytest.mark.parametrize("seed", range(30))
def test_broken_cache_files_are_made_anew(seed: int, learned: Precomputed, tmp_path: Path) -> None:
    chance, output = random.Random(seed), tmp_path / "skirt.h5"
    shutil.copytree(default_cache(learned.path), default_cache(output))
    files = sorted(path for path in default_cache(output).rglob("*") if path.is_file())
    for path in chance.sample(files, min(5, len(files))):
        data = bytearray(path.read_bytes())
        if chance.random() < 0.5:
            del data[chance.randrange(len(data)) :]
        else:
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        path.write_bytes(data)
    finish(output, learned.database)


@pytest.mark.parametrize("writes", range(15))
def test_a_disk_that_fills_leaves_nothing_half_written(writes: int, learned: Precomputed, tmp_path: Path) -> None:
    output = tmp_path / "skirt.h5"
    process = begin(output, 1, first=FULL_DISK, WRITES=str(writes))
    assert process.wait(timeout=600) != 0 and not output.exists()
    assert not list(tmp_path.rglob(".*.part"))
    finish(output, learned.database)


@pytest.mark.parametrize("size", ["64k", "300k", "1m", "3m"])
def test_a_small_disk_is_full_at_any_byte(size: str, learned: Precomputed, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "none", disk], capture_output=True).returncode:
        pytest.skip("only a system's administrator may mount a disk")
    try:
        output = disk / "skirt.h5"
        assert begin(output, 1).wait(timeout=600) != 0 and not output.exists()
        assert not list(disk.rglob(".*.part"))
        subprocess.run(["mount", "-o", "remount,size=200m", disk], check=True)
        finish(output, learned.database)
    finally:
        subprocess.run(["umount", disk], check=True)


@pytest.mark.parametrize("gigabytes", [1.0, 1.5, 2.0, 3.0])
def test_processes_without_memory(gigabytes: float, learned: Precomputed, tmp_path: Path) -> None:
    """The system gives each process so much address space and no more."""
    output, limit = tmp_path / "skirt.h5", round(gigabytes * 2**30)
    process = begin(output, prepare=partial(resource.setrlimit, resource.RLIMIT_AS, (limit, limit)))
    if process.wait(timeout=600) != 0:
        assert not output.exists() and not list(tmp_path.rglob(".*.part"))
        finish(output, learned.database)
    same(read_database(output), learned.database)


@pytest.mark.parametrize("jump", [-86400.0, 86400.0])
def test_a_clock_that_jumps(jump: float, learned: Precomputed, tmp_path: Path) -> None:
    """It goes a day wrong and comes back, each second."""
    output = tmp_path / "skirt.h5"
    assert begin(output, first=JUMPING_CLOCK, JUMP=str(jump)).wait(timeout=600) == 0
    same(read_database(output), learned.database)


def test_two_at_once_on_one_cache(learned: Precomputed, tmp_path: Path) -> None:
    processes = [begin(tmp_path / name) for name in ("one.h5", "two.h5")]
    assert [process.wait(timeout=1200) for process in processes] == [0, 0]
    for name in ("one.h5", "two.h5"):
        (tmp_path / name).unlink()
        finish(tmp_path / name, learned.database)
