"""What experiments measure with: frame rate, gravity, times, energy, lengths and depths of cloth."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pbd import Capsule, DistanceField, Plane, Sphere
from pbd.models import StepError

__all__ = [
    "FRAME_RATE", "GRAVITY", "TimedSteps", "deepest", "edge_strain", "elongation", "mechanical_energy",
    "signed_distance", "typical_ms",
]  # fmt: skip

FRAME_RATE = 60.0  # of all measured runs [Hz]
GRAVITY = 9.81  # [m/s2]


@dataclass
class TimedSteps:
    """Calls a function that makes a frame, takes its time and keeps why it failed.

    Attributes:
        step: makes a frame.
        expected: errors that end a run; any other one is passed on.
        times: processor time of each frame that was made [s].
        error: why the last frame was not made; None if it was.
    """

    step: Callable[..., Any]
    expected: tuple[type[Exception], ...] = (StepError,)
    times: list[float] = field(default_factory=list)
    error: Exception | None = None

    def __call__(self, *given: Any, **named: Any) -> bool:
        """Make a frame; False if it failed."""
        begin = time.process_time()
        try:
            self.step(*given, **named)
        except self.expected as error:
            self.error = error
            return False
        self.times.append(time.process_time() - begin)
        return True

    @property
    def problem(self) -> str:
        """Why the last frame failed, in words; empty if it did not."""
        return self.error.problem if isinstance(self.error, StepError) else str(self.error or "")


def typical_ms(times: Sequence[float] | np.ndarray, without: float = np.nan) -> float:
    """Median of times [s] in [ms]; ``without`` where there is none."""
    return 1e3 * float(np.median(times)) if len(times) else without


def mechanical_energy(
    mass: np.ndarray, position: np.ndarray, velocity: np.ndarray, gravity: float = GRAVITY
) -> tuple[np.ndarray, np.ndarray]:
    """Kinetic energy and gravity's, and the kinetic part of it, of each frame [J], each shape (f,).

    Elastic energy is left out: the strain that a solver leaves when it has not converged would count for much in stiff
    cloth, but never comes back as motion, and stored energy can only lower this sum.

    Args:
        mass: of the vertices [kg], shape (n,); 0 leaves a vertex out.
        position, velocity: [m], [m/s], shape (f, n, 3); y points upwards.
        gravity: [m/s2].
    """
    kinetic = 0.5 * np.einsum("n,fni,fni->f", mass, velocity, velocity, dtype=float)
    return kinetic + gravity * (position[:, :, 1].astype(float) @ mass), kinetic


def edge_strain(position: np.ndarray, edges: np.ndarray, rest_lengths: np.ndarray) -> np.ndarray:
    """Strain of each edge in each frame [-], shape (f, e), of positions of shape (f, n, 3)."""
    return np.linalg.norm(position[:, edges[:, 1]] - position[:, edges[:, 0]], axis=2) / rest_lengths - 1.0


def elongation(x: np.ndarray, faces: np.ndarray, inverse_flat: np.ndarray) -> np.ndarray:
    """Length of each face's warp and weft over that at rest [-], shape (m, 2), of positions of shape (n, 3)."""
    corners = x[faces]
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    return np.linalg.norm(sides @ inverse_flat, axis=1)


def deepest(primitives: Sequence[Plane | Sphere | Capsule | DistanceField], x: np.ndarray) -> np.ndarray:
    """Depth of the deepest vertex under a collider's surface, 0 where none is [m], shape (f,), of shape (f, n, 3)."""
    depth = np.zeros(len(x))
    for primitive in primitives:
        depth = np.maximum(depth, -signed_distance(primitive, x).min(axis=1))
    return depth


def signed_distance(collider: Plane | Sphere | Capsule | DistanceField, points: np.ndarray) -> np.ndarray:
    """Distance of points from a collider's surface, negative inside [m].

    Args:
        collider: a plane, sphere or capsule.
        points: [m], shape (..., 3).

    Returns:
        shape (...).
    """
    if isinstance(collider, Plane):
        normal = np.asarray(collider.normal, float)
        return (points - collider.point) @ (normal / np.linalg.norm(normal))
    if isinstance(collider, Sphere):
        return np.linalg.norm(points - collider.centre, axis=-1) - collider.radius
    assert isinstance(collider, Capsule)  # no scene that is judged has a distance field
    start, axis = np.asarray(collider.start, float), np.subtract(collider.end, collider.start)
    along = np.clip((points - start) @ axis / max(float(axis @ axis), 1e-20), 0.0, 1.0)
    return np.linalg.norm(points - (start + along[..., None] * axis), axis=-1) - collider.radius
