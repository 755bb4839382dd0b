"""What a process made of a file, kept until the file is written again."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

__all__ = ["file_state", "kept_while_unchanged"]

P = ParamSpec("P")
T = TypeVar("T")

_MOST_KEPT = 64  # results of one function; the oldest goes first


def file_state(path: Path) -> tuple[int, int] | None:
    """Size [bytes] and time of the last change [ns] of a file; None where there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


def kept_while_unchanged(read: Callable[P, T]) -> Callable[P, T]:
    """A function that reads files, called again with the same arguments only where one of the files has changed.

    Args:
        read: takes arguments, in one order, that can be keys of a dictionary; those that are strings or paths name
            files, or built-in things, which never change.
    """
    kept: dict[tuple[Any, ...], tuple[list[tuple[int, int] | None], T]] = {}

    @wraps(read)
    def found(*args: P.args, **kwargs: P.kwargs) -> T:
        key = tuple(
            Path(value).absolute() if isinstance(value, (str, Path)) else value for value in (*args, *kwargs.values())
        )
        states = [file_state(value) for value in key if isinstance(value, Path)]
        before = kept.get(key)
        if before is not None and before[0] == states:
            return before[1]
        result = read(*args, **kwargs)
        kept.pop(key, None)
        kept[key] = states, result
        while len(kept) > _MOST_KEPT:
            kept.pop(next(iter(kept)))
        return result

    return found
