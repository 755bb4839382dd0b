"""Whether the garments of an outfit lie over one another in the order in which a scene lists them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from pbd import InputError
from pbd.attachment import closest_points, smooth_normals
from pbd.layers import FASTENING_REACH
from wrinkles.levels import Layers

__all__ = ["check_fastened", "check_order", "in_order"]

NEAR = 0.1  # garments further apart than this do not lie over one another there [m]
ASIDE = 0.7  # share of the distance along the normal below which a vertex lies beside a garment, not over it [-]
# Garments made for one body start with at most 31 % of their vertices inside the one below, up to 39 mm deep, and
# contact brings these out. In the other order it is 54 % and more, 57 mm deep.
MOST_INSIDE = 0.5  # share of the vertices near a garment that may start inside it [-]
DEEPEST = 0.05  # depth at which a garment may start inside one below it [m]


class _Depths(NamedTuple):
    """How a garment lies over another one.

    Attributes:
        inside: share of the vertices near the other garment that are inside it [-].
        deepest: greatest depth of a vertex inside it [m], 0 if there is none.
        place: of that vertex [m], shape (3,).
    """

    inside: float
    deepest: float
    place: np.ndarray

    @property
    def possible(self) -> bool:
        """Whether contact brings out what is inside."""
        return self.inside <= MOST_INSIDE and self.deepest <= DEEPEST


def check_order(vertices: np.ndarray, faces: np.ndarray, layers: Layers) -> None:
    """Refuse an outfit of which a garment starts inside one that is listed before it.

    Args:
        vertices: of all garments in the bind pose [m], shape (n, 3).
        faces: int, shape (m, 3).
        layers: garments of the mesh.

    Raises:
        InputError: see above; it says where, how deep, and what mends it.
    """
    parts = [faces[layers.layer[faces[:, 0]] == number] for number in range(len(layers.names))]
    for inner, outer in combinations(range(len(parts)), 2):
        found = _depths(vertices, parts[outer], parts[inner])
        if found.possible:
            continue
        under, over = layers.names[inner], layers.names[outer]
        x, y, z = found.place
        received = (
            f"{100 * found.inside:.0f} % of {over!r} that is near {under!r} lies inside it, "
            f"{1e3 * found.deepest:.0f} mm deep at ({x:.2f}, {y:.2f}, {z:.2f})"
        )
        expected = f"{over!r} outside {under!r} by its shape: make it wider there"
        if _depths(vertices, parts[inner], parts[outer]).possible:
            expected = f"{over!r} listed before {under!r}, for it lies inside it; or made wider there"
        key = f"garment[{outer}].mesh"
        raise InputError("a garment starts inside one below it", key=key, received=received, expected=expected)


def in_order(garments: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[int]:
    """Numbers of garments from the innermost outwards, by how much of each lies inside the other where two are near.

    Args:
        garments: vertices in the bind pose [m], shapes (n, 3), and faces, int, shapes (m, 3); those that lie apart keep
            their order.
    """
    order = list(range(len(garments)))

    def inside(over: int, under: int) -> float:
        (x, f), (y, g) = garments[over], garments[under]
        return _depths(np.concatenate([x, y]), f, g + len(x)).inside

    for _ in order:
        for place in range(len(order) - 1):
            one, other = order[place : place + 2]
            if inside(other, one) > inside(one, other):
                order[place : place + 2] = other, one
    return order


def check_fastened(vertices: np.ndarray, faces: np.ndarray, layers: Layers) -> None:
    """Refuse an outfit with a garment that is to be fastened where nothing lies below it.

    Args:
        vertices, faces, layers: as for :func:`check_order`.

    Raises:
        InputError: see above.
    """
    for number in np.unique(layers.layer[layers.fastened]).tolist():
        fastened = layers.fastened[layers.layer[layers.fastened] == number]
        below = faces[layers.layer[faces[:, 0]] < number]
        face, weights = closest_points(vertices[fastened], vertices, below)
        distance = np.linalg.norm(np.einsum("pc,pci->pi", weights, vertices[below[face]]) - vertices[fastened], axis=1)
        if distance.max() >= FASTENING_REACH:
            x, y, z = vertices[fastened[np.argmax(distance)]]
            received = f"{1e3 * distance.max():.0f} mm from the nearest one at ({x:.2f}, {y:.2f}, {z:.2f})"
            expected = (
                f"vertices of {layers.names[number]!r} less than {1e3 * FASTENING_REACH:.0f} mm from a garment below"
            )
            raise InputError(
                "nothing below to fasten to", key=f"garment[{number}].fasten", received=received, expected=expected
            )


def _depths(vertices: np.ndarray, over: np.ndarray, under: np.ndarray) -> _Depths:
    """How the garment with faces ``over`` lies over the one with faces ``under``, int, shapes (k, 3), (m, 3)."""
    own_vertices = np.unique(over)
    face, weights = closest_points(vertices[own_vertices], vertices, under)
    corners = under[face]
    surface = np.einsum("pc,pci->pi", weights, vertices[corners])
    normals = np.einsum("pc,pci->pi", weights, smooth_normals(vertices, under)[corners])
    offset = vertices[own_vertices] - surface
    height = np.einsum("pi,pi->p", offset, normals) / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)
    distance = np.linalg.norm(offset, axis=1)
    near = (distance < NEAR) & (np.abs(height) > ASIDE * distance)
    inside = near & (height < 0.0)
    if not inside.any():
        return _Depths(0.0, 0.0, np.zeros(3))
    deepest = int(np.argmin(np.where(inside, height, np.inf)))
    return _Depths(inside.sum() / near.sum(), -float(height[deepest]), vertices[own_vertices[deepest]])
