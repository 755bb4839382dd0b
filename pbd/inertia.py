"""How much of the motion of what carries it a garment feels, and damping that leaves its motion as a whole alone."""

from __future__ import annotations

import numpy as np

from pbd.model import State
from pbd.pace import rigid_motion

__all__ = ["damp_locally", "relieve"]


def relieve(state: State, before: np.ndarray, after: np.ndarray, linear: float, angular: float, dt: float) -> None:
    """Let the cloth go along with a change of the motion of what carries it, but for a part that it feels.

    A vertex that moved with the carrier in the last frame would have to gain the difference of the carrier's velocities
    there to do so in this one: the linear part of it is that at the carrier's centre, the angular one, centrifugal
    and Coriolis forces included, the rest. It is given what it shall not feel. Gravity, wind and contact stay whole.

    Args:
        state: its ``carrier`` says how the carrier moved in the last frame, and is brought up to date.
        before, after: points of the carrier at the start and end of the frame about the state's origin [m],
            shape (k, 3), k > 0.
        linear, angular: part that is felt [-], 1 for all.
        dt: frame time [s].
    """
    turn, centre, way = rigid_motion(before, after)
    way = centre + way - turn @ centre
    # Velocity now ((R - 1) x + p)/dt, and in the last frame, of what came here, (x - R^T (x - p))/dt.
    now = np.column_stack([turn - np.eye(3), way]) / dt
    change = now - state.carrier
    state.carrier[:] = np.column_stack([np.eye(3) - turn.T, turn.T @ way]) / dt
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
