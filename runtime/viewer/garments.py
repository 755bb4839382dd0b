"""What a viewer shows: the meshes of a garment that is played, their positions, and the values that colour them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from assets.character import Character
from assets.io.sequence import Sequence
from assets.motion import Motion
from pbd import ClothMesh, Fabric, Solver, build_model
from runtime.draw.shown_body import insets
from runtime.play.fine_garment import FineGarment
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.plain_surface import SUBDIVISIONS, PlainGarment, SmoothGarment
from runtime.play.player import Player
from runtime.viewer.colors import CLOTH, FaceBending, FaceStrain, place
from wrinkles.decoder import Upsampler
from wrinkles.levels import garment_vertices

__all__ = ["FabricFactors", "ShownTruth", "ViewedGarment", "ViewedMesh"]

COARSE, SMOOTH, OURS, PLAIN, TRUTH = "coarse", "smooth", "ours", "plain cloth", "truth"


class FabricFactors(NamedTuple):
    """Factors on the fabric of a garment [-].

    Attributes:
        bending, stretch, weight: factors on bending stiffness, on stretch and shear stiffness, and on mass per area.
    """

    bending: float = 1.0
    stretch: float = 1.0
    weight: float = 1.0

    def applied(self, fabric: Fabric) -> Fabric:
        """The fabric with these factors."""
        return replace(
            fabric,
            areal_density=self.weight * fabric.areal_density,
            bend_warp=self.bending * fabric.bend_warp,
            bend_weft=self.bending * fabric.bend_weft,
            stretch_warp=self.stretch * fabric.stretch_warp,
            stretch_weft=self.stretch * fabric.stretch_weft,
            shear=self.stretch * fabric.shear,
        )


@dataclass(frozen=True)
class ShownTruth:
    """A recorded fine simulation of a motion.

    Attributes:
        ticks: number of the tick of each frame, ascending, int, shape (f,).
        positions: world [m], float32, shape (f, N, 3).
    """

    ticks: np.ndarray
    positions: np.ndarray

    def at(self, tick: float) -> np.ndarray:
        """Positions at a tick, between two frames interpolated [m], float32, shape (N, 3)."""
        after = int(np.clip(np.searchsorted(self.ticks, tick), 1, len(self.ticks) - 1)) if len(self.ticks) > 1 else 0
        before = max(after - 1, 0)
        length = max(1, self.ticks[after] - self.ticks[before])
        share = np.float32(np.clip((tick - self.ticks[before]) / length, 0.0, 1.0))
        return self.positions[before] + share * (self.positions[after] - self.positions[before])


class ViewedMesh:
    """A mesh of a garment and what its colours are computed from.

    Args:
        cloth: gives faces and rest shape.
        faces: as they are drawn, int, shape (m, 3); None for those of the cloth.
        from_simulated: matrix from values at simulated vertices to those at its own; None if these are the same.
    """

    def __init__(
        self, cloth: ClothMesh, faces: np.ndarray | None = None, from_simulated: csr_matrix | None = None
    ) -> None:
        self.cloth, self._from_simulated = cloth, from_simulated
        self.faces = cloth.faces if faces is None else faces

    @cached_property
    def strain(self) -> FaceStrain:
        """Strain of its faces."""
        return FaceStrain(self.cloth)

    @cached_property
    def bending(self) -> FaceBending:
        """Curvature at its faces."""
        return FaceBending(self.cloth)

    def at_faces(self, values: np.ndarray) -> np.ndarray:
        """Means over the corners of each face, shape (m,), of values at simulated vertices, shape (n,)."""
        own = values if self._from_simulated is None else self._from_simulated @ values
        return own[self.cloth.faces].mean(axis=1)


class ViewedGarment:
    """A player and the meshes that it can show.

    Args:
        player: plays the garment, at the start of the motion.
        motion: of the body; None without one.
        body: as it is drawn, see :mod:`runtime.draw.shown_body`; None without one.
        texture: texture coordinates of each face corner of the main mesh, shape (m, 3, 2); None without any.
        truth: a recorded fine simulation of the motion, if there is one.

    Attributes:
        meshes: by name, from the coarsest on.
        body, motion, player, texture: the arguments.
        body_faces: of the body that are drawn, int, shape (k, 3); no faces without one.
        wrinkled: whether its wrinkles are played.
        details: levels of detail that it can be played at, the full one first; none where it has no such levels.
    """

    def __init__(
        self,
        player: Player,
        motion: Motion | None,
        body: Character | Sequence | None,
        texture: np.ndarray | None,
        truth: ShownTruth | None = None,
    ) -> None:
        self.player, self.motion, self.body, self.texture, self._truth = player, motion, body, texture, truth
        self.wrinkled = isinstance(player.surface, FineGarment)
        self.details: dict[str, LevelOfDetail] = details_of(player) if self.wrinkled else {}
        self.meshes = self._meshes()
        self._smooth: Upsampler | None = None
        if self.wrinkled:
            self._smooth = Upsampler(player.levels.subdivision)
            self._smooth_vertices = np.zeros_like(player.vertices)
        self._fabric = player.simulation.model.fabric
        self.body_faces = np.zeros((0, 3), np.int32) if body is None else body.faces
        source, model = player.simulation.source, player.simulation.model
        self._insets = (
            None if source is None else insets(model.mesh, model.layer, source.vertices, source.faces)[:, None]
        )

    def _meshes(self) -> dict[str, ViewedMesh]:
        simulated, surface = ViewedMesh(self.player.simulation.model.mesh), self.player.surface
        if isinstance(surface, SmoothGarment):
            return {COARSE: simulated, SMOOTH: ViewedMesh(surface.fine, from_simulated=surface.subdivision.matrix)}
        levels = self.player.levels
        subdivision = surface.subdivision if isinstance(surface, PlainGarment) else levels.subdivision
        matrix = None if subdivision is None else subdivision.matrix
        fine = ViewedMesh(levels.fine, levels.subdivision.faces, matrix)
        meshes = {COARSE: simulated, SMOOTH: fine, OURS: fine} if self.wrinkled else {PLAIN: fine}
        return meshes if self._truth is None else meshes | {TRUTH: fine}

    @property
    def worn(self) -> tuple[str, ...]:
        """Names of the garments that are worn; none where none can be taken off."""
        return self.player.worn

    @property
    def vertices_of_garments(self) -> dict[str, np.ndarray] | None:
        """Fine vertices of each garment of an outfit by its name; None for anything else."""
        return garment_vertices(self.player.levels) if self.wrinkled else None

    @property
    def main(self) -> str:
        """Name of the mesh that a game would draw."""
        return next(name for name in (OURS, PLAIN, SMOOTH) if name in self.meshes)

    def vertices(self, name: str, tick: float) -> np.ndarray:
        """Vertices of a mesh about the player's origin [m], float32, shape (n, 3).

        Args:
            name: of the mesh.
            tick: of the picture, for the truth.
        """
        player = self.player
        if name == COARSE:
            return player.interpolated()[0][:, :3]
        if name == TRUTH:
            assert self._truth is not None
            return self._truth.at(tick) - player.origin.astype(np.float32)
        if name == SMOOTH and self._smooth is not None:
            self._smooth(player.interpolated()[0], self._smooth_vertices)
            return self._smooth_vertices
        return player.vertices

    def body_vertices(self) -> np.ndarray:
        """Vertices of the body as it is drawn, about the player's origin [m], float32, shape (b, 3)."""
        vertices = self.player.interpolated()[1]
        if self._insets is None:
            return vertices
        return vertices - self._insets * self.player.simulation.body.normals

    def values(self, name: str, coloring: str, vertices: np.ndarray) -> np.ndarray | None:
        """Values that colour the faces of a mesh, shape (m,); None where they are not known of it.

        Args:
            name: of the mesh.
            coloring: a key of :data:`runtime.viewer.colors.SCALES`, or its CLOTH, which tells garments of an outfit.
            vertices: of the mesh [m], float32, shape (n, 3).
        """
        mesh, player = self.meshes[name], self.player
        if coloring == CLOTH:
            layer = player.simulation.model.layer
            return place(np.round(mesh.at_faces(layer.astype(np.float32)))) if layer.any() else None
        if coloring == "strain" and name == SMOOTH and isinstance(player.surface, SmoothGarment):
            simulated = self.meshes[COARSE].strain(self.vertices(COARSE, 0.0))  # of the surface no rest shape is known
            return np.repeat(simulated, 4**SUBDIVISIONS)
        if coloring == "strain":
            return mesh.strain(vertices)
        if coloring == "bending":
            return mesh.bending(vertices)
        if name == TRUTH:
            return None
        if coloring == "contact":
            return 1e3 * mesh.at_faces(player.simulation.state.contact)
        if not self.wrinkled:
            return None
        if coloring == "novelty":
            return mesh.at_faces(player.predicted_error()) if player.detail.atoms else None
        index = list(self.details.values()).index(player.detail)
        return np.full(len(mesh.faces), place(index if name == OURS else len(self.details)), np.float32)

    def colors_by(self, coloring: str) -> bool:
        """Whether a key of :data:`runtime.viewer.colors.SCALES` colours any of the meshes."""
        if coloring in ("novelty", "level of detail"):
            return self.wrinkled
        return coloring != "contact" or len(self.body_faces) > 0

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of the kinds that the level of detail colours."""
        return (*self.details, "another mesh")

    def set_detail(self, name: str) -> None:
        """Play at another level of detail.

        Args:
            name: a key of :attr:`details`.
        """
        self.player.change(self.details[name])

    def wear(self, factors: FabricFactors) -> None:
        """Give the simulated garment other stiffness and weight. The wrinkles stay those of the learned fabric."""
        simulation = self.player.simulation
        model = simulation.model
        fabric = factors.applied(self._fabric)
        simulation.model = build_model(
            model.mesh, fabric, model.held, options=model.options, bend_factor=model.bend_factor, limits=model.limits
        )
        simulation.solver = Solver(simulation.model, simulation.solver.options)
        simulation.state.position[:, 3] = simulation.model.inverse_mass


def details_of(player: Player) -> dict[str, LevelOfDetail]:
    """Levels of detail of a player by name, from the full one downwards."""
    full = player.full
    few = max(1, full.atoms // 4)
    return {
        "full": full,
        "a quarter of the atoms": replace(full, atoms=few),
        "every 2nd tick": replace(full, every=2),
        "every 2nd tick, a quarter of the atoms": replace(full, every=2, atoms=few),
        "no wrinkles": replace(full, atoms=0),
    }
