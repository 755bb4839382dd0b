"""A moment of a garment's motion that is kept, so that it can be shown and played on from again."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pbd import State
from runtime.play.simulation import Simulation

__all__ = ["Moment"]


class Moment(NamedTuple):
    """The state of a simulated garment at one time.

    Attributes:
        state: a copy of the garment's state.
        time: time since the start, at which turbulent wind is taken [s].
        memory: of what makes the fine mesh; empty without one.
    """

    state: State
    time: float
    memory: tuple[np.ndarray | int, ...] = ()

    @classmethod
    def of(cls, simulation: Simulation, memory: tuple[np.ndarray | int, ...] = ()) -> Moment:
        """The present moment of a simulation."""
        return cls(simulation.state.copy(), simulation.time, memory)

    @property
    def byte_count(self) -> int:
        """Size in memory [bytes]."""
        arrays = [getattr(self.state, name) for name in State._names] + [*self.memory]
        return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))

    def put_back(self, simulation: Simulation, pose: np.ndarray | None) -> None:
        """Bring a simulation back to this moment; a vertex that was dragged then is free.

        Args:
            simulation: of the same mesh; fabric and options may be others.
            pose: of the body at this moment; None without a body.
        """
        simulation.state, simulation.time = self.state.copy(), self.time
        simulation.state.position[:, 3] = simulation.model.inverse_mass
        if pose is None:
            return
        body = simulation.body
        probes = body.probes, body.probe_weights  # chosen by the first pose, for the whole motion
        simulation.place_body(pose)
        body.probes, body.probe_weights = probes
