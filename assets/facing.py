"""Where a body stands and which way it looks: its own frame, found by its shape alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

__all__ = ["StandingFrame", "standing_frame"]

Floats = NDArray[np.float64]

_SAMPLES = 4000  # points of the surface whose mirror images are held against it
_ROUNDS = 100  # of finding the plane of symmetry
_KEPT_SHARE = 0.7  # of the pairs that lie nearest: a raised arm has no partner [-]
_TURNED = 1e-7  # a plane that turns less than that in a round is found [-]
_FOOT, _ANKLE = 0.02, (0.07, 0.11)  # height of soles and ankles over the stature [-]
_OVER_FOOT = 0.02  # of the stature, beside a foot: a nearer point is the ankle over it, not a leg that is lifted [-]
_LEAST_FOOT = 0.01  # of the stature, by which a foot's middle lies ahead of the ankle [-]


@dataclass(frozen=True, eq=False)
class StandingFrame:
    """The frame of a body: X to its left, Y up, Z ahead; x = 0 is the plane between left and right.

    Attributes:
        rotation: from that frame to the world, about the vertical, shape (3, 3).
        origin: of the frame in the world [m], shape (3,); its height is 0.
    """

    rotation: Floats
    origin: Floats

    def local(self, points: Floats) -> Floats:
        """Points of the world in the body's frame [m], shape (n, 3)."""
        return (points - self.origin) @ self.rotation

    def world(self, points: Floats) -> Floats:
        """Points of the body's frame in the world [m], shape (n, 3)."""
        return points @ self.rotation.T + self.origin


def standing_frame(vertices: Floats, faces: NDArray[np.int32]) -> StandingFrame:
    """The frame of an upright body, wherever it stands and however it is turned about the vertical.

    The body is broader than deep, which gives the first guess of its plane of symmetry; the mirror image of its surface
    mends it. The feet point ahead. Without feet, the direction nearer to +Z is ahead.

    Args:
        vertices: [m], Y up, shape (n, 3).
        faces: shape (m, 3).
    """
    corners = vertices[faces]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    middles = corners.mean(axis=1)
    centre = np.average(middles[:, [0, 2]], axis=0, weights=areas)
    offsets = middles[:, [0, 2]] - centre
    across = np.linalg.eigh((offsets * areas[:, None]).T @ offsets)[1][:, 1]
    # Evenly by area, so that a head or a hand of fine triangles counts as any other part.
    places = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    chosen = faces[np.minimum(np.searchsorted(np.cumsum(areas) / areas.sum(), places), len(faces) - 1), 0]
    across, offset = _symmetry(vertices[np.unique(chosen)], vertices[np.unique(faces)], across, float(centre @ across))
    left = np.array([across[0], 0.0, across[1]])
    ahead = np.cross(left, (0.0, 1.0, 0.0))
    if _ahead(middles, areas, ahead) < 0.0:
        left, ahead, offset = -left, -ahead, -offset
    rotation = np.stack([left, [0.0, 1.0, 0.0], ahead], axis=1)
    return StandingFrame(rotation, offset * left + (centre @ ahead[[0, 2]]) * ahead)


def _symmetry(points: Floats, surface: Floats, across: Floats, offset: float) -> tuple[Floats, float]:
    """The upright plane whose mirror images of points are nearest to points of the surface.

    Args:
        points: of the surface [m], shape (n, 3).
        surface: all points of it [m], shape (k, 3).
        across: the first guess of the plane's normal, shape (2,).
        offset: of the plane along it [m].

    Returns:
        normal, shape (2,), and offset [m].
    """
    tree, flat, whole = cKDTree(surface), points[:, [0, 2]], surface[:, [0, 2]]
    for _ in range(_ROUNDS):
        image = points.copy()
        image[:, [0, 2]] -= 2.0 * (flat @ across - offset)[:, None] * across
        distance, nearest = tree.query(image)
        kept = distance <= np.quantile(distance, _KEPT_SHARE)
        one, other = flat[kept], whole[nearest[kept]]
        middle = 0.5 * (one.mean(axis=0) + other.mean(axis=0))
        # Least squares over planes: the normal makes the sum of products of both offsets along it least.
        product = (one - one.mean(axis=0)).T @ (other - other.mean(axis=0))
        normal = np.linalg.eigh(product + product.T)[1][:, 0]
        normal *= np.sign(normal @ across) or 1.0
        turned = float(np.abs(normal - across).max())
        across, offset = normal, float(middle @ normal)
        if turned < _TURNED:
            break
    return across, offset


def _ahead(middles: Floats, areas: Floats, direction: Floats) -> float:
    """Above 0 if the body looks along a direction, below 0 if it looks against it.

    The foot or feet on the floor reach further ahead of the ankles over them than behind.
    """
    height = float(np.ptp(middles[:, 1]))
    share, flat = (middles[:, 1] - middles[:, 1].min()) / height, middles[:, [0, 2]]
    foot, ankle = share < _FOOT, (share > _ANKLE[0]) & (share < _ANKLE[1])
    ankle[ankle] = cKDTree(flat[foot]).query(flat[ankle])[0] < _OVER_FOOT * height
    if not ankle.any():
        return float(direction[2]) or 1.0
    along = middles @ direction
    lead = float(np.average(along[foot], weights=areas[foot]) - np.average(along[ankle], weights=areas[ankle]))
    return lead if abs(lead) > _LEAST_FOOT * height else float(direction[2]) or 1.0
