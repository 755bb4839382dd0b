import io
import json
import time
from pathlib import Path

import numpy as np
import pytest

from runtime.output import report
from runtime.output.report import Progress, machine_description, process_age, write_report


def test_numpy_and_unusual_numbers_become_plain_json(tmp_path: Path) -> None:
    out = tmp_path / "report.json"
    figures = {"frame_ms_p50": np.float32(1.5), "count": np.int64(3), "lost": float("nan"), "far": np.inf}
    write_report(out, "bench", figures, [{"sizes": np.arange(3), "file": Path("a.h5"), "passed": np.bool_(True)}])
    content = json.loads(out.read_text(encoding="utf-8"))
    assert content["figures"] == {"frame_ms_p50": 1.5, "count": 3, "lost": None, "far": None}
    assert content["rows"] == [{"sizes": [0, 1, 2], "file": "a.h5", "passed": True}]


def test_the_machine_is_named() -> None:
    machine = machine_description()
    assert machine["cpu"]
    assert machine["memory_gib"] > 0
    assert machine["taichi"].startswith("1.")


def test_progress_is_a_line_each_in_a_file() -> None:
    stream = io.StringIO()
    with Progress(stream) as progress:
        progress("simulating: 1 of 2")
        progress("simulating: 2 of 2")
    assert [line.partition("] ")[2] for line in stream.getvalue().splitlines()] == [
        "simulating: 1 of 2",
        "simulating: 2 of 2",
    ]


def test_the_age_of_this_process_grows() -> None:
    first = process_age()
    assert 0.0 < first < process_age() + 1e-9


def shown(stream: io.StringIO) -> list[str]:
    return [line.partition("] ")[2] for line in stream.getvalue().splitlines()]


def wait_for(stream: io.StringIO, count: int) -> list[str]:
    """The lines, once there are so many."""
    end = time.monotonic() + 20.0
    while len(shown(stream)) < count and time.monotonic() < end:
        time.sleep(0.01)
    return shown(stream)


def test_a_line_is_shown_again_until_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "PLAIN_WAIT", 0.02)
    stream = io.StringIO()
    with Progress(stream) as progress:
        progress("fitting")
        assert wait_for(stream, 3)[:3] == ["fitting"] * 3
        progress("evaluating")
        first = shown(stream).index("evaluating")
        assert wait_for(stream, first + 2)[first : first + 2] == ["evaluating"] * 2
    closed = shown(stream)
    time.sleep(0.1)
    assert shown(stream) == closed and set(closed) == {"fitting", "evaluating"}


def test_a_command_that_ends_at_once_shows_no_line_that_may_come_later(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    with Progress(stream) as progress:
        progress.later("reading")
    assert shown(stream) == []
    monkeypatch.setattr(report, "FIRST_WAIT", 0.02)
    with Progress(stream) as progress:
        progress.later("reading")
        progress.later("still reading")
        assert wait_for(stream, 1) == ["still reading"]
        progress.later("simulating")
        assert shown(stream) == ["still reading", "simulating"]
