"""The fine surface of plain cloth: the simulated mesh subdivided, its shortest folds brought to rest."""

from __future__ import annotations

import numpy as np

from pbd import Body, Fabric, State
from pbd.geometry import surface_normals
from pbd.taichi_internals import Launch
from runtime.simulation import BodySource
from wrinkles.decoder import Upsampler
from wrinkles.levels import Levels
from wrinkles.relaxation import Relaxation

__all__ = ["PlainSurface"]


class PlainSurface:
    """Subdivides a simulated mesh, and brings the fine garment's own forces to rest.

    Args:
        levels: from the simulated mesh to the fine one.
        fabric: of the garment.
        bend_factor: hinge factor of its meshes, see :func:`pbd.bending.hinge_calibration`; None finds it.
        source: the body, in its bind pose.
        passes: of relaxation; 0 draws the smooth surface.
    """

    def __init__(
        self, levels: Levels, fabric: Fabric, bend_factor: float | None, source: BodySource, passes: int
    ) -> None:
        self._levels, self._passes = levels, passes
        self._upsample = Upsampler(levels.subdivision)
        self._relax: Relaxation | None = None
        if passes:
            self._relax = Relaxation.of(levels, source.vertices, source.faces, fabric, bend_factor)
            count = levels.subdivision.coarse_count
            self._points, self._normals = np.zeros((2, count, 3), np.float32)
            self._frames = np.zeros((count, 9), np.float32)
            self._shade = Launch(surface_normals)

    def __call__(
        self, position: np.ndarray, state: State, body: Body, body_vertices: np.ndarray, fine: np.ndarray
    ) -> None:
        """Write fine vertices.

        Args:
            position: of the simulated vertices, float32, shape (n, 4); the first three columns are used [m].
            state: of the simulated garment; gives contacts with the body.
            body: that the garment lies on.
            body_vertices: where the body is shown [m], float32, shape (b, 3).
            fine: receives the fine vertices [m], float32, shape (N, 3).
        """
        self._upsample(position, fine)
        if self._relax is None:
            return
        self._points[:] = position[:, :3]
        self._shade(self._points, self._levels.coarse.faces, self._normals)
        self._frames[:, 6:] = self._normals
        targets = self._levels.fine_attachment.targets(body_vertices)
        self._relax(fine, targets, self._frames, state.nearest, state.contact, body, body_vertices, self._passes)

    @property
    def memory(self) -> tuple[np.ndarray | int, ...]:
        """What the relaxation remembers, see :attr:`wrinkles.relaxation.Relaxation.memory`; empty without one."""
        return () if self._relax is None else self._relax.memory

    @memory.setter
    def memory(self, memory: tuple[np.ndarray | int, ...]) -> None:
        if self._relax is not None:
            self._relax.memory = memory
