"""Faces of the body that always lie under the garment: nobody sees them, and so they need not be drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from pbd.distance import BodyDistance
from pbd.mesh import edges_of
from precompute.learning.recording import Recording, Run, body_source
from precompute.learning.training import spread_frames
from wrinkles.clearance import facing

__all__ = ["covered_faces"]

FRAMES = 60  # that are looked at, at most, spread over all runs
NEAR = 0.025  # a face that the garment is ever further away from is seen: a leg under a loose skirt [m]
OUTSIDE = 0.005  # by which the body may stand out of the garment, as fine cloth lets it in places [m]
# From the rim at neck, sleeves and hem. As it is more than NEAR, the point of the garment that is closest to a covered
# face never lies on the rim.
RIM = 0.03  # [m]


def covered_faces(runs: Sequence[Run], recordings: Sequence[Recording]) -> tuple[np.ndarray, np.ndarray]:
    """Faces of the body that lie under each garment in all frames that are looked at.

    Args:
        runs: fine runs of the same garments on the same body.
        recordings: of them.

    Returns:
        faces of the body, and the number of the garment that covers each of them, int32, shape (c,) each.
    """
    levels, source = runs[0].levels, body_source(runs[0].body)
    faces, layer = levels.subdivision.faces, levels.fine_layer
    garments = [faces] if layer is None else [faces[layer[faces[:, 0]] == k] for k in range(int(layer.max()) + 1)]
    outwards = facing(levels.coarse, source.vertices, source.faces)
    covers = [_Cover(garment, source.faces, outwards) for garment in garments]
    posed = np.zeros((len(source.vertices), 3), np.float32)
    for run, recording in zip(runs, spread_frames(recordings, FRAMES), strict=True):
        for frame, vertices in zip(recording.frames, recording.positions, strict=True):
            origin = np.round(vertices.mean(axis=0).astype(float))
            source.skin(run.poses[frame], origin, posed)
            for cover in covers:
                cover.look(vertices.astype(float) - origin, posed.astype(float))
    number = np.repeat(np.arange(len(covers), dtype=np.int32), [len(cover.left) for cover in covers])
    return np.concatenate([cover.left for cover in covers]), number


class _Cover:
    """What of a body one garment has covered in all frames up to now.

    Args:
        garment_faces: int, shape (m, 3); the numbering of vertices may have others between.
        body_faces: int, shape (k, 3).
        outwards: 1 if the garment's faces look away from the body, -1 if they look at it.

    Attributes:
        left: faces of the body, int32, shape (c,).
    """

    def __init__(self, garment_faces: np.ndarray, body_faces: np.ndarray, outwards: float) -> None:
        self._distance, self._body_faces, self._outwards = BodyDistance(garment_faces), body_faces, outwards
        edges, side_edge = edges_of(garment_faces)
        self._rim = np.unique(edges[np.bincount(side_edge.ravel()) == 1])
        self.left = np.arange(len(body_faces), dtype=np.int32)

    def look(self, garment: np.ndarray, body: np.ndarray) -> None:
        """Look at a frame: a face is covered if its corners and its centre are.

        Args:
            garment: vertices [m], shape (n, 3).
            body: vertices [m], shape (b, 3).
        """
        corners = self._body_faces[self.left]
        used, at = np.unique(corners, return_inverse=True)
        self.left = self.left[self._under(body[used], garment)[at.reshape(-1, 3)].all(axis=1)]
        centres = body[self._body_faces[self.left]].mean(axis=1)
        self.left = self.left[self._under(centres, garment)]

    def _under(self, points: np.ndarray, garment: np.ndarray) -> np.ndarray:
        """Whether points of the body lie under the garment and away from its rim, shape (n,)."""
        under = cKDTree(garment[self._rim]).query(points)[0] >= RIM
        distance = self._outwards * self._distance.signed_distance(points[under], garment)
        under[under] = (-NEAR <= distance) & (distance <= OUTSIDE)
        return under
