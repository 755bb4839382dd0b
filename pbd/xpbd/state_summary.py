"""What a solver has to know of all vertices of a state at once."""

import numpy as np

from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Vec3, Vec4, vec3, xyz
from pbd.state import State
from pbd.taichi_internals import Launch

__all__ = ["StateSummary"]


@ti.kernel
def _summarize(position: Vec4, velocity: Vec3, out: Float1):
    """Mean position [m] and mean velocity [m/s]; 0 if all numbers are finite, else none."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        centre, drift, zero = vec3(0.0), vec3(0.0), 0.0
        for i in range(position.shape[0]):
            x, v = position[i], velocity[i]
            centre += xyz(x)
            drift += v
            zero += 0.0 * x[0] + 0.0 * x[1] + 0.0 * x[2] + 0.0 * x[3] + (0.0 * v[0] + 0.0 * v[1] + 0.0 * v[2])
        for a in ti.static(range(3)):
            out[a] = centre[a] / position.shape[0]
            out[3 + a] = drift[a] / position.shape[0]
        out[6] = zero


class StateSummary:
    """Means over the vertices of a state, and whether its numbers are finite, as of the last :meth:`read`.

    Attributes:
        centre: mean position [m], float32, shape (3,).
        drift: mean velocity [m/s], float32, shape (3,).
    """

    def __init__(self) -> None:
        ensure_initialized()
        self._numbers = np.zeros(7, np.float32)
        self.centre, self.drift = self._numbers[:3], self._numbers[3:6]
        self._launch = Launch(_summarize)

    def read(self, state: State) -> None:
        """Look at a state."""
        self._launch(state.position, state.velocity, self._numbers)

    @property
    def is_finite(self) -> bool:
        """Whether all positions and velocities are finite."""
        return bool(self._numbers[6] == 0.0)
