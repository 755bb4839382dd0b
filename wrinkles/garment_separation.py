"""Fine garments of an outfit are kept apart: a vertex of an outer one stays over the garments below it."""

import numpy as np
from scipy.spatial import cKDTree

from pbd import Body
from pbd.contact.body_surface import BodySurface
from pbd.engine import ensure_initialized, ti
from pbd.geometry import Int1, Int2, Int3, Vec3, closest_in_fan, descend, surface_normals, vec3
from pbd.taichi_internals import Launch
from wrinkles.levels import Layers
from wrinkles.surface import Subdivision

__all__ = ["GarmentSeparation"]

NEAR = 0.01  # a coarse vertex further than this and a mean coarse edge from those below is not over them [m]
DEEPEST = 0.01  # a vertex deeper than this under them is not under them, but at another place [m]
ASIDE = 0.001  # beyond a rim by more than this, and by more than its height, a vertex is not over the garment [m]


@ti.kernel
def _separate(
    fine: Vec3,
    normals: Vec3,
    ring_start: Int1,
    ring: Int1,
    fan_start: Int1,
    fan: Int2,
    moved: Int1,
    around: Int3,
    seeds: Int1,
    facing: ti.f32,
    kept: ti.f32,
):
    """See :meth:`GarmentSeparation.__call__`. Over 10 arguments: a kernel takes arrays one by one."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        below = BodySurface(fine, fine, ring_start, ring, fan_start, fan, normals)
        for i in range(moved.shape[0]):
            p = fine[moved[i]]
            best, distance = -1, 1e30
            for c in ti.static(range(3)):
                seed = seeds[around[i][c]]
                if seed >= 0:
                    offset = fine[seed] - p
                    if offset.dot(offset) < distance:
                        distance = offset.dot(offset)
                        best = seed
            if best >= 0:
                best = descend(p, best, 0.0, below)
                f, w, squared = closest_in_fan(p, best, 0.0, below)
                normal = w[0] * normals[best] + w[1] * normals[f[0]] + w[2] * normals[f[1]]
                normal *= facing / ti.max(normal.norm(), 1e-20)
                point = w[0] * fine[best] + w[1] * fine[f[0]] + w[2] * fine[f[1]]
                height = (p - point).dot(normal)
                over = squared - height * height <= ti.max(height * height, ASIDE * ASIDE)
                if over and -DEEPEST < height and height < kept:
                    fine[moved[i]] = p + (kept - height) * vec3(normal)


class GarmentSeparation:
    """Keeps a garment of an outfit over the garments below it.

    Args:
        layers: garments of the coarse mesh.
        subdivision: from the coarse to the fine mesh.
        leading: coarse vertices around each fine one, int, shape (N, 3).
        number: of the garment that is moved, at least 1.
        held: fine vertices that are not moved, int, shape (P,).
        facing: 1 where the garments' faces look away from the body, -1 where they look at it.
        kept: distance from the garments below [m].
        edge: mean length of the coarse edges [m].
    """

    def __init__(
        self,
        layers: Layers,
        subdivision: Subdivision,
        leading: np.ndarray,
        number: int,
        held: np.ndarray,
        facing: float,
        kept: float,
        edge: float,
    ) -> None:
        ensure_initialized()
        fine = layers.subdivided(subdivision).layer
        faces = subdivision.faces
        below = Body(faces[fine[faces[:, 0]] < number], len(fine))
        self._faces, self._normals = below.faces, below.normals
        self._rings = below.ring_start, below.ring, below.fan_start, below.fan
        own_vertices = np.setdiff1d(np.flatnonzero(fine == number), held)
        # Vertices that lie near one another look at the same place.
        self._moved = own_vertices[np.lexsort((leading[own_vertices, 1], leading[own_vertices, 0]))].astype(np.int32)
        self._around = np.ascontiguousarray(leading[self._moved], np.int32)
        self._below, self._outer = np.flatnonzero(layers.layer < number), np.flatnonzero(layers.layer == number)
        self._seeds = np.full(len(layers.layer), -1, np.int32)
        self._facing, self._kept, self._near = facing, kept, NEAR + edge
        self._shade, self._separate = Launch(surface_normals), Launch(_separate)

    def __call__(self, fine: np.ndarray) -> None:
        """Move vertices of the garment that are not over the garments below, in place.

        The nearest place below is found from the coarse vertices, which come first in the numbering of both meshes, by
        walking to nearer neighbours. A result does not depend on what came before it.

        Args:
            fine: vertices of all garments [m], float32, shape (N, 3).
        """
        tree = cKDTree(fine[self._below])
        distance, nearest = tree.query(fine[self._outer], distance_upper_bound=self._near)
        near = np.isfinite(distance)
        self._seeds[self._outer] = -1
        self._seeds[self._outer[near]] = self._below[nearest[near]]
        self._shade(fine, self._faces, self._normals)
        self._separate(
            fine, self._normals, *self._rings, self._moved, self._around, self._seeds, self._facing, self._kept
        )
