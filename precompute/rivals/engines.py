"""The rivals: engines that pip installs, their settings, and the search for good ones."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from precompute.rivals.dressing import Dressing

__all__ = ["RIVALS", "Rival", "RivalRun", "Tried", "for_quality", "for_speed", "play_rival", "search_settings"]

TRIES = 12  # settings that a search looks at, at most
START_S, FRAME_S = 60.0, 1.0  # that a run may take for its start and for a frame, by the clock [s]
SPEED_ERROR = 1.3  # error of the setting for speed over the lowest, at most


@dataclass(frozen=True)
class Rival:
    """An engine with a method of its own.

    Attributes:
        name: for people.
        module: that it is imported as.
        package: whose version is reported.
        first: the setting that a search begins with.
        ladders: values of each parameter, in the order in which a search goes through them.
    """

    name: str
    module: str
    package: str
    first: Mapping[str, float]
    ladders: Mapping[str, Sequence[float]]

    @property
    def missing(self) -> str:
        """Why it cannot run; empty where it can."""
        return "" if importlib.util.find_spec(self.module) else "not installed: pip install 'gube[rivals]'"

    @property
    def version(self) -> str:
        """Of its package."""
        return importlib.metadata.version(self.package)


_SCALES = (0.1, 0.3, 1.0, 3.0)
RIVALS: Mapping[str, Rival] = {
    "blender": Rival(
        "Blender", "bpy", "bpy",
        {"steps": 5, "stretch": 15.0, "bend": 0.05, "mass": 0.1, "friction": 4.0, "collision": 2},
        {
            "stretch": (5.0, 15.0, 40.0, 120.0), "bend": (0.005, 0.05, 0.5), "steps": (3, 5, 10, 20),
            "friction": (0.0, 1.0, 4.0), "mass": (0.1, 0.3, 1.0), "collision": (1, 2, 4),
        },
    ),
    "style3d": Rival(
        "Newton Style3D", "newton", "newton",
        {"substeps": 2, "iterations": 4, "linear_iterations": 10, "stretch": 1.0, "bend": 1.0, "contact": 1e3},
        {
            "substeps": (1, 2, 4, 8), "iterations": (2, 4, 8), "contact": (1e1, 1e2, 1e3, 1e4),
            "linear_iterations": (5, 10, 20), "bend": _SCALES, "stretch": _SCALES,
        },
    ),
    "vbd": Rival(
        "Newton VBD", "newton", "newton",
        {"substeps": 8, "iterations": 5, "stretch": 1.0, "bend": 1.0, "contact": 1e3, "searches": 4},
        {
            "substeps": (2, 4, 8), "iterations": (2, 3, 5), "contact": (1e2, 1e3, 1e4), "searches": (1, 2, 4, 8),
            "bend": _SCALES, "stretch": _SCALES,
        },
    ),
    "xpbd": Rival(
        "Newton XPBD", "newton", "newton",
        {"substeps": 40, "iterations": 1, "stretch": 0.1, "bend": 1.0, "searches": 10},
        {
            "substeps": (20, 40, 80, 120), "stretch": (0.03, 0.1, 0.3, 1.0), "bend": (0.0, *_SCALES),
            "searches": (2, 4, 10, 40), "iterations": (1, 2),
        },
    ),
    "mujoco": Rival(
        "MuJoCo flex", "mujoco", "mujoco",
        {"substeps": 8, "iterations": 20, "stretch": 1.0, "damping": 1e-4},
        {
            "substeps": (4, 8, 16), "iterations": (5, 10, 20, 50), "damping": (1e-5, 1e-4, 1e-3), "stretch": _SCALES,
        },
    ),
}  # fmt: skip


class RivalRun(NamedTuple):
    """What a rival played.

    Attributes:
        frames: vertices of its mesh at the kept frames [m], float32, shape (f, n, 3).
        frame_ms: median processor time of the second half of the frames, without skinning [ms].
        ended: why it stopped early; empty where it did not.
    """

    frames: np.ndarray
    frame_ms: float
    ended: str


class Tried(NamedTuple):
    """A setting that a search looked at.

    Attributes:
        settings: of the rival.
        frame_ms: see :class:`RivalRun`.
        error: what the search makes small; infinite where the run stopped early.
        ended: why it did.
    """

    settings: Mapping[str, float]
    frame_ms: float
    error: float
    ended: str


def play_rival(
    engine: str, settings: Mapping[str, float], dressing: Path, keep: Sequence[int], frames: int, folder: Path
) -> RivalRun:
    """Play a dressing by a rival in a process of its own.

    Args:
        engine: name of one of RIVALS.
        settings: of it.
        dressing: file of a :class:`precompute.rivals.dressing.Dressing`.
        keep: numbers of the frames whose vertices are wanted.
        frames: that are played, at most.
        folder: for what it writes; a new one, as an absolute path like `dressing`.
    """
    folder.mkdir()
    job, out = folder / "job.json", folder / "out.npz"
    job_text = {"dressing": str(dressing), "engine": engine, "settings": dict(settings), "frames": int(frames)}
    job.write_text(json.dumps(job_text | {"keep": [int(one) for one in keep], "out": str(out)}), encoding="utf-8")
    command = [sys.executable, "-m", "precompute.rivals.worker", str(job)]
    root = str(Path(__file__).resolve().parents[2])
    paths = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": paths}
    longest = START_S + FRAME_S * frames
    try:
        # MuJoCo writes its warnings into the folder in which it runs.
        ran = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder, timeout=longest)
        words = (ran.stderr.strip().splitlines() or ["no message"])[-1]
        ended = f"ended with status {ran.returncode}: {words}" if ran.returncode or not out.exists() else ""
    except subprocess.TimeoutExpired:
        ended = f"given up: not played after {longest:.0f} s"
    if ended:
        count = len(Dressing.read(dressing).start)
        return RivalRun(np.zeros((0, count, 3), np.float32), math.nan, ended)
    with np.load(out) as file:
        times = file["times"]
        return RivalRun(file["frames"], float(np.median(times[len(times) // 2 :])), str(file["ended"]))


def search_settings(rival: Rival, measure: Callable[[Mapping[str, float]], Tried]) -> list[Tried]:
    """Look for a setting with a small error: one parameter after the other, up and down its ladder.

    Args:
        rival: whose ladders are climbed.
        measure: tries a setting.

    Returns:
        all that were tried, in order, at most TRIES.
    """
    tried: dict[tuple, Tried] = {}

    def look(settings: dict[str, float]) -> Tried | None:
        key = tuple(sorted(settings.items()))
        if key not in tried and len(tried) < TRIES:
            tried[key] = measure(settings)
        return tried.get(key)

    best = look(dict(rival.first))
    assert best is not None
    moved = True
    while moved:
        moved = False
        for name, ladder in rival.ladders.items():
            for way in (1, -1):
                place = ladder.index(best.settings[name]) + way
                while 0 <= place < len(ladder):
                    found = look({**best.settings, name: ladder[place]})
                    if found is None or not found.error < best.error:
                        break
                    best, moved, place = found, True, place + way
    return list(tried.values())


def for_quality(tried: Sequence[Tried]) -> Tried | None:
    """The setting with the lowest error; None where none held."""
    held = [one for one in tried if math.isfinite(one.error)]
    return min(held, key=lambda one: one.error, default=None)


def for_speed(tried: Sequence[Tried]) -> Tried | None:
    """The cheapest setting whose error is at most SPEED_ERROR of the lowest; None where none held."""
    best = for_quality(tried)
    if best is None:
        return None
    return min((one for one in tried if one.error <= SPEED_ERROR * best.error), key=lambda one: one.frame_ms)
