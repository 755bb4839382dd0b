"""Fine vertices and normals of a garment, made from its coarse state by what a database has learned."""

from __future__ import annotations

import time

import numpy as np

from pbd import State
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.simulation import BodySource, Simulation
from wrinkles.charts import Charts
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.database import WrinkleDatabase
from wrinkles.decoder import Decoder, Upsampler
from wrinkles.features import Stencil
from wrinkles.fine_normals import FineNormals
from wrinkles.fine_surface import FineSurface
from wrinkles.levels import Levels
from wrinkles.patches import Patches
from wrinkles.relaxation import Relaxation
from wrinkles.temporal_sharpening import TemporalSharpening

__all__ = ["FineGarment"]


class FineGarment:
    """Makes the fine mesh: subdivides, adds wrinkles and relaxes against the body.

    Args:
        database: what was learned.
        levels: coarse and fine mesh.
        source: the body, in its bind pose.

    Attributes:
        vertices: about the coarse state's origin [m], float32, shape (N, 3).
        normals: unit, float32, shape (N, 3).
    """

    def __init__(self, database: WrinkleDatabase, levels: Levels, source: BodySource) -> None:
        subdivision, charts = levels.subdivision, Charts.of(levels.coarse)
        self._levels = levels
        self._filter = CoarseFilter(levels)
        self._sharpen = TemporalSharpening(levels)
        self._upsample, self._upsample_velocity = Upsampler(subdivision), Upsampler(subdivision)
        layer = None if levels.layers is None else levels.layers.layer
        stencil, atoms = Stencil.of(charts, database.held, layer), database.atoms
        self._decoder = Decoder(stencil, database.mapping, atoms, database.novelty)
        self._surface = FineSurface(subdivision, Patches.of(subdivision, charts), atoms.vertex_mean)
        self._relax = Relaxation.of(levels, source.vertices, source.faces, database.fabric, database.bend_factor)
        self._write_normals = FineNormals(subdivision)
        self.vertices = np.zeros((subdivision.fine_count, 3), np.float32)
        self.normals = np.zeros((subdivision.fine_count, 3), np.float32)

    def begin(self, position: np.ndarray) -> None:
        """Take a state of the coarse garment as one in which it has been for long: [m], float32, shape (n, 4)."""
        self._sharpen.begin(position)

    def follow(self, position: np.ndarray, dt: float) -> None:
        """Follow a step of the coarse garment: see :meth:`wrinkles.temporal_sharpening.TemporalSharpening.follow`."""
        self._sharpen.follow(position, dt)

    def make(
        self,
        position: np.ndarray,
        alpha: float,
        simulation: Simulation,
        body_vertices: np.ndarray,
        detail: LevelOfDetail,
    ) -> float:
        """Write :attr:`vertices`; see :meth:`runtime.play.shown_surface.Surface.make`."""
        state, body = simulation.state, simulation.body
        position = self._filter(self._sharpen(position, alpha))
        decoder, drawn = self._decoder, detail.atoms > 0
        self._upsample.to_middle(position)
        if drawn:
            decoder.predict(position, state.contact, detail.atoms)
        elif detail.passes:
            decoder.read(position, state.contact)
        grids = decoder.grids if drawn else None
        self._surface(self._upsample.middle, grids, decoder.frames, self.vertices)
        began = time.thread_time()
        targets = self._levels.fine_attachment.targets(body_vertices)
        if detail.passes:
            self._relax(
                self.vertices, targets, decoder.frames, state.nearest, state.contact, body, body_vertices, detail.passes
            )
        else:
            self.vertices[self._levels.fine_held] = targets
        return 1e3 * (time.thread_time() - began)

    @property
    def novelty_score(self) -> np.ndarray:
        """Log of the error that the dictionary expects at each coarse vertex [log deg], float32, shape (n,)."""
        return self._decoder.score

    @property
    def memory(self) -> tuple[np.ndarray | int, ...]:
        """What sharpening and relaxation remember, a copy; may be set again."""
        return *self._sharpen.memory, *self._relax.memory

    @memory.setter
    def memory(self, memory: tuple[np.ndarray | int, ...]) -> None:
        count = len(self._sharpen.memory)
        self._sharpen.memory, self._relax.memory = memory[:count], memory[count:]

    def sample(
        self, position: np.ndarray, simulation: Simulation, body_vertices: np.ndarray, detail: LevelOfDetail
    ) -> np.ndarray:
        """Vertices as :meth:`make` makes them, float32, shape (N, 3); the garment itself stays as it is."""
        kept, memory = self.vertices.copy(), self._relax.memory
        self.make(position, 1.0, simulation, body_vertices, detail)
        made = self.vertices.copy()
        self.vertices[:], self._relax.memory = kept, memory
        return made

    def subdivide_velocity(self, velocity: np.ndarray, out: np.ndarray) -> None:
        """Velocities of the fine vertices; see :meth:`runtime.play.shown_surface.Surface.subdivide_velocity`."""
        self._upsample_velocity(self._filter(velocity), out)

    def update_normals(self) -> None:
        """Write :attr:`normals`; vertices along a cut in the mesh have the normal of the vertex that they stand for."""
        self._write_normals(self.vertices, self.normals)

    def smooth(self, state: State) -> np.ndarray:
        """The garment without wrinkles in the world [m], float64, shape (N, 3)."""
        return self._levels.subdivision.upsample(state.world())
