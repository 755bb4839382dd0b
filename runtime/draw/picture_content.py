"""What a picture shows: meshes, and the camera that sees them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pbd.errors import InputError

__all__ = ["BODY_COLOR", "GARMENT_COLOR", "GARMENT_COLORS", "Camera", "Drawn", "frame_camera"]

BODY_COLOR = (0.62, 0.59, 0.56)
GARMENT_COLOR = (0.37, 0.45, 0.55)
# Of the garments of an outfit, from the innermost outwards; a fifth one begins anew.
GARMENT_COLORS = (GARMENT_COLOR, (0.58, 0.36, 0.30), (0.40, 0.50, 0.36), (0.63, 0.52, 0.30))


@dataclass(frozen=True)
class Drawn:
    """One mesh of a picture.

    Attributes:
        vertices: [m], shape (n, 3), world coordinates.
        faces: vertex indices, shape (m, 3), counter-clockwise seen from outside.
        color: red, green, blue in 0..1.
        pattern: place of each corner of each face in the flat pattern [m], shape (m, 3, 2). A weave is drawn by it.
        cloth: it has a sheen; False for what is matt, as the body.
    """

    vertices: np.ndarray
    faces: np.ndarray
    color: tuple[float, float, float] = GARMENT_COLOR
    pattern: np.ndarray | None = None
    cloth: bool = True

    @classmethod
    def body(cls, vertices: np.ndarray, faces: np.ndarray) -> Drawn:
        """A body: one neutral tone, matt."""
        return cls(vertices, faces, BODY_COLOR, cloth=False)

    @classmethod
    def garments(
        cls, vertices: np.ndarray, faces: np.ndarray, pattern: np.ndarray | None, layer: np.ndarray | None
    ) -> list[Drawn]:
        """A garment, or each garment of an outfit in a colour of its own.

        Args:
            vertices, faces, pattern: of all garments, as above.
            layer: number of the garment of each vertex, int, shape (n,); None for one garment.
        """
        if layer is None:
            return [cls(vertices, faces, pattern=pattern)]
        drawn = []
        for number in range(int(layer.max()) + 1):
            own_faces, own = layer[faces[:, 0]] == number, np.flatnonzero(layer == number)
            own_number = np.zeros(len(layer), np.int64)
            own_number[own] = np.arange(len(own))
            flat = None if pattern is None else pattern[own_faces]
            color = GARMENT_COLORS[number % len(GARMENT_COLORS)]
            drawn.append(cls(vertices[own], own_number[faces[own_faces]], color, flat))
        return drawn


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
