"""Bands of a garment that hold on a body: rims of cloth that does not give way, drawn tight around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from assets.garment import boundary_loops
from pbd.attachment import closest_points
from pbd.mesh import MAX_STRETCH

__all__ = ["REACH", "distances", "taut_bands"]

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

REACH = 0.03  # from the surface on which a band lies [m]


def taut_bands(
    vertices: Floats,
    faces: Faces,
    rest: Floats,
    max_stretch: Floats,
    body: tuple[Floats, Faces],
) -> list[tuple[int, NDArray[np.int32]]]:
    """Boundary loops that run along a band, are longer than it lets them be, and lie on the body all around.

    A waistband is drawn tight; a cuff or a neckline that has room moves on the body, and is not among them.

    Args:
        vertices, faces: of the garment [m], shapes (n, 3) and (m, 3).
        rest: place of each corner of each face in its flat pattern [m], shape (m, 3, 2).
        max_stretch: see :attr:`assets.garment.Garment.max_stretch`, shape (m,).
        body: its vertices [m] and faces.

    Returns:
        number of each such loop, and its vertices, as :func:`assets.garment.boundary_loops` has them.
    """
    if not (max_stretch < MAX_STRETCH).any():
        return []
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    number = {(a, b): k for k, (a, b) in enumerate(sides.tolist())}
    lengths = np.linalg.norm(np.roll(rest, -1, axis=1) - rest, axis=2).ravel()
    found = []
    for place, loop in enumerate(boundary_loops(faces)):
        following = np.roll(loop, -1)
        rows = np.array([number[pair] for pair in zip(loop.tolist(), following.tolist(), strict=True)])
        stretch = max_stretch[rows // 3]
        length = np.linalg.norm(vertices[following] - vertices[loop], axis=1).sum()
        taut = stretch.max() < MAX_STRETCH and length > stretch @ lengths[rows]
        if taut and distances(vertices[loop], *body).max() <= REACH:
            found.append((place, loop))
    return found


def distances(points: Floats, vertices: Floats, faces: Faces) -> Floats:
    """Distances from points to a surface [m], shape (p,)."""
    face, weights = closest_points(points, vertices, faces)
    return np.linalg.norm(np.einsum("pc,pci->pi", weights, vertices[faces[face]]) - points, axis=1)
