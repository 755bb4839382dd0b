"""A frame of this checkout against a frame of another one: both play in turns on one core."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pbd import InputError
from wrinkles.database_file import read_database

__all__ = ["FrameComparison", "compare_frames"]

HERE = Path(__file__).resolve().parents[2]
FRAMES = 20  # of a turn
MIN_TURNS = 2
LAYOUTS = (
    ("runtime.setup.playback_inputs", "runtime.play.player", "runtime.play.simulation"),
    ("runtime.playback_inputs", "runtime.player", "runtime.simulation"),
    ("runtime.play", "runtime.player", "runtime.simulation"),
)
"""Modules that the worker imports, as checkouts call them; it names those of the first row."""


@dataclass(frozen=True)
class FrameComparison:
    """Times of both checkouts, turn by turn.

    Attributes:
        other, here: of each part the times in each turn and frame [ms], shape (turns, frames).
    """

    other: Mapping[str, np.ndarray]
    here: Mapping[str, np.ndarray]

    def figures(self) -> dict[str, float]:
        """``PART_other_ms``, ``PART_here_ms`` and ``PART_ratio``, the median of the turns' ratios of medians."""
        found = {}
        for part in self.here:
            ratios = self._ratios(part)
            found |= {
                f"{part}_other_ms": float(np.median(self.other[part])),
                f"{part}_here_ms": float(np.median(self.here[part])),
                f"{part}_ratio": float(np.median(ratios)),
                f"{part}_least_ratio": float(ratios.min()),
                f"{part}_greatest_ratio": float(ratios.max()),
            }
        return found

    def _ratios(self, part: str) -> np.ndarray:
        other, here = (np.median(times[part], axis=1) for times in (self.other, self.here))
        return here / np.maximum(other, 1e-9)

    def text(self) -> str:
        """The figures as a table."""
        lines, figures = [f"{'part':16} {'other [ms]':>10} {'here [ms]':>10} {'ratio':>6}  of turns"], self.figures()
        for part in self.here:
            other, here, ratio, least, greatest = (
                figures[f"{part}_{name}"] for name in ("other_ms", "here_ms", "ratio", "least_ratio", "greatest_ratio")
            )
            name = part.replace("_", " ")
            lines.append(f"{name:16} {other:10.3f} {here:10.3f} {ratio:6.3f}  {least:.2f}-{greatest:.2f}")
        return "\n".join(lines)


def compare_frames(
    path: Path,
    checkout: Path,
    seconds: float,
    report: Callable[[str], None] = lambda line: None,
    *,
    other_path: Path | None = None,
) -> FrameComparison:
    """Play a database with this checkout and with another one, in two processes on one core.

    Args:
        path: the database.
        checkout: folder of the other checkout.
        seconds: of motion that each plays.
        report: called with a line of progress.
        other_path: the database that the other checkout plays instead: one of its own, which may have another schema.

    Raises:
        InputError: as :func:`wrinkles.database_file.read_database`, or a checkout does not play the database.
    """
    rate = read_database(path).frame_rate
    turns = max(MIN_TURNS, round(seconds * rate / FRAMES))
    if _layout(checkout) is None:
        raise InputError("no checkout", key="--against", received=str(checkout), expected="a folder with runtime/")
    report("both start")
    folders = (checkout.resolve(), HERE)
    workers = [_start(folder, own) for folder, own in zip(folders, (other_path or path, path), strict=True)]
    try:
        for folder, worker in zip(folders, workers, strict=True):
            _answer(worker, folder)
        rows: tuple[list, list] = ([], [])
        for turn in range(turns):
            report(f"turn {turn + 1} of {turns}")
            for k in (0, 1) if turn % 2 == 0 else (1, 0):
                print(FRAMES, file=workers[k].stdin, flush=True)
                rows[k].append(json.loads(_answer(workers[k], folders[k])))
    finally:
        for worker in workers:
            worker.kill()
            worker.communicate()
    common = [part for part in rows[1][0] if part in rows[0][0]]
    return FrameComparison(*({part: np.array([row[part] for row in own]) for part in common} for own in rows))


def _layout(folder: Path) -> tuple[str, ...] | None:
    return next((row for row in LAYOUTS if all((folder / f"{x.replace('.', '/')}.py").is_file() for x in row)), None)


def _start(folder: Path, path: Path) -> subprocess.Popen[str]:
    program = Path(__file__).with_name("frame_worker.py").read_text(encoding="utf-8")
    for new, old in zip(LAYOUTS[0], _layout(folder) or LAYOUTS[0], strict=True):
        program = program.replace(f"from {new} import", f"from {old} import")
    arguments: Sequence[str] = [sys.executable, "-c", program, str(path.resolve())]
    environment = os.environ | {"PYTHONPATH": str(folder)}
    pipe = subprocess.PIPE
    return subprocess.Popen(arguments, cwd=folder, env=environment, text=True, stdin=pipe, stdout=pipe)


def _answer(worker: subprocess.Popen[str], folder: Path) -> str:
    """The next line that a worker prints for us; Taichi prints others."""
    assert worker.stdout is not None
    for line in worker.stdout:
        if line.startswith(("ready", "{")):
            return line
    raise InputError(
        "a checkout does not play the database", key="--against", received=str(folder),
        expected="a version that reads this database's file",
    )  # fmt: skip
