"""Folders of files that a command needs only while it runs, and how far jobs in other processes have come."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

__all__ = ["PREFIX", "UNCOUNTED", "Tally", "scratch_folder"]

PREFIX = "gube-"  # of the folders' names
_IN_USE = "in-use"  # the file that the process which made the folder holds locked as long as it lives


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A new folder among the temporary files, which goes when the block ends.

    A process that was killed could not remove its own: those of processes that no longer live are removed first. The
    system takes back the lock of any process that has ended.
    """
    _remove_left()
    with tempfile.TemporaryDirectory(prefix=PREFIX, ignore_cleanup_errors=True) as name:
        folder = Path(name)
        beside = folder / f"{_IN_USE}.new"
        with beside.open("w") as file:
            with suppress(OSError):  # a file system without locks: the folder then counts as in use for ever
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                beside.rename(folder / _IN_USE)  # nobody finds the file before it is locked
            yield folder


def _remove_left() -> None:
    """Remove the folders of this user that nobody uses any more."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):  # in use, of another user, or removed by somebody else just now
            if folder.is_symlink() or folder.stat().st_uid != os.getuid():
                continue
            with (folder / _IN_USE).open("r+") as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)


@dataclass(frozen=True)
class Tally:
    """Counts what jobs in other processes have done: each adds bytes to one file.

    Attributes:
        path: of the file; None counts nothing.
    """

    path: Path | None

    def add(self, count: int = 1) -> None:
        """Count so many more."""
        if self.path is not None:
            with self.path.open("ab") as file:
                file.write(b"." * count)

    @property
    def count(self) -> int:
        """How many were counted."""
        return self.path.stat().st_size if self.path is not None and self.path.exists() else 0


UNCOUNTED = Tally(None)
"""Where nobody asks how far it has come."""
