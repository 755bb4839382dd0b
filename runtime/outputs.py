"""What a command is told to write, looked at before anything long begins. Nothing is made yet."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from pbd.errors import InputError

__all__ = ["check_file", "check_folder"]


def check_file(path: Path, *endings: str, key: str = "-o") -> None:
    """Refuse a file that could not be written later. Missing folders above it are none of its faults.

    Args:
        path: the file.
        endings: that its name may have, such as ".h5".
        key: the argument, for the message.

    Raises:
        InputError: a folder, another ending, or a place that cannot be written to.
    """
    kind = "a file" + (f" ending in {' or '.join(endings)}" if endings else "")
    if path.is_dir():
        raise InputError("cannot be written: it is a folder", key=key, received=str(path), expected=kind)
    if endings and path.suffix.lower() not in endings:
        raise InputError("cannot be written", key=key, received=str(path), expected=kind)
    _check_place(path.absolute().parent, path, key, f"{kind} where files can be written")


def check_folder(path: Path, key: str = "-o") -> None:
    """Refuse a folder that could not be made or written to later.

    Args:
        path: the folder.
        key: the argument, for the message.

    Raises:
        InputError: a file, or a place that cannot be written to.
    """
    _check_place(path.absolute(), path, key, "a folder that can be written to")


def _check_place(folder: Path, path: Path, key: str, expected: str) -> None:
    while not os.path.lexists(folder):
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):  # permissions alone do not tell of read-only disks
            pass
    except OSError as error:
        problem = f"cannot be written: {folder}: {(error.strerror or str(error)).lower()}"
        raise InputError(problem, key=key, received=str(path), expected=expected) from error
