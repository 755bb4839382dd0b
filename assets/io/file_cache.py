"""What a process made of a file, kept until the file is written again."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar
from urllib.parse import unquote

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


def _referenced_files(path: Path) -> list[Path]:
    """Files that a readable file refers to: buffers and pictures of a .gltf, layers and other assets of USD."""
    if path.suffix.lower() == ".gltf":
        data = path.read_bytes()
        if data[:4] == b"glTF":  # a binary file by another name holds its buffers
            return []
        content = json.loads(data)
        uris = [part.get("uri", "data:") for kind in ("buffers", "images") for part in content.get(kind, [])]
        return [path.parent / unquote(uri) for uri in uris if not uri.startswith("data:")]
    if path.suffix.lower().startswith(".usd"):
        from pxr import Tf, UsdUtils

        try:
            layers, assets, _ = UsdUtils.ComputeAllDependencies(str(path))
        except Tf.ErrorException:  # text with a byte order mark, which the reader takes off, and USD does not
            return []
        return [*(Path(layer.realPath) for layer in layers), *(Path(asset) for asset in assets)]
    return []


def kept_while_unchanged(read: Callable[P, T]) -> Callable[P, T]:
    """A function that reads files, called again with the same arguments only where one of the files has changed.

    Args:
        read: takes arguments, in one order, that can be keys of a dictionary; those that are strings or paths name
            files, or built-in things, which never change. Files that these refer to count, too.
    """
    kept: dict[tuple[Any, ...], tuple[dict[Path, tuple[int, int] | None], T]] = {}

    @wraps(read)
    def found(*args: P.args, **kwargs: P.kwargs) -> T:
        key = tuple(
            Path(value).absolute() if isinstance(value, (str, Path)) else value for value in (*args, *kwargs.values())
        )
        before = kept.get(key)
        if before is not None and all(file_state(file) == state for file, state in before[0].items()):
            return before[1]
        named = {value: file_state(value) for value in key if isinstance(value, Path)}
        result = read(*args, **kwargs)
        referenced = {file: file_state(file) for path in named if named[path] for file in _referenced_files(path)}
        kept.pop(key, None)
        kept[key] = referenced | named, result
        while len(kept) > _MOST_KEPT:
            kept.pop(next(iter(kept)))
        return result

    return found
