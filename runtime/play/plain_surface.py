"""Surfaces of plain cloth: the simulated mesh itself, or subdivided, perhaps with its shortest folds at rest."""

from __future__ import annotations

import numpy as np

from pbd import Body, ClothMesh, Fabric, State
from pbd.geometry import surface_normals
from pbd.taichi_internals import Launch
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.simulation import BodySource, Simulation
from wrinkles.decoder import Upsampler
from wrinkles.fine_normals import FineNormals
from wrinkles.levels import Levels
from wrinkles.relaxation import Relaxation
from wrinkles.surface import Subdivision

__all__ = ["SUBDIVISIONS", "PlainGarment", "PlainSurface", "SmoothGarment"]

SUBDIVISIONS = 2  # of the smooth surface of a scene's garments


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
        self,
        position: np.ndarray,
        state: State,
        body: Body,
        body_vertices: np.ndarray,
        fine: np.ndarray,
        most_passes: int | None = None,
    ) -> None:
        """Write fine vertices.

        Args:
            position: of the simulated vertices, float32, shape (n, 4); the first three columns are used [m].
            state: of the simulated garment; gives contacts with the body.
            body: that the garment lies on.
            body_vertices: where the body is shown [m], float32, shape (b, 3).
            fine: receives the fine vertices [m], float32, shape (N, 3).
            most_passes: of relaxation; None makes all.
        """
        passes = self._passes if most_passes is None else min(most_passes, self._passes)
        self._upsample(position, fine)
        if self._relax is None or not passes:
            return
        self._points[:] = position[:, :3]
        self._shade(self._points, self._levels.coarse.faces, self._normals)
        self._frames[:, 6:] = self._normals
        targets = self._levels.fine_attachment.targets(body_vertices)
        self._relax(fine, targets, self._frames, state.nearest, state.contact, body, body_vertices, passes)

    @property
    def memory(self) -> tuple[np.ndarray | int, ...]:
        """What the relaxation remembers, see :attr:`wrinkles.relaxation.Relaxation.memory`; empty without one."""
        return () if self._relax is None else self._relax.memory

    @memory.setter
    def memory(self, memory: tuple[np.ndarray | int, ...]) -> None:
        if self._relax is not None:
            self._relax.memory = memory


class PlainGarment:
    """Shows plain cloth: the simulated mesh itself, or a surface through it.

    Args:
        mesh: gives numbers and faces of the shown vertices: from any coarser mesh to the shown one.
        subdivision: from the simulated mesh to the shown one; None where the simulated mesh is shown.
        surface: brings the shown mesh to rest; None leaves it smooth.
        shaded: make normals.

    Attributes:
        vertices: about the simulation's origin [m], float32, shape (N, 3).
        normals: unit, float32, shape (N, 3); no rows where none are made.
        subdivision: the argument.
    """

    def __init__(
        self,
        mesh: Subdivision,
        subdivision: Subdivision | None,
        surface: PlainSurface | None = None,
        *,
        shaded: bool = True,
    ) -> None:
        self.subdivision, self._surface = subdivision, surface
        self._upsample = None if subdivision is None else Upsampler(subdivision)
        self._write_normals = FineNormals(mesh) if shaded else None
        self.vertices = np.zeros((mesh.fine_count, 3), np.float32)
        self.normals = np.zeros((mesh.fine_count if shaded else 0, 3), np.float32)

    def begin(self, position: np.ndarray) -> None:
        """See :meth:`runtime.play.shown_surface.Surface.begin`: it keeps nothing of it."""

    def follow(self, position: np.ndarray, dt: float) -> None:
        """See :meth:`runtime.play.shown_surface.Surface.follow`: it keeps nothing of it."""

    def make(
        self,
        position: np.ndarray,
        alpha: float,
        simulation: Simulation,
        body_vertices: np.ndarray,
        detail: LevelOfDetail,
    ) -> float:
        """Write :attr:`vertices`; see :meth:`runtime.play.shown_surface.Surface.make`."""
        if self._surface is not None:
            self._surface(position, simulation.state, simulation.body, body_vertices, self.vertices, detail.passes)
        elif self._upsample is not None:
            self._upsample(position, self.vertices)
        else:
            self.vertices[:] = position[:, :3]
        return 0.0

    @property
    def memory(self) -> tuple[np.ndarray | int, ...]:
        """What the relaxation remembers; empty without one."""
        return () if self._surface is None else self._surface.memory

    @memory.setter
    def memory(self, memory: tuple[np.ndarray | int, ...]) -> None:
        if self._surface is not None:
            self._surface.memory = memory

    def subdivide_velocity(self, velocity: np.ndarray, out: np.ndarray) -> None:
        """Velocities of the shown vertices; see :meth:`runtime.play.shown_surface.Surface.subdivide_velocity`."""
        if self._upsample is None:
            out[:] = velocity[:, :3]
        else:
            self._upsample(velocity, out)

    def update_normals(self) -> None:
        """Write :attr:`normals`, if any."""
        if self._write_normals is not None:
            self._write_normals(self.vertices, self.normals)

    def smooth(self, state: State) -> np.ndarray:
        """The garment without wrinkles in the world, which here is all of it [m], float64, shape (N, 3)."""
        return self.vertices + state.origin


class SmoothGarment(PlainGarment):
    """Shows the smooth surface through the garments of a scene.

    Args:
        mesh: that is simulated.

    Attributes:
        subdivision: from the simulated mesh to the smooth surface.
        fine: the smooth surface at the start; each simulated face has 4 ** :data:`SUBDIVISIONS` of its faces, in order.
    """

    subdivision: Subdivision

    def __init__(self, mesh: ClothMesh) -> None:
        subdivision = Subdivision.of(mesh.faces, len(mesh.vertices), SUBDIVISIONS)
        super().__init__(subdivision, subdivision, shaded=False)
        self.fine = ClothMesh.from_surface(subdivision.upsample(mesh.vertices), subdivision.cut)
