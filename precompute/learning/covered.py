"""Faces of the body that always lie under the garment: nobody sees them, and so they need not be drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from pbd.distance import BodyDistance
from pbd.mesh import edges_of
from precompute.learning.body_seen import shows_through
from precompute.learning.nearest_faces import nearest_faces
from precompute.learning.recording import Recording, Run, body_source
from precompute.learning.training import spread_frames
from runtime.light import directions_everywhere
from runtime.pictures import frame_camera
from wrinkles.clearance import facing

__all__ = ["covered_faces"]

# Measured on the sewn T-shirt, learned from 15 s of two motions: of 196 pixels of skin that show through the smooth
# garment on a walk, 40 are left. In its fine run 3.7 pixels of a picture show a covered face from 35 deg below and from
# 35 deg above, none at level.
FRAMES = 60  # that are looked at, at most, spread over all runs
NEAR = 0.025  # a face that the garment is ever further away from is seen: a leg under a loose skirt [m]
OUTSIDE = 0.005  # by which the body may stand out of the garment, as fine cloth lets it in places [m]
# From the rim at neck, sleeves and hem. As it is more than NEAR, the point of the garment that is closest to a covered
# face never lies on the rim. With half of it twice as many pixels show a covered face, if nobody looks.
RIM = 0.03  # [m]
VIEWS = 8  # directions from which each frame is looked at; twice as many leave 60 pixels of skin, and 1.3 and 0.7
# The lowest height of a direction of length 1: who looks up under the hem from more than 45 deg below sees the inside
# of the cloth where a face is left out. With such views, too, the faces at the bust stay, and 179 of the 196 pixels.
LOWEST = -0.7
VIEW = (280, 320)  # [pixel]


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
    garments = [garment if outwards > 0.0 else garment[:, ::-1] for garment in garments]
    covers = [_Cover(garment, source.faces) for garment in garments]
    posed = np.zeros((len(source.vertices), 3), np.float32)
    looked_at = spread_frames(recordings, FRAMES)
    count, number = sum(len(recording.frames) for recording in looked_at), 0
    directions = directions_everywhere(VIEWS * count)
    directions = directions[directions[:, 1] > LOWEST]
    for run, recording in zip(runs, looked_at, strict=True):
        for frame, vertices in zip(recording.frames, recording.positions, strict=True):
            origin = np.round(vertices.mean(axis=0).astype(float))
            source.skin(run.poses[frame], origin, posed)
            for cover in covers:
                cover.look(vertices.astype(float) - origin, posed.astype(float), directions[number::count])
            number += 1
    number = np.repeat(np.arange(len(covers), dtype=np.int32), [len(cover.left) for cover in covers])
    return np.concatenate([cover.left for cover in covers]), number


class _Cover:
    """What of a body one garment has covered in all frames up to now.

    Args:
        garment_faces: counter-clockwise seen from outside, int, shape (m, 3); vertices of others may be between theirs.
        body_faces: int, shape (k, 3).

    Attributes:
        left: faces of the body, int32, shape (c,).
    """

    def __init__(self, garment_faces: np.ndarray, body_faces: np.ndarray) -> None:
        self._distance, self._faces, self._body_faces = BodyDistance(garment_faces), garment_faces, body_faces
        edges, side_edge = edges_of(garment_faces)
        self._rim = np.unique(edges[np.bincount(side_edge.ravel()) == 1])
        self.left = np.arange(len(body_faces), dtype=np.int32)

    def look(self, garment: np.ndarray, body: np.ndarray, directions: np.ndarray) -> None:
        """Look at a frame: a face is covered if its corners and its centre are, and if it is not seen.

        Args:
            garment: vertices [m], shape (n, 3).
            body: vertices [m], shape (b, 3).
            directions: from which it is looked at, unit, shape (k, 3).
        """
        corners = self._body_faces[self.left]
        used, at = np.unique(corners, return_inverse=True)
        self.left = self.left[self._under(body[used], garment)[at.reshape(-1, 3)].all(axis=1)]
        centres = body[self._body_faces[self.left]].mean(axis=1)
        self.left = self.left[self._under(centres, garment)]
        for direction in directions if len(self.left) else ():
            self.left = np.setdiff1d(self.left, self._seen(garment, body, direction))

    def _seen(self, garment: np.ndarray, body: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Faces of the body that are seen from a direction, but for those that show through the cloth, shape (c,)."""
        azimuth, elevation = np.arctan2(direction[0], direction[2]), np.arcsin(direction[1])
        worn = garment[np.unique(self._faces)]
        (camera,) = frame_camera(
            worn[None], azimuth_deg=np.degrees(azimuth), elevation_deg=np.degrees(elevation), aspect=VIEW[0] / VIEW[1]
        )
        cloth = nearest_faces(garment, self._faces, camera, VIEW)
        depth, owner = nearest_faces(body, self._body_faces, camera, VIEW)
        return owner[(owner > 0) & (depth < cloth[0]) & ~shows_through(depth, *cloth)] - 1

    def _under(self, points: np.ndarray, garment: np.ndarray) -> np.ndarray:
        """Whether points of the body lie under the garment and away from its rim, shape (n,)."""
        under = cKDTree(garment[self._rim]).query(points)[0] >= RIM
        distance = self._distance.signed_distance(points[under], garment)
        under[under] = (-NEAR <= distance) & (distance <= OUTSIDE)
        return under
