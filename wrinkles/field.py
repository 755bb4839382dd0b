"""Makes a collider from a closed mesh: a distance field with the mesh's exact signed distance at points of a grid."""

from __future__ import annotations

import numpy as np

from pbd.contact.distance_field import DistanceField
from pbd.distance import BodyDistance
from pbd.errors import InputError
from pbd.geometry import FAR

__all__ = ["MAX_GRID_POINTS", "field_of_mesh"]

MAX_GRID_POINTS = 10_000_000  # 40 MB, and one or two minutes of computing


def field_of_mesh(vertices: np.ndarray, faces: np.ndarray, spacing: float, margin: float = FAR) -> DistanceField:
    """Make the distance field of a mesh, in the mesh's own coordinates.

    The field smooths details finer than the spacing s: its surface lies up to s^2/(4 r) too deep at bulges of radius
    r, and about s/2 at sharp edges.

    Args:
        vertices: [m], shape (n, 3).
        faces: int, counter-clockwise seen from outside, shape (m, 3).
        spacing: distance of grid points [m].
        margin: by which the grid extends beyond the mesh [m]. Contact begins at its border, so thicker cloth needs
            more.

    Raises:
        InputError: a mesh that is not finite, not closed, or inside out; a spacing or margin that is not above 0; or a
            grid of over 10 million points.
    """
    for key, value in (("spacing", spacing), ("margin", margin)):
        if not (np.isfinite(value) and value > 0):
            raise InputError("bad length", key=key, received=value, expected="a finite number above 0 [m]")
    distance, vertices = BodyDistance(faces), np.asarray(vertices, float)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all() or distance.faces.min() < 0:
        raise InputError("bad positions", key="vertices", received=vertices.shape, expected="finite, shape (n, 3)")
    if distance.faces.max() >= len(vertices):
        expected = f"0..{len(vertices) - 1}"
        raise InputError("no such vertex", key="faces", received=int(distance.faces.max()), expected=expected)
    _check_closed(vertices, distance.faces)
    used = vertices[np.unique(distance.faces)]
    low = used.min(axis=0) - margin
    cells = (used.max(axis=0) + margin - low) / spacing
    points = np.prod(np.ceil(cells) + 1.0)
    if points > MAX_GRID_POINTS:
        min_spacing = spacing * (points / MAX_GRID_POINTS) ** (1 / 3)
        expected = f"about {min_spacing:.2g} or more: at most {MAX_GRID_POINTS:,} grid points"
        raise InputError(f"a grid of {points:.3g} points", key="spacing", received=spacing, expected=expected)
    counts = np.ceil(cells).astype(int) + 1
    axes = [first + spacing * np.arange(count) for first, count in zip(low, counts, strict=True)]
    slab = np.stack(np.meshgrid(axes[0][:1], axes[1], axes[2], indexing="ij"), axis=-1).reshape(-1, 3)
    values = np.zeros(counts, np.float32)
    for k, x in enumerate(axes[0]):  # slab by slab: the nearest faces of one slab bound the search in the next
        slab[:, 0] = x
        values[k] = distance.signed_distance(slab, vertices).reshape(counts[1:])
    return DistanceField(values, low, spacing)


def _check_closed(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Refuse a surface that is not closed, or whose faces point inwards.

    Each directed side of a face must occur once, and once in the other direction.
    """
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    directed, occurrences = np.unique(sides, axis=0, return_counts=True)
    paired = np.isin(directed @ [len(vertices), 1], directed @ [1, len(vertices)]) & (occurrences == 1)
    if not paired.all():
        a, b = directed[np.argmin(paired)]
        received = f"{np.count_nonzero(~paired)} edges that are no seam of two faces, the first {a}-{b}"
        raise InputError("a mesh that is not closed", key="faces", received=received, expected="a watertight mesh")
    corners = vertices[faces] - vertices[faces[0, 0]]
    volume = float(np.einsum("mi,mi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0
    if volume <= 0:
        expected = "faces counter-clockwise seen from outside"
        raise InputError(
            "a mesh that is inside out", key="faces", received=f"a volume of {volume:.3g}", expected=expected
        )
