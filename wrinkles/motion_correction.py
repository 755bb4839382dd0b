"""A learned correction of the coarse garment's motion: an acceleration that brings it to where the fine one goes.

The coarse garment is nudged along training motion towards the filtered fine one, and a network learns what the nudging
had to add (Watt-Meyer et al. 2021, "Correcting weather and climate models by machine learning nudged hindcast
simulations"; see :mod:`precompute.learning.nudging`).
"""

from dataclasses import dataclass

import numpy as np
from threadpoolctl import ThreadpoolController

from pbd import State
from pbd.engine import ti
from pbd.geometry import Float1, Vec3, Vec4
from pbd.taichi_internals import Launch
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.dictionary import CLIP
from wrinkles.features import AROUND, DYNAMIC_COUNT, Stencil

__all__ = ["VELOCITY_COUNT", "MotionCorrection", "MotionCorrector", "VelocityReader"]

VELOCITY_COUNT = 3 * len(AROUND)
STILL = 0.1  # below this speed against the garment's mean the correction fades: nothing was learned from pauses [m/s]

vec3 = ti.math.vec3
Float2 = ti.types.ndarray(dtype=ti.f32, ndim=2)
Int2 = ti.types.ndarray(dtype=ti.i32, ndim=2)


@ti.kernel
def _read_velocity(
    velocity: Vec4,
    corners: Int2,
    weights: Float2,
    frames: Float2,
    scale: Float1,
    limit: ti.f32,
    features: Float2,
):
    """The kernel of :class:`VelocityReader`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(velocity.shape[0]):
            own, f = velocity[i], 0
            for p in ti.static(AROUND):
                total = -own
                for c in ti.static(range(3)):
                    total += weights[i, 3 * p + c] * velocity[corners[i, 3 * p + c]]
                for a in ti.static(range(3)):
                    axis = vec3(frames[i, 3 * a], frames[i, 3 * a + 1], frames[i, 3 * a + 2])
                    along = axis.dot(vec3(total[0], total[1], total[2]))
                    features[i, f] = ti.math.clamp(along * scale[f], -limit, limit)
                    f += 1


@ti.kernel
def _to_world(frames: Float2, acceleration: Float2, velocity: Vec3, most: ti.f32, dt: ti.f32, change: Vec4):
    """Changes of velocity in the world for accelerations in vertex frames.

    None is larger than ``most``, and they fade where the garment is nearly still.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        mean = vec3(0.0)
        for i in range(change.shape[0]):
            mean += velocity[i]
        mean /= change.shape[0]
        for i in range(change.shape[0]):
            total, moving = vec3(0.0), (velocity[i] - mean).norm() / STILL
            for a in ti.static(range(3)):
                total += acceleration[i, a] * vec3(frames[i, 3 * a], frames[i, 3 * a + 1], frames[i, 3 * a + 2])
            total *= dt * ti.min(1.0, most / ti.max(total.norm(), 1e-12)) * ti.min(1.0, moving * moving)
            change[i] = ti.math.vec4(total[0], total[1], total[2], 0.0)


@ti.kernel
def _add(change: Vec4, position: Vec4, velocity: Vec3):
    """Change the velocity of the vertices that are free."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(velocity.shape[0]):
            if position[i][3] > 0.0:
                velocity[i] += vec3(change[i][0], change[i][1], change[i][2])


class VelocityReader:
    """Reads how fast the cloth around each coarse vertex moves away from it.

    Args:
        stencil: of the coarse mesh.
        coarse_filter: of the coarse mesh; velocities are filtered as positions are.

    Attributes:
        features: differences of velocity at the eight nearest stencil points, in the vertex's frame [m/s] times a
            scale, float32, shape (n, VELOCITY_COUNT).
    """

    def __init__(self, stencil: Stencil, coarse_filter: CoarseFilter) -> None:
        count = len(stencil.corners)
        self._corners, self._weights, self._filter = stencil.corners, stencil.weights, coarse_filter
        self._velocity, self._smooth = np.zeros((2, count, 4), np.float32)
        self.features = np.zeros((count, VELOCITY_COUNT), np.float32)
        self._launch = Launch(_read_velocity)

    def __call__(self, velocity: np.ndarray, frames: np.ndarray, scale: np.ndarray, limit: float) -> np.ndarray:
        """Set :attr:`features`, and return them.

        Args:
            velocity: of the coarse vertices [m/s], float32, shape (n, 3).
            frames: of the coarse vertices, see :meth:`Stencil.read`.
            scale: of each feature [s/m], float32, shape (VELOCITY_COUNT,).
            limit: of the scaled features [-].
        """
        self._velocity[:, :3] = velocity
        smooth = self._filter(self._velocity, self._smooth)
        self._launch(smooth, self._corners, self._weights, frames, scale, limit, self.features)
        return self.features


@dataclass(frozen=True)
class MotionCorrection:
    """A network that gives the acceleration which the coarse garment lacks, in the frame of each vertex.

    Two hidden layers of rectified units and a linear one. Its input are the scaled features that
    :class:`wrinkles.dictionary.CoefficientNetwork` sees, scaled differences of velocity, and what belongs to the place.

    Attributes:
        velocity_scale: of the differences of velocity [s/m], float32, shape (VELOCITY_COUNT,).
        weights_1, velocity_weights, place_weights, bias_1: of the first layer, float32, shapes (DYNAMIC_COUNT, h1),
            (VELOCITY_COUNT, h1), (s, h1), (h1,).
        weights_2, bias_2: of the second, float32, shapes (h1, h2), (h2,).
        weights_3, bias_3: of the last [m/s2], float32, shapes (h2, 3), (3,).
        most: acceleration at most, all that training had but for outliers [m/s2].
    """

    velocity_scale: np.ndarray
    weights_1: np.ndarray
    velocity_weights: np.ndarray
    place_weights: np.ndarray
    bias_1: np.ndarray
    weights_2: np.ndarray
    bias_2: np.ndarray
    weights_3: np.ndarray
    bias_3: np.ndarray
    most: float

    @classmethod
    def none(cls, place_features: int) -> "MotionCorrection":
        """One without units, which stands for none in files."""
        shapes = (DYNAMIC_COUNT, 0), (VELOCITY_COUNT, 0), (place_features, 0), (0,), (0, 0), (0,), (0, 3), (3,)
        nothing = [np.zeros(shape, np.float32) for shape in shapes]
        return cls(np.ones(VELOCITY_COUNT, np.float32), *nothing, most=0.0)


class MotionCorrector:
    """Adds the learned acceleration to the velocity of a coarse garment, once a tick.

    Args:
        correction: what was learned.
        place: static features of each coarse vertex, float32, shape (n, s).
        stencil: of the coarse mesh.
        coarse_filter: of the coarse mesh.
    """

    def __init__(
        self, correction: MotionCorrection, place: np.ndarray, stencil: Stencil, coarse_filter: CoarseFilter
    ) -> None:
        count, (width_1, width_2) = len(place), correction.weights_2.shape
        self._correction, self._filter = correction, coarse_filter
        self._read = VelocityReader(stencil, coarse_filter)
        self._place_bias = place @ correction.place_weights + correction.bias_1
        self._change, self._smooth = np.zeros((2, count, 4), np.float32)
        self._hidden_1, self._by_velocity = np.zeros((2, count, width_1), np.float32)
        self._hidden_2 = np.zeros((count, width_2), np.float32)
        self._acceleration = np.zeros((count, 3), np.float32)
        self._to_world, self._add = Launch(_to_world), Launch(_add)
        self._blas = ThreadpoolController()

    def __call__(self, state: State, frames: np.ndarray, features: np.ndarray, dt: float) -> None:
        """Change the velocity of the free vertices.

        Args:
            state: of the coarse garment, at the end of a tick.
            frames, features: of that state, see :class:`wrinkles.decoder.Decoder`.
            dt: length of the tick [s].
        """
        self._add(self.change(state, frames, features, dt), state.position, state.velocity)

    def change(self, state: State, frames: np.ndarray, features: np.ndarray, dt: float) -> np.ndarray:
        """The change of velocity [m/s], float32, shape (n, 4); valid until the next call."""
        c = self._correction
        seen = self._read(state.velocity, frames, c.velocity_scale, CLIP)
        with self._blas.limit(limits=1, user_api="blas"):  # the bits would depend on the number of threads
            np.matmul(features, c.weights_1, out=self._hidden_1)
            np.matmul(seen, c.velocity_weights, out=self._by_velocity)
            self._hidden_1 += self._by_velocity
            self._hidden_1 += self._place_bias
            np.maximum(self._hidden_1, 0.0, out=self._hidden_1)
            np.matmul(self._hidden_1, c.weights_2, out=self._hidden_2)
            self._hidden_2 += c.bias_2
            np.maximum(self._hidden_2, 0.0, out=self._hidden_2)
            np.matmul(self._hidden_2, c.weights_3, out=self._acceleration)
        self._acceleration += c.bias_3
        self._to_world(frames, self._acceleration, state.velocity, c.most, dt, self._change)
        return self._filter(self._change, self._smooth)
