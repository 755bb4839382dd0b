"""The panel of the viewer's window: its controls, what it says, and the graph of frame times.

A control only puts a command into a queue; the viewer's loop carries it out between two pictures.
"""

from __future__ import annotations

import html
import math
from collections.abc import Callable
from itertools import cycle
from queue import SimpleQueue
from typing import Any

import numpy as np
import viser

from runtime.play.player import PARTS
from runtime.viewer.colors import CLOTH, CLOTH_COLORS, SCALES, legend, names_legend
from runtime.viewer.garments import FabricFactors, ViewedGarment
from runtime.viewer.sources import Source
from runtime.viewer.stage import OVERLAID_COLORS, Look

__all__ = ["SPEEDS", "Controls"]

SPEEDS = {"1": 1.0, "1/2": 0.5, "1/4": 0.25, "1/10": 0.1}
MAX_WIND = 12.0  # [m/s]
GRAPHED = (*(part for part in PARTS if part != "frame"), "sending")
GRAPH_COLORS = (
    (156, 117, 95), (78, 121, 167), (242, 142, 43), (225, 87, 89), (118, 183, 178), (176, 122, 161),
)  # fmt: skip
GRAPH_FRAMES = 240
GRAPH_MS = 20.0  # height of the graph [ms]; a frame at 60 Hz has 16.7

Command = Callable[[], None]


class Controls:
    """Makes the controls of a garment.

    Args:
        server: viser's.
        source: what is viewed.
        garment: the garment that is shown.
        viewer: what the controls act on, see :class:`runtime.viewer.viewer.Viewer`.

    Attributes:
        commands: to be carried out by the viewer's loop, in order.
    """

    def __init__(self, server: viser.ViserServer, source: Source, garment: ViewedGarment, viewer: Any) -> None:
        self._gui, self._source, self._viewer = server.gui, source, viewer
        self.commands: SimpleQueue[Command] = SimpleQueue()
        notice = source.wrinkles_notice if viewer.choice.wrinkles else source.notice
        self._gui.add_html(_paragraph(source.title, notice))
        self._status = self._gui.add_html("")
        with self._gui.add_folder("Time"):
            self._add_time()
        with self._gui.add_folder("Show"):
            self._add_show(garment)
        with self._gui.add_folder("Wind and fabric"):
            self._add_wind()
            self._add_fabric()
        with self._gui.add_folder("Save", expand_by_default=False):
            self._add_save()
        with self._gui.add_folder("Frame time", expand_by_default=False):
            self._add_graph()

    def remove(self) -> None:
        """Take all controls away."""
        self._gui.reset()

    def say(self, line: str) -> None:
        """Show a line above the controls."""
        self._status.content = f'<div style="{_STYLE};min-height:2.6em"><i>{html.escape(line)}</i></div>'

    def show_time(self, seconds: float, playing: bool) -> None:
        """Move the slider of the time [s] and name the button by what it does."""
        self._time.value = seconds
        self._play.label = "Pause" if playing else "Play"

    def show_timings(self, timings: np.ndarray) -> None:
        """Draw the graph of frame times.

        Args:
            timings: of the last frames by part [ms], float64, shape (frames, parts).
        """
        count = len(timings)
        if count > 1:
            self._graph.data = (np.arange(1.0 - count, 1.0), *timings.T)
            medians = [
                f"{name} {value:.1f} ms" for name, value in zip(GRAPHED, np.median(timings, axis=0), strict=True)
            ]
            self._graph_legend.content = names_legend(dict(zip(medians, GRAPH_COLORS, strict=True)))

    def _add_time(self) -> None:
        viewer, gui, playback = self._viewer, self._gui, self._viewer.playback
        self._play = gui.add_button("Pause", hint="play or pause")
        self._on_click(self._play, viewer.toggle)
        steps = gui.add_button_group("step", ("back", "on"), hint="pause and go one tick back or on")
        self._on_click(steps, lambda: viewer.step(-1 if steps.value == "back" else 1))
        self._time = gui.add_slider(
            "time [s]", 0.0, playback.duration, playback.tick, 0.0, hint="pause and show another moment"
        )
        self._time.precision = 2  # a tick has more digits than the field has room for
        self._on_update(self._time, viewer.scrub)
        names = {value: name for name, value in SPEEDS.items()}
        speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value=names.get(playback.speed, "1"))
        self._on_update(speed, lambda name: viewer.set_speed(SPEEDS[name]))
        if len(self._source.motions) > 1:
            motions = {motion.name: motion for motion in self._source.motions}
            motion = gui.add_dropdown("motion", tuple(motions), initial_value=playback.motion.name)
            self._on_update(motion, lambda name: viewer.choose(motion=motions[name]))

    def _add_show(self, garment: ViewedGarment) -> None:
        gui, look = self._gui, self._viewer.look
        if self._source.prefers_plain_cloth:
            wrinkles = gui.add_checkbox(
                "play the wrinkles", self._viewer.choice.wrinkles, hint="instead of plain cloth"
            )
            self._on_update(wrinkles, lambda value: self._viewer.choose(wrinkles=value))
        if self._source.garments and garment.worn:
            worn_boxes = {
                name: gui.add_checkbox(name, name in garment.worn, hint="worn") for name in self._source.garments
            }
            for box in worn_boxes.values():
                self._on_update(
                    box, lambda _: self._viewer.wear(tuple(name for name, box in worn_boxes.items() if box.value))
                )
        if len(garment.meshes) > 1:
            boxes = {name: gui.add_checkbox(name, name in look.meshes) for name in garment.meshes}
            for box in boxes.values():
                self._on_update(
                    box, lambda _: self._show(garment, meshes=tuple(name for name, box in boxes.items() if box.value))
                )
            places = ("side by side", "overlaid")
            overlaid = gui.add_dropdown("arranged", places, initial_value=places[look.overlaid])
            self._on_update(overlaid, lambda value: self._show(garment, overlaid=value == places[1]))
        colorings = (CLOTH, *(name for name in SCALES if garment.colors_by(name)))
        coloring = gui.add_dropdown("colours", colorings, initial_value=look.coloring)
        self._on_update(coloring, lambda value: self._show(garment, coloring=value))
        self._legend = gui.add_html("")
        self._show(garment)
        for name, hint in (
            ("wireframe", "edges instead of faces"),
            ("body", None),
            ("follow", "keep it in the middle"),
        ):
            box = gui.add_checkbox(name, getattr(look, name), hint=hint)
            self._on_update(box, lambda value, name=name: self._show(garment, **{name: value}))
        if garment.details:
            details = gui.add_dropdown("level of detail", tuple(garment.details))
            self._on_update(details, self._viewer.set_detail)

    def _show(self, garment: ViewedGarment, **changes: Any) -> None:
        """Change how the garment is shown, and its legend."""
        look: Look = self._viewer.show(**changes)
        scale = SCALES.get(look.coloring)
        garments = garment.worn if look.coloring == CLOTH and not look.overlaid and len(garment.worn) > 1 else ()
        self._legend.visible = scale is not None or len(garments) > 1 or (look.overlaid and len(look.meshes) > 1)
        if scale is not None:
            self._legend.content = legend(scale, garment.kinds if look.coloring == "level of detail" else ())
        elif garments:
            self._legend.content = names_legend(dict(zip(garments, cycle(CLOTH_COLORS), strict=False)))
        elif self._legend.visible:
            self._legend.content = names_legend({name: OVERLAID_COLORS[name] for name in look.meshes})

    def _add_wind(self) -> None:
        viewer, gui, wind = self._viewer, self._gui, self._viewer.playback.wind
        speed, azimuth = (
            math.hypot(wind.velocity[0], wind.velocity[2]),
            math.degrees(math.atan2(wind.velocity[0], wind.velocity[2])),
        )
        sliders = [
            gui.add_slider("wind [m/s]", 0.0, MAX_WIND, 0.1, min(speed, MAX_WIND)),
            gui.add_slider(
                "towards [deg]", -180.0, 180.0, 1.0, azimuth, hint="0 is forward along +Z, 90 to the body's left"
            ),
            gui.add_slider(
                "turbulence", 0.0, 1.0, 0.01, min(wind.turbulence, 1.0), hint="speed of eddies over the wind's"
            ),
        ]
        for slider in sliders:
            self._on_update(slider, lambda _: viewer.set_wind(*(one.value for one in sliders)))

    def _add_fabric(self) -> None:
        viewer, gui, source = self._viewer, self._gui, self._source
        if len(source.fabrics) > 1:
            fabric = gui.add_dropdown("fabric", source.fabrics, initial_value=viewer.choice.fabric)
            self._on_update(fabric, lambda name: viewer.choose(fabric=name))
        if not source.wearable:
            return
        hint = "factor on the fabric: 1 is as it is; wrinkles stay those of the fabric that was learned"
        sliders = []
        for name, value in zip(FabricFactors._fields, viewer.factors, strict=True):
            least, most = (0.3, 3.0) if name == "weight" else (0.1, 10.0)
            sliders.append(gui.add_slider(name, least, most, 0.05, min(max(value, least), most), hint=hint))
        for slider in sliders:
            self._on_update(slider, lambda _: viewer.set_factors(FabricFactors(*(one.value for one in sliders))))

    def _add_save(self) -> None:
        viewer, gui = self._viewer, self._gui
        picture = gui.add_button("Picture", hint="this window's picture (.png)")

        @picture.on_click
        def _(event: Any) -> None:
            viewer.save_picture(event.client)

        clip = gui.add_button("Clip", hint="all moments that were played (.glb)")
        self._on_click(clip, viewer.save_clip)
        scene = gui.add_button("Scene", hint="the scene file that gives this view again (.toml)")

        @scene.on_click
        async def _(event: Any) -> None:
            camera = event.client.camera
            seen = np.array(camera.position), np.array(camera.look_at), float(camera.fov)
            self.commands.put(lambda: viewer.save_scene(*seen))

    def _add_graph(self) -> None:
        series: Any = [{}]
        series += [{"stroke": f"rgb{color}", "width": 1.5} for color in GRAPH_COLORS]
        self._graph = self._gui.add_uplot(
            (np.arange(2.0), *(np.zeros(2) for _ in GRAPHED)),
            tuple(series),
            scales={"x": {"time": False}, "y": {"range": (0.0, GRAPH_MS)}},
            axes=({"show": False}, {"size": 36}),
            legend={"show": False},
            height=180,
        )
        self._graph_legend = self._gui.add_html("")

    def _on_click(self, handle: Any, act: Command) -> None:
        @handle.on_click
        async def _(event: Any) -> None:
            self.commands.put(act)

    def _on_update(self, handle: Any, act: Callable[[Any], Any]) -> None:
        @handle.on_update
        async def _(event: Any) -> None:
            if event.client_id is not None:  # else the viewer itself has moved the control
                value = handle.value
                self.commands.put(lambda: act(value))


_STYLE = "font-size:0.85em;line-height:1.35;padding:0.3em 0.9em"


def _paragraph(title: str, text: str) -> str:
    return f'<div style="{_STYLE}"><b>{html.escape(title)}</b><br>{html.escape(text)}</div>'
