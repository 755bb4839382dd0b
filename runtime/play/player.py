"""Plays a garment: pose and dt in, fine vertices and normals out.

Where a comparison has found that plain cloth costs less and is as good, :func:`player_of` plays it.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from assets.character import Character
from assets.io.sequence import Sequence
from pbd import InputError
from pbd.contact.colliders import Primitive
from pbd.wind import CALM, Air
from runtime.play.dressing import Wardrobe
from runtime.play.fine_garment import FineGarment
from runtime.play.input_checks import check_drag, check_step
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.moment import Moment
from runtime.play.plain_cloth import PlainCloth, plain_choice
from runtime.play.played_garment import PlayedGarment, played_cloth, played_scene, played_wrinkles
from runtime.play.shown_surface import Surface
from runtime.play.simulation import Simulation, body_source
from runtime.play.transitions import FADE
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import Levels
from wrinkles.worn_garments import garment_names, with_garments

__all__ = ["FADE", "PARTS", "Player", "player_of"]

PARTS = ("skin", "coarse", "decode", "relax", "normals", "frame")  # of a frame's time


class Player:
    """Plays one garment of a wrinkle database on one body: poses in, fine vertices and normals out.

    It plays the learned wrinkles, or plain cloth (:class:`runtime.play.plain_cloth.PlainCloth`). Of plain cloth the
    coarse vertices of the database are the first simulated ones, so that they can be dragged by their numbers. Garments
    without a database are played by :meth:`of_scene`. A frame allocates no memory, except for small matrices of NumPy.

    Args:
        database: the garment and its wrinkles.
        body: the character or vertex sequence that it was learned on.
        pose: pose of the body at the start: its bind pose, moved as a whole; None takes the bind pose itself.
        primitives: further colliders of the coarse garment: planes, spheres, capsules, distance fields.
        fabric: name of a fabric of the database; None takes the garment's own.
        cloth: plain cloth that is simulated instead; None plays the wrinkles.

    Attributes:
        cloth: the argument.
        timings: processor times of the last frame by part [ms].

    Raises:
        InputError: a body that the database was not made for, a fabric that it was not learned in, a plain cloth that
            is not there, or a bad pose.
    """

    def __init__(
        self,
        database: WrinkleDatabase,
        body: Character | Sequence,
        pose: np.ndarray | None = None,
        primitives: Iterable[Primitive] = (),
        fabric: str | None = None,
        *,
        cloth: PlainCloth | None = None,
    ) -> None:
        database.require_body(body)
        bind_pose = body.bind_pose() if isinstance(body, Character) else body.vertices[0]
        start = bind_pose if pose is None else pose
        if fabric is not None:
            database = database.in_fabric(fabric)
        self.cloth, self._wardrobe = cloth, None
        source, primitives = body_source(body), tuple(primitives)
        if cloth is not None:
            self._begin(played_cloth(database, source, start, primitives, cloth), start)
            return
        self._wardrobe = Wardrobe(
            database, lambda worn: self._begin(played_wrinkles(worn, source, start, primitives), start)
        )
        self._wardrobe.take(database)

    @classmethod
    def of_scene(cls, simulation: Simulation, pose: np.ndarray | None, rate_hz: float) -> Player:
        """Plays the garments of a scene, also without a body, with a smooth surface through them and no normals.

        Args:
            simulation: of the garments, at its start.
            pose: pose of the body at the start; None without a body.
            rate_hz: rate of ticks [Hz].
        """
        player = cls.__new__(cls)
        player.cloth, player._wardrobe = None, None
        player._begin(played_scene(simulation, rate_hz), pose)
        return player

    def _begin(self, garment: PlayedGarment, pose: np.ndarray | None) -> PlayedGarment:
        """Play a garment from its start, as fast in the first frame as in the others.

        A step that is taken back loads or compiles every kernel.
        """
        self._garment, simulation = garment, garment.simulation
        self.timings: dict[str, float] = dict.fromkeys(PARTS, 0.0)
        start = simulation.state.copy()
        self.step(pose, 1.0 / garment.rate_hz)
        simulation.state = start
        if self._wardrobe is None:  # learned wrinkles are played one tick further into turbulent wind
            simulation.time = 0.0
        if pose is not None:
            simulation.place_body(pose)
        garment.surface.begin(start.position)
        garment.between.remember()
        self.timings = dict.fromkeys(PARTS, 0.0)
        self.decode()
        garment.start = self.keep()
        return garment

    @property
    def simulation(self) -> Simulation:
        """Simulation of the garment."""
        return self._garment.simulation

    @property
    def surface(self) -> Surface:
        """What is shown of it."""
        return self._garment.surface

    @property
    def vertices(self) -> np.ndarray:
        """Fine vertices about :attr:`origin` [m], float32, shape (N, 3)."""
        return self._garment.surface.vertices

    @property
    def normals(self) -> np.ndarray:
        """Normals of the fine vertices, unit, float32, shape (N, 3)."""
        return self._garment.surface.normals

    @property
    def database(self) -> WrinkleDatabase:
        """The garments that are worn and their wrinkles; a scene has none."""
        return self._learned[0]

    @property
    def levels(self) -> Levels:
        """Coarse and fine mesh of :attr:`database`."""
        return self._learned[1]

    @property
    def _learned(self) -> tuple[WrinkleDatabase, Levels]:
        learned = self._garment.learned
        if learned is None:
            raise InputError("no database", key="player", received="garments of a scene", expected="one of a database")
        return learned

    @property
    def start(self) -> Moment:
        """The moment at which the garments that are worn would begin."""
        return self._garment.start

    @property
    def full(self) -> LevelOfDetail:
        """The most detail there is; the player begins with it."""
        return self._garment.control.full

    @property
    def worn(self) -> tuple[str, ...]:
        """Names of the garments that are worn, from the innermost outwards; none where none can be taken off."""
        return () if self._wardrobe is None else garment_names(self.database)

    def wear(self, names: Iterable[str]) -> None:
        """Put garments of an outfit on and take others off; garments that stay on go on as they are, and nothing pops.

        A garment that is put on is placed where the body carries it from the bind pose, and finds its place here.
        ``database``, ``levels``, ``simulation``, ``vertices`` and ``normals`` are others after it. The first call with
        a set of garments makes what these need in a second or two; the player keeps that for the next time, so that
        taking off then costs a few frames and putting on some tenths of a second. A vertex that was dragged is free.

        Args:
            names: of garments of the outfit; the order in which they are worn is that of the outfit.

        Raises:
            InputError: no garment, one that the outfit does not have, or no learned wrinkles; then nothing has changed.
        """
        wardrobe = self._require_wardrobe()
        database = with_garments(wardrobe.outfit, names)
        if garment_names(database) == self.worn:
            return
        if self.detail.level:  # the mesh below the coarse one is another for other garments
            self.change(replace(self.detail, level=0), self._garment.control.wait, fade=False)
        before, shown = self._garment, self.vertices.copy()
        self._garment = wardrobe.take(database)
        stay = wardrobe.put_on(self._garment, before)
        self.decode(self._alpha)
        now = self.vertices.copy()
        now[stay.fine] = shown[stay.fine_before]
        self._garment.control.fade.start_from(now)

    def fasten(self, name: str, closed: bool = True) -> None:
        """Fasten a garment of an outfit to those below it again, as its scene says, or open it.

        Args:
            name: one of :attr:`worn`.
            closed: False opens it.

        Raises:
            InputError: a garment that is not worn, or that nothing fastens.
        """
        self._require_wardrobe().fasten(self._garment, name, closed)

    def _require_wardrobe(self) -> Wardrobe:
        if self._wardrobe is None:
            raise InputError("all garments stay on", key="player", received="plain cloth", expected="learned wrinkles")
        return self._wardrobe

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
        return self._garment.control.detail

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
        control = self._garment.control
        if control.turn_to(detail, wait):
            self.decode(self._alpha)
            if fade:
                control.fade.start()

    def prepare(self, details: Iterable[LevelOfDetail]) -> None:
        """Make in advance all that some details need: the mesh below the coarse one takes some tenths of a second.

        Raises:
            InputError: a level that this garment does not have.
        """
        self._garment.control.prepare(max((detail.level for detail in details), default=0))

    def update(self, pose: np.ndarray, dt: float, wind: Air = CALM) -> None:
        """One frame: advance the coarse garment to a pose in ``dt`` [s] and make the fine one; see :meth:`step`."""
        self.step(pose, dt, wind)
        self.decode()

    def step(self, pose: np.ndarray | None, dt: float, wind: Air = CALM) -> None:
        """Advance the simulated garment alone; with a :attr:`detail` that leaves ticks out, in some ticks only.

        Args:
            pose: of the body at the end of the step; None without a body.
            dt: [s].
            wind: velocity of the air [m/s].

        Raises:
            InputError: an input that is not finite or of another shape; then nothing has changed.
        """
        garment, simulation, timings = self._garment, self.simulation, self.timings
        control, between = garment.control, garment.between
        self._check(pose, dt, wind)
        due = control.elapse(dt)
        if due is None:
            timings["skin"] = timings["coarse"] = 0.0
            return
        stepped = control.stepped
        began = time.thread_time()
        origin = simulation.state.origin.copy()
        between.remember()
        stepped.pose_body(pose)
        between.move_origin(stepped.state.origin - origin)
        skinned = time.thread_time()
        control.step_cloth(due, wind)
        garment.surface.follow(simulation.state.position, due)
        timings["skin"] = 1e3 * (skinned - began)
        timings["coarse"] = 1e3 * (time.thread_time() - skinned)

    def _check(self, pose: np.ndarray | None, dt: float = 0.0, wind: Air = CALM) -> None:
        source = self.simulation.source
        check_step(None if source is None else pose, () if source is None else source.pose_shape, dt, wind=wind)

    def decode(self, alpha: float = 1.0) -> None:
        """Make fine vertices and normals.

        Args:
            alpha: 0 for the state before the last step, 1 for the one after it, in between interpolated.
        """
        garment, timings, self._alpha = self._garment, self.timings, alpha
        began = time.thread_time()
        relax_ms = garment.control.show(alpha, self._make)
        made = time.thread_time()
        timings["decode"], timings["relax"] = 1e3 * (made - began) - relax_ms, relax_ms
        garment.control.fade.add()
        began = time.thread_time()
        if garment.control.idle == 0.0:
            garment.surface.update_normals()
        timings["normals"] = 1e3 * (time.thread_time() - began)
        timings["frame"] = sum(timings[part] for part in PARTS if part != "frame")

    def _make(self, alpha: float) -> float:
        """Make the surface of the last update, or between it and the one before; time of relaxation [ms]."""
        garment = self._garment
        position, body_vertices = garment.between.at(alpha)
        return garment.surface.make(position, alpha, garment.simulation, body_vertices, garment.control.detail)

    def smooth(self) -> np.ndarray:
        """The garment without wrinkles in the world [m], float64, shape (N, 3); of plain cloth this is all of it."""
        return self.surface.smooth(self.simulation.state)

    def interpolated(self) -> tuple[np.ndarray, np.ndarray]:
        """Simulated vertices, shape (n, 4), and body, shape (b, 3), of the last picture about ``origin`` [m], float32.

        Both are valid until the next call.
        """
        return self._garment.between.at(self._alpha)

    def predicted_error(self) -> np.ndarray:
        """Normal error of the wrinkles that is expected at each coarse vertex [deg], float32, shape (n,)."""
        return np.exp(self._wrinkles.novelty_score)

    def decoded(self, detail: LevelOfDetail) -> np.ndarray:
        """Fine vertices of the last update at a detail, about ``origin`` [m], float32, shape (N, 3), a copy.

        The player itself stays as it is, so that two details can be compared on the same state.
        """
        position, body_vertices = self._garment.between.at(1.0)
        return self._wrinkles.sample(position, self.simulation, body_vertices, detail)

    @property
    def _wrinkles(self) -> FineGarment:
        if not isinstance(self.surface, FineGarment):
            raise InputError("no wrinkles", key="player", received="plain cloth", expected="learned wrinkles")
        return self.surface

    def keep(self) -> Moment:
        """The present moment, to which :meth:`go_back` returns."""
        return Moment.of(self.simulation, self.surface.memory)

    def go_back(self, moment: Moment, pose: np.ndarray | None) -> None:
        """Show a kept moment and play on from it. A vertex that was dragged then is free.

        Args:
            moment: of a player of the same garments, in any fabric.
            pose: of the body at that moment; None without a body.

        Raises:
            InputError: a pose that is not finite or of another shape; then nothing has changed.
        """
        self._check(pose)
        moment.put_back(self.simulation, pose)
        self.surface.memory = moment.memory
        self._garment.control.start_again()
        self._garment.between.remember()
        self.decode()

    def drag(self, vertex: int, target: np.ndarray | None) -> None:
        """Hold a simulated vertex at a point in the world [m], shape (3,); None lets it go.

        To let go of a vertex that went with its garment (:meth:`wear`) changes nothing: a game loop cannot know of it.

        Raises:
            InputError: no such vertex, or a bad target.
        """
        if target is None and self._wardrobe is not None:
            if check_drag(vertex, target, 2**31) >= self.simulation.model.vertex_count:
                return
        self.simulation.drag(vertex, target)
        self._garment.control.hold()


def player_of(
    database: WrinkleDatabase,
    body: Character | Sequence,
    pose: np.ndarray | None = None,
    *,
    primitives: Iterable[Primitive] = (),
    wrinkles: bool = False,
) -> Player:
    """What plays a database best: plain cloth where a comparison found that it costs less and is as good.

    Args:
        database, body, pose, primitives: as for :class:`Player`.
        wrinkles: play the wrinkles in any case.
    """
    return Player(database, body, pose, primitives, cloth=None if wrinkles else plain_choice(database))
