"""Which face of a mesh is nearest to a camera in each pixel of its picture: a depth buffer, drawn without a window."""

import numpy as np

from pbd.engine import ensure_initialized, ti
from runtime.draw.picture_content import Camera

__all__ = ["nearest_faces"]

FAR = 1e9  # depth of a pixel in which there is nothing [m]

_vec3 = ti.types.vector(3, ti.f64)
_Vec3 = ti.types.ndarray(dtype=_vec3, ndim=1)
_Index2 = ti.types.ndarray(dtype=ti.i32, ndim=2)
_Double2 = ti.types.ndarray(dtype=ti.f64, ndim=2)


def nearest_faces(
    vertices: np.ndarray, faces: np.ndarray, camera: Camera, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Find the nearest face in the middle of each pixel.

    Args:
        vertices: [m], shape (n, 3).
        faces: counter-clockwise seen from outside, int, shape (m, 3). One that is not wholly before the camera is left
            out.
        camera: sees them.
        size: width and height of the picture [pixel].

    Returns:
        depth along the camera's axis [m], :data:`FAR` where there is none, shape (height, width); number of the face
        plus one, negative where it is seen from inside, 0 where there is none, int32, shape (height, width).
    """
    back = np.asarray(camera.position, float) - camera.target
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    seen = (np.asarray(vertices, float) - camera.position) @ np.stack([right, np.cross(back, right), -back], axis=1)
    nearness = 1.0 / np.where(np.abs(seen[:, 2]) > 1e-6, seen[:, 2], -1e-6)
    width, height = size
    scale = 0.5 * height / np.tan(np.radians(camera.field_of_view_deg) / 2.0) * nearness
    at = np.stack([0.5 * width + scale * seen[:, 0], 0.5 * height - scale * seen[:, 1], nearness], axis=1)
    nearest, owner = np.full((height, width), 1.0 / FAR), np.zeros((height, width), np.int32)
    ensure_initialized()
    _draw(at, np.ascontiguousarray(faces, np.int32), nearest, owner)
    return 1.0 / nearest, owner


@ti.kernel
def _draw(at: _Vec3, faces: _Index2, nearest: _Double2, owner: _Index2):
    """Draw all faces; ``at`` holds pixels to the right, pixels down and 1 / depth, which is linear in the picture."""
    ti.loop_config(serialize=True)
    for f in range(faces.shape[0]):
        a, b, c = at[faces[f, 0]], at[faces[f, 1]], at[faces[f, 2]]
        low, high = ti.min(a, b, c), ti.max(a, b, c)
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        height, width = nearest.shape[0], nearest.shape[1]
        if ti.abs(area) > 1e-9 and low[2] > 0.0 and high[0] > 0.0 and high[1] > 0.0 and low[0] < width:
            last_row, last_column = ti.min(height, ti.ceil(high[1], ti.i32)), ti.min(width, ti.ceil(high[0], ti.i32))
            for row in range(ti.i32(ti.max(0.0, low[1])), last_row):
                for column in range(ti.i32(ti.max(0.0, low[0])), last_column):
                    x, y = column + 0.5 - a[0], row + 0.5 - a[1]
                    v = (x * (c[1] - a[1]) - (c[0] - a[0]) * y) / area
                    w = ((b[0] - a[0]) * y - x * (b[1] - a[1])) / area
                    near = a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2])
                    if v >= 0.0 and w >= 0.0 and v + w <= 1.0 and near > nearest[row, column]:
                        nearest[row, column] = near
                        # Rows run downwards: a face that is counter-clockwise seen from outside has a negative area.
                        owner[row, column] = ti.select(area < 0.0, f + 1, -f - 1)
