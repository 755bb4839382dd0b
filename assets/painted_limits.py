"""Limits that were painted on a garment, read from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets.text import read_words
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
    rows: dict[int, list[float]] = {}
    for number, words in read_words(path, COLUMNS):
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
