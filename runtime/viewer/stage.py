"""The scene in the viewer's window: floor, lights, and a column with body and garment for each mesh that is shown.

Everything stands about the place of the body, so that the camera follows by itself: the floor moves, not the camera.
Only the newest state is sent; a browser that is slow skips those between.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from runtime.draw.picture_content import BODY_COLOR, GARMENT_COLOR
from runtime.draw.studio import BACKGROUND
from runtime.viewer.colors import BANDS, CLOTH, GARMENTS, SCALES, bands_of, rgb
from runtime.viewer.garments import COARSE, OURS, PLAIN, SMOOTH, TRUTH, ViewedGarment
from runtime.viewer.playback import Playback

__all__ = ["OVERLAID_COLORS", "Look", "Stage"]

Rgb = tuple[int, int, int]
Point = tuple[float, float, float]


CLOTH_COLOR, SKIN_COLOR = rgb(GARMENT_COLOR), rgb(BODY_COLOR)
OVERLAID_COLORS = {
    COARSE: (206, 142, 70), SMOOTH: (104, 158, 108), OURS: CLOTH_COLOR, PLAIN: CLOTH_COLOR, TRUTH: (176, 84, 92),
}  # fmt: skip
OVERLAID_OPACITY = 0.45  # of all meshes but the main one; the coarse one shows its edges
SPACING = 0.62  # from one column to the next, in heights
CELL = 0.5  # of the floor's grid [m]
FIELD_OF_VIEW_DEG = 30.0
AZIMUTH_DEG, ELEVATION_DEG = 18.0, 7.0  # of the camera at the start, seen from where the body looks
# Azimuth from there and elevation [deg], colour, intensity: a key light that rakes from the side, a rim light.
LIGHTS = {"key": (-62.0, 38.0, (255, 247, 236), 5.5), "rim": (108.0, 26.0, (224, 236, 255), 2.2)}


@dataclass(frozen=True)
class Look:
    """How a garment is shown.

    Attributes:
        meshes: names of the meshes that are shown.
        overlaid: all in one place; else side by side.
        coloring: :data:`runtime.viewer.colors.CLOTH` or a key of its SCALES.
        wireframe: edges instead of faces.
        body: show the body.
        follow: keep the body in the middle.
    """

    meshes: tuple[str, ...]
    overlaid: bool = False
    coloring: str = CLOTH
    wireframe: bool = False
    body: bool = True
    follow: bool = True


class Stage:
    """Draws a garment.

    Args:
        server: viser's.
        garment: at the start of its motion.

    Attributes:
        place: point on the floor that is in the middle of the window [m], shape (3,).
        height: of body and garment at the start [m].
    """

    def __init__(self, server: viser.ViserServer, garment: ViewedGarment) -> None:
        self._server, self._garment = server, garment
        player = garment.player
        simulated, body = player.interpolated()
        points = np.concatenate([simulated[:, :3], body[: len(body) if len(garment.body_faces) else 0]])
        self.height = float(np.ptp(points[:, 1]))
        self._floor_height = float(points[:, 1].min() + player.origin[1]) if len(garment.body_faces) else 0.0
        self.spacing = SPACING * self.height
        if not len(garment.body_faces):
            self.spacing = 1.2 * float(np.ptp(simulated[:, 0]))
            self.height = max(self.height, float(np.ptp(simulated[:, 0])))
        self.place = self._under_body()
        self.middle = 0.5 * float(points[:, 1].min() + points[:, 1].max()) + float(player.origin[1])
        self._nodes: dict[str, Any] = {}
        self._colored: set[str] = set()
        self._drag: Any = None
        with server.atomic():
            self._add_surroundings()
            for name in garment.meshes:
                self._add_column(name)

    def on_drag(self, callback: Any) -> None:
        """Call a coroutine function with viser's event and the name of the mesh whenever a garment is dragged."""
        self._drag = callback
        for name in self._garment.meshes:
            self._bind(self._nodes[f"{name}/garment"], name)

    def show(self, playback: Playback, look: Look) -> None:
        """Send the present picture."""
        garment, player, nodes = self._garment, self._garment.player, self._nodes
        if look.follow:
            self.place = self._under_body()
        tick = playback.time / playback.tick
        # A slow browser takes over places and vertices at different times: only the vertices move.
        shift = (player.origin - self.place).astype(np.float32)
        body = garment.body_vertices() + shift
        with self._server.atomic():
            nodes["floor"].position = self._floor_place()
            for index, name in enumerate(look.meshes):
                column = nodes[name]
                column.position = _point(self.offset(look, name))
                labelled = len(look.meshes) > 1 and not look.overlaid
                nodes[f"{name}/label"].visible = labelled
                if labelled:
                    nodes[f"{name}/label"].position = self._over_head(garment.vertices(name, tick), shift)
                shows_body = look.body and len(garment.body_faces) > 0 and (index == 0 or not look.overlaid)
                if f"{name}/body" in nodes:
                    nodes[f"{name}/body"].visible = shows_body
                if shows_body:
                    nodes[f"{name}/body"].vertices = body
                self._show_garment(name, look, garment.vertices(name, tick), shift)
                column.visible = True
            for name in garment.meshes:
                if name not in look.meshes:
                    nodes[name].visible = False

    def offset(self, look: Look, name: str) -> np.ndarray:
        """Where the column of a mesh stands, from the middle of the window [m], shape (3,)."""
        if look.overlaid or name not in look.meshes:
            return np.zeros(3)
        index = look.meshes.index(name) - 0.5 * (len(look.meshes) - 1)
        azimuth = math.radians(AZIMUTH_DEG)  # side by side as seen by the camera at the start
        return self.spacing * index * np.array([math.cos(azimuth), 0.0, -math.sin(azimuth)])

    def camera(self, columns: int) -> tuple[Point, Point]:
        """Position and target of a camera that sees so many columns [m], about :attr:`place`."""
        target = np.array([0.0, self.middle, 0.0])
        distance = (0.70 * self.height + 0.30 * self.spacing * (columns - 1)) / math.tan(
            math.radians(FIELD_OF_VIEW_DEG) / 2.0
        )
        eye = target + distance * _direction(AZIMUTH_DEG, ELEVATION_DEG)
        return _point(eye), _point(target)

    def remove(self) -> None:
        """Take everything away."""
        for name in [*self._garment.meshes, "floor", *LIGHTS, "sky"]:
            self._nodes[name].remove()

    def _under_body(self) -> np.ndarray:
        """The point of the floor under the body, or under a garment without one [m], float64, shape (3,)."""
        player = self._garment.player
        simulated, body = player.interpolated()
        points = body if len(self._garment.body_faces) else simulated[:, :3]
        return (points.mean(axis=0, dtype=float) + player.origin) * [1.0, 0.0, 1.0]

    def _floor_place(self) -> Point:
        along, _, across = np.mod(-self.place, CELL)
        return float(along), self._floor_height, float(across)

    def _add_surroundings(self) -> None:
        server, nodes = self._server, self._nodes
        below, above = (np.array(rgb(color), float) for color in BACKGROUND)
        shade = np.linspace(0.0, 1.0, 64)[:, None, None]
        picture = np.broadcast_to(above + shade * (below - above), (64, 64, 3)).astype(np.uint8)
        server.scene.set_background_image(picture)
        server.scene.world_axes.visible = False
        server.scene.configure_default_lights(False)
        server.scene.configure_environment_map(None)
        nodes["floor"] = server.scene.add_grid(
            "/floor",
            width=40.0,
            height=40.0,
            plane="xz",
            cell_size=CELL,
            section_size=CELL,
            cell_color=(150, 150, 152),
            section_color=(150, 150, 152),
            section_thickness=0.8,
            fade_distance=14.0,
            fade_strength=2.0,
            shadow_opacity=0.35,
            position=self._floor_place(),
        )
        for name, (azimuth, elevation, color, intensity) in LIGHTS.items():
            nodes[name] = server.scene.add_light_directional(
                f"/{name}",
                color=color,
                intensity=intensity,
                cast_shadow=name == "key",
                position=_point(10.0 * _direction(AZIMUTH_DEG + azimuth, elevation)),
            )
        nodes["sky"] = server.scene.add_light_hemisphere(
            "/sky", sky_color=(214, 224, 238), ground_color=(132, 124, 116), intensity=2.0
        )

    def _add_column(self, name: str) -> None:
        scene, garment, nodes = self._server.scene, self._garment, self._nodes
        place = f"/{name.replace(' ', '_')}"
        nodes[name] = scene.add_frame(place, show_axes=False, visible=False)
        nodes[f"{name}/label"] = scene.add_label(
            f"{place}/label", name, position=(0.0, 0.0, 0.0), anchor="bottom-center", visible=False
        )
        if len(garment.body_faces):
            nodes[f"{name}/body"] = scene.add_mesh_simple(
                f"{place}/body", garment.body_vertices(), garment.body_faces, color=SKIN_COLOR
            )
        nodes[f"{name}/garment"] = scene.add_mesh_simple(
            f"{place}/garment",
            np.array(garment.vertices(name, 0.0)),
            garment.meshes[name].faces,
            color=CLOTH_COLOR,
            side="double",
            receive_shadow=False,  # viser sets no bias: cloth that shades itself has stripes that look like folds
        )

    def _show_garment(self, name: str, look: Look, vertices: np.ndarray, shift: np.ndarray) -> None:
        garment, nodes = self._garment, self._nodes
        shown = vertices + shift
        # Meshes that are overlaid have a colour each, and the garments of an outfit do not.
        plainly = look.coloring == CLOTH and look.overlaid
        values = None if plainly else garment.values(name, look.coloring, vertices)
        plain = nodes[f"{name}/garment"]
        plain.visible = values is None
        if name in self._colored:
            for band in range(BANDS):
                nodes[f"{name}/{band}"].visible = values is not None
        if values is None:
            under = look.overlaid and name != garment.main and len(look.meshes) > 1
            plain.color = OVERLAID_COLORS[name] if look.overlaid else CLOTH_COLOR
            plain.opacity = OVERLAID_OPACITY if under else None
            plain.wireframe = look.wireframe or (under and name == COARSE)
            plain.vertices = shown
            return
        scale = GARMENTS if look.coloring == CLOTH else SCALES[look.coloring]
        parts = bands_of(np.ascontiguousarray(shown), garment.meshes[name].faces, scale.band(values))
        if name not in self._colored:
            self._add_bands(name)
        for band, part in enumerate(parts):
            node = nodes[f"{name}/{band}"]
            node.color, node.wireframe = scale.colors[band], look.wireframe
            node.vertices, node.faces = part.vertices, part.faces

    def _add_bands(self, name: str) -> None:
        """Meshes for the bands, made when they are first shown."""
        empty = np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.uint32)
        for band in range(BANDS):
            place = f"/{name.replace(' ', '_')}/band_{band}"
            node = self._nodes[f"{name}/{band}"] = self._server.scene.add_mesh_simple(
                place, *empty, side="double", receive_shadow=False
            )
            self._bind(node, name)
        self._colored.add(name)

    def _bind(self, node: Any, name: str) -> None:
        callback = self._drag
        if callback is None:
            return

        async def dragged(event: Any) -> None:
            await callback(event, name)

        node.on_drag("left")(dragged)

    def _over_head(self, vertices: np.ndarray, shift: np.ndarray) -> Point:
        """A point over the body, or over a garment without one, in its column [m]."""
        player = self._garment.player
        points = player.interpolated()[1] if len(self._garment.body_faces) else vertices
        x, _, z = self._under_body() - self.place
        return float(x), float(points[:, 1].max() + shift[1]) + 0.06, float(z)


def _direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    return np.array(
        [math.sin(azimuth) * math.cos(elevation), math.sin(elevation), math.cos(azimuth) * math.cos(elevation)]
    )


def _point(values: np.ndarray) -> Point:
    x, y, z = (float(value) for value in values)
    return x, y, z
