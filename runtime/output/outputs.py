"""Checks of output paths before long work begins. They create no file and no folder."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from pbd.errors import InputError

__all__ = ["check_file", "check_folder", "check_is_no_source"]


def check_file(path: Path, *endings: str, key: str = "-o") -> None:
    """Refuse a file that could not be written later. Folders above it may be missing: they are made with the file.

    Args:
        path: the file.
        endings: allowed endings of its name, such as ".h5"; any ending where none is given.
        key: name of the argument for the message.

    Raises:
        InputError: the path is a folder, has another ending, or its folder is not writable.
    """
    kind = "a file" + (f" ending in {' or '.join(endings)}" if endings else "")
    if path.is_dir():
        raise InputError("cannot be written: it is a folder", key=key, received=str(path), expected=kind)
    if endings and path.suffix.lower() not in endings:
        raise InputError("cannot be written", key=key, received=str(path), expected=kind)
    _check_place(path.absolute().parent, path, key, f"{kind} where files can be written")


def check_is_no_source(path: Path, settings: Any, key: str = "-o") -> None:
    """Refuse to write over a file that something was made of, such as the character of a scene.

    Args:
        path: the file to write; of a point cache also the mesh beside it.
        settings: a path, or a dataclass or a tuple of such, whose paths are the files.
        key: name of the argument for the message.

    Raises:
        InputError: the file is one of those.
    """
    beside = [path.with_suffix(".obj")] if path.suffix.lower() in (".pc2", ".mdd") else []
    written = {one.resolve() for one in (path, *beside)}
    for source in _paths(settings):
        if source.resolve() in written:
            problem = "would be written over: the scene is made of it"
            raise InputError(problem, file=source, key=key, received=str(path), expected="a file of another name")


def _paths(settings: Any) -> Iterator[Path]:
    if isinstance(settings, Path):
        yield settings
    elif isinstance(settings, tuple):
        for one in settings:
            yield from _paths(one)
    elif is_dataclass(settings):
        for one in fields(settings):
            yield from _paths(getattr(settings, one.name))


def check_folder(path: Path, key: str = "-o") -> None:
    """Refuse a folder that could not be made or written to later.

    Args:
        path: the folder.
        key: name of the argument for the message.

    Raises:
        InputError: the path is a file, or the nearest folder that exists is not writable.
    """
    _check_place(path.absolute(), path, key, "a folder that can be written to")


def _check_place(folder: Path, path: Path, key: str, expected: str) -> None:
    while not os.path.lexists(folder):
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):  # permissions alone do not show a read-only disk
            pass
    except OSError as error:
        problem = f"cannot be written: {folder}: {(error.strerror or str(error)).lower()}"
        raise InputError(problem, key=key, received=str(path), expected=expected) from error
