"""The process of one rival: `python -m precompute.rivals.worker JOB.json` plays a dressing and writes what came.

It needs NumPy and the engine. Times are processor times of all threads of the process.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from precompute.rivals.dressing import Dressing

__all__ = ["FAR", "SLOW_MS", "main"]

SLOW_MS = 500.0  # a setting that takes longer for a frame is given up [ms]
SLOW_FRAMES = 12  # after which that is judged; the first are left out, in which kernels are compiled
FAR = 100.0  # a vertex further from the origin has burst [m]


def main(path: Path) -> None:
    """Play a job: a JSON object with ``dressing``, ``engine``, ``settings``, ``frames``, ``keep`` and ``out``."""
    job = json.loads(path.read_bytes())
    dressing, keep, kept, times, ended = Dressing.read(Path(job["dressing"])), set(job["keep"]), [], [], ""
    step, vertices = _start(job["engine"], dressing, path.parent, job["settings"])
    for frame in range(1, min(job["frames"], dressing.frame_count) + 1):
        began = time.process_time()
        step(frame)
        times.append(1e3 * (time.process_time() - began))
        found = vertices()
        if not (np.isfinite(found).all() and abs(found).max() < FAR):
            ended = f"burst after {frame * dressing.dt:.2f} s"
            break
        if frame == SLOW_FRAMES and np.median(times[SLOW_FRAMES // 2 :]) > SLOW_MS:
            ended = f"given up: {np.median(times[SLOW_FRAMES // 2 :]):.0f} ms a frame"
            break
        if frame in keep:
            kept.append(found.astype(np.float32))
    shape = (len(kept), len(dressing.start), 3)
    np.savez(job["out"], frames=np.array(kept, np.float32).reshape(shape), times=np.array(times), ended=ended)


def _start(
    engine: str, dressing: Dressing, folder: Path, settings: dict[str, Any]
) -> tuple[Callable[[int], None], Callable[[], np.ndarray]]:
    if engine == "blender":
        from precompute.rivals.blender_cloth import start_blender

        return start_blender(dressing, folder, **settings)
    if engine == "mujoco":
        from precompute.rivals.mujoco_cloth import start_mujoco

        return start_mujoco(dressing, **settings)
    from precompute.rivals.newton_cloth import start_newton

    return start_newton(dressing, engine, **settings)


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    main(Path(sys.argv[1]))
