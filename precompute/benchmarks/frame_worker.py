"""Plays a database with the code of the checkout that it runs in, so many frames for each line that it reads.

Run as ``python -c TEXT_OF_THIS_FILE DATABASE`` by :mod:`precompute.benchmarks.frame_turns`. It prints "ready", then for
each line with a number of frames a line of JSON: the times of each part in these frames [ms]. It uses only a few names,
so that it runs in checkouts of other versions.
"""

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from pbd.taichi_internals import Launch
from runtime.play.player import Player
from runtime.play.simulation import poses_of
from runtime.setup.playback_inputs import open_database

SKIPPED = 10  # frames that get going


class _Playback:
    """The database on its own body and first held-out motion, which begins again where it ends."""

    def __init__(self, path: str) -> None:
        database, self._inputs = open_database(Path(path))
        self._dt = 1.0 / database.frame_rate
        self._poses = poses_of(self._inputs.motions[0], self._dt)
        self._player = Player(database, self._inputs.body, self._poses[0], self._inputs.primitives)
        self._number, self._in_kernels = 0, 0.0
        plain, playback = Launch.__call__, self

        def timed(self: Launch, *arguments: Any) -> None:
            began = time.thread_time()
            plain(self, *arguments)
            playback._in_kernels += 1e3 * (time.thread_time() - began)

        Launch.__call__ = timed

    def frame(self) -> dict[str, float]:
        """Times of the next frame; the network takes nearly all the time of the fine vertices outside of kernels."""
        self._number = self._number % (len(self._poses) - 1) + 1
        self._player.step(self._poses[self._number], self._dt, self._inputs.wind)
        self._in_kernels = 0.0
        self._player.decode()
        times = dict(self._player.timings)
        network = times["decode"] + times["relax"] + times["normals"] - self._in_kernels
        return times | {"without_network": times["frame"] - network}


def main() -> None:
    """Answer lines until there are no more."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    time.perf_counter = time.thread_time  # players of older checkouts take times by the clock
    playback = _Playback(sys.argv[1])
    for _ in range(SKIPPED):
        playback.frame()
    _say("ready")
    for line in sys.stdin:
        rows = [playback.frame() for _ in range(int(line))]
        _say(json.dumps({part: [row[part] for row in rows] for part in rows[0]}))


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
