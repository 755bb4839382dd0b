"""Folders of files that a command needs only while it runs: what becomes of them however it ends."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from precompute.scratch import PREFIX, Tally, scratch_folder
from runtime.cli import command
from runtime.output.report import Report
from tests.data import ROOT

HOLD = """
import sys, time
from precompute.scratch import scratch_folder
with scratch_folder() as folder:
    (folder / "frames").write_bytes(b"x")
    print(folder, flush=True)
    time.sleep(600)
"""


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for temporary files, for this test alone."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def holder(temporary: Path) -> tuple[subprocess.Popen[str], Path]:
    """A process that uses a folder, and the folder."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(temporary)}
    words = [sys.executable, "-c", HOLD]
    process = subprocess.Popen(words, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def test_a_folder_goes_at_the_end_and_after_an_error(temporary: Path) -> None:
    with scratch_folder() as folder:
        (folder / "frames").write_bytes(b"x")
        assert folder.parent == temporary and folder.name.startswith(PREFIX)
    with pytest.raises(ValueError, match="ended"), scratch_folder() as folder:
        raise ValueError("ended")
    assert list(temporary.iterdir()) == []


def test_folders_of_killed_processes_go_and_those_in_use_stay(temporary: Path) -> None:
    other = temporary / f"{PREFIX}of-somebody-else"
    other.mkdir()
    (killed, left), (living, used) = holder(temporary), holder(temporary)
    try:
        killed.kill()
        killed.wait()
        assert (left / "frames").exists()
        with scratch_folder() as folder:
            assert {*temporary.iterdir()} == {folder, used, other}
    finally:
        living.kill()
        living.wait()
        for process in (killed, living):
            assert process.stdout is not None
            process.stdout.close()
    assert (used / "frames").exists()


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_a_command_and_removes_its_folder(
    kind: signal.Signals, temporary: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def ended(options: argparse.Namespace) -> Report:
        with scratch_folder():
            os.kill(os.getpid(), kind)
            time.sleep(20.0)
        return Report()

    if signal.getsignal(kind) is signal.SIG_IGN:
        pytest.skip("the program that runs the tests ignores this signal, as nohup does")
    before = [signal.getsignal(one) for one in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)]
    monkeypatch.setattr(command, "_command_module", lambda options: SimpleNamespace(run=ended))
    assert command.main(["info", "any.h5"]) == 1
    assert capsys.readouterr().err == "stopped\n"
    assert list(temporary.iterdir()) == []
    assert [signal.getsignal(one) for one in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)] == before


def test_jobs_count_in_one_file(tmp_path: Path) -> None:
    tally = Tally(tmp_path / "done")
    assert tally.count == 0
    tally.add()
    Tally(tmp_path / "done").add(3)
    assert tally.count == 4
    nothing = Tally(None)
    nothing.add()
    assert nothing.count == 0
