"""Transforms as translation, rotation and scale: matrices from them, back again, and between two of them.

Quaternions are x, y, z, w. All functions work on stacks; leading axes are free.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pbd.errors import InputError

__all__ = ["decompose", "local_matrices", "quaternions", "slerp"]

Floats = NDArray[np.float64]

# Pairs of quaternion components whose products make up a rotation matrix: xx yy zz, xy xz yz, xw yw zw.
_FIRST = np.array([0, 1, 2, 0, 0, 1, 0, 1, 2])
_SECOND = np.array([0, 1, 2, 1, 2, 2, 3, 3, 3])


def local_matrices(translation: Floats, rotation: Floats, scale: Floats) -> Floats:
    """Matrices ``T R S``, shape (..., 4, 4).

    Args:
        translation: [m], shape (..., 3).
        rotation: unit quaternions x, y, z, w [-], shape (..., 4).
        scale: [-], shape (..., 3).
    """
    # All products in one multiplication: on small arrays every numpy call costs a microsecond.
    doubled = 2.0 * rotation[..., _FIRST] * rotation[..., _SECOND]
    xx, yy, zz, xy, xz, yz, xw, yw, zw = np.moveaxis(doubled, -1, 0)
    matrix = np.zeros((*rotation.shape[:-1], 4, 4))
    matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 0, 2] = 1.0 - yy - zz, xy - zw, xz + yw
    matrix[..., 1, 0], matrix[..., 1, 1], matrix[..., 1, 2] = xy + zw, 1.0 - xx - zz, yz - xw
    matrix[..., 2, 0], matrix[..., 2, 1], matrix[..., 2, 2] = xz - yw, yz + xw, 1.0 - xx - yy
    matrix[..., :3, :3] *= scale[..., None, :]
    matrix[..., :3, 3] = translation
    matrix[..., 3, 3] = 1.0
    return matrix


def quaternions(rotation: Floats) -> Floats:
    """Unit quaternions x, y, z, w, shape (..., 4), of rotation matrices, shape (..., 3, 3)."""
    matrices = np.asarray(rotation, dtype=np.float64)
    return Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat().reshape(*matrices.shape[:-2], 4)


def decompose(matrices: Floats, key: str | None = None) -> tuple[Floats, Floats, Floats]:
    """Translation (..., 3), rotation (..., 4) and scale (..., 3) of matrices, shape (..., 4, 4).

    Raises:
        InputError: a matrix that shears or is singular; ``key`` names its owner.
    """
    linear = matrices[..., :3, :3]
    scale = np.linalg.norm(linear, axis=-2)
    scale[..., 0] *= np.where(np.linalg.det(linear) < 0.0, -1.0, 1.0)
    if not (np.abs(scale) > 1e-9).all():
        raise InputError("a transform that flattens space", key=key)
    rotation = linear / scale[..., None, :]
    if np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max() > 1e-3:
        raise InputError("a transform that shears", key=key, expected="translation, rotation and scale")
    return matrices[..., :3, 3].copy(), quaternions(rotation), scale


def slerp(start: Floats, end: Floats, share: Floats | float) -> Floats:
    """Rotations between two, at constant angular speed on the shorter way (Shoemake 1985), shape (..., 4).

    Args:
        start: unit quaternions, shape (..., 4).
        end: unit quaternions, shape (..., 4).
        share: 0 at the start, 1 at the end; a number or shape (...).
    """
    cosine = np.einsum("...i,...i->...", start, end)
    angle = np.arccos(np.minimum(np.abs(cosine), 1.0))
    # sin((1-u) a)/sin(a) and sin(u a)/sin(a), with their limits 1-u and u where the angle vanishes.
    small = angle < 1e-6
    sine = np.sin(angle) + small
    first = np.where(small, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    second = np.where(small, share, np.sin(share * angle) / sine) * np.where(cosine < 0.0, -1.0, 1.0)
    mixed = first[..., None] * start + second[..., None] * end
    return mixed / np.sqrt(np.einsum("...i,...i->...", mixed, mixed))[..., None]
