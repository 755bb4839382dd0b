"""Tables: columns in order, cells rounded as asked, files that appear whole."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from precompute.reporting.tables import write_table

ROWS = [{"name": 'a, "b"', "error": 1.23456789}, {"name": "c", "cost_ms": 2, "error": 0.1}]


def read(path: Path) -> list[dict[str, str]]:
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_columns_come_in_the_order_in_which_rows_name_them(tmp_path):
    write_table(tmp_path / "a.csv", ROWS)
    assert read(tmp_path / "a.csv") == [
        {"name": 'a, "b"', "error": "1.23456789", "cost_ms": ""},
        {"name": "c", "error": "0.1", "cost_ms": "2"},
    ]


def test_digits_round_floats_alone_and_the_machine_is_named(tmp_path):
    write_table(tmp_path / "a.csv", [{"error": 1.23456789, "count": 123456}], digits=4, machine=True)
    (row,) = read(tmp_path / "a.csv")
    assert (row["error"], row["count"]) == ("1.235", "123456") and row["cpu"] and row["date"].endswith("+00:00")


def test_a_table_that_cannot_be_written_leaves_the_old_one(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("old")
    with pytest.raises(ValueError, match="cost_ms"):
        write_table(path, ROWS, columns=["name", "error"])
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
