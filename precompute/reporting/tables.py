"""Tables as CSV files for other programs."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pbd.storage import replacing
from runtime.output.report import machine_description

__all__ = ["write_table"]


def write_table(
    path: Path,
    rows: Sequence[Mapping[str, Any]],
    *,
    columns: Sequence[str] = (),
    digits: int | None = None,
    machine: bool = False,
) -> None:
    """Write rows as CSV with a header; the file appears whole or not at all.

    Args:
        path: the file.
        rows: a mapping from column to value each; a cell that a row does not have is left empty.
        columns: their order; by default that in which the rows name them first.
        digits: significant ones of a float; None keeps all of them.
        machine: adds the columns ``cpu`` and ``date`` (UTC) to every row.
    """
    if machine:
        here = machine_description()
        rows = [{**row, "cpu": here["cpu"], "date": here["date"]} for row in rows]
    names = list(columns) or list(dict.fromkeys(name for row in rows for name in row))
    with replacing(path) as beside, open(beside, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows({name: _rounded(value, digits) for name, value in row.items()} for row in rows)


def _rounded(value: Any, digits: int | None) -> Any:
    return f"{value:.{digits}g}" if digits is not None and isinstance(value, float) else value
