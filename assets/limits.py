"""Limits that were painted on a garment, read from a file."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from pbd import InputError, Limits
from pbd.limits import NONE

__all__ = ["COLUMNS", "load_limits"]

COLUMNS = ("vertex", "maximum_distance", "backstop", "stiffness")


def load_limits(path: Path, vertex_count: int) -> Limits:
    """Read limits from a file with the columns ``COLUMNS`` and a line of these titles.

    Vertices count from 0, distances are in metres, stiffness in N/m3; an empty place is no limit.

    Args:
        path: the file.
        vertex_count: number of vertices of the mesh.

    Raises:
        InputError: the file cannot be read, has other titles, or a row that is no limit; the message names line and
            column.
    """
    try:
        with open(path, newline="", encoding="utf-8") as file:
            lines = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read: {error}", file=path, expected="a .csv file") from error
    titles = tuple(word.strip() for word in lines[0]) if lines else ()
    if titles != COLUMNS:
        raise InputError(
            "other columns", file=path, key="line 1", received=",".join(titles), expected=",".join(COLUMNS)
        )
    rows: dict[int, list[float]] = {}
    for number, words in enumerate(lines[1:], start=2):
        if not any(word.strip() for word in words):
            continue
        if len(words) != len(COLUMNS):
            expected = f"{len(COLUMNS)} columns"
            raise InputError("no limit", file=path, key=f"line {number}", received=",".join(words), expected=expected)
        vertex = words[0].strip()
        if not vertex.isdecimal() or int(vertex) >= vertex_count or int(vertex) in rows:
            expected = f"a vertex, 0 to {vertex_count - 1}, each once"
            raise InputError("bad vertex", file=path, key=f"line {number}", received=words[0], expected=expected)
        rows[int(vertex)] = [
            _value(path, f"line {number}, column {name}", word, empty)
            for name, word, empty in zip(COLUMNS[1:], words[1:], (NONE, NONE, 0.0), strict=True)
        ]
    vertices = sorted(rows)
    return Limits(np.array(vertices, np.int32), *np.array([rows[vertex] for vertex in vertices]).reshape(-1, 3).T)


def _value(path: Path, key: str, word: str, empty: float) -> float:
    if not word.strip():
        return empty
    try:
        value = float(word)
    except ValueError:
        value = np.nan
    if not 0.0 <= value < np.inf:
        expected = "a finite number, at least 0, or nothing"
        raise InputError("bad limit", file=path, key=key, received=word, expected=expected)
    return value
