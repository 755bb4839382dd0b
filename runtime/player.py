"""Plays a wrinkle database: pose and dt in, fine vertices and normals out."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from assets.character import Character
from assets.io.sequence import Sequence
from pbd import InputError
from pbd.contact.colliders import Primitive
from pbd.wind import CALM, Air
from runtime.checks import check_drag, check_step
from runtime.dressing import Stay, place_on_body, settle, take_over
from runtime.fine_garment import FineGarment
from runtime.level_of_detail import LevelOfDetail
from runtime.moment import Moment
from runtime.proxy_simulation import ProxySimulation
from runtime.simulation import Simulation, body_source
from runtime.transitions import FADE, Extrapolation, Fade, Interpolation
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import Levels
from wrinkles.proxy_mesh import proxy_mesh_of
from wrinkles.relaxation import PASSES
from wrinkles.worn_garments import garment_names, with_garments

__all__ = ["FADE", "PARTS", "Player"]

DRESSED = (
    "database", "levels", "simulation", "_fine", "vertices", "normals", "_between", "_extrapolation", "_fade", "full",
    "_coarser", "start",
)  # fmt: skip
"""Attributes of a player that belong to the garments that are worn."""
PARTS = ("skin", "coarse", "decode", "relax", "normals", "frame")  # of a frame's time


class Player:
    """Plays one garment of a wrinkle database on one body: poses in, fine vertices and normals out.

    A frame allocates no memory, except for small matrices of NumPy.

    Args:
        database: the garment and its wrinkles.
        body: the character or vertex sequence that it was learned on.
        pose: pose of the body at the start: its bind pose, moved as a whole; None takes the bind pose itself.
        primitives: further colliders of the coarse garment: planes, spheres, capsules, distance fields.
        fabric: name of a fabric of the database; None takes the garment's own.

    Attributes:
        levels: coarse and fine mesh.
        vertices: fine vertices about ``origin`` [m], float32, shape (N, 3).
        normals: unit, float32, shape (N, 3).
        timings: processor times of the last frame by part [ms].
        full: the most detail there is; the player begins with it.
        start: the moment at which the garments that are worn would begin.

    Raises:
        InputError: a body that the database was not made for, a fabric that it was not learned in, or a bad pose.
    """

    def __init__(
        self,
        database: WrinkleDatabase,
        body: Character | Sequence,
        pose: np.ndarray | None = None,
        primitives: Iterable[Primitive] = (),
        fabric: str | None = None,
    ) -> None:
        database.require_body(body)
        bind_pose = body.bind_pose() if isinstance(body, Character) else body.vertices[0]
        self._start_pose = start = bind_pose if pose is None else pose
        if fabric is not None:
            database = database.in_fabric(fabric)
        self._pose_shape = (len(body.joint_names), 3, 4) if isinstance(body, Character) else body.vertices.shape[1:]
        check_step(start, self._pose_shape)
        self._outfit, self._source, self._primitives = database, body_source(body), tuple(primitives)
        self._dressed: dict[tuple[str, ...], dict[str, Any]] = {}  # what was made for other sets of garments
        self._unfastened: set[str] = set()
        self._idle, self._dt, self._wait = 0.0, 0.0, 0  # since the last update, last tick [s]; ticks to leave out
        self._alpha = 1.0
        self.timings: dict[str, float] = dict.fromkeys(PARTS, 0.0)
        self._dress(database, start)

    def _dress(self, database: WrinkleDatabase, start: np.ndarray) -> None:
        """Make all that depends on the garments that are worn, at a pose of the body."""
        source = self._source
        self.database = database
        self.levels: Levels = database.levels(source.vertices, source.faces)
        rest = database.rest_shape.applied(self.levels.coarse)
        model = self.levels.model(database.fabric, database.options, bend_factor=database.bend_factor, mesh=rest)
        self.simulation = Simulation(
            model, self.levels.coarse_attachment, source, start, database.solver, self._primitives
        )
        self._fine = FineGarment(database, self.levels, source)
        self.vertices, self.normals = self._fine.vertices, self._fine.normals
        self._between = Interpolation(self.simulation)
        self._extrapolation = Extrapolation(self.simulation, self._fine)
        self._fade = Fade(self.vertices)
        substeps = max(1, int(np.ceil(1.0 / (database.frame_rate * database.solver.substep) - 1e-6)))
        self.full = LevelOfDetail(1, substeps, len(database.atoms.shapes), PASSES)
        self._detail = self.full
        self._coarser: ProxySimulation | None = None  # made when it is first asked for
        self._warm_up(start)
        self.decode()
        self.start = self.keep()

    @property
    def worn(self) -> tuple[str, ...]:
        """Names of the garments that are worn, from the innermost outwards."""
        return garment_names(self.database)

    def wear(self, names: Iterable[str]) -> None:
        """Put garments of an outfit on and take others off; those that stay on keep their state, without a jump.

        A garment that is put on is placed where the body carries it from the bind pose, and settles within this call.
        ``database``, ``levels``, ``simulation``, ``vertices`` and ``normals`` are others after it. The first call with
        a set of garments makes what these need in a second or two; the player keeps that for the next time, so that
        taking off then costs a few frames and putting on some tenths of a second. A vertex that was dragged is free.

        Args:
            names: of garments of the outfit; the order in which they are worn is that of the outfit.

        Raises:
            InputError: no garment, or one that the outfit does not have; then nothing has changed.
        """
        database = with_garments(self._outfit, names)
        before, worn = self.worn, garment_names(database)
        if worn == before:
            return
        if self._detail.level:  # the mesh below the coarse one is another for other garments
            self.change(replace(self._detail, level=0), self._wait, fade=False)
        old_database, old_simulation, shown = self.database, self.simulation, self.vertices.copy()
        old_between, detail, times = self._between.before, self._detail, (self._idle, self._dt, self._wait)
        self._dressed[before] = {name: getattr(self, name) for name in DRESSED}
        if worn in self._dressed:
            vars(self).update(self._dressed[worn])
        else:
            self._dress(database, self._start_pose)
        stay = Stay.between(old_database, self.database)
        simulation = self.simulation
        take_over(old_simulation, simulation, stay)
        if len(stay.new):
            place_on_body(simulation, self.levels.coarse.vertices, stay.new)
            settle(simulation, stay.new)
        for name in self._fastened():
            self._fasten(name, name not in self._unfastened)
        self._between.remember()
        self._between.before[stay.coarse, :3] = old_between[stay.before, :3]
        simulation.solver.options = old_simulation.solver.options
        self._fine.begin(simulation.state.position)
        self._detail, self._extrapolation.started = detail, False
        self._idle, self._dt, self._wait = times
        self._fade.prepare()
        self.decode(self._alpha)
        now = self.vertices.copy()
        now[stay.fine] = shown[stay.fine_before]
        self._fade.start_from(now)

    @property
    def origin(self) -> np.ndarray:
        """World position of the frame's origin [m], float64, shape (3,)."""
        return self.simulation.state.origin

    @property
    def body_vertices(self) -> np.ndarray:
        """The body about ``origin`` [m], float32, shape (b, 3)."""
        return self.simulation.body.current

    @property
    def detail(self) -> LevelOfDetail:
        """How much is modelled; see :meth:`change`."""
        return self._detail

    def change(self, detail: LevelOfDetail, wait: int = 0, *, fade: bool = True) -> None:
        """Model more or less from now on. The coarse state goes on as it is, and nothing pops.

        The shown vertices stay where they are; their distance from the same state at the new detail fades within
        :data:`FADE`.

        Args:
            detail: how much to model; more atoms than the dictionary has count as all of them.
            wait: ticks that are left out before the next update, fewer than the detail's ``every``: garments that share
                a frame take turns.
            fade: False shows the new detail at once: after a cut there is no picture that it could jump in.
        """
        self._wait = min(wait, detail.every - 1)
        if detail == self._detail:
            return
        if detail.level:
            self.prepare([detail])
        self._fade.prepare()
        before, self._detail, self._extrapolation.started = self._detail, detail, False
        substep = self.database.solver.substep
        if (detail.every, detail.substeps) != (self.full.every, self.full.substeps):
            substep = detail.every / (self.database.frame_rate * detail.substeps)
        self._moved.solver.options = replace(self.database.solver, substep=substep)
        if self._coarser is not None and detail.level > before.level:
            self._coarser.take_over()
            self._between.before[:, :3] = self._coarser.carried(self._between.before[:, :3])
        elif self._coarser is not None and detail.level < before.level:
            self._coarser.give_back()
        self.decode(self._alpha)
        if fade:
            self._fade.start()

    def prepare(self, details: Iterable[LevelOfDetail]) -> None:
        """Make in advance all that some details need: the mesh below the coarse one takes some tenths of a second.

        Raises:
            InputError: a level that this garment does not have.
        """
        if self._coarser is not None or not any(detail.level for detail in details):
            return
        proxy = proxy_mesh_of(self.levels, self.database.warp)
        if proxy is None:
            raise InputError("no such mesh", key="level", received=1, expected="0: this garment's mesh is too coarse")
        self._coarser = ProxySimulation(
            proxy, self.simulation, self.database.options, self._source.vertices, self.levels.coarse_attachment
        )

    @property
    def _moved(self) -> Simulation:
        """What is stepped."""
        return self._coarser.simulation if self._coarser is not None and self._detail.level else self.simulation

    def fasten(self, name: str, closed: bool = True) -> None:
        """Fasten a garment of an outfit to those below it again, as its scene says, or open it.

        Args:
            name: one of :attr:`worn`.
            closed: False opens it.

        Raises:
            InputError: a garment that is not worn, or that nothing fastens.
        """
        fastened = self._fastened()
        if name not in fastened:
            expected = "one of " + ", ".join(fastened) if fastened else "none: nothing is fastened"
            raise InputError("no such fastening", key="name", received=name, expected=expected)
        self._unfastened = self._unfastened - {name} if closed else self._unfastened | {name}
        self._fasten(name, closed)

    def _fastened(self) -> list[str]:
        """Names of the garments that are worn and that the scene fastens to those below them."""
        layers = self.levels.layers
        return [] if layers is None else sorted({layers.names[k] for k in np.unique(layers.layer[layers.fastened])})

    def _fasten(self, name: str, closed: bool) -> None:
        assert self.levels.layers is not None
        self.simulation.fasten(self.levels.layers.names.index(name), closed)

    def update(self, pose: np.ndarray, dt: float, wind: Air = CALM) -> None:
        """One frame: advance the coarse garment to a pose in ``dt`` [s] and make the fine one; see :meth:`step`."""
        self.step(pose, dt, wind)
        self.decode()

    def step(self, pose: np.ndarray, dt: float, wind: Air = CALM) -> None:
        """Advance the coarse garment alone; with a :attr:`detail` that leaves ticks out, in some ticks only.

        Args:
            pose: of the body at the end of the step.
            dt: [s].
            wind: velocity of the air [m/s].

        Raises:
            InputError: an input that is not finite or of another shape; then nothing has changed.
        """
        check_step(pose, self._pose_shape, dt, wind=wind)
        self._fade.advance(dt)
        self._dt, self._idle = dt, self._idle + dt
        if self._wait:
            self._wait -= 1
            self.timings["skin"] = self.timings["coarse"] = 0.0
            return
        dt, self._idle, self._wait = self._idle, 0.0, self._detail.every - 1
        self._extrapolation.started = False
        simulation, moved = self.simulation, self._moved
        began = time.thread_time()
        origin = simulation.state.origin.copy()
        self._between.remember()
        moved.pose_body(pose)
        self._between.move_origin(moved.state.origin - origin)
        skinned = time.thread_time()
        moved.time = simulation.time
        moved.step_cloth(dt, wind)
        simulation.time = moved.time
        if self._coarser is not None and self._detail.level:
            self._coarser.lead()
        self._fine.follow(simulation.state.position, dt)
        self.timings["skin"] = 1e3 * (skinned - began)
        self.timings["coarse"] = 1e3 * (time.thread_time() - skinned)

    def decode(self, alpha: float = 1.0) -> None:
        """Make fine vertices and normals.

        Args:
            alpha: 0 for the state before the last step, 1 for the one after it, in between interpolated.
        """
        self._alpha = alpha
        if self._idle == 0.0 and self._detail.every == 1:
            self._make(alpha)
        else:
            self._carry_on(alpha)
        self._fade.add()
        began = time.thread_time()
        if self._idle == 0.0:
            self._fine.update_normals()
        timings = self.timings
        timings["normals"] = 1e3 * (time.thread_time() - began)
        timings["frame"] = sum(timings[part] for part in ("skin", "coarse", "decode", "relax", "normals"))

    def smooth(self) -> np.ndarray:
        """The garment without wrinkles in the world [m], float64, shape (N, 3)."""
        return self.levels.subdivision.upsample(self.simulation.state.world())

    def interpolated(self) -> tuple[np.ndarray, np.ndarray]:
        """Coarse vertices, shape (n, 4), and body, shape (b, 3), of the last picture about ``origin`` [m], float32.

        Both are valid until the next call.
        """
        return self._between.at(self._alpha)

    def predicted_error(self) -> np.ndarray:
        """Normal error of the wrinkles that is expected at each coarse vertex [deg], float32, shape (n,)."""
        return np.exp(self._fine.novelty_score)

    def keep(self) -> Moment:
        """The present moment, to which :meth:`go_back` returns."""
        return Moment.of(self.simulation, self._fine.memory)

    def go_back(self, moment: Moment, pose: np.ndarray) -> None:
        """Show a kept moment and play on from it. A vertex that was dragged then is free.

        Args:
            moment: of a player of this database, in any of its fabrics.
            pose: of the body at that moment.

        Raises:
            InputError: a pose that is not finite or of another shape; then nothing has changed.
        """
        check_step(pose, self._pose_shape)
        moment.put_back(self.simulation, pose)
        self._fine.memory = moment.memory
        self._idle, self._wait, self._extrapolation.started = 0.0, 0, False
        self._fade.prepare()
        if self._coarser is not None and self._detail.level:
            self._coarser.take_over()
        self._between.remember()
        self.decode()

    def decoded(self, detail: LevelOfDetail) -> np.ndarray:
        """Fine vertices of the last update at a detail, about ``origin`` [m], float32, shape (N, 3), a copy.

        The player itself stays as it is, so that two details can be compared on the same state.
        """
        position, body_vertices = self._between.at(1.0)
        return self._fine.sample(position, self.simulation.state, self.simulation.body, body_vertices, detail)

    def _make(self, alpha: float) -> None:
        """Fine vertices of the last update, or between it and the one before."""
        began = time.thread_time()
        position, body_vertices = self._between.at(alpha)
        between_ms = 1e3 * (time.thread_time() - began)
        simulation = self.simulation
        decode_ms, relax_ms = self._fine.make(
            position, alpha, simulation.state, simulation.body, body_vertices, self._detail
        )
        self.timings["decode"], self.timings["relax"] = between_ms + decode_ms, relax_ms

    def _carry_on(self, alpha: float) -> None:
        """Fine vertices between updates: those of the last one, carried on as the coarse garment went."""
        began = time.thread_time()
        self.timings["relax"] = 0.0
        if not self._extrapolation.started:
            self._make(1.0)
            self._extrapolation.start()
        self._extrapolation.show(self._idle - (1.0 - alpha) * self._dt)
        self.timings["decode"] = 1e3 * (time.thread_time() - began) - self.timings["relax"]

    def drag(self, vertex: int, target: np.ndarray | None) -> None:
        """Hold a coarse vertex at a point in the world [m], shape (3,); None lets it go.

        To let go of a vertex that went with its garment (:meth:`wear`) changes nothing: a game loop cannot know of it.

        Raises:
            InputError: no such vertex, or a bad target.
        """
        count = self.levels.subdivision.coarse_count
        check_drag(vertex, target, count if target is not None else 2**31)
        if target is None and vertex >= count:
            return
        self.simulation.drag(vertex, target)
        if self._coarser is not None and self._detail.level:
            self._coarser.hold()

    def _warm_up(self, pose: np.ndarray) -> None:
        """Load or compile every kernel by a step that is taken back: the first frame is as fast as the others."""
        simulation = self.simulation
        start = simulation.state.copy()
        self.step(pose, 1.0 / self.database.frame_rate)
        simulation.state = start
        simulation.place_body(pose)
        self._fine.begin(start.position)
        self._between.remember()
        self.timings = dict.fromkeys(self.timings, 0.0)
