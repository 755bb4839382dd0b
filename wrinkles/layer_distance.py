"""What a garment lies on: the body, or the garments of an outfit below it."""

import numpy as np
from scipy.spatial import cKDTree

from pbd import Body, ClothMesh
from pbd.contact.body_surface import BodySurface
from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Int1, Int2, Vec3, Vec4, closest_in_fan, descend, vec3, xyz
from pbd.taichi_internals import Launch

__all__ = ["LayerDistance"]


@ti.kernel
def _lower(
    position: Vec4,
    contact: Float1,
    ring_start: Int1,
    ring: Int1,
    fan_start: Int1,
    fan: Int2,
    outer: Int1,
    seeds: Int1,
    points: Vec3,
    distance: Float1,
):
    """See :meth:`LayerDistance.__call__`. ``points`` receives the positions; a kernel takes arrays one by one."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(position.shape[0]):
            points[i] = xyz(position[i])
            distance[i] = contact[i]
        below = BodySurface(points, points, ring_start, ring, fan_start, fan, points)
        for k in range(outer.shape[0]):
            p = vec3(points[outer[k]])
            nearest = descend(p, seeds[k], 0.0, below)
            _corners, _weights, squared = closest_in_fan(p, nearest, 0.0, below)
            distance[outer[k]] = ti.min(distance[outer[k]], ti.sqrt(squared))


class LayerDistance:
    """Distance of the vertices of an outfit from what they lie on.

    Each garment over others looks for the nearest place on those by walking to nearer neighbours, from the vertex that
    is nearest where the mesh rests: a result does not depend on what came before it.

    Args:
        mesh: of all garments, on the body.
        layer: number of the garment of each vertex, 0 for the innermost, int, shape (n,).
    """

    def __init__(self, mesh: ClothMesh, layer: np.ndarray) -> None:
        ensure_initialized()
        count = len(mesh.vertices)
        self._parts = []
        for number in range(1, int(layer.max()) + 1):
            inner, outer = np.flatnonzero(layer < number), np.flatnonzero(layer == number)
            below = Body(mesh.faces[layer[mesh.faces[:, 0]] < number], count)
            nearest = cKDTree(mesh.vertices[inner]).query(mesh.vertices[outer])[1]
            rings = below.ring_start, below.ring, below.fan_start, below.fan
            self._parts.append((*rings, outer.astype(np.int32), inner[nearest].astype(np.int32)))
        self._points, self._distance = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
        self._lower = Launch(_lower)

    def __call__(self, position: np.ndarray, contact: np.ndarray) -> np.ndarray:
        """Distance from the body or the garments below, whichever is nearer [m], float32, shape (n,).

        The array is valid until the next call.

        Args:
            position: [m], float32, shape (n, 4); the last column is not used.
            contact: distance from the body [m], float32, shape (n,).
        """
        for part in self._parts:
            self._lower(position, contact, *part, self._points, self._distance)
            contact = self._distance
        return self._distance
