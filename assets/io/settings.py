"""Tables of settings, each declared once: a frozen dataclass whose fields carry their check, default and unit.

:class:`Reader` turns what a TOML parser returns into such dataclasses and collects every error on the way;
:func:`settings_text` prints them as TOML again.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pbd.errors import InputError

__all__ = [
    "AllowedValues",
    "Reader",
    "Refused",
    "choice",
    "entry",
    "file_path",
    "indices",
    "number",
    "pair",
    "portable_path",
    "settings_text",
    "several",
    "table",
    "tables",
    "text",
    "truth",
    "vector",
    "whole",
]

_DATA = "${GUBE_DATA}"  # in a path: the data folder


class Refused(Exception):
    """A check's ``convert`` raises it for a value that the check does not accept."""


@dataclass(frozen=True)
class AllowedValues:
    """The values that a setting may have.

    Attributes:
        expected: the accepted values in words, for the message.
        convert: called with (reader, value, key); returns the value to keep. It raises :class:`Refused`, or
            InputError where there is more to say, or reports to the reader and returns None.
        unit: unit of the value, for messages and printing.
    """

    expected: str
    convert: Callable[[Reader, Any, str], Any]
    unit: str = ""


def entry(check: AllowedValues, default: Any = MISSING, *, key: str | None = None) -> Any:
    """A dataclass field that is read from a file through ``check``, under ``key`` where its name there differs."""
    return field(default=default, metadata={"check": check, "key": key})


class Reader:
    """Reads tables of one file.

    Attributes:
        file: path of the file, for messages and for the paths relative to it.
        errors: every error found so far.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.errors: list[InputError] = []

    def table(self, kind: type, values: Any, key: str = "") -> Any:
        """An instance of the dataclass ``kind``; None where something was wrong, which is then in ``errors``."""
        before = len(self.errors)
        # A dataclass that declares no checks validates its own values when it is made.
        entries = [one for one in fields(kind) if "check" in one.metadata] or fields(kind)
        known = {one.metadata.get("key") or one.name: one for one in entries}
        for name in values:
            if name not in known:
                self._add("unknown key", _join(key, name), None, _one_of(name, known))
        arguments = {}
        for name, one in known.items():
            place = _join(key, name)
            if name in values:
                check = one.metadata.get("check")
                arguments[one.name] = self.value(check, values[name], place) if check else values[name]
            elif one.default is MISSING:
                self._add("missing key", place, None, one.metadata["check"].expected)
        if len(self.errors) > before:
            return None
        try:
            return kind(**arguments)
        except InputError as error:
            self._relocate(error, key)
            return None

    def value(self, check: AllowedValues, value: Any, key: str) -> Any:
        """The converted value; None where it was refused, which is then in ``errors``."""
        try:
            return check.convert(self, value, key)
        except Refused:
            self._add("bad value", key, value, f"{check.expected} [{check.unit}]" if check.unit else check.expected)
        except InputError as error:
            if error.file is None:
                self._add(error.problem, key, error.received, error.expected)
            else:  # about another file, which the message must go on naming
                self._add(str(error), key, None, None)
        return None

    def _add(self, problem: str, key: str, received: Any, expected: str | None) -> None:
        self.errors.append(InputError(problem, file=self.file, key=key, received=received, expected=expected))

    def _relocate(self, error: InputError, key: str) -> None:
        """Report the error that a dataclass raised about its own values: one, or several in one text."""
        name = error.key.rpartition(".")[2] if error.key else ""
        self._add(error.problem.replace("\n", "\n  "), _join(key, name), error.received, error.expected)


def number(
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    at_most: float = math.inf,
    below: float = math.inf,
    unit: str = "",
) -> AllowedValues:
    """A finite number within bounds; integers become floats."""

    def convert(reader: Reader, value: Any, key: str) -> float:
        if not _is_number(value) or not above < value < below or not at_least <= value <= at_most:
            raise Refused
        return float(value)

    bounds = [("above", above), ("at least", at_least), ("at most", at_most), ("below", below)]
    words = [f"{word} {bound:g}" for word, bound in bounds if math.isfinite(bound)]
    return AllowedValues(" ".join(["a finite number", ", ".join(words)]).rstrip(), convert, unit)


def whole(*, at_least: int) -> AllowedValues:
    """A whole number."""

    def convert(reader: Reader, value: Any, key: str) -> int:
        if not _is_whole(value, at_least):
            raise Refused
        return value

    return AllowedValues(f"a whole number, at least {at_least}", convert)


def text() -> AllowedValues:
    """A string that is not empty."""

    def convert(reader: Reader, value: Any, key: str) -> str:
        if not isinstance(value, str) or not value.strip():
            raise Refused
        return value

    return AllowedValues("a string that is not empty", convert)


def choice(*names: str) -> AllowedValues:
    """One of some strings."""

    def convert(reader: Reader, value: Any, key: str) -> str:
        if value not in names:
            raise InputError("bad value", received=value, expected=_one_of(value, names))
        return value

    return AllowedValues(_one_of(None, names), convert)


def truth() -> AllowedValues:
    """True or false."""

    def convert(reader: Reader, value: Any, key: str) -> bool:
        if not isinstance(value, bool):
            raise Refused
        return value

    return AllowedValues("true or false", convert)


def vector(*, unit: str = "", not_zero: bool = False) -> AllowedValues:
    """Three finite numbers."""

    def convert(reader: Reader, value: Any, key: str) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != 3 or not all(map(_is_number, value)):
            raise Refused
        if not_zero and not any(value):
            raise Refused
        return tuple(map(float, value))

    return AllowedValues("three finite numbers" + ", not all zero" * not_zero, convert, unit)


def pair(*, at_least: float, at_most: float) -> AllowedValues:
    """Two finite numbers within bounds."""
    one = number(at_least=at_least, at_most=at_most)

    def convert(reader: Reader, value: Any, key: str) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != 2:
            raise Refused
        return tuple(one.convert(reader, item, key) for item in value)

    return AllowedValues(f"two finite numbers, each at least {at_least:g}, at most {at_most:g}", convert)


def indices() -> AllowedValues:
    """Different whole numbers from 0."""

    def convert(reader: Reader, value: Any, key: str) -> tuple[int, ...]:
        if not isinstance(value, list) or not all(_is_whole(index, 0) for index in value):
            raise Refused
        if len(set(value)) < len(value):
            raise Refused
        return tuple(value)

    return AllowedValues("a list of different whole numbers, each at least 0", convert)


def several(one: AllowedValues) -> AllowedValues:
    """A list of different values, each read by the check ``one``."""

    def convert(reader: Reader, value: Any, key: str) -> tuple[Any, ...]:
        if not isinstance(value, list) or any(item in value[:index] for index, item in enumerate(value)):
            raise Refused
        return tuple(reader.value(one, item, f"{key}[{index}]") for index, item in enumerate(value))

    return AllowedValues(f"a list of different values, each {one.expected}", convert)


def file_path(*suffixes: str, builtins: Sequence[str] = ()) -> AllowedValues:
    """A file that exists, relative to the file being read, or the name of something built in.

    ``${GUBE_DATA}`` stands for the data folder: the environment variable of that name, or ``../shared/data``
    relative to the current folder.
    """

    def convert(reader: Reader, value: Any, key: str) -> Path | str:
        if not isinstance(value, str) or not value.strip():
            raise Refused
        if value.startswith("builtin:"):
            if value not in builtins:
                raise InputError("nothing of that name is built in", received=value, expected=_one_of(value, builtins))
            return value
        data = Path(os.environ.get("GUBE_DATA") or "../shared/data").absolute()
        expanded = value.replace(_DATA, str(data))
        if "${" in expanded:
            raise InputError("unknown variable", received=value, expected="no other variable than ${GUBE_DATA}")
        path = (reader.file.parent / expanded).resolve()
        if suffixes and path.suffix.lower() not in suffixes:
            raise Refused
        if not path.is_file():
            raise InputError("no such file", received=value, expected=f"a file at {path}")
        return path

    words = " ".join(["path of a", " or ".join(suffixes), "file"]) if suffixes else "path of a file"
    return AllowedValues(" or ".join([words, *map(repr, builtins)]), convert)


def portable_path(file: Path, folder: Path) -> str:
    """What a settings file names another file by, so that it is still found where both are moved.

    Args:
        file: that is named.
        folder: of the settings file.

    Returns:
        a path relative to the folder for what lies in it, below it, or beside it in the folder above; one that begins
        with ``${GUBE_DATA}`` for what lies in the data folder, where that variable is set and the settings file lies
        elsewhere; else the absolute path.
    """
    file = file.resolve() if ".." in file.parts else file.absolute()
    if file.is_relative_to(folder):
        return os.path.relpath(file, folder)
    real, here, named = file.resolve(), folder.resolve(), os.environ.get("GUBE_DATA")
    data = Path(named).resolve() if named else None
    if data is not None and real.is_relative_to(data) and not here.is_relative_to(data):
        return f"{_DATA}/{real.relative_to(data).as_posix()}"
    above = here.parent
    beside = real.is_relative_to(above) and above != above.parent  # everything lies beside a folder of the root
    return os.path.relpath(real, here) if beside else str(file)


def table(kind: type, *, one_of: Sequence[str] = ()) -> AllowedValues:
    """A table that the dataclass ``kind`` describes, with exactly one of the keys ``one_of``."""

    def convert(reader: Reader, value: Any, key: str) -> Any:
        if not isinstance(value, dict):
            raise Refused
        present = [name for name in one_of if name in value]
        if one_of and len(present) != 1:
            reader.errors.append(
                InputError(
                    "missing key" if not present else "keys that exclude each other",
                    file=reader.file,
                    key=key,
                    received=present or None,
                    expected="exactly one of " + ", ".join(map(repr, one_of)),
                )
            )
        return reader.table(kind, value, key)

    return AllowedValues("a table", convert)


def tables(one: AllowedValues, *, at_least: int = 0, unique: str | None = None) -> AllowedValues:
    """A list of tables, each read by the check ``one``, with different values under the key ``unique``."""

    def convert(reader: Reader, value: Any, key: str) -> tuple[Any, ...]:
        if not isinstance(value, list) or len(value) < at_least:
            raise Refused
        names = [item.get(unique) for item in value if isinstance(item, dict)] if unique else []
        for name in dict.fromkeys(name for name in names if names.count(name) > 1 and name is not None):
            problem = InputError(f"the same {unique} twice", file=reader.file, key=key, received=name)
            reader.errors.append(problem)
        return tuple(reader.value(one, item, f"{key}[{index}]") for index, item in enumerate(value))

    return AllowedValues("a list of tables" + f", at least {at_least}" * (at_least > 0), convert)


def settings_text(settings: Any) -> str:
    """The settings as TOML, with defaults, and with units as comments; settings that are None are left out."""
    return "\n".join(_lines(settings, "", "")).lstrip("\n") + "\n"


def _lines(settings: Any, prefix: str, header: str) -> list[str]:
    own: list[str] = [header] if header else []
    below: list[str] = []
    for one in fields(settings):
        name, value = one.metadata.get("key") or one.name, getattr(settings, one.name)
        place, check = _join(prefix, name), one.metadata.get("check")
        if value is None or (value == () and not prefix):
            continue
        if is_dataclass(value):
            below += ["", *_lines(value, place, f"[{place}]")]
        elif not prefix and isinstance(value, tuple) and is_dataclass(value[0]):
            for item in value:
                below += ["", *_lines(item, place, f"[[{place}]]")]
        else:
            own.append(f"{name} = {_toml(value)}" + (f"  # [{check.unit}]" if check and check.unit else ""))
    return own + below


def _toml(value: Any) -> str:
    if is_dataclass(value):
        pairs = [(one.name, getattr(value, one.name)) for one in fields(value)]
        return "{ " + ", ".join(f"{name} = {_toml(item)}" for name, item in pairs if item is not None) + " }"
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (str, Path)):
        return json.dumps(str(value), ensure_ascii=False)
    return repr(value)


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key and name else key or name


def _one_of(received: Any, names: Any) -> str:
    """The names in words, with the nearest one where the received name looks like a slip of the keyboard."""
    words = "one of " + ", ".join(map(repr, names)) if names else "nothing"
    near = get_close_matches(received, list(names), n=1) if isinstance(received, str) else []
    return f"{words}; did you mean {near[0]!r}?" if near else words


def _is_number(value: Any) -> bool:
    # Compared, as math.isfinite raises for whole numbers beyond float's range.
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _is_whole(value: Any, at_least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= at_least
