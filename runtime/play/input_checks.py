"""What a garment is moved by while it is played, refused at the door: poses, times, wind and drags."""

from __future__ import annotations

import numpy as np

from pbd.arrays import floats, integers
from pbd.errors import InputError
from pbd.wind import CALM, Air, Wind

__all__ = ["check_drag", "check_step"]


def check_step(pose: np.ndarray | None, shape: tuple[int, ...], dt: float = 0.0, *, wind: Air = CALM) -> None:
    """Refuse the input of a frame that cannot be taken; a pose of None is no input.

    Raises:
        InputError: a pose of another shape, a pose, time or wind that is not finite, or a time below 0.
    """
    if pose is not None:
        floats(pose, "pose", shape, "bad pose")
    if floats(dt, "dt", (), "bad time step", unit=" [s]") < 0.0:
        raise InputError("bad time step", key="dt", received=dt, expected="a finite number, at least 0 [s]")
    if not isinstance(wind, Wind):
        floats(wind, "wind", (3,), "bad wind", unit=" [m/s]")


def check_drag(vertex: int, target: np.ndarray | None, count: int) -> int:
    """Refuse to hold a vertex beyond ``count``, or at a point that is not finite; return the vertex.

    Raises:
        InputError: see above.
    """
    if target is not None:
        floats(target, "target", (3,), "bad target", unit=" [m]")
    return int(integers(vertex, "vertex", (), count, outside="no such simulated vertex"))
