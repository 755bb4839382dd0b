"""What bodies have in common: their height, in one of some units, and faces that point out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from assets.weld import weld
from pbd.errors import InputError

__all__ = ["HEIGHTS", "UNITS", "check_right_side_out"]

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

HEIGHTS = (0.7, 2.6)  # of bodies [m]
UNITS = {"metres": 1.0, "centimetres": 0.01, "inches": 0.0254, "decimetres": 0.1, "millimetres": 0.001}
_MAX_HOLES = 0.1  # share of a body's volume below its holes; of a more open one, a bowl, either side may be meant
_MIN_VOLUME = 1e-6  # over area^1.5: less is rounding of a body without thickness


def check_right_side_out(vertices: Floats, faces: Faces, file: Path) -> None:
    """Refuse a closed body whose faces point inwards: contact would draw cloth into it.

    Holes, such as those between the parts of a jointed figure, are closed by fans about their middles. A surface passes
    if the fans make more than a tenth of its volume: it is open.

    Args:
        vertices: [m], shape (n, 3).
        faces: shape (m, 3).
        file: for the message.

    Raises:
        InputError: the volume that it encloses is negative.
    """
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    middle = areas @ (a + b + c) / (3.0 * max(areas.sum(), 1e-300))
    vertices, faces, _ = weld(vertices - middle, faces)
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2).astype(np.int64)
    count = len(vertices)
    rims = sides[~np.isin(sides @ [count, 1], sides @ [1, count])]
    _, hole = connected_components(csr_matrix((np.ones(len(rims)), tuple(rims.T)), (count, count)), directed=False)
    middles = np.stack([np.bincount(hole[rims[:, 0]], vertices[rims[:, 0], axis], count) for axis in range(3)], axis=1)
    middles = middles / np.maximum(np.bincount(hole[rims[:, 0]], minlength=count), 1)[:, None]
    fans = np.stack([vertices[rims[:, 1]], vertices[rims[:, 0]], middles[hole[rims[:, 0]]]], axis=1)
    volume, closing = _volume(vertices[faces]), _volume(fans)
    if abs(closing) <= _MAX_HOLES * abs(volume) and volume < -_MIN_VOLUME * areas.sum() ** 1.5:
        raise InputError("a body that is inside out", file=file, key="faces", expected="normals that point out")


def _volume(corners: Floats) -> float:
    """Volume between triangles, shape (m, 3, 3), and the origin [m3], positive where they face away from it."""
    return float(np.einsum("mi,mi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0
