"""The viewer: a loop that plays a garment at 60 Hz and sends what browsers show; it never waits for one of them."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from assets.io.scene import CameraSettings
from assets.io.view_settings import ViewSettings
from assets.motion import Motion
from pbd import InputError
from runtime.viewer.colors import CLOTH
from runtime.viewer.controls import GRAPH_FRAMES, GRAPHED, Controls
from runtime.viewer.garments import FabricFactors, ViewedGarment
from runtime.viewer.opened_view import Opened
from runtime.viewer.playback import Playback
from runtime.viewer.saving import bake_clip, clip_frames, write_picture, write_view
from runtime.viewer.server import HOST, Server, open_server
from runtime.viewer.sources import DatabaseSource, Source
from runtime.viewer.stage import FIELD_OF_VIEW_DEG, Look, Stage

__all__ = ["PORT", "RATE_HZ", "ViewChoice", "Viewer"]

PORT = 8080
RATE_HZ = 60.0
TOLD_EVERY = 6  # frames from one update of the time's slider to the next
GRAPHED_EVERY = 20  # frames from one drawing of the graph to the next
SETTLED = 0.2  # a slider of the fabric must stand still for so long before it acts [s]


@dataclass(frozen=True)
class ViewChoice:
    """What is played.

    Attributes:
        motion: of the body; None where there is no choice.
        fabric: one of the source's.
        wrinkles: play the wrinkles even where plain cloth is the better choice.
    """

    motion: Motion | None
    fabric: str
    wrinkles: bool = False


class Viewer:
    """Plays what is viewed and serves it on loopback.

    Args:
        opened: what is viewed, and how.
        output: folder for what is saved.
        port: of the server, see :func:`runtime.viewer.server.open_server`.

    Attributes:
        playback: the time and what is played.
        look: how it is shown.
        choice: what is played.
        factors: on the fabric.
        frame_count: pictures since the start.
    """

    def __init__(self, opened: Opened, output: Path, port: int = PORT) -> None:
        source, view, camera = opened
        self._source, self._output = source, output
        self.choice = _choice_of(source, view)
        self.factors = FabricFactors(view.bending, view.stretch, view.weight)
        self.frame_count = 0
        self._garment = self._make()
        if view.garments:
            self._garment = _wearing(source, self._garment, view.garments)
        self.playback = self._new_playback()
        self.look = _look_of(self._garment, view)
        if view.time > 0.0:
            self.playback.step(round(min(view.time, self.playback.duration) * source.frame_rate))
        self._server: Server = open_server("gube", port)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        self._server.scene.set_up_direction("+y")
        self._timings: deque[list[float]] = deque(maxlen=GRAPH_FRAMES)
        self._changes = 0  # commands that were carried out; a picture after one is sent even if time stands still
        self._sent: tuple = ()
        self._new_factors: tuple[FabricFactors, float] | None = None
        self._set_stage()
        self._aim(camera)

    @property
    def address(self) -> str:
        """Where browsers on this machine find it."""
        return f"http://{HOST}:{self.port}"

    @property
    def port(self) -> int:
        """Port of the server."""
        return self._server.get_port()

    def run(self, stop: threading.Event) -> None:
        """Play until ``stop`` is set."""
        start, turn, due = time.perf_counter(), 0, 1
        while not stop.is_set():
            began = time.perf_counter()
            self._obey(began)
            self._frame((due - turn) / RATE_HZ)
            turn = due
            due = max(turn + 1, math.ceil((time.perf_counter() - start) * RATE_HZ))
            time.sleep(max(0.0, start + turn / RATE_HZ - time.perf_counter()))

    def close(self) -> None:
        """End the server."""
        self._server.stop()

    # What the controls do, in the loop's thread.

    def toggle(self) -> None:
        """Play or pause."""
        self.playback.playing = not self.playback.playing

    def step(self, ticks: int) -> None:
        """Pause and go some ticks on or back."""
        self.playback.step(ticks)

    def scrub(self, seconds: float) -> None:
        """Pause and show another moment [s]."""
        self.playback.scrub(seconds)

    def set_speed(self, speed: float) -> None:
        """Set the garment's time over the clock's [-]."""
        self.playback.speed = speed

    def show(self, **changes: Any) -> Look:
        """Change how it is shown: fields of :class:`runtime.viewer.stage.Look`."""
        self.look = replace(self.look, **changes)
        return self.look

    def set_detail(self, name: str) -> None:
        """Play at another level of detail."""
        self._garment.set_detail(name)

    def set_wind(self, speed: float, azimuth_deg: float, turbulence: float) -> None:
        """Set the wind [m/s, deg, -]; azimuth 0 is towards +Z, 90 towards +X."""
        azimuth = math.radians(azimuth_deg)
        velocity = speed * math.sin(azimuth), 0.0, speed * math.cos(azimuth)
        self.playback.wind = replace(self._source.wind, velocity=velocity, turbulence=turbulence)

    def set_factors(self, factors: FabricFactors) -> None:
        """Change the fabric as soon as the sliders stand still: each change takes some hundredths of a second."""
        self._new_factors = factors, time.perf_counter() + SETTLED

    def choose(self, **changes: Any) -> None:
        """Play something else from its start: fields of :class:`ViewChoice`."""
        self._controls.say("making another garment ...")
        self.choice = replace(self.choice, **changes)
        self._garment = self._make()
        playing, speed, wind = self.playback.playing, self.playback.speed, self.playback.wind
        self.playback = self._new_playback()
        self.playback.playing, self.playback.speed, self.playback.wind = playing, speed, wind
        self._show_other_meshes()

    def wear(self, names: tuple[str, ...]) -> None:
        """Put garments of the outfit on and take others off, and play on."""
        source = self._source
        assert isinstance(source, DatabaseSource)
        player = self._garment.player
        try:
            self._garment = source.wearing(self._garment, names)
            self.playback.forget(player.start)
        finally:  # a box that may not be cleared is set again
            self._show_other_meshes()

    def _show_other_meshes(self) -> None:
        """Show the garment after it has been made anew."""
        kept = tuple(name for name in self.look.meshes if name in self._garment.meshes)
        coloring = self.look.coloring if self._garment.colors_by(self.look.coloring) else CLOTH
        self.look = replace(self.look, meshes=kept or (self._garment.main,), coloring=coloring)
        self._stage.remove()
        self._controls.remove()
        self._set_stage()

    def save_picture(self, client: Any) -> None:
        """Write the picture of a browser; called on a thread of viser, since the browser takes its time."""
        camera = client.camera
        try:
            drawn = client.get_render(camera.image_height, camera.image_width, transport_format="png", timeout=20.0)
            self._controls.say(f"picture: {write_picture(self._output, drawn)}")
        except (RuntimeError, OSError) as error:  # TimeoutError is an OSError
            self._controls.say(f"no picture: {error}")

    def save_clip(self) -> None:
        """Write every moment that is kept; the loop waits only until they are shown once more."""
        frames, poses, rate_hz = clip_frames(self._garment, self.playback)
        faces, body = self._garment.meshes[self._garment.main].faces, self._garment.body
        shown = frames, poses, rate_hz, body, self._garment.vertices_of_garments, self._garment.texture
        self._controls.say("writing the clip ...")

        def bake() -> None:
            try:
                self._controls.say(f"clip: {bake_clip(self._output, faces, *shown)}")
            except (OSError, InputError) as error:
                self._controls.say(f"no clip: {error}")

        threading.Thread(target=bake, daemon=True).start()

    def save_scene(self, position: np.ndarray, target: np.ndarray, field_of_view: float) -> None:
        """Write the scene file that gives this view again.

        Args:
            position, target: of the browser's camera, about the middle of the window [m], shape (3,).
            field_of_view: vertical [rad].
        """
        eye, middle = (_rounded(point + self._stage.place) for point in (position, target))
        camera = CameraSettings(position=eye, target=middle, field_of_view_deg=round(math.degrees(field_of_view), 3))
        source, look, choice = self._source, self.look, self.choice
        view = ViewSettings(
            database=source.path.absolute() if isinstance(source, DatabaseSource) else None,
            motion=None if choice.motion is None else choice.motion.name,
            garments=self._garment.worn if source.garments and self._garment.worn != source.garments else (),
            fabric=choice.fabric or None,
            wrinkles=choice.wrinkles,
            time=round(self.playback.time, 4),
            meshes=look.meshes,
            overlaid=look.overlaid,
            colors=look.coloring,
            wireframe=look.wireframe,
            body=look.body,
            follow=look.follow,
            **self.factors._asdict(),
        )
        try:
            path = write_view(self._output, source.scene, self.playback.wind, camera, view)
            self._controls.say(f"scene: {path}")
        except OSError as error:
            self._controls.say(f"no scene: {error}")

    # The loop.

    def _obey(self, now: float) -> None:
        commands = self._controls.commands
        while not commands.empty():
            try:
                commands.get()()
            except InputError as error:
                self._controls.say(str(error))
            self._changes += 1
            commands = self._controls.commands
        if self._new_factors is not None and now >= self._new_factors[1]:
            self.factors, self._new_factors = self._new_factors[0], None
            self._garment.wear(self.factors)

    def _frame(self, elapsed: float) -> None:
        playback = self.playback
        try:
            playback.advance(elapsed)
        except InputError as error:  # what was dragged or set has driven the cloth out of all bounds
            self._controls.say(f"starts again: {error}")
            playback.release()
            playback.go_to(0)
        picture = playback.time, self.look, self._changes
        began = time.perf_counter()
        if picture != self._sent or playback.playing:
            self._stage.show(playback, self.look)
            self._sent = picture
        sending = 1e3 * (time.perf_counter() - began)
        if playback.playing:
            self._timings.append([playback.player.timings.get(part, sending) for part in GRAPHED])
        self.frame_count += 1
        if self.frame_count % TOLD_EVERY == 0:
            self._controls.show_time(playback.time, playback.playing)
        if self.frame_count % GRAPHED_EVERY == 0:
            self._controls.show_timings(np.array(self._timings))
        self._server.flush()

    def _make(self) -> ViewedGarment:
        garment = self._source.garment(self.choice.motion, self.choice.fabric, self.choice.wrinkles)
        if self.factors != FabricFactors():
            garment.wear(self.factors)
        return garment

    def _new_playback(self) -> Playback:
        garment, source = self._garment, self._source
        return Playback(garment.player, garment.motion, 1.0 / source.frame_rate, source.wind)

    def _set_stage(self) -> None:
        self._stage = Stage(self._server, self._garment)
        self._stage.on_drag(self._dragged)
        self._controls = Controls(self._server, self._source, self._garment, self)
        self._controls.say("Drag the garment with the left mouse button; drag beside it to turn the camera.")

    def _aim(self, saved: CameraSettings | None) -> None:
        camera = self._server.initial_camera
        camera.position, camera.look_at = self._stage.camera(len(self.look.meshes))
        camera.fov = math.radians(FIELD_OF_VIEW_DEG)
        camera.up = (0.0, 1.0, 0.0)
        if saved is not None:
            camera.position, camera.look_at = (np.array(saved.position), np.array(saved.target)) - self._stage.place
            camera.fov = math.radians(saved.field_of_view_deg)

    async def _dragged(self, event: Any, mesh: str) -> None:
        """Viser calls it on its own thread, start, updates and end of a drag in order."""
        phase = event.phase
        point = np.array(event.start_position if phase == "start" else event.end_position, float)
        self._controls.commands.put(lambda: self._drag(phase, mesh, point))

    def _drag(self, phase: str, mesh: str, seen: np.ndarray) -> None:
        playback, stage = self.playback, self._stage
        point = seen - stage.offset(self.look, mesh) + stage.place
        if phase == "end":
            playback.release()
        elif phase == "start":
            vertex = playback.nearest_free_vertex(point)
            playback.drag(vertex, playback.player.simulation.state.world()[vertex])
            self._grip = playback.player.simulation.state.world()[vertex] - point
        elif playback.dragged is not None:
            playback.drag(playback.dragged[0], point + self._grip)


def _rounded(point: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 4) for value in point)
    return x, y, z


def _choice_of(source: Source, view: ViewSettings) -> ViewChoice:
    """What a view plays.

    Raises:
        InputError: a motion or a fabric that the source does not have.
    """
    motions = {motion.name: motion for motion in source.motions}
    for key, value, known in (("motion", view.motion, list(motions)), ("fabric", view.fabric, source.fabrics)):
        if value is not None and value not in known:
            expected = "one of " + ", ".join(known) if known else "none"
            raise InputError("unknown in this view", key=f"view.{key}", received=value, expected=expected)
    motion = next(iter(source.motions), None) if view.motion is None else motions[view.motion]
    return ViewChoice(motion, view.fabric or next(iter(source.fabrics), ""), view.wrinkles)


def _wearing(source: Source, garment: ViewedGarment, names: tuple[str, ...]) -> ViewedGarment:
    """A view of some garments of an outfit.

    Raises:
        InputError: no outfit, or a garment that it does not have.
    """
    if not isinstance(source, DatabaseSource) or not source.garments:
        expected = "the file of an outfit"
        raise InputError("no garments to choose", key="view.garments", received=list(names), expected=expected)
    return source.wearing(garment, names)


def _look_of(garment: ViewedGarment, view: ViewSettings) -> Look:
    """How a view shows a garment.

    Raises:
        InputError: a mesh that the garment does not have, or colours that say nothing of it.
    """
    for name in view.meshes:
        if name not in garment.meshes:
            expected = "one of " + ", ".join(garment.meshes)
            raise InputError("no such mesh", key="view.meshes", received=name, expected=expected)
    if view.colors != CLOTH and not garment.colors_by(view.colors):
        raise InputError("no such colours of this garment", key="view.colors", received=view.colors)
    meshes = view.meshes or (garment.main,)
    return Look(meshes, view.overlaid, view.colors, view.wireframe, view.body, view.follow)
