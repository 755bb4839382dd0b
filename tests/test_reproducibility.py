"""The same bits from any number of threads, in any process, and from any Python: `-s` prints the table."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

from runtime.output.terminal import say
from tests.data import ROOT

PYTHONS = ("python3.10", "python3.11", "python3.12", "python3.13")


def ends(python: str, threads: int) -> dict[str, str]:
    """The hash in which each scene of :mod:`tests.reproduced` ends, in a process of its own."""
    settings = os.environ | {"GUBE_THREADS": str(threads), "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "random"}
    command = [python, "-m", "tests.reproduced"]
    result = subprocess.run(command, cwd=ROOT, env=settings, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return dict(line.split() for line in result.stdout.splitlines() if len(line.split()) == 2)


def others() -> list[str]:
    """Other Pythons of the search path that have what a player needs."""
    found = [shutil.which(name) for name in PYTHONS if name != f"python3.{sys.version_info.minor}"]
    needs = "import taichi, numpy, scipy, h5py, pygltflib, trimesh"
    return [path for path in found if path and subprocess.run([path, "-c", needs], capture_output=True).returncode == 0]


@pytest.mark.proof
def test_threads_processes_and_pythons_end_in_the_same_bits() -> None:
    """Each run in a process of its own, with another seed of Python's hashes."""
    runs = [(sys.executable, 1), (sys.executable, 1), *((sys.executable, count) for count in (2, 3, 4))]
    runs += [(python, 2) for python in others()]
    expected = ends(*runs[0])
    assert len(expected) == 3
    for python, threads in runs[1:]:
        found = ends(python, threads)
        version = subprocess.run([python, "--version"], capture_output=True, text=True).stdout.strip()
        say(f"{version}, {threads} threads: " + ", ".join(f"{name} {value[:12]}" for name, value in found.items()))
        assert found == expected
