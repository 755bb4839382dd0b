"""The share of its carrier's inertial forces that a garment feels, and damping that keeps its rigid motion."""

from __future__ import annotations

import numpy as np

from pbd.state import State
from pbd.xpbd.rigid_motion import fit_rigid_transform

__all__ = ["damp_locally", "scale_inertial_forces"]


def scale_inertial_forces(
    state: State, before: np.ndarray, after: np.ndarray, linear: float, angular: float, dt: float
) -> None:
    """Let the cloth feel only a part of the inertial forces that changes of its carrier's motion cause.

    The carrier is the body or the held vertices. A vertex that moved along with it in the last frame must gain the
    difference of the carrier's velocities to do so in this frame. The linear part of that difference is the one at the
    carrier's centre. The rest is the angular part; it includes centrifugal and Coriolis forces. The vertex receives the
    share of both that the cloth shall not feel. Gravity, wind and contact stay as they are.

    Args:
        state: its ``carrier`` says how the carrier moved in the last frame, and is brought up to date.
        before, after: points of the carrier at the start and end of the frame about the state's origin [m],
            shape (k, 3), k > 0.
        linear, angular: share that the cloth feels [-], 1 for all.
        dt: frame time [s].
    """
    rotation, centre, translation = fit_rigid_transform(before, after)
    translation = centre + translation - rotation @ centre
    # Velocity now ((R - 1) x + p)/dt; in the last frame, of the point that came here, (x - R^T (x - p))/dt.
    now = np.column_stack([rotation - np.eye(3), translation]) / dt
    change = now - state.carrier
    state.carrier[:] = np.column_stack([np.eye(3) - rotation.T, rotation.T @ translation]) / dt
    at_centre = change[:, :3] @ centre + change[:, 3]
    about = (state.position[:, :3] - centre) @ change[:, :3].T
    free = state.position[:, 3] > 0.0
    state.velocity[free] += ((1.0 - linear) * at_centre + (1.0 - angular) * about)[free].astype(np.float32)


def damp_locally(state: State, mass: np.ndarray, rate: float, dt: float) -> None:
    """Damp velocities against the garment's own rigid motion (Mueller et al. 2007, "Position based dynamics", 3.5).

    Linear and angular momentum stay.

    Args:
        state: changed in place.
        mass: of the vertices [kg], shape (n,).
        rate: at which differences die away [1/s].
        dt: frame time [s].
    """
    free = state.position[:, 3] > 0.0
    x, v, m = state.position[free, :3].astype(float), state.velocity[free].astype(float), mass[free, None]
    if not len(x):
        return
    x -= (m * x).sum(axis=0) / m.sum()
    drift = (m * v).sum(axis=0) / m.sum()
    spin = (m * np.cross(x, v)).sum(axis=0)
    inertia = np.eye(3) * (m * x * x).sum() - (m * x).T @ x
    rigid = drift + np.cross(np.linalg.lstsq(inertia, spin, rcond=1e-9)[0], x)
    state.velocity[free] += ((1.0 - np.exp(-rate * dt)) * (rigid - v)).astype(np.float32)
