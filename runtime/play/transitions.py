"""What a player shows between two states: interpolated, carried on, or faded from one detail to another."""

from __future__ import annotations

import numpy as np

from runtime.play.shown_surface import Surface
from runtime.play.simulation import Simulation

__all__ = ["FADE", "Extrapolation", "Fade", "Interpolation"]

FADE = 0.3  # a change of detail is drawn over this time [s]


class Interpolation:
    """Coarse garment and body between the last two states of a simulation.

    Args:
        simulation: of the coarse garment, at its start.

    Attributes:
        before: the coarse vertices before the last step, about the origin after it [m], float32, shape (n, 4).
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._position = simulation.state.position.copy()
        self.before = self._position.copy()
        self._body = np.zeros_like(simulation.body.current)

    def remember(self) -> None:
        """Keep the present state as the one before the next step."""
        self.before[:] = self._simulation.state.position

    def move_origin(self, shift: np.ndarray) -> None:
        """Follow the origin, which the next step has moved by ``shift`` [m], float64, shape (3,)."""
        if shift.any():
            self.before[:, :3] -= shift.astype(np.float32)

    def at(self, alpha: float) -> tuple[np.ndarray, np.ndarray]:
        """Coarse vertices, shape (n, 4), and those of the body, shape (b, 3) [m], float32: valid until the next call.

        Args:
            alpha: 0 for the state before the last step, 1 for the one after it.
        """
        state, body = self._simulation.state, self._simulation.body
        if alpha == 1.0:
            return state.position, body.current
        np.subtract(state.position, self.before, out=self._position)
        self._position *= np.float32(alpha)
        self._position += self.before
        np.subtract(body.current, body.previous, out=self._body)
        self._body *= np.float32(alpha)
        self._body += body.previous
        return self._position, self._body


class Extrapolation:
    """Fine vertices in ticks without an update: those of the last update, carried on at their velocity.

    Args:
        simulation: of the coarse garment.
        surface: the fine garment.

    Attributes:
        started: whether the last update is the one that is carried on.
    """

    def __init__(self, simulation: Simulation, surface: Surface) -> None:
        self._simulation, self._surface = simulation, surface
        self._coarse_velocity = np.zeros_like(simulation.state.position)  # padded as positions are
        self._velocity, self._updated = np.zeros_like(surface.vertices), np.zeros_like(surface.vertices)
        self.started = False

    def start(self) -> None:
        """Carry on from the fine vertices as they are."""
        self._coarse_velocity[:, :3] = self._simulation.state.velocity
        self._surface.subdivide_velocity(self._coarse_velocity, self._velocity)
        np.copyto(self._updated, self._surface.vertices)
        self.started = True

    def show(self, seconds: float) -> None:
        """Write the fine vertices as they are so long after the last update [s]."""
        np.multiply(self._velocity, np.float32(seconds), out=self._surface.vertices)
        self._surface.vertices += self._updated


class Fade:
    """Lets the difference between two details vanish within :data:`FADE`, so that nothing jumps.

    Args:
        vertices: what is shown [m], float32, shape (N, 3).
    """

    def __init__(self, vertices: np.ndarray) -> None:
        self._vertices = vertices
        self._offset, self._scratch = np.zeros_like(vertices), np.zeros_like(vertices)
        self._left = 0.0  # of the offset: from 1 to 0

    def prepare(self) -> None:
        """Keep what is shown, and show the vertices as they are until :meth:`start`."""
        np.copyto(self._scratch, self._vertices)
        self._left = 0.0

    def start_from(self, shown: np.ndarray) -> None:
        """Show other vertices [m], float32, shape (N, 3), and let their difference vanish from now on."""
        np.copyto(self._scratch, shown)
        self.start()

    def start(self) -> None:
        """Show again what was kept, and let its difference to the vertices vanish from now on."""
        np.subtract(self._scratch, self._vertices, out=self._offset)
        np.copyto(self._vertices, self._scratch)
        self._left = 1.0

    def advance(self, dt: float) -> None:
        """Let a time pass [s]."""
        self._left = max(0.0, self._left - dt / FADE)

    def add(self) -> None:
        """Add to the vertices as much of the difference as is left."""
        if self._left > 0.0:
            np.multiply(self._offset, self._left * self._left * (3.0 - 2.0 * self._left), out=self._scratch)
            self._vertices += self._scratch
