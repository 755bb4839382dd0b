"""Plays the garment of a wrinkle database as plain cloth: a finer mesh is simulated, and no learned wrinkles are added.

Where a comparison has found that plain cloth costs less and is as good, :func:`player_of` plays it.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from assets.character import Character
from assets.io.sequence import Sequence
from pbd import InputError, Model, ModelOptions
from pbd.contact.colliders import Primitive
from pbd.wind import CALM, Air
from runtime.checks import check_drag, check_step
from runtime.moment import Moment
from runtime.plain_surface import PlainSurface
from runtime.player import PARTS, Player
from runtime.simulation import BodySource, Simulation, body_source
from runtime.transitions import Interpolation
from wrinkles.database import WrinkleDatabase
from wrinkles.fine_normals import FineNormals
from wrinkles.levels import Levels, held_between, levels_of
from wrinkles.surface import Subdivision

__all__ = ["PlainCloth", "PlainPlayer", "middle_levels", "plain_choice", "plain_model", "player_of"]


class PlainCloth(NamedTuple):
    """A way to play a garment as plain cloth.

    Attributes:
        cuts: how often the database's coarse mesh is subdivided before it is simulated: 0 for the coarse mesh, the
            database's ``subdivisions`` for the fine one.
        substeps: in a tick.
        passes: of relaxation of the fine mesh for what is shown; 0 shows the smooth surface.
    """

    cuts: int
    substeps: int
    passes: int = 0


def plain_choice(database: WrinkleDatabase) -> PlainCloth | None:
    """The plain cloth that a comparison found cheaper than the wrinkles and as good; None if there is none."""
    quality = database.quality
    if quality.get("cost_advantage", np.inf) >= 1.0 or quality["cost_advantage_is_at_least"]:
        return None
    for cuts in range(database.subdivisions + 1):
        if _vertex_count(database, cuts) == quality["plain_vertex_count"]:
            return PlainCloth(cuts, int(quality["plain_substeps"]), int(quality["plain_passes"]))
    return None  # of another mesh, as files of earlier versions may name it


def _vertex_count(database: WrinkleDatabase, cuts: int) -> int:
    coarse = len(database.coarse_vertices)
    return Subdivision.of(database.coarse_faces, coarse, cuts).fine_count if cuts else coarse


def middle_levels(database: WrinkleDatabase, source: BodySource, cuts: int = 1) -> Levels | None:
    """Levels from the coarse mesh subdivided ``cuts`` times to the fine mesh, whose numbering is the same.

    The middle mesh has the fine one's side lengths, as the coarse mesh has. None where so many subdivisions make the
    fine mesh already.
    """
    if database.subdivisions <= cuts:
        return None
    one = Subdivision.of(database.coarse_faces, len(database.coarse_vertices), cuts)
    # Points of the smooth surface, so that the smooth surface through them is the same.
    plain = replace(database, binding=None)
    vertices = plain.subdivision.upsample(database.coarse_vertices)[: one.fine_count]
    held = held_between(one, database.held)
    limits = database.limits.between(one.matrix)
    sewn = None if database.sewn is None else database.sewn.subdivided(cuts)
    body = (source.vertices, source.faces)
    left = database.subdivisions - cuts
    layers = database.layers
    if layers is not None:
        layers = layers.subdivided(one)
    return levels_of(
        vertices,
        one.faces,
        held,
        *body,
        left,
        database.warp,
        binding=database.binding,
        limits=limits,
        sewn=sewn,
        layers=layers,
    )


def plain_model(database: WrinkleDatabase, levels: Levels) -> Model:
    """The garment of the fabric itself, uncalibrated, on the coarse mesh of some levels.

    Args:
        database: gives fabric and pressure.
        levels: of the database, or its middle levels.
    """
    return levels.model(database.fabric, ModelOptions(pressure=database.options.pressure))


class PlainPlayer:
    """Plays one garment of a wrinkle database as plain cloth: poses in, fine vertices and normals out.

    It is used as :class:`runtime.player.Player` is, by everything that does not change the level of detail. The coarse
    vertices of the database are the first ones of the simulated mesh, so that they can be dragged by their numbers.

    Args:
        database: the garment.
        body: the character or vertex sequence that it was learned on.
        cloth: what is simulated.
        pose: pose of the body at the start: its bind pose, moved as a whole; None takes the bind pose itself.
        primitives: further colliders: planes, spheres, capsules, distance fields.

    Attributes:
        levels: coarse and fine mesh of the database.
        simulation: of the plain cloth.
        subdivision: from the simulated to the fine mesh; None where the fine mesh is simulated.
        vertices: fine vertices about ``origin`` [m], float32, shape (N, 3).
        normals: unit, float32, shape (N, 3).
        timings: processor times of the last frame by part [ms].

    Raises:
        InputError: a body that the database was not made for, a bad pose, or a plain cloth that is not there.
    """

    def __init__(
        self,
        database: WrinkleDatabase,
        body: Character | Sequence,
        cloth: PlainCloth,
        pose: np.ndarray | None = None,
        primitives: Iterable[Primitive] = (),
    ) -> None:
        database.require_body(body)
        possible = cloth.passes == 0 if cloth.cuts == database.subdivisions else cloth.passes >= 0
        if not (0 <= cloth.cuts <= database.subdivisions and cloth.substeps >= 1 and possible):
            expected = (
                f"0 to {database.subdivisions} cuts, at least 1 substep, no passes where the fine mesh is simulated"
            )
            raise InputError("no such plain cloth", key="cloth", received=tuple(cloth), expected=expected)
        bind_pose = body.bind_pose() if isinstance(body, Character) else body.vertices[0]
        start = bind_pose if pose is None else pose
        self._pose_shape = np.shape(bind_pose)
        check_step(start, self._pose_shape)
        self.database, self.cloth = database, cloth
        source = body_source(body)
        self.levels: Levels = database.levels(source.vertices, source.faces)
        self.subdivision: Subdivision | None = None
        self._surface: PlainSurface | None = None
        if cloth.cuts == database.subdivisions:
            fine = self.levels
            options = ModelOptions(pressure=database.options.pressure)
            model = fine.model(database.fabric, options, fine=True)
            attachment = fine.fine_attachment
        else:
            simulated = self.levels if cloth.cuts == 0 else middle_levels(database, source, cloth.cuts)
            assert simulated is not None
            model, attachment = plain_model(database, simulated), simulated.coarse_attachment
            self.subdivision = simulated.subdivision
            self._surface = PlainSurface(simulated, database.fabric, database.bend_factor, source, cloth.passes)
        solver = replace(database.solver, substep=1.0 / (database.frame_rate * cloth.substeps))
        self.simulation = Simulation(model, attachment, source, start, solver, primitives)
        self._between, self._alpha = Interpolation(self.simulation), 1.0
        self._write_normals = FineNormals(self.levels.subdivision)
        self.vertices, self.normals = np.zeros((2, self.levels.subdivision.fine_count, 3), np.float32)
        self.timings: dict[str, float] = dict.fromkeys(PARTS, 0.0)
        self._warm_up(start)
        self.decode()

    @property
    def origin(self) -> np.ndarray:
        """World position of the frame's origin [m], float64, shape (3,)."""
        return self.simulation.state.origin

    @property
    def body_vertices(self) -> np.ndarray:
        """The body about ``origin`` [m], float32, shape (b, 3)."""
        return self.simulation.body.current

    def smooth(self) -> np.ndarray:
        """The garment without wrinkles in the world, which here is all of it [m], float64, shape (N, 3)."""
        return self.vertices + self.origin

    def update(self, pose: np.ndarray, dt: float, wind: Air = CALM) -> None:
        """One frame: advance the cloth to a pose in ``dt`` [s] and make the fine mesh; see :meth:`step`."""
        self.step(pose, dt, wind)
        self.decode()

    def step(self, pose: np.ndarray, dt: float, wind: Air = CALM) -> None:
        """Advance the cloth.

        Args:
            pose: of the body at the end of the step.
            dt: [s].
            wind: velocity of the air [m/s].

        Raises:
            InputError: an input that is not finite or of another shape; then nothing has changed.
        """
        check_step(pose, self._pose_shape, dt, wind=wind)
        began = time.thread_time()
        origin = self.simulation.state.origin.copy()
        self._between.remember()
        self.simulation.pose_body(pose)
        self._between.move_origin(self.simulation.state.origin - origin)
        skinned = time.thread_time()
        self.simulation.step_cloth(dt, wind)
        self.timings["skin"] = 1e3 * (skinned - began)
        self.timings["coarse"] = 1e3 * (time.thread_time() - skinned)

    def decode(self, alpha: float = 1.0) -> None:
        """Make fine vertices and normals.

        Args:
            alpha: 0 for the state before the last step, 1 for the one after it, in between interpolated.
        """
        began, self._alpha = time.thread_time(), alpha
        position, body_vertices = self._between.at(alpha)
        if self._surface is None:
            self.vertices[:] = position[:, :3]
        else:
            self._surface(position, self.simulation.state, self.simulation.body, body_vertices, self.vertices)
        made = time.thread_time()
        self._write_normals(self.vertices, self.normals)
        timings = self.timings
        timings["decode"], timings["normals"] = 1e3 * (made - began), 1e3 * (time.thread_time() - made)
        timings["frame"] = sum(timings[part] for part in PARTS if part != "frame")

    def drag(self, vertex: int, target: np.ndarray | None) -> None:
        """Hold a simulated vertex at a point in the world [m], shape (3,); None lets it go.

        Raises:
            InputError: no such vertex, or a bad target.
        """
        check_drag(vertex, target, self.simulation.model.vertex_count)
        self.simulation.drag(vertex, target)

    def interpolated(self) -> tuple[np.ndarray, np.ndarray]:
        """Simulated vertices, shape (n, 4), and body, shape (b, 3), of the last picture about ``origin`` [m], float32.

        Both are valid until the next call.
        """
        return self._between.at(self._alpha)

    def keep(self) -> Moment:
        """The present moment, to which :meth:`go_back` returns."""
        return Moment.of(self.simulation, () if self._surface is None else self._surface.memory)

    def go_back(self, moment: Moment, pose: np.ndarray) -> None:
        """Show a kept moment and play on from it. A vertex that was dragged then is free.

        Args:
            moment: of the same plain cloth, in any fabric.
            pose: of the body at that moment.

        Raises:
            InputError: a pose that is not finite or of another shape; then nothing has changed.
        """
        check_step(pose, self._pose_shape)
        moment.put_back(self.simulation, pose)
        if self._surface is not None:
            self._surface.memory = moment.memory
        self._between.remember()
        self.decode()

    def _warm_up(self, pose: np.ndarray) -> None:
        """Load or compile every kernel by a step that is taken back: the first frame is as fast as the others."""
        simulation = self.simulation
        start = simulation.state.copy()
        self.step(pose, 1.0 / self.database.frame_rate)
        simulation.state, simulation.time = start, 0.0
        simulation.place_body(pose)
        self._between.remember()
        self.timings: dict[str, float] = dict.fromkeys(PARTS, 0.0)


def player_of(
    database: WrinkleDatabase,
    body: Character | Sequence,
    pose: np.ndarray | None = None,
    *,
    primitives: Iterable[Primitive] = (),
    wrinkles: bool = False,
) -> Player | PlainPlayer:
    """What plays a database best: plain cloth where a comparison found that it costs less and is as good.

    Args:
        database, body, pose, primitives: as for :class:`runtime.player.Player`.
        wrinkles: play the wrinkles in any case.
    """
    cloth = None if wrinkles else plain_choice(database)
    if cloth is None:
        return Player(database, body, pose, primitives)
    return PlainPlayer(database, body, cloth, pose, primitives)
