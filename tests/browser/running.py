"""A viewer in a process of its own, and what it says of itself."""

from __future__ import annotations

import threading
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from runtime.viewer.opened_view import Opened
from runtime.viewer.viewer import Viewer
from tests.runtime.viewer.views import skirt_source

__all__ = ["Running", "Told"]


class Told(NamedTuple):
    """The state of a viewer at one moment."""

    frame_count: int
    tick_count: int
    playing: bool
    look: Any
    dragged: tuple[int, np.ndarray] | None
    world: np.ndarray
    place: np.ndarray
    bend_warp: float
    wind: tuple[float, float, float]
    camera: tuple[np.ndarray, np.ndarray, float]


def _told(viewer: Viewer) -> Told:
    playback = viewer.playback
    simulation, camera = playback.player.simulation, viewer._server.initial_camera
    return Told(
        viewer.frame_count,
        playback.tick_count,
        playback.playing,
        viewer.look,
        playback.dragged,
        simulation.state.world(),
        viewer._stage.place.copy(),
        simulation.model.fabric.bend_warp,
        playback.wind.velocity,
        (np.array(camera.position), np.array(camera.look_at), camera.fov),
    )


def _play(folder: Path, pipe: Connection) -> None:
    viewer = Viewer(Opened(skirt_source()), folder, port=0)
    pipe.send(viewer.address)
    stop = threading.Event()

    def answer() -> None:
        while pipe.recv():
            pipe.send(_told(viewer))
        stop.set()

    threading.Thread(target=answer, daemon=True).start()
    viewer.run(stop)
    viewer.close()


class Running:
    """A viewer of the skirt that plays until it is closed.

    Args:
        folder: for what is saved.
    """

    def __init__(self, folder: Path) -> None:
        context = get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=_play, args=(folder, other))
        self._process.start()
        assert self._pipe.poll(300.0), "the viewer does not start"
        self.folder, self.address = folder, self._pipe.recv()

    def told(self) -> Told:
        """Its present state."""
        self._pipe.send(True)
        assert self._pipe.poll(120.0), "the viewer does not answer"
        return self._pipe.recv()

    def close(self) -> None:
        """End it."""
        self._pipe.send(False)
        self._process.join(20.0)
        self._process.kill()
