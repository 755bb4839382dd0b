"""How much of the body shows through the garment, in pixels of a picture."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from precompute.learning.nearest_faces import nearest_faces
from runtime.draw.picture_content import frame_camera
from runtime.draw.strips import PICTURE

__all__ = ["body_seen_figures", "shows_through"]

BEHIND = 0.015  # a garment that is further behind the body is not meant to cover it there: an arm before it [m]


def body_seen_figures(
    frames: Iterable[tuple[np.ndarray, np.ndarray, np.ndarray]],
    faces: np.ndarray,
    body_faces: np.ndarray,
    dressed: np.ndarray,
) -> dict[str, float]:
    """Count pixels where the body lies before the front of the garment, which should cover it there.

    Args:
        frames: of each the vertices of the garment, of the body as it is drawn and of the body as it is [m],
            shapes (N, 3), (b, 3), (b, 3).
        faces: of the garment, counter-clockwise seen from outside, int, shape (m, 3).
        body_faces: likewise of the body, int, shape (k, 3).
        dressed: whether each vertex of the body lies under the garment, shape (b,): an arm may pass before it.

    Returns:
        ``body_seen_px``: such pixels of a picture, mean over the frames; ``body_seen_frames_percent``: frames that have
        any [%]; ``body_seen_whole_px``: pixels if the body were drawn as it is.
    """
    rows, under = [], dressed[body_faces].all(axis=1)
    for garment, *bodies in frames:
        (camera,) = frame_camera(garment[None], aspect=PICTURE[0] / PICTURE[1], margin=1.15)
        cloth, row = nearest_faces(garment, faces, camera, PICTURE), []
        for body in bodies:
            depth, owner = nearest_faces(body, body_faces, camera, PICTURE)
            of_dressed = (owner > 0) & under[np.maximum(owner, 1) - 1]
            row.append(np.count_nonzero(shows_through(depth, *cloth) & of_dressed))
        rows.append(row)
    seen, whole = np.mean(rows, axis=0)
    some_seen = 100.0 * float(np.mean(np.array(rows)[:, 0] > 0))
    return {"body_seen_px": float(seen), "body_seen_frames_percent": some_seen, "body_seen_whole_px": float(whole)}


def shows_through(body_depth: np.ndarray, cloth_depth: np.ndarray, cloth_owner: np.ndarray) -> np.ndarray:
    """Pixels where the body lies a little before the outer side of the garment; arguments of one shape.

    Args:
        body_depth: of :func:`precompute.learning.nearest_faces.nearest_faces` [m].
        cloth_depth, cloth_owner: the same of the garment.
    """
    gap = cloth_depth - body_depth
    return (cloth_owner > 0) & (0.0 < gap) & (gap < BEHIND)
