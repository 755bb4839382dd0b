"""What the measuring packages share: frame rate, gravity, the energy of cloth, its distance from colliders."""

from __future__ import annotations

import numpy as np

from pbd import Capsule, DistanceField, Plane, Sphere

__all__ = ["FRAME_RATE", "GRAVITY", "mechanical_energy", "signed_distance"]

FRAME_RATE = 60.0  # of all measured runs [Hz]
GRAVITY = 9.81  # [m/s2]


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
