"""How many pictures of `gube view` reach a browser, and what slow and leaving browsers do to the others.

A client speaks viser's protocol as a browser does, in a process of its own, but draws nothing.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from websockets.sync.client import ClientConnection, connect

from assets.io.view import ViewSettings
from pbd import InputError
from runtime.viewer.garments import DatabaseSource
from runtime.viewer.opening import open_source
from runtime.viewer.viewer import Viewer

__all__ = ["Watched", "bench_viewer", "connected", "pictures_in", "watch"]

CROWD_S = 12.0  # with a second, a slow and a leaving client [s]
LEAVES_AFTER_S = 3.0


@dataclass(frozen=True)
class Watched:
    """What reached a client.

    Attributes:
        times: when each picture arrived [s], shape (pictures,).
    """

    times: np.ndarray

    @property
    def rate_hz(self) -> float:
        """Pictures a second [Hz]."""
        return float((len(self.times) - 1) / (self.times[-1] - self.times[0])) if len(self.times) > 1 else 0.0

    def interval_ms(self, percent: float) -> float:
        """A percentile of the time from one picture to the next [ms]."""
        return float(np.percentile(1e3 * np.diff(self.times), percent)) if len(self.times) > 1 else float("nan")


def connected(port: int) -> ClientConnection:
    """A connection to a viewer, as its own page opens it."""
    protocol: Any = f"viser-v{viser.__version__}"
    origin: Any = f"http://127.0.0.1:{port}"
    return connect(
        f"ws://127.0.0.1:{port}",
        origin=origin,
        subprotocols=[protocol],
        max_size=None,
        compression=None,
        close_timeout=0.5,  # one that has stalled would have to read all that waits for it first
    )


def pictures_in(message: bytes) -> bool:
    """Whether a message from the server moves a garment."""
    packed = int.from_bytes(message[8:16], "little")
    content = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(message[16 : 16 + packed]))
    return any(
        part.get("type") == "SceneNodeUpdateMessage"
        and "vertices" in part["updates"]
        and not part["name"].endswith("/body")
        for part in content["messages"]
    )


def watch(port: int, seconds: float) -> Watched:
    """Receive for so long [s]."""
    times, end = [], time.perf_counter() + seconds
    with connected(port) as connection:
        while (left := end - time.perf_counter()) > 0.0:
            try:
                message = connection.recv(timeout=left)
            except TimeoutError:
                break
            assert isinstance(message, bytes)
            if pictures_in(message):
                times.append(time.perf_counter())
    return Watched(np.array(times))


def _stall(port: int, seconds: float) -> None:
    """Connect and receive nothing."""
    with connected(port):
        time.sleep(seconds)


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _run(viewer: Viewer, seconds: float, at: dict[float, Callable[[], Any]]) -> None:
    """Play for so long [s], and call functions at times from the start [s]."""
    stop = threading.Event()
    timers = [threading.Timer(t, act) for t, act in {**at, seconds: stop.set}.items()]
    for timer in timers:
        timer.start()
    viewer.run(stop)
    for timer in timers:
        timer.join()


def bench_viewer(file: Path, seconds: float, report: Callable[[str], None]) -> dict[str, float]:
    """Play a database's wrinkles to one client, then to several.

    Args:
        file: the database.
        seconds: with one client [s].
        report: told lines of progress.

    Returns:
        figures by name.

    Raises:
        InputError: no database.
    """
    opened = open_source(file)
    source = opened.source
    if not isinstance(source, DatabaseSource):
        raise InputError("no database", file=file, expected="a wrinkle database (.h5)")
    with TemporaryDirectory() as folder, ProcessPoolExecutor(4, get_context("spawn")) as pool:
        viewer = Viewer(opened._replace(view=ViewSettings(wrinkles=True)), Path(folder), port=0)
        port = viewer.port
        list(pool.map(time.sleep, [0.5] * 4))  # the processes are started
        report(f"one client for {seconds:.0f} s")
        one = pool.submit(watch, port, seconds)
        memory: list[float] = []
        sample = lambda: memory.append(_resident_mb())  # noqa: E731
        spent = time.process_time()
        _run(viewer, seconds, {0.25 * seconds: sample, 0.99 * seconds: sample})
        spent = time.process_time() - spent
        watched, frames, late = one.result(), viewer.frame_count, viewer.late_count
        report("with a second client, one that reads nothing and one that goes away")
        crowd = [pool.submit(watch, port, CROWD_S) for _ in range(2)]
        pool.submit(_stall, port, CROWD_S)
        leaving = pool.submit(watch, port, LEAVES_AFTER_S)
        _run(viewer, CROWD_S, {})
        leaving.result()
        rates = [client.result().rate_hz for client in crowd]
        viewer.close()
    return {
        "fine_vertex_count": float(source.database.fine_vertex_count),
        "updates_per_s": watched.rate_hz,
        "update_interval_ms_p50": watched.interval_ms(50.0),
        "update_interval_ms_p99": watched.interval_ms(99.0),
        "loop_rate_hz": frames / seconds,
        "processor_ms_per_update": 1e3 * spent / max(1, frames),
        "late_periods": float(late),
        "memory_mb": memory[0],
        "memory_growth_mb": memory[-1] - memory[0],
        "crowd_loop_rate_hz": (viewer.frame_count - frames) / CROWD_S,
        "crowd_updates_per_s_least": min(rates),
    }
