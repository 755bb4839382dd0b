"""Makes the folds of a coarse garment change as fast as those of a fine one: a high-boost filter in time.

On a coarse mesh folds have the right energy, but their crests follow the edges of the mesh and stay there: they change
with half the energy of a fine garment's, with any substep, friction and bending stiffness.
"""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix

from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Int1, Int3, Vec3, Vec4, vec3, vec4, xyz
from pbd.taichi_internals import Launch
from wrinkles.levels import Levels
from wrinkles.spectrum import curvature_matrix
from wrinkles.surface import csr_arrays

__all__ = ["LIMIT", "SHARPNESS", "TIME", "TemporalSharpening"]

# Share by which changes of a fold at the cut-off are raised. With 1 the folds of a skirt and of a T-shirt have the
# energy of fine ones.
SHARPNESS = 1.0
TIME = 0.05  # in which the running mean follows [s]
LIMIT = 0.05  # of the difference from it, in cut-offs: a garment that is put elsewhere at once does not grow spikes


@ti.kernel
def _follow(
    start: Int1,
    index: Int1,
    value: Float1,
    faces: Int3,
    position: Vec4,
    share: ti.f32,
    limit: ti.f32,
    normal: Vec3,
    mean: Float1,
    change: Vec4,
):
    """See :meth:`TemporalSharpening.follow`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(position.shape[0]):
            normal[i] = vec3(0.0)
        for f in range(faces.shape[0]):
            a, b, c = faces[f][0], faces[f][1], faces[f][2]
            area = (xyz(position[b]) - xyz(position[a])).cross(xyz(position[c]) - xyz(position[a]))
            for corner in ti.static(range(3)):
                normal[faces[f][corner]] += area
        for i in range(position.shape[0]):
            n = normal[i] / ti.max(normal[i].norm(), 1e-12)
            curvature = 0.0
            for q in range(start[i], start[i + 1]):
                curvature += value[q] * n.dot(xyz(position[index[q]]) - xyz(position[i]))
            mean[i] += share * (curvature - mean[i])
            change[i] = vec4(SHARPNESS * ti.math.clamp(curvature - mean[i], -limit, limit) * n, 0.0)


@ti.kernel
def _show(position: Vec4, before: Vec4, change: Vec4, alpha: ti.f32, shown: Vec4):
    """See :meth:`TemporalSharpening.__call__`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(shown.shape[0]):
            shown[i] = position[i] + before[i] + alpha * (change[i] - before[i])


class TemporalSharpening:
    """Adds to a coarse garment, along its normals, what its curvature differs from its running mean.

    With k the mean curvature of a vertex and s the :data:`SHARPNESS`, s (cutoff / 2 pi)^2 (k - running mean) is added.
    So the changes of a fold of wavelength L are raised by the share s (cutoff / L)^2, and a garment that hangs still is
    shown as it is. The simulation itself is not changed.

    Args:
        levels: of the garment.
    """

    def __init__(self, levels: Levels) -> None:
        ensure_initialized()
        mesh, count = levels.coarse, levels.subdivision.coarse_count
        curvature = ((levels.cutoff / (2.0 * np.pi)) ** 2 * curvature_matrix(mesh)).tolil()
        curvature[levels.coarse_held] = 0.0
        self._curvature = csr_arrays(csr_matrix(curvature))
        self._faces = np.ascontiguousarray(mesh.faces, np.int32)
        self._limit = LIMIT * levels.cutoff
        self._normal, self._mean = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
        self._before, self._change, self._shown = np.zeros((3, count, 4), np.float32)
        self._follow, self._show = Launch(_follow), Launch(_show)

    def begin(self, position: np.ndarray) -> None:
        """Take a state of the garment as one in which it has been for long: [m], float32, shape (n, 4)."""
        self._move(position, 1.0)
        self._before[:] = 0.0

    def follow(self, position: np.ndarray, dt: float) -> None:
        """Let the running mean follow a step of the garment.

        Args:
            position: after the step [m], float32, shape (n, 4).
            dt: length of the step [s].
        """
        self._before[:] = self._change
        self._move(position, 1.0 - float(np.exp(-dt / TIME)))

    def _move(self, position: np.ndarray, share: float) -> None:
        self._follow(
            *self._curvature, self._faces, position, share, self._limit, self._normal, self._mean, self._change,
        )  # fmt: skip

    def __call__(self, position: np.ndarray, alpha: float = 1.0) -> np.ndarray:
        """The garment as it is to be shown.

        Args:
            position: of the coarse garment [m], float32, shape (n, 4).
            alpha: 0 before the last step, 1 after it.

        Returns:
            [m], float32, shape (n, 4): valid until the next call.
        """
        self._show(position, self._before, self._change, alpha, self._shown)
        return self._shown

    @property
    def memory(self) -> tuple[np.ndarray, ...]:
        """What the next step starts from, a copy; may be set again."""
        return self._mean.copy(), self._before.copy(), self._change.copy()

    @memory.setter
    def memory(self, memory: Sequence[np.ndarray | int]) -> None:
        for array, kept in zip((self._mean, self._before, self._change), memory, strict=True):
            array[:] = kept
