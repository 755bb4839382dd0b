"""Text in files that other programs wrote: its encoding, and tables of values that are separated by commas."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path

from pbd.errors import InputError

__all__ = ["decoded", "read_text", "read_words"]

_SHOWN = 60  # characters of a line in a message, and bytes in which text in UTF-16 without a mark is noticed
# What a file begins with, the longer marks first: that of UTF-32 begins as one of UTF-16 does.
_OTHER_MARKS = (
    (codecs.BOM_UTF32_LE, "UTF-32"),
    (codecs.BOM_UTF32_BE, "UTF-32"),
    (codecs.BOM_UTF16_LE, "UTF-16"),
    (codecs.BOM_UTF16_BE, "UTF-16"),
)
_EXPECTED = "UTF-8: save the file in this encoding"
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")


def read_text(path: Path, expected: str, strict: bool = True) -> str:
    """The text of a file in UTF-8, with or without a byte order mark; every line ends with a line feed.

    Args:
        path: the file.
        expected: kind of the file, for the message.
        strict: False takes text that is not UTF-8 for Windows-1252, in formats in which it stands in comments and names
            alone.

    Raises:
        InputError: the file cannot be read, or is in another encoding; the message names it.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        problem = f"cannot be read: {(error.strerror or str(error)).lower()}"
        raise InputError(problem, file=path, expected=expected) from error
    return decoded(data, path, strict)


def decoded(data: bytes, path: Path, strict: bool = True) -> str:
    """The text of the bytes of a file; see :func:`read_text`.

    Byte order marks are left out wherever they stand: files that were put together have them in the middle.

    Raises:
        InputError: the bytes are in another encoding; the message names it.
    """
    for mark, name in _OTHER_MARKS:
        if data.startswith(mark):
            raise InputError(f"text in {name}", file=path, expected=_EXPECTED)
    if any(half and not any(half) for half in (data[:_SHOWN:2], data[1:_SHOWN:2])):
        raise InputError("text in UTF-16", file=path, expected=_EXPECTED)
    data = data.replace(codecs.BOM_UTF8, b"").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        if not strict:
            return data.decode("cp1252", errors="replace")
        number, start = data.count(b"\n", 0, error.start) + 1, data.rfind(b"\n", 0, error.start) + 1
        raise InputError(
            "text that is not UTF-8, but perhaps Latin-1 (Windows-1252)",
            file=path,
            key=f"line {number}",
            received=data[start:].partition(b"\n")[0].decode("latin-1").strip()[:_SHOWN],
            expected=_EXPECTED,
        ) from error


def read_words(path: Path, columns: Sequence[str]) -> list[tuple[int, list[str]]]:
    """The rows of a .csv file below a line of titles, each with the number of its line; empty rows are left out.

    Args:
        path: the file.
        columns: its titles.

    Returns:
        words as they stand, at most as many as there are columns.

    Raises:
        InputError: the file cannot be read, is in another encoding than UTF-8, has other titles or other separators
            than commas, more words than titles in a row, or a number with a decimal comma; the message names the line.
    """
    wanted = ",".join(columns)
    reader = csv.reader(io.StringIO(read_text(path, "a .csv file")))
    try:
        rows = [(reader.line_num, words) for words in reader]
    except csv.Error as error:
        key = f"line {reader.line_num}"
        raise InputError(f"cannot be read: {error}", file=path, key=key, expected="a .csv file") from error
    titles = [word.strip() for word in rows[0][1]] if rows else []
    if titles != list(columns):
        received = ",".join(titles)[:_SHOWN]
        problem, expected = "other columns", wanted
        for separator, name in _SEPARATORS.items():
            if separator in received:
                problem, expected = f"columns between {name}", f"commas: {wanted}, and a decimal point in numbers"
        raise InputError(problem, file=path, key="line 1", received=received, expected=expected)
    rows = [(number, words) for number, words in rows[1:] if any(word.strip() for word in words)]
    for number, words in rows:
        if len(words) > len(columns):
            expected = f"{wanted}, and a decimal point in numbers"
            received = ",".join(words)[:_SHOWN]
            raise InputError("too many columns", file=path, key=f"line {number}", received=received, expected=expected)
        for column, word in zip(columns, words, strict=False):
            if _DECIMAL_COMMA.fullmatch(word.strip()):
                key = f"line {number}, column {column}"
                raise InputError("a decimal comma", file=path, key=key, received=word, expected="a decimal point")
    return rows
