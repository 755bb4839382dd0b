"""How the built-in mannequin is made: its skeleton, its surface and its skin weights.

``python -m assets.procedural.mannequin_shape`` writes the data file anew, and its garments are sewn after it (see
:mod:`assets.procedural.builtin_sewing`). Playing only reads the file (see :mod:`assets.procedural.mannequin`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from assets.implicit import (
    ellipsoid,
    loft,
    smooth_max,
    smooth_min,
    surface_mesh,
    tapered_tube,
)
from assets.procedural.mannequin import DATA, JOINTS
from assets.remesh import even_mesh
from pbd.mesh import edges_of
from pbd.storage import replacing

__all__ = ["body_field", "make_mannequin", "skin_weights", "strongest", "write_mannequin"]

Floats = NDArray[np.float64]

# Trunk: height, half width, depth in front of and behind the middle line, z of the middle line [m].
_TRUNK = np.array(
    [
        (0.770, 0.080, 0.036, 0.036, -0.005),
        (0.800, 0.108, 0.058, 0.060, -0.005),
        (0.840, 0.130, 0.078, 0.082, -0.005),
        (0.880, 0.146, 0.091, 0.096, -0.004),
        (0.930, 0.153, 0.098, 0.098, -0.003),
        (0.980, 0.146, 0.096, 0.091, -0.002),
        (1.030, 0.133, 0.092, 0.081, -0.002),
        (1.080, 0.121, 0.087, 0.076, -0.003),
        (1.120, 0.120, 0.086, 0.078, -0.005),
        (1.170, 0.126, 0.088, 0.084, -0.009),
        (1.230, 0.135, 0.090, 0.088, -0.013),
        (1.290, 0.143, 0.086, 0.086, -0.017),
        (1.335, 0.143, 0.074, 0.080, -0.021),
        (1.370, 0.124, 0.062, 0.072, -0.025),
        (1.400, 0.094, 0.052, 0.062, -0.027),
        (1.430, 0.068, 0.046, 0.054, -0.027),
        (1.470, 0.050, 0.042, 0.046, -0.024),
    ]
)


# Bones that pull the skin: joint, start, end, radius of the flesh around [m]. The left side stands for both.
_BONES = [
    ("Hips", (0.10, 0.955, -0.005), (-0.10, 0.955, -0.005), 0.090),
    ("Hips", (0.0, 0.84, -0.005), (0.0, 1.00, -0.01), 0.085),
    ("Spine", (0.0, 1.06, -0.01), (0.0, 1.13, -0.015), 0.105),
    ("Spine1", (0.0, 1.17, -0.015), (0.0, 1.24, -0.02), 0.115),
    ("Spine2", (0.06, 1.28, -0.02), (-0.06, 1.28, -0.02), 0.085),
    ("Spine2", (0.0, 1.28, -0.02), (0.0, 1.40, -0.025), 0.085),
    ("Neck", (0.0, 1.435, -0.025), (0.0, 1.505, -0.01), 0.052),
    ("Head", (0.0, 1.535, 0.0), (0.0, 1.63, 0.0), 0.075),
    ("LeftShoulder", (0.055, 1.380, -0.015), (0.130, 1.365, -0.022), 0.042),
    ("LeftArm", (0.172, 1.339, -0.024), (0.352, 1.171, -0.030), 0.042),
    ("LeftForeArm", (0.372, 1.153, -0.029), (0.525, 1.001, -0.004), 0.033),
    ("LeftHand", (0.545, 0.980, -0.001), (0.640, 0.890, 0.008), 0.030),
    ("LeftUpLeg", (0.092, 0.840, -0.003), (0.107, 0.495, 0.006), 0.070),
    ("LeftLeg", (0.109, 0.460, 0.005), (0.119, 0.105, -0.028), 0.042),
    ("LeftFoot", (0.120, 0.060, -0.045), (0.125, 0.035, 0.075), 0.034),
    ("LeftToeBase", (0.126, 0.024, 0.100), (0.128, 0.022, 0.145), 0.032),
]

_BONE_HEAT = 4.0  # how closely the skin keeps to the nearest bone [-]


def make_mannequin(count: int = 8300, *, spacing: float = 0.011) -> dict[str, NDArray]:
    """The mannequin's mesh and weights as the data file holds them.

    Args:
        count: vertices to start from; about a tenth is taken out again for better triangles.
        spacing: of the grid that finds the surface [m].

    Returns:
        vertices [m] (n, 3) float32, faces (m, 3) uint16, joint_indices (n, 4) uint8, joint_weights (n, 4) uint16 of
        65535.
    """
    low, high = np.array([-0.77, -0.04, -0.24]), np.array([0.77, 1.76, 0.24])
    vertices, faces = even_mesh(body_field, *surface_mesh(body_field, low, high, spacing), count)
    indices, weights = strongest(skin_weights(vertices, faces))
    return {
        "vertices": vertices.astype(np.float32),
        "faces": faces.astype(np.uint16),
        "joint_indices": indices,
        "joint_weights": weights,
    }


def strongest(weights: Floats) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """Joints, shape (vertices, 4), and weights in whole parts of 65535 of the four strongest influences of a vertex."""
    order = np.argsort(-weights, axis=1, kind="stable")
    indices = order[:, :4]
    # The fifth joint's share is taken off the first four: no weight jumps where another joint becomes the fourth.
    fifth = np.take_along_axis(weights, order[:, 4:5], axis=1)
    kept = np.maximum(np.take_along_axis(weights, indices, axis=1) - np.maximum(fifth, 0.01), 0.0)
    whole = np.round(kept / kept.sum(axis=1, keepdims=True) * 65535.0)
    whole[:, 0] += 65535.0 - whole.sum(axis=1)
    return np.where(whole > 0, indices, 0).astype(np.uint8), whole.astype(np.uint16)


def skin_weights(vertices: Floats, faces: NDArray[np.int32]) -> Floats:
    """Share of every joint in the motion of every vertex [-], shape (vertices, joints); rows sum to one.

    Each bone is a source of heat that spreads over the skin (I. Baran and J. Popovic, "Automatic rigging and animation
    of 3D characters", 2007): the skin near a bone follows it, and the transition is about as wide as the limb.
    Distances are measured in radii of the limb, since the thick trunk would otherwise lose its sides to the thin arms.
    """
    names = list(JOINTS)
    nearest, owner = np.full(len(vertices), np.inf), np.zeros(len(vertices), dtype=np.int64)
    width = np.zeros(len(vertices))
    for name, start, end, radius in _BONES:
        for side, mirror in (("Left", 1.0), ("Right", -1.0)):
            a, b = np.array(start) * [mirror, 1.0, 1.0], np.array(end) * [mirror, 1.0, 1.0]
            distance = tapered_tube(vertices, a, b, [(0.0, 0.0), (1.0, 0.0)]) / radius
            closer = distance < nearest
            nearest[closer], width[closer] = distance[closer], radius
            owner[closer] = names.index(name.replace("Left", side))
    edges = edges_of(faces)[0]
    both = np.concatenate([edges, edges[:, ::-1]])
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1).mean()
    n = len(vertices)
    # Laplacian of a function on nearly equilateral triangles: 2 / (3 length^2) times the sum of the differences.
    links = sparse.csr_matrix((np.full(len(both), 2.0 / (3.0 * length**2)), tuple(both.T)), shape=(n, n))
    heat = _BONE_HEAT / (nearest * width) ** 2
    system = sparse.diags(np.asarray(links.sum(axis=1)).ravel() + heat) - links
    sources = np.zeros((n, len(names)))
    sources[np.arange(n), owner] = heat
    weights = np.maximum(splu(system.tocsc()).solve(sources), 0.0)
    return weights / weights.sum(axis=1, keepdims=True)


def body_field(points: Floats) -> Floats:
    """The mannequin's body as a solid (see :mod:`assets.implicit`).

    Args:
        points: [m], shape (n, 3).

    Returns:
        [m], shape (n,), negative inside.
    """
    mirrored = points * [-1.0, 1.0, 1.0]
    left = np.where(points[:, :1] >= 0.0, points, mirrored)
    right = np.where(points[:, :1] >= 0.0, mirrored, points)
    leg, other_leg = _leg(left), _leg(right)
    body = smooth_min(_trunk(points, left, right), smooth_min(leg, other_leg, 0.05), 0.06)
    body = smooth_min(body, _arm(left), 0.04)
    return smooth_min(body, _head(points), 0.035)


def _at(name: str) -> Floats:
    return np.array(JOINTS[name][1])


def _trunk(points: Floats, left: Floats, right: Floats) -> Floats:
    height = points[:, 1]
    trunk = loft(points, _TRUNK)
    trunk = smooth_max(trunk, np.maximum(_TRUNK[0, 0] - height, height - _TRUNK[-1, 0]), 0.04)
    for side in (left, right):
        trunk = smooth_min(trunk, _bust(side), 0.055)
        trunk = smooth_min(
            trunk, ellipsoid(side, np.array([0.076, 0.862, -0.048]), np.array([0.074, 0.098, 0.076])), 0.06
        )
    return trunk


def _bust(points: Floats) -> Floats:
    return ellipsoid(points, np.array([0.068, 1.218, 0.040]), np.array([0.060, 0.068, 0.068]))


def _arm(points: Floats) -> Floats:
    shoulder, elbow, wrist = _at("LeftArm"), _at("LeftForeArm"), _at("LeftHand")
    arm = tapered_tube(
        points,
        _at("LeftShoulder") + [0.02, -0.012, -0.004],
        shoulder + [0.0, -0.012, 0.0],
        [(0.0, 0.044), (1.0, 0.053)],
    )
    upper = tapered_tube(points, shoulder, elbow, [(0.0, 0.0475), (0.25, 0.0455), (0.6, 0.0395), (1.0, 0.0330)])
    fore = tapered_tube(points, elbow, wrist, [(0.0, 0.0335), (0.25, 0.0365), (0.65, 0.031), (1.0, 0.0235)])
    arm = smooth_min(smooth_min(arm, upper, 0.03), fore, 0.012)
    # A mitten: a flat palm with the fingers together, and a thumb.
    along = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    across = np.array([0.0, 0.0, 1.0]) - along * along[2]
    across /= np.linalg.norm(across)
    frame = np.array([along, across, np.cross(along, across)], dtype=np.float64)
    palm = ellipsoid(points, wrist + 0.055 * along + 0.004 * across, np.array([0.062, 0.040, 0.020]), frame)
    fingers = ellipsoid(points, wrist + 0.118 * along, np.array([0.066, 0.033, 0.0165]), frame)
    thumb = tapered_tube(
        points,
        wrist + 0.030 * along + 0.022 * across,
        wrist + 0.082 * along + 0.050 * across,
        [(0.0, 0.019), (1.0, 0.0165)],
    )
    hand = smooth_min(smooth_min(palm, fingers, 0.02), thumb, 0.03)
    return smooth_min(arm, hand, 0.025)


def _leg(points: Floats) -> Floats:
    hip, knee, ankle, ball = _at("LeftUpLeg"), _at("LeftLeg"), _at("LeftFoot"), _at("LeftToeBase")
    thigh = tapered_tube(
        points, hip + [0.006, -0.03, 0.0], knee, [(0.0, 0.079), (0.2, 0.078), (0.5, 0.069), (0.8, 0.055), (1.0, 0.0475)]
    )
    # The calf bulges backwards: a limb that runs a little behind the bone.
    shin = tapered_tube(points, knee, ankle, [(0.0, 0.0465), (0.2, 0.0455), (0.6, 0.037), (0.85, 0.0325), (1.0, 0.035)])
    down = ankle - knee
    calf = tapered_tube(
        points,
        knee + 0.08 * down + [0.0, 0.0, -0.010],
        knee + 0.72 * down + [0.0, 0.0, -0.004],
        [(0.0, 0.040), (0.33, 0.049), (0.6, 0.044), (1.0, 0.030)],
    )
    leg = smooth_min(smooth_min(thigh, shin, 0.016), calf, 0.02)
    heel = ellipsoid(points, np.array([ankle[0], 0.034, ankle[2] - 0.012]), np.array([0.034, 0.050, 0.044]))
    instep = tapered_tube(
        points, ankle + [0.0, -0.012, 0.008], ball + [0.0, 0.010, 0.0], [(0.0, 0.034), (0.5, 0.032), (1.0, 0.026)]
    )
    fore = ellipsoid(points, ball + [0.002, 0.002, 0.006], np.array([0.044, 0.026, 0.072]))
    foot = smooth_min(smooth_min(heel, instep, 0.035), fore, 0.035)
    foot = smooth_max(foot, -points[:, 1], 0.012)
    return smooth_min(leg, foot, 0.03)


def _head(points: Floats) -> Floats:
    neck = tapered_tube(
        points,
        np.array([0.0, 1.39, -0.032]),
        np.array([0.0, 1.535, -0.008]),
        [(0.0, 0.054), (0.4, 0.050), (1.0, 0.047)],
    )
    skull = ellipsoid(points, np.array([0.0, 1.613, -0.010]), np.array([0.072, 0.087, 0.090]))
    face = ellipsoid(points, np.array([0.0, 1.563, 0.026]), np.array([0.053, 0.080, 0.058]))
    return smooth_min(neck, smooth_min(skull, face, 0.05), 0.03)


def write_mannequin(folder: Path = DATA) -> None:
    """Make the data file of the mannequin."""
    arrays: dict[str, Any] = make_mannequin()
    with replacing(folder / "mannequin.npz") as path, open(path, "wb") as file:
        np.savez_compressed(file, **arrays)


if __name__ == "__main__":
    write_mannequin()
