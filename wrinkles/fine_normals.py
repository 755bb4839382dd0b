"""Normals of the fine mesh."""

import numpy as np

from pbd.engine import ensure_initialized, ti
from pbd.geometry import Int1, Int3, Vec3, Vec4, vec3, vec4, xyz
from pbd.taichi_internals import Launch
from wrinkles.surface import Subdivision

__all__ = ["FineNormals"]

Int6 = ti.types.ndarray(dtype=ti.types.vector(6, ti.i32), ndim=1)


@ti.func
def _area_normal(a: vec3, b: vec3, c: vec3):
    """Normal of a triangle, twice as long as its area [m2], with a fourth component."""
    return vec4((b - a).cross(c - a))


@ti.func
def _clear(sums: ti.template()):
    for i in range(sums.shape[0]):
        sums[i] = ti.math.vec4(0.0)


@ti.func
def _unit(sum_of_normals) -> vec3:
    """The unit vector along a sum of normals."""
    n = xyz(sum_of_normals)
    return n * (1.0 / ti.max(n.norm(), 1e-20))


@ti.kernel
def _subdivided_normals(vertices: Vec3, fours: Int6, sums: Vec4, normals: Vec3):
    """Unit vertex normals, weighted by area, of a mesh whose faces come in fours that one face was cut into.

    The four share six vertices, so that each vertex is read and written once for all of them.

    Args:
        vertices, normals: of the mesh, shape (n, 3); the latter are written.
        fours: corners of the face that was cut, then the middles of its sides 0-1, 1-2, 2-0.
        sums: workspace.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        _clear(sums)
        for q in range(fours.shape[0]):
            f = fours[q]
            i0, i1, i2, i01, i12, i20 = f[0], f[1], f[2], f[3], f[4], f[5]
            a, b, c = vertices[i0], vertices[i1], vertices[i2]
            ab, bc, ca = vertices[i01], vertices[i12], vertices[i20]
            at_a, at_b, at_c = _area_normal(a, ab, ca), _area_normal(ab, b, bc), _area_normal(ca, bc, c)
            between = _area_normal(ab, bc, ca)
            sums[i0] = sums[i0] + at_a
            sums[i1] = sums[i1] + at_b
            sums[i2] = sums[i2] + at_c
            sums[i01] = sums[i01] + (at_a + at_b + between)
            sums[i12] = sums[i12] + (at_b + at_c + between)
            sums[i20] = sums[i20] + (at_c + at_a + between)
        for i in range(sums.shape[0]):
            normals[i] = _unit(sums[i])


@ti.kernel
def _delivered_normals(vertices: Vec3, faces: Int3, stands_for: Int1, sums: Vec4, normals: Vec3):
    """The same of any mesh; each vertex has the normal of the one that stands for it in ``faces``."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        _clear(sums)
        for c in range(faces.shape[0]):
            f = faces[c]
            n = _area_normal(vertices[f[0]], vertices[f[1]], vertices[f[2]])
            for a in ti.static(range(3)):
                sums[f[a]] = sums[f[a]] + n
        for i in range(sums.shape[0]):
            normals[i] = _unit(sums[stands_for[i]])


class FineNormals:
    """Unit vertex normals of the fine mesh, weighted by area.

    Args:
        subdivision: from the coarse to the fine mesh.
    """

    def __init__(self, subdivision: Subdivision) -> None:
        ensure_initialized()
        self._sums = np.zeros((subdivision.fine_count, 4), np.float32)
        if subdivision.stands_for is None:
            fours = subdivision.faces.reshape(-1, 4, 3)
            # As loop_step orders them: at the corners a, b, c, and in the middle (ab, bc, ca).
            corners = np.stack([fours[:, c, c] for c in range(3)], axis=1)
            self._mesh = (np.ascontiguousarray(np.concatenate([corners, fours[:, 3]], axis=1), np.int32),)
        else:
            self._mesh = subdivision.faces, subdivision.stands_for.astype(np.int32)
        self._launch = Launch(_subdivided_normals if len(self._mesh) == 1 else _delivered_normals)

    def __call__(self, vertices: np.ndarray, normals: np.ndarray) -> None:
        """Write the normals, float32, shape (N, 3), of fine vertices [m], float32, shape (N, 3)."""
        self._launch(vertices, *self._mesh, self._sums, normals)
