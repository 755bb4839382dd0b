"""A precompute that is killed, starved or fed with broken cache files gives the same database when it goes on."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from precompute.learning.pipeline import Precomputed, default_cache
from tests.data import ROOT
from tests.precompute.miniature import same
from wrinkles.database import WrinkleDatabase, read_database

pytestmark = pytest.mark.proof

PRECOMPUTE = """
import sys
from pathlib import Path
from precompute.learning.pipeline import precompute
from tests.precompute.miniature import OPTIONS, scene

if __name__ == "__main__":
    precompute(scene(), Path(sys.argv[1]), workers=int(sys.argv[2]), options=OPTIONS)
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


def begin(output: Path, workers: int = 2, first: str = "", **environment: str) -> subprocess.Popen[bytes]:
    script = output.with_suffix(".py")
    script.parent.mkdir(parents=True, exist_ok=True)
    script.write_text(first + PRECOMPUTE, encoding="utf-8")
    paths = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    return subprocess.Popen(
        [sys.executable, str(script), str(output), str(workers)],
        cwd=ROOT, env=paths, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
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


@pytest.mark.parametrize("seed", range(10))
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


@pytest.mark.parametrize("writes", [0, 1, 2, 5, 9, 14])
def test_a_disk_that_fills_leaves_nothing_half_written(writes: int, learned: Precomputed, tmp_path: Path) -> None:
    output = tmp_path / "skirt.h5"
    process = begin(output, 1, FULL_DISK, WRITES=str(writes))
    assert process.wait(timeout=600) != 0 and not output.exists()
    assert not list(tmp_path.rglob(".*.part"))
    finish(output, learned.database)


def test_two_at_once_on_one_cache(learned: Precomputed, tmp_path: Path) -> None:
    processes = [begin(tmp_path / name) for name in ("one.h5", "two.h5")]
    assert [process.wait(timeout=1200) for process in processes] == [0, 0]
    for name in ("one.h5", "two.h5"):
        (tmp_path / name).unlink()
        finish(tmp_path / name, learned.database)
