"""Figures of a command, the JSON file that keeps them, and lines of progress."""

from __future__ import annotations

import json
import math
import os
import platform
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from pbd.storage import replacing
from runtime.output.terminal import LiveLine, is_plain

__all__ = [
    "Progress",
    "Report",
    "machine_description",
    "numbers_of",
    "package_version",
    "process_age",
    "processor_name",
    "write_report",
]

PLAIN_WAIT, LIVE_WAIT = 4.8, 1.0  # until a line of progress is shown again, in a file and on a terminal [s]
FIRST_WAIT = 0.4  # until the first one is shown of a command that may end at once [s]


@dataclass(frozen=True)
class Report:
    """The result of a command.

    Attributes:
        figures: single figures by name; the ending of a name is its unit (``frame_ms_p50``, ``rmse_mm``). All are
            numbers, except ``state_hash`` and other words.
        rows: one table, a mapping from column to value for each row.
        passed: False for a failed run, whose exit status is 1.
    """

    figures: Mapping[str, float | str] = field(default_factory=dict)
    rows: Sequence[Mapping[str, Any]] = ()
    passed: bool = True


def numbers_of(row: Mapping[str, Any]) -> dict[str, Any]:
    """The figures of a table's row: all columns except texts."""
    return {name: value for name, value in row.items() if not isinstance(value, str)}


class Progress:
    """Lines of progress: one that is written over on a terminal, else a line each. Closed by ``with``.

    Work that cannot say how far it is does not look dead: until the next line comes, a thread shows the last one again
    with the time that has gone by.

    Args:
        stream: where they go.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._began = stream, time.monotonic()
        self._live = None if is_plain(stream) else LiveLine(stream)
        self._wait = PLAIN_WAIT if self._live is None else LIVE_WAIT
        self._lock, self._line, self._shown, self._any = threading.Lock(), "", self._began, False
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None

    def __call__(self, line: str) -> None:
        with self._lock:
            self._line = line
            self._show()
        self._watch()

    def later(self, line: str) -> None:
        """Show a line, the first one after a moment alone: a command that ends at once, as with an error, has none."""
        if self._any:
            self(line)
            return
        with self._lock:
            self._line, self._shown = line, self._began + FIRST_WAIT - self._wait
        self._watch()

    def _watch(self) -> None:
        if self._thread is None:
            self._closed.clear()
            self._thread = threading.Thread(target=self._show_again, daemon=True)
            self._thread.start()

    def _show(self) -> None:
        self._any, self._shown = True, time.monotonic()
        if self._live is not None:
            self._live.show(self._line)
            return
        self._stream.write(f"[{self._shown - self._began:5.0f} s] {self._line}\n")
        self._stream.flush()

    def _show_again(self) -> None:
        """Show the last line whenever it has stood for long, until this is closed or nobody reads any more."""
        with suppress(OSError, ValueError):
            while not self._closed.wait(max(0.0, self._shown + self._wait - time.monotonic())):
                with self._lock:
                    if not self._closed.is_set() and time.monotonic() - self._shown >= self._wait:
                        self._show()

    def say(self, line: str) -> None:
        """Write a line that stays."""
        self(line)
        self.__exit__()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self._live is not None:
            self._live.close()


def process_age() -> float:
    """Time since this process was started [s]; not a number where the system has no /proc."""
    try:
        fields = Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return math.nan
    return time.clock_gettime(time.CLOCK_BOOTTIME) - int(fields[19]) / os.sysconf("SC_CLK_TCK")


def write_report(
    path: Path, command: str, figures: Mapping[str, float | str], rows: Sequence[Mapping[str, Any]]
) -> None:
    """Write figures and rows as JSON, with the version and a description of this machine.

    Numbers that are not finite become null. The file appears whole.

    Args:
        path: the file; missing folders are made.
        command: name of the command.
        figures: see :class:`Report`.
        rows: see :class:`Report`.

    Raises:
        OSError: the file cannot be written.
    """
    content = {
        "command": command,
        "version": package_version("gube"),
        "machine": machine_description(),
        "figures": _plain(figures),
        "rows": _plain(rows),
    }
    with replacing(path) as beside:
        beside.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def machine_description() -> dict[str, Any]:
    """Description of this machine: processor, cores, memory [GiB], platform, versions, and the date in UTC."""
    return {
        "cpu": processor_name(),
        "cores": os.cpu_count(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "taichi": package_version("taichi"),
        "blas": _blas_kernels(),
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
    }


def package_version(name: str) -> str:
    """Version of an installed package, or "not installed"."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


def _blas_kernels() -> str:
    """Name of the processor for which OpenBLAS has chosen its kernels, such as "SkylakeX"."""
    from threadpoolctl import threadpool_info

    return ", ".join(sorted({pool["architecture"] for pool in threadpool_info() if "architecture" in pool}))


def processor_name() -> str:
    """Name of this machine's processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _plain(value: Any) -> Any:
    """A value converted to the types that JSON has."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
