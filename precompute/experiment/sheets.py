"""Flat cloth of experiments: triangulations of the plane, how they stand in space, and models without tethers."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import Delaunay

from pbd import ClothMesh, Fabric, Model, ModelOptions, build_model
from pbd.bending import hinge_calibration
from pbd.mesh import lattice_faces

__all__ = [
    "band", "hinge_factor", "lattice", "level", "square", "tilted", "triangulated", "tube", "untethered",
]  # fmt: skip


def lattice(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers of the vertices of a lattice, shape (rows, columns), and row and column of each vertex."""
    index = np.arange(rows * columns).reshape(rows, columns)
    row, column = np.divmod(index.ravel(), columns)
    return index, row, column


def triangulated(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Delaunay's triangles of places in the plane, counter-clockwise, and twice the area of each [m2]."""
    faces = Delaunay(flat).simplices
    one, two = flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]]
    twice_area = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    faces[twice_area < 0] = faces[twice_area < 0][:, ::-1]
    return faces, np.abs(twice_area)


def level(flat: np.ndarray) -> np.ndarray:
    """Places on the level plane: along x, across z."""
    return np.stack([flat[:, 0], np.zeros(len(flat)), -flat[:, 1]], axis=1)


def tilted(across: np.ndarray, up: np.ndarray, angle_deg: float) -> np.ndarray:
    """Places of cloth that is tilted about the x axis from the vertical, its lower part to the front."""
    angle = math.radians(angle_deg)
    return np.stack([across, up * math.cos(angle), -up * math.sin(angle)], axis=1)


def square(edges: int, size: float = 0.5, *, upright: bool = True) -> ClothMesh:
    """Square with alternating diagonals, its upper side at the origin's height, or level, in the middle."""
    step = size / edges
    index, along, up = lattice(edges + 1, edges + 1)
    flat = [step * along - size / 2, step * (up - edges), 0.0 * up]
    if not upright:
        flat = [flat[0], 0.0 * up, -size / 2 - flat[1]]
    return ClothMesh.from_surface(np.stack(flat, axis=1), lattice_faces(index), warp=(1.0, 0.0, 0.0))


def band(length: float, width: float, edges: int) -> tuple[ClothMesh, np.ndarray]:
    """Strip down from the origin, and the row of each vertex."""
    across = max(2, round(edges * width / length))
    index, rows, columns = lattice(edges + 1, across + 1)
    faces = lattice_faces(index, alternating=False)
    vertices = np.stack([width * (columns / across - 0.5), -length * rows / edges, 0.0 * rows], axis=1)
    return ClothMesh.from_surface(vertices, faces, warp=(0.0, 1.0, 0.0)), rows


def tube(radius: float, height: float, around: int, edges: int) -> tuple[ClothMesh, list[int]]:
    """Sleeve about the y axis, down from the origin, and its upper ring."""
    index, turn, row = lattice(around, edges + 1)
    following = np.roll(index, -1, axis=0)
    a, b, c, d = (part.ravel() for part in (index[:, :-1], index[:, 1:], following[:, 1:], following[:, :-1]))
    faces = np.stack([a, c, b, a, d, c], axis=1).reshape(-1, 3)
    angle = 2.0 * np.pi * turn / around
    vertices = np.stack([radius * np.cos(angle), -height * row / edges, radius * np.sin(angle)], axis=1)
    return ClothMesh.from_surface(vertices, faces), np.flatnonzero(row == 0).tolist()


def hinge_factor(flat: np.ndarray, faces: np.ndarray, places: np.ndarray | None = None) -> float:
    """Hinge factor of a kind of mesh, measured on a large sheet of it.

    Args:
        flat: places in the plane [m], shape (n, 2).
        faces: shape (m, 3).
        places: of the same in space; None takes the plane z = 0.
    """
    vertices = np.insert(flat, 2, 0.0, axis=1) if places is None else places
    return hinge_calibration(ClothMesh.from_pattern(vertices, faces, flat[faces]))


def untethered(
    mesh: ClothMesh, fabric: Fabric, held: np.ndarray | None = None, *, bend_factor: float | None = 1 / 3
) -> Model:
    """A model without tethers, which are no part of the fabric's physics."""
    return build_model(mesh, fabric, held, options=ModelOptions(tether_slack=0.0), bend_factor=bend_factor)
