"""Pictures of garments and bodies, drawn off-screen: no display is needed.

pyvista (VTK) draws; it and Pillow are imported where they are used, so that playing a database loads neither.
"""

from __future__ import annotations

import io
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pbd.errors import InputError
from pbd.storage import replacing
from wrinkles.metrics import vertex_normals

__all__ = [
    "BODY_COLOR",
    "GARMENT_COLOR",
    "Camera",
    "Drawn",
    "encode_image",
    "frame_camera",
    "render",
    "save_png",
    "strip",
]

BODY_COLOR = (0.76, 0.61, 0.53)
GARMENT_COLOR = (0.31, 0.50, 0.70)

_BACKGROUND = ((0.58, 0.58, 0.59), (0.80, 0.80, 0.81))  # below, above
_PAPER, _INK = (255, 255, 255), (30, 30, 34)

# Azimuth from the camera's own direction [deg], elevation [deg], intensity, colour. The key light rakes from the
# side, so that a wrinkle has a bright and a dark flank. The fill is weak and stands near the camera: a stronger one
# from the other side would brighten the dark flanks again.
_LIGHTS = (
    (-66.0, 34.0, 1.22, (1.0, 0.97, 0.93)),
    (36.0, 5.0, 0.30, (0.90, 0.95, 1.0)),
    (160.0, 45.0, 0.45, (1.0, 1.0, 1.0)),
)
_AMBIENT = 0.15
_SHADOW_CELLS = 192
_SHADOW_REACH = 1.6  # [m] half the side of the square on the floor that can hold a shadow


@dataclass(frozen=True)
class Drawn:
    """One mesh of a picture.

    Attributes:
        vertices: [m], shape (n, 3), world coordinates.
        faces: vertex indices, shape (m, 3), counter-clockwise seen from outside.
        color: red, green, blue in 0..1.
        normals: unit vertex normals, shape (n, 3); area-weighted ones are made where absent.
        smooth: interpolate normals over a face; False draws facets.
        edges: draw the mesh's edges too.
    """

    vertices: np.ndarray
    faces: np.ndarray
    color: tuple[float, float, float] = GARMENT_COLOR
    normals: np.ndarray | None = None
    smooth: bool = True
    edges: bool = False


@dataclass(frozen=True)
class Camera:
    """A perspective camera, Y up.

    Attributes:
        position: [m], shape (3,), world coordinates of the eye.
        target: [m], shape (3,), the point in the middle of the picture.
        field_of_view_deg: vertical field of view [deg].
    """

    position: np.ndarray
    target: np.ndarray
    field_of_view_deg: float = 30.0


def frame_camera(
    vertices_over_time: np.ndarray,
    *,
    azimuth_deg: float = 25.0,
    elevation_deg: float = 6.0,
    field_of_view_deg: float = 30.0,
    aspect: float = 1.0,
    margin: float = 1.06,
) -> list[Camera]:
    """One camera a frame that keeps all vertices in the picture and follows their centroid horizontally.

    Direction, height and distance are the same in every frame, so that wrinkles keep their size on the picture.

    Args:
        vertices_over_time: vertices that must be seen, of the garment or of garment and body [m], shape (f, n, 3).
        azimuth_deg: direction of the eye; 0 looks at the front (+Z side), 90 at the character's left (+X side) [deg].
        elevation_deg: angle of the eye above the target's level [deg].
        field_of_view_deg: vertical field of view [deg].
        aspect: width of the picture over its height.
        margin: room around the vertices; 1 lets them touch the border.

    Raises:
        InputError: the array is not a non-empty finite (f, n, 3).
    """
    points = np.asarray(vertices_over_time, dtype=np.float64)
    if points.ndim != 3 or points.shape[2] != 3 or points.size == 0 or not np.isfinite(points).all():
        raise InputError(
            "a camera cannot be framed on these vertices",
            received=points.shape,
            expected="finite vertices of shape (frames, vertices, 3)",
        )
    target = points.mean(axis=1)
    target[:, 1] = 0.5 * (points[..., 1].min() + points[..., 1].max())
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    backward = np.array(
        [math.sin(azimuth) * math.cos(elevation), math.sin(elevation), math.cos(azimuth) * math.cos(elevation)]
    )
    right = np.array([math.cos(azimuth), 0.0, -math.sin(azimuth)])
    up = np.cross(backward, right)
    offset = points - target[:, None, :]
    slope = math.tan(math.radians(field_of_view_deg) / 2.0)
    # A point is inside when its height and its width are at most its depth times the slope of the border.
    across = np.maximum(np.abs(offset @ up), np.abs(offset @ right) / aspect)
    distance = float((across * margin / slope + offset @ backward).max())
    return [Camera(middle + distance * backward, middle, field_of_view_deg) for middle in target]


def render(
    meshes: Sequence[Drawn], camera: Camera, size: tuple[int, int] = (900, 900), *, floor: float | None = 0.0
) -> np.ndarray:
    """Draw meshes in a neutral studio: grey background, three lights, a soft shadow on the floor.

    The window, and the meshes whose faces stay the same, are kept from one picture to the next. Several threads must
    not call this at the same time.

    Args:
        meshes: the meshes of the picture.
        camera: the camera that sees them.
        size: width and height of the picture [pixel].
        floor: height of the floor on which shadows fall [m]; None draws no shadow.

    Returns:
        red, green, blue, uint8, shape (height, width, 3).

    Raises:
        InputError: a vertex is not finite.
    """
    for index, mesh in enumerate(meshes):
        if not np.isfinite(mesh.vertices).all():
            raise InputError("a vertex of a picture is not finite", key=f"meshes[{index}].vertices")
    return _studio().draw(meshes, camera, size, floor)


def strip(
    columns: Sequence[Sequence[np.ndarray]], column_titles: Sequence[str], row_titles: Sequence[str]
) -> np.ndarray:
    """Set pictures side by side, a column for each kind and a row for each moment, with titles.

    Args:
        columns: ``columns[c][r]`` is an image uint8 (h, w, 3); all have one size.
        column_titles: one line above each column.
        row_titles: one line at the left of each row, turned upright; empty ones take no room.

    Returns:
        uint8, shape (height, width, 3).

    Raises:
        InputError: titles and pictures do not match in number, or pictures do not match in size.
    """
    from PIL import Image, ImageDraw, ImageFont

    shapes = {np.shape(image) for column in columns for image in column}
    counts = (len(columns), *(len(column) for column in columns))
    if counts != (len(column_titles), *([len(row_titles)] * len(columns))) or len(shapes) != 1:
        raise InputError(
            "pictures and titles do not form a grid",
            received=f"{counts[0]} columns of {counts[1:]} pictures in sizes {sorted(shapes)}",
            expected=f"{len(column_titles)} columns of {len(row_titles)} pictures of one size",
        )
    height, width, _ = shapes.pop()
    text_size = max(14, height // 24)
    font = ImageFont.load_default(text_size)
    line = int(1.7 * text_size)
    gap = max(2, height // 150)
    left = line if any(row_titles) else 0
    sheet = Image.new(
        "RGB", (left + len(columns) * (width + gap) - gap, line + len(row_titles) * (height + gap) - gap), _PAPER
    )
    draw = ImageDraw.Draw(sheet)
    for c, (column, title) in enumerate(zip(columns, column_titles, strict=True)):
        x = left + c * (width + gap)
        draw.text((x + width / 2, line / 2), title, fill=_INK, font=_fitting(font, title, width), anchor="mm")
        for r, image in enumerate(column):
            sheet.paste(Image.fromarray(np.ascontiguousarray(image)), (x, line + r * (height + gap)))
    for r, title in enumerate(row_titles if left else ()):
        label = Image.new("RGB", (height, line), _PAPER)
        ImageDraw.Draw(label).text(
            (height / 2, line / 2), title, fill=_INK, font=_fitting(font, title, height), anchor="mm"
        )
        sheet.paste(label.transpose(Image.Transpose.ROTATE_90), (0, line + r * (height + gap)))
    return np.asarray(sheet)


def encode_image(image: np.ndarray, kind: str = "png") -> bytes:
    """A picture as the bytes of a PNG or JPEG file.

    Args:
        image: uint8, shape (h, w, 3).
        kind: ``"png"`` (exact) or ``"jpeg"`` (a tenth of the size).

    Raises:
        InputError: the array is no such picture.
    """
    from PIL import Image

    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise InputError("not a picture", received=f"{image.dtype} {image.shape}", expected="uint8 of shape (h, w, 3)")
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, kind.upper(), optimize=kind == "jpeg", quality=90)
    return buffer.getvalue()


def save_png(path: str | os.PathLike[str], image: np.ndarray) -> None:
    """Write a picture uint8 (h, w, 3) as PNG; the file is never half-written.

    Raises:
        InputError: the array is no picture.
    """
    with replacing(Path(path)) as beside:
        beside.write_bytes(encode_image(image))


def _fitting(font: Any, text: str, room: float) -> Any:
    """The font, made smaller until the text fits into the room [pixel]."""
    length = font.getlength(text)
    return font if length <= 0.96 * room else font.font_variant(size=max(8.0, font.size * 0.96 * room / length))


def _floor_shadow(points: np.ndarray, height: float) -> np.ndarray:
    """Darkness of the floor under points, uint8, shape (cells, cells), rows along +Z, columns along +X.

    Light comes from the whole sky, so higher points shade a wider area more weakly: the points are sorted into layers
    by height, and every layer is blurred by its own height.
    """
    from scipy.ndimage import gaussian_filter

    cell = 2.0 * _SHADOW_REACH / _SHADOW_CELLS
    above = points[:, 1] - height
    light = np.ones((_SHADOW_CELLS, _SHADOW_CELLS))
    for low, high, strength in ((-0.1, 0.06, 0.45), (0.06, 0.25, 0.30), (0.25, 0.7, 0.25), (0.7, 2.5, 0.25)):
        layer = points[(above >= low) & (above < high)]
        if len(layer) == 0:
            continue
        index = np.floor((layer[:, (2, 0)] + _SHADOW_REACH) / cell).astype(np.int64)
        index = index[((index >= 0) & (index < _SHADOW_CELLS)).all(axis=1)]
        covered = np.zeros_like(light)
        covered[index[:, 0], index[:, 1]] = 1.0
        light *= 1.0 - strength * gaussian_filter(covered, (0.012 + 0.22 * max(low, 0.0) + 0.1 * (high - low)) / cell)
    return np.round(255.0 * (1.0 - light)).astype(np.uint8)


@lru_cache(maxsize=1)
def _studio() -> _Studio:
    return _Studio()


@contextmanager
def _quiet_vtk() -> Iterator[None]:
    """VTK tries an X server first and complains on standard error before it takes EGL or Mesa."""
    from vtkmodules.vtkCommonCore import vtkLogger

    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(before)


class _Studio:
    """One off-screen window with its lights, floor and the meshes of the last picture."""

    def __init__(self) -> None:
        import pyvista

        with _quiet_vtk():
            self._plotter: Any = pyvista.Plotter(off_screen=True, lighting="none")
            below, above = _BACKGROUND
            self._plotter.set_background(below, top=above)
            self._plotter.enable_anti_aliasing("msaa", multi_samples=8)
            self._lights = [
                pyvista.Light(light_type="scene light", intensity=intensity, color=color)
                for _, _, intensity, color in _LIGHTS
            ]
            for light in self._lights:
                self._plotter.add_light(light)
            self._add_floor()
            self._meshes: list[tuple[np.ndarray, Any, Any]] = []  # faces, data, actor
            self._plotter.render()

    def draw(self, meshes: Sequence[Drawn], camera: Camera, size: tuple[int, int], floor: float | None) -> np.ndarray:
        if tuple(self._plotter.window_size) != tuple(size):
            self._plotter.window_size = size  # not a new window: VTK does not free the old one
        # Seen from the target: float32 keeps its precision however far from the world's origin the scene is.
        origin = np.asarray(camera.target, dtype=np.float64)
        points = [np.asarray(mesh.vertices, dtype=np.float64) - origin for mesh in meshes]
        for slot, (mesh, local) in enumerate(zip(meshes, points, strict=True)):
            self._put(slot, mesh, local)
        for slot, (_, _, actor) in enumerate(self._meshes):
            actor.SetVisibility(slot < len(meshes))
        self._shade_floor(points, None if floor is None else floor - origin[1])
        eye = np.asarray(camera.position, dtype=np.float64) - origin
        self._aim_lights(eye)
        view = self._plotter.camera
        view.position, view.focal_point, view.up = tuple(eye), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        view.view_angle = camera.field_of_view_deg
        self._plotter.renderer.ResetCameraClippingRange()
        self._plotter.render()
        return np.array(self._plotter.screenshot(return_img=True)[..., :3])

    def _put(self, slot: int, mesh: Drawn, local: np.ndarray) -> None:
        """Show a mesh in a slot; the slot's actor is kept while the faces stay the same."""
        import pyvista

        faces = np.asarray(mesh.faces)
        normals = vertex_normals(local, faces) if mesh.normals is None else np.asarray(mesh.normals)
        if slot == len(self._meshes) or not np.array_equal(self._meshes[slot][0], faces):
            data = pyvista.PolyData.from_regular_faces(local.astype(np.float32), faces)
            data.point_data.active_normals = normals.astype(np.float32)
            actor = self._plotter.add_mesh(data, reset_camera=False, render=False)
            if slot < len(self._meshes):
                self._plotter.remove_actor(self._meshes[slot][2], render=False)
                self._meshes[slot] = (faces.copy(), data, actor)
            else:
                self._meshes.append((faces.copy(), data, actor))
        _, data, actor = self._meshes[slot]
        data.points = local.astype(np.float32)
        data.point_data.active_normals = normals.astype(np.float32)
        look = actor.prop
        look.color = mesh.color
        look.ambient, look.diffuse, look.specular, look.specular_power = _AMBIENT, 1.0, 0.04, 12.0
        look.interpolation = "Gouraud" if mesh.smooth else "Flat"
        look.show_edges = mesh.edges
        look.edge_color, look.line_width, look.edge_opacity = (0.1, 0.1, 0.12), 1.0, 0.6

    def _aim_lights(self, eye: np.ndarray) -> None:
        """Lights keep their places relative to the camera, so that every view is lit alike."""
        around = math.atan2(eye[0], eye[2])
        for light, (azimuth_deg, elevation_deg, _, _) in zip(self._lights, _LIGHTS, strict=True):
            azimuth, elevation = around + math.radians(azimuth_deg), math.radians(elevation_deg)
            light.position = (
                5.0 * math.sin(azimuth) * math.cos(elevation),
                5.0 * math.sin(elevation),
                5.0 * math.cos(azimuth) * math.cos(elevation),
            )
            light.focal_point = (0.0, 0.0, 0.0)

    def _add_floor(self) -> None:
        """A square that only carries the shadow: black, as opaque as the shadow is dark."""
        import pyvista

        reach = _SHADOW_REACH
        square = pyvista.PolyData.from_regular_faces(
            np.array([[-reach, 0, -reach], [-reach, 0, reach], [reach, 0, reach], [reach, 0, -reach]], np.float32),
            np.array([[0, 1, 2, 3]]),
        )
        square.active_texture_coordinates = np.array([[0, 0], [0, 1], [1, 1], [1, 0]], np.float32)
        self._shadow: Any = pyvista.ImageData(dimensions=(_SHADOW_CELLS, _SHADOW_CELLS, 1))
        self._shadow["rgba"] = np.zeros((_SHADOW_CELLS**2, 4), np.uint8)
        texture = pyvista.Texture(self._shadow)
        texture.interpolate = True
        self._floor = self._plotter.add_mesh(square, texture=texture, lighting=False, reset_camera=False)

    def _shade_floor(self, points: list[np.ndarray], height: float | None) -> None:
        self._floor.SetVisibility(height is not None and len(points) > 0)
        if height is None or not points:
            return
        self._floor.position = (0.0, height, 0.0)
        self._shadow["rgba"][:, 3] = _floor_shadow(np.concatenate(points), height).ravel()
        self._shadow.Modified()
