"""A sheet of two panels with a seam between them whose sides have different vertices."""

from __future__ import annotations

import numpy as np

from assets.seams import Seams
from tests.pbd.meshes import grid

__all__ = ["two_panels"]


def two_panels(
    along: int = 6, first: int = 6, second: int = 4, width: float = 0.24
) -> tuple[np.ndarray, np.ndarray, Seams]:
    """Two panels beside each other in the x-y plane, sewn along their common side.

    Args:
        along: edges of each panel at right angles to the seam.
        first, second: edges along the seam of both panels.
        width: of the sheet along the seam; both panels together are twice as long [m].

    Returns:
        vertices [m], faces, and the seams: every vertex of the second panel's side on an edge of the first's.
    """
    parts, faces, count = [], [], 0
    for number, across in enumerate((first, second)):
        vertices, own = grid(along, across, 1.0)
        parts.append(vertices * [width / along, width / across, 0.0] + [number * width, 0.0, 0.0])
        faces.append(own + count)
        count += len(vertices)
    start = len(parts[0])
    place = first * np.arange(second + 1) / second
    edge = np.minimum(place.astype(int), first - 1)
    low = along * (first + 1) + edge
    rows = np.stack([start + np.arange(second + 1), low, low + 1], axis=1)
    return np.concatenate(parts), np.concatenate(faces), Seams(rows.astype(np.int32), place - edge)
