"""Plays the garments of a scene as they are simulated, without a database: poses in, vertices out."""

from __future__ import annotations

import time

import numpy as np

from pbd import ClothMesh
from pbd.wind import CALM, Air
from runtime.checks import check_drag
from runtime.moment import Moment
from runtime.player import PARTS
from runtime.simulation import Simulation
from runtime.transitions import Interpolation
from wrinkles.decoder import Upsampler
from wrinkles.surface import Subdivision

__all__ = ["SUBDIVISIONS", "ScenePlayer"]

SUBDIVISIONS = 2  # of the smooth surface


class ScenePlayer:
    """Plays a simulation as :class:`runtime.plain_player.PlainPlayer` plays plain cloth, also without a body.

    Args:
        simulation: of the garments, at its start.
        pose: pose of the body at the start; None without a body.
        dt: length of a tick [s].

    Attributes:
        simulation: of the garments.
        subdivision: from the simulated mesh to the smooth surface.
        fine: the smooth surface at the start; each simulated face has 4 ** :data:`SUBDIVISIONS` of its faces, in order.
        vertices: of the smooth surface about ``origin`` [m], float32, shape (N, 3).
        timings: processor times of the last frame by part [ms].
    """

    def __init__(self, simulation: Simulation, pose: np.ndarray | None, dt: float) -> None:
        self.simulation = simulation
        mesh = simulation.model.mesh
        self.subdivision = Subdivision.of(mesh.faces, len(mesh.vertices), SUBDIVISIONS)
        self.fine = ClothMesh.from_surface(self.subdivision.upsample(mesh.vertices), self.subdivision.cut)
        self._upsample = Upsampler(self.subdivision)
        self.vertices = np.zeros((self.subdivision.fine_count, 3), np.float32)
        self._between, self._alpha = Interpolation(simulation), 1.0
        self.timings: dict[str, float] = dict.fromkeys(PARTS, 0.0)
        start = self.keep()
        self.step(pose, dt)  # loads or compiles every kernel
        self.go_back(start, pose)

    @property
    def origin(self) -> np.ndarray:
        """World position of the frame's origin [m], float64, shape (3,)."""
        return self.simulation.state.origin

    def step(self, pose: np.ndarray | None, dt: float, wind: Air = CALM) -> None:
        """Advance the garments by ``dt`` [s] to a pose; see :meth:`runtime.simulation.Simulation.step`."""
        simulation = self.simulation
        began, origin = time.thread_time(), simulation.state.origin.copy()
        self._between.remember()
        simulation.pose_body(pose)
        self._between.move_origin(simulation.state.origin - origin)
        skinned = time.thread_time()
        simulation.step_cloth(dt, wind)
        self.timings["skin"] = 1e3 * (skinned - began)
        self.timings["coarse"] = 1e3 * (time.thread_time() - skinned)

    def decode(self, alpha: float = 1.0) -> None:
        """Make the smooth surface between the state before the last step (0) and the one after it (1)."""
        began, self._alpha = time.thread_time(), alpha
        self._upsample(self._between.at(alpha)[0], self.vertices)
        self.timings["decode"] = 1e3 * (time.thread_time() - began)
        self.timings["frame"] = sum(self.timings[part] for part in PARTS if part != "frame")

    def interpolated(self) -> tuple[np.ndarray, np.ndarray]:
        """Simulated vertices, shape (n, 4), and body, shape (b, 3), of the last picture about ``origin`` [m], float32.

        Both are valid until the next call.
        """
        return self._between.at(self._alpha)

    def drag(self, vertex: int, target: np.ndarray | None) -> None:
        """Hold a vertex at a point in the world [m], shape (3,); None lets it go.

        Raises:
            InputError: no such vertex, or a bad target.
        """
        check_drag(vertex, target, self.simulation.model.vertex_count)
        self.simulation.drag(vertex, target)

    def keep(self) -> Moment:
        """The present moment, to which :meth:`go_back` returns."""
        return Moment.of(self.simulation)

    def go_back(self, moment: Moment, pose: np.ndarray | None) -> None:
        """Show a kept moment and play on from it. A vertex that was dragged then is free.

        Args:
            moment: of the same garments, in any fabric.
            pose: of the body at that moment; None without a body.
        """
        moment.put_back(self.simulation, pose)
        self._between.remember()
        self.decode()
