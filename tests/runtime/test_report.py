import io
import json
from pathlib import Path

import numpy as np

from runtime.report import Progress, machine_description, process_age, write_report


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
