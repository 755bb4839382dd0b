"""Files of limits that are painted on a garment."""

from pathlib import Path

import pytest

from assets.painted_limits import load_limits
from pbd.limits import NONE
from tests.refusals import refuses

TITLES = "vertex,maximum_distance,backstop,stiffness\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "limits.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_what_is_painted_is_read_in_the_order_of_vertices(tmp_path: Path) -> None:
    limits = load_limits(write(tmp_path, TITLES + "7,0.05,,\n\n2, ,0.01,300\n"), 8)
    assert limits.vertices.tolist() == [2, 7]
    assert limits.maximum_distance == pytest.approx([NONE, 0.05])
    assert limits.backstop == pytest.approx([0.01, NONE])
    assert limits.stiffness == pytest.approx([300.0, 0.0])


def test_a_file_of_titles_limits_nothing(tmp_path: Path) -> None:
    assert len(load_limits(write(tmp_path, TITLES), 8).vertices) == 0


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["line 1", "vertex,maximum_distance"]),
        ("vertex,backstop\n1,2", ["line 1: other columns", "vertex,backstop"]),
        (TITLES + "1,0.1", ["line 2: no limit", "1,0.1"]),
        (TITLES + "8,0.1,,", ["line 2: bad vertex", "0 to 7"]),
        (TITLES + "1,0.1,,\n1,0.2,,", ["line 3: bad vertex", "each once"]),
        (TITLES + "1,far,,", ["line 2, column maximum_distance", "far", "at least 0, or nothing"]),
        (TITLES + "1,,-1,", ["line 2, column backstop", "-1"]),
        (TITLES + "1,,,inf", ["line 2, column stiffness", "inf"]),
    ],
)
def test_what_is_refused(tmp_path: Path, text: str, parts: list[str]) -> None:
    said = refuses("", load_limits, write(tmp_path, text), 8)
    for part in [*parts, "limits.csv"]:
        assert part in said


def test_no_file(tmp_path: Path) -> None:
    refuses("cannot be read", load_limits, tmp_path / "absent.csv", 8)
