"""Linear-blend skinning: where a pose puts the vertices of a character."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from assets.character import Character
from pbd.engine import ensure_initialized, ti
from pbd.taichi_internals import Launch

__all__ = ["MovedSurface", "SkinnedBody", "skin_vertices"]

Floats = NDArray[np.float64]
vec3, vec4 = ti.math.vec3, ti.math.vec4


class MovedSurface(Protocol):
    """A surface that a motion moves.

    Attributes:
        vertices: bind pose [m], shape (n, 3), float64.
        faces: shape (m, 3), int32.
    """

    vertices: Floats
    faces: NDArray[np.int32]

    def skin(self, pose: Floats, origin: Floats, out: Any) -> None:
        """Write the vertices of a pose, world minus origin [m].

        Args:
            pose: of the body's motion.
            origin: of the frame that ``out`` is in [m], shape (3,), float64.
            out: float32, shape (n, 3); a Taichi array of n three-vectors, or a numpy array.
        """
        ...


def skin_vertices(character: Character, pose: Floats) -> Floats:
    """Vertices of a pose in the world [m], shape (n, 3), float64; the reference for :class:`SkinnedBody`.

    Args:
        character: the skinned mesh.
        pose: skinning matrices, shape (joints, 3, 4).
    """
    weights = character.joint_weights.astype(np.float64)
    weights /= weights.sum(axis=1, keepdims=True)  # stored as float32, they sum to one only nearly
    vertices = np.zeros((len(character.vertices), 3))
    for entry in range(weights.shape[1]):
        matrices = pose[character.joint_indices[:, entry]]
        moved = np.einsum("nab,nb->na", matrices[:, :, :3], character.vertices) + matrices[:, :, 3]
        vertices += weights[:, entry, None] * moved
    return vertices


class SkinnedBody:
    """A character's surface, skinned by one serial kernel.

    A vertex is the sum over its influences of the columns of the joint's matrix, each times a coordinate of the
    weighted bind position, which never changes and is stored. The first influences of all vertices come before their
    second ones: no sum waits for the one before it, and no loop's end has to be foreseen.

    Attributes:
        vertices: bind pose [m], shape (n, 3), float64.
        faces: shape (m, 3), int32.
        pose_shape: shape of a pose: (joints, 3, 4).
    """

    def __init__(self, character: Character) -> None:
        ensure_initialized()
        self.vertices, self.faces = character.vertices, character.faces
        self.pose_shape = (character.joint_count, 3, 4)
        weights = character.joint_weights.astype(np.float64)
        weights /= weights.sum(axis=1, keepdims=True)
        points = (
            np.concatenate([self.vertices, np.ones((len(self.vertices), 1))], axis=1)[:, None] * weights[:, :, None]
        )
        used = character.joint_weights.T > 0.0
        self._columns = np.zeros((4 * character.joint_count, 4), dtype=np.float32)  # by joint; row 3 unused
        self._points = np.swapaxes(points, 0, 1)[used].astype(np.float32)
        self._joints = character.joint_indices.T[used].astype(np.int32)
        self._bound = np.nonzero(used)[1].astype(np.int32)  # the vertex of each influence
        self._sums = np.zeros((len(self.vertices), 4), np.float32)
        self._blend = Launch(_blend)

    def skin(self, pose: Floats, origin: Floats, out: Any) -> None:
        """Write the vertices of a pose, world minus origin [m]; see :class:`MovedSurface`.

        Args:
            pose: skinning matrices, shape (joints, 3, 4), float64.
            origin: [m], shape (3,), float64; taken off before rounding to float32.
            out: float32, shape (n, 3).
        """
        columns = self._columns.reshape(-1, 4, 4)
        columns[:, :3, :3] = np.swapaxes(pose[:, :, :3], 1, 2)
        columns[:, 3, :3] = pose[:, :, 3] - origin
        self._blend(self._columns, self._points, self._joints, self._bound, self._sums, out)


@ti.kernel
def _blend(
    columns: ti.types.ndarray(dtype=vec4, ndim=1),
    points: ti.types.ndarray(dtype=vec4, ndim=1),
    joints: ti.types.ndarray(dtype=ti.i32, ndim=1),
    bound: ti.types.ndarray(dtype=ti.i32, ndim=1),
    sums: ti.types.ndarray(dtype=vec4, ndim=1),
    out: ti.types.ndarray(dtype=vec3, ndim=1),
):
    ti.loop_config(serialize=True)
    for _ in range(1):
        for vertex in range(sums.shape[0]):
            sums[vertex] = vec4(0.0)
        for entry in range(joints.shape[0]):
            column, point, vertex = 4 * joints[entry], points[entry], bound[entry]
            sums[vertex] = (
                sums[vertex]
                + columns[column] * point.x
                + columns[column + 1] * point.y
                + columns[column + 2] * point.z
                + columns[column + 3] * point.w
            )
        for vertex in range(sums.shape[0]):
            out[vertex] = sums[vertex].xyz
