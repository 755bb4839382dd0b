"""What is shown of a simulated garment: what a player asks of learned wrinkles and of plain cloth."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from pbd import State
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.simulation import Simulation

__all__ = ["Surface"]


class Surface(Protocol):
    """Makes the mesh that is shown from the simulated one.

    Attributes:
        vertices: about the simulation's origin [m], float32, shape (N, 3).
        normals: unit, float32, shape (N, 3); no rows where none are made.
        memory: what it keeps from one frame to the next, a copy; may be set again.
    """

    vertices: np.ndarray
    normals: np.ndarray

    @property
    def memory(self) -> tuple[np.ndarray | int, ...]: ...

    @memory.setter
    def memory(self, memory: tuple[np.ndarray | int, ...]) -> None: ...

    def begin(self, position: np.ndarray) -> None:
        """Take a state as one in which the garment has been for long: its positions [m], float32, shape (n, 4)."""
        ...

    def follow(self, position: np.ndarray, dt: float) -> None:
        """Follow a step of the simulation of ``dt`` [s] to these positions [m], float32, shape (n, 4)."""
        ...

    def make(
        self,
        position: np.ndarray,
        alpha: float,
        simulation: Simulation,
        body_vertices: np.ndarray,
        detail: LevelOfDetail,
    ) -> float:
        """Write :attr:`vertices`.

        Args:
            position: of the simulated vertices, float32, shape (n, 4); the first three columns are used [m].
            alpha: where they are between the last two states: 1 at the last one.
            simulation: of the garment; gives its body and its contacts with it.
            body_vertices: where the body is shown [m], float32, shape (b, 3).
            detail: says how many parts of the work are done, and how often.

        Returns:
            processor time of relaxation [ms]; 0 where it is not distinguished.
        """
        ...

    def update_normals(self) -> None:
        """Write :attr:`normals`."""
        ...

    def subdivide_velocity(self, velocity: np.ndarray, out: np.ndarray) -> None:
        """Velocities of the shown vertices without wrinkles.

        Args:
            velocity: of the simulated vertices, float32, shape (n, 4); the first three columns are used [m/s].
            out: gets those of the shown ones [m/s], float32, shape (N, 3).
        """
        ...

    def smooth(self, state: State) -> np.ndarray:
        """The garment in a state without wrinkles, in the world [m], float64, shape (N, 3)."""
        ...
