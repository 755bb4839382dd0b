"""Plays a wrinkle database: pose and dt in, fine vertices and normals out."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from assets.character import Character
from assets.io.sequence import Sequence
from pbd import InputError, build_model
from pbd.colliders import Primitive
from pbd.geometry import surface_normals
from pbd.taichi_internals import Launch
from pbd.wind import CALM, Air, Wind
from runtime.coarser import CoarserSimulation
from runtime.detail import Detail
from runtime.simulation import Simulation, body_source
from wrinkles.charts import Charts
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.coarser import coarser_of
from wrinkles.database import WrinkleDatabase
from wrinkles.decoder import Decoder, Upsampler
from wrinkles.features import Stencil
from wrinkles.isometry import PASSES, Isometry
from wrinkles.levels import Levels, levels_of
from wrinkles.patches import Patches
from wrinkles.relaxation import Relaxation

__all__ = ["FADE", "Player"]

FADE = 0.3  # a change of detail is drawn over this time [s]


class Player:
    """One garment on one body. Nothing is allocated a frame but what NumPy needs for small matrices.

    Args:
        database: what was learned.
        body: the character or vertex sequence that it was learned on.
        pose: where the body is at the start: its bind pose, moved as a whole; None takes the bind pose where it is.
        primitives: what the coarse garment meets besides the body: planes, spheres, capsules.
        fabric: name of one that the database was learned in; None takes the garment's own.

    Attributes:
        levels: coarse and fine mesh.
        vertices: fine vertices about ``origin`` [m], float32, shape (N, 3).
        normals: unit, float32, shape (N, 3).
        timings: what the last frame took, by part [ms].
        full: the most detail there is: what the database was made for, and what a player begins with.

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
        start = bind_pose if pose is None else pose
        if fabric is not None:
            database = database.in_fabric(fabric)
        self._pose_shape = (len(body.joint_names), 3, 4) if isinstance(body, Character) else body.vertices.shape[1:]
        self._check_pose(start)
        self.database = database
        source = body_source(body)
        self.levels: Levels = levels_of(
            database.coarse_vertices,
            database.coarse_faces,
            database.held,
            source.vertices,
            source.faces,
            database.subdivisions,
            database.warp,
            database.binding,
            database.limits,
        )
        model = build_model(
            database.gathers.applied(self.levels.coarse),
            database.fabric,
            database.held,
            database.options,
            database.bend_factor,
            database.limits,
        )
        self.simulation = Simulation(model, self.levels.coarse_attachment, source, start, database.solver, primitives)
        charts = Charts.of(self.levels.coarse)
        subdivision = self.levels.subdivision
        patches, middle_patches = Patches.of(subdivision, charts), Patches.of(subdivision.middle, charts)
        self._filter = CoarseFilter(self.levels)
        self._upsample, self._upsample_velocity = (Upsampler(self.levels.subdivision) for _ in range(2))
        stencil = Stencil.of(charts, database.held)
        self._decoder = Decoder(
            stencil, patches, middle_patches, database.mapping, database.atoms, database.unfamiliarity
        )
        self._keep_lengths = Isometry(self.levels)
        self._surface_normals = Launch(surface_normals)
        self._faces, self._stands_for = self.levels.subdivision.faces, self.levels.subdivision.stands_for
        self._relax = Relaxation.of(self.levels, source.vertices, source.faces, database.fabric.thickness)
        count, body_count = self.levels.subdivision.fine_count, len(source.vertices)
        self.vertices = np.zeros((count, 3), np.float32)
        self.normals = np.zeros((count, 3), np.float32)
        self._position = self.simulation.state.position.copy()
        self._before = self._position.copy()
        self._body_between = np.zeros((body_count, 3), np.float32)
        substeps = max(1, int(np.ceil(1.0 / (database.frame_rate * database.solver.substep) - 1e-6)))
        self.full = Detail(1, substeps, len(database.atoms.shapes), PASSES, 1)
        self._detail, self._wait = self.full, 0  # ticks to leave out before the next update
        self._coarser: CoarserSimulation | None = None  # made when it is first asked for
        self._bind_vertices = source.vertices
        self._idle, self._dt = 0.0, 0.0  # time since the last update, length of the last tick [s]
        self._velocity = np.zeros_like(self._position)
        self._updated, self._going, self._offset, self._scratch = np.zeros((4, count, 3), np.float32)
        self._made = False  # whether the last update was decoded, where there are ticks without
        self._left = 0.0  # of a change of detail: from 1 to 0
        self.timings = dict.fromkeys(("skin", "coarse", "decode", "relax", "normals", "frame"), 0.0)
        self._alpha = 1.0
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

    @property
    def detail(self) -> Detail:
        """How much is modelled; see :meth:`change`."""
        return self._detail

    def change(self, detail: Detail, wait: int = 0, fade: bool = True) -> None:
        """Model more or less from now on. The coarse state goes on as it is, and nothing pops.

        What is shown stays where it is; the difference to the same state at the new detail fades within :data:`FADE`.

        Args:
            detail: what to model; atoms beyond the dictionary's count as all of them.
            wait: ticks that are left out before the next update, fewer than the detail's ``every``: garments that share
                a frame take turns.
            fade: False shows the new detail at once: after a cut there is no picture that it could jump in.
        """
        self._wait = min(wait, detail.every - 1)
        if detail == self._detail:
            return
        if detail.level:
            self.prepare([detail])
        np.copyto(self._scratch, self.vertices)
        before, self._detail, self._made, self._left = self._detail, detail, False, 0.0
        substep = self.database.solver.substep
        if (detail.every, detail.substeps) != (self.full.every, self.full.substeps):
            substep = detail.every / (self.database.frame_rate * detail.substeps)
        self._moved.solver.options = replace(self.database.solver, substep=substep)
        if self._coarser is not None and detail.level > before.level:
            self._coarser.take_over()
            self._before[:, :3] = self._coarser.carried(self._before[:, :3])
        elif self._coarser is not None and detail.level < before.level:
            self._coarser.give_back()
        self.decode(self._alpha)
        if not fade:
            return
        np.subtract(self._scratch, self.vertices, out=self._offset)
        np.copyto(self.vertices, self._scratch)
        self._left = 1.0

    def prepare(self, details: Iterable[Detail]) -> None:
        """Make what details need before they are needed: the mesh below the coarse one takes some tenths of a second.

        Raises:
            InputError: a level that this garment does not have.
        """
        if self._coarser is not None or not any(detail.level for detail in details):
            return
        coarser = coarser_of(self.levels, self.database.warp)
        if coarser is None:
            raise InputError("no such mesh", key="level", received=1, expected="0: this garment's mesh is too coarse")
        self._coarser = CoarserSimulation(
            coarser, self.simulation, self.database.options, self._bind_vertices, self.levels.coarse_attachment
        )

    @property
    def _moved(self) -> Simulation:
        """What is stepped."""
        return self._coarser.simulation if self._coarser is not None and self._detail.level else self.simulation

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
        self._check_pose(pose)
        if not (np.isfinite(dt) and dt >= 0.0):
            raise InputError("bad time step", key="dt", received=dt, expected="a finite number, at least 0 [s]")
        if not isinstance(wind, Wind) and (np.shape(wind) != (3,) or not np.isfinite(wind).all()):
            raise InputError("bad wind", key="wind", received=wind, expected="three finite numbers [m/s]")
        self._left = max(0.0, self._left - dt / FADE)
        self._dt, self._idle = dt, self._idle + dt
        if self._wait:
            self._wait -= 1
            self.timings["skin"] = self.timings["coarse"] = 0.0
            return
        dt, self._idle, self._made, self._wait = self._idle, 0.0, False, self._detail.every - 1
        simulation, moved = self.simulation, self._moved
        began = time.perf_counter()
        origin = simulation.state.origin.copy()
        self._before[:] = simulation.state.position
        moved.pose_body(pose)
        self._before[:, :3] -= (moved.state.origin - origin).astype(np.float32)
        skinned = time.perf_counter()
        moved.time = simulation.time
        moved.step_cloth(dt, wind)
        simulation.time = moved.time
        if self._coarser is not None and self._detail.level:
            self._coarser.lead()
        self.timings["skin"] = 1e3 * (skinned - began)
        self.timings["coarse"] = 1e3 * (time.perf_counter() - skinned)

    def decode(self, alpha: float = 1.0) -> None:
        """Make fine vertices and normals.

        Args:
            alpha: 0 for the state before the last step, 1 for the one after it, in between interpolated.
        """
        self._alpha = alpha
        if self._idle == 0.0 and self._detail.every == 1:
            self._make(alpha)
        else:
            self._go_on(alpha)
        if self._left > 0.0:
            np.multiply(self._offset, self._left * self._left * (3.0 - 2.0 * self._left), out=self._scratch)
            self.vertices += self._scratch
        began = time.perf_counter()
        if self._idle == 0.0:
            self._surface_normals(self.vertices, self._faces, self.normals)
            if self._stands_for is not None:
                self.normals[:] = self.normals[self._stands_for]
        timings = self.timings
        timings["normals"] = 1e3 * (time.perf_counter() - began)
        timings["frame"] = sum(timings[part] for part in ("skin", "coarse", "decode", "relax", "normals"))

    def decoded(self, detail: Detail) -> np.ndarray:
        """Fine vertices of the last update at a detail, about ``origin`` [m], float32, shape (N, 3), a copy.

        Nothing else changes: this is what a detail is compared with another by.
        """
        kept, shown, memory = self.vertices.copy(), self._detail, self._relax.memory
        self._detail = detail
        self._make(1.0)
        made = self.vertices.copy()
        self._detail, self.vertices[:], self._relax.memory = shown, kept, memory
        return made

    def _make(self, alpha: float) -> None:
        """Fine vertices of the last update, or between it and the one before."""
        simulation, timings, detail = self.simulation, self.timings, self._detail
        state, body = simulation.state, simulation.body
        began = time.perf_counter()
        position, current = state.position, body.current
        if alpha != 1.0:
            position = self._position
            np.subtract(state.position, self._before, out=position)
            position *= np.float32(alpha)
            position += self._before
            np.subtract(body.current, body.previous, out=self._body_between)
            self._body_between *= np.float32(alpha)
            self._body_between += body.previous
            current = self._body_between
        position = self._filter(position)
        middle = self._upsample.middle
        self._upsample(position, self.vertices)
        if detail.atoms:
            self._decoder.add(position, state.contact, self.vertices, middle, detail.atoms)
        elif detail.passes:
            self._decoder.read(position, state.contact)
        if detail.sweeps:
            self._keep_lengths(middle, self.vertices, detail.sweeps)
        decoded = time.perf_counter()
        targets = self.levels.fine_attachment.targets(current)
        if detail.passes:
            frames = self._decoder.frames
            self._relax(self.vertices, targets, frames, state.nearest, state.contact, body, current, detail.passes)
        else:
            self.vertices[self.levels.fine_held] = targets
        timings["decode"] = 1e3 * (decoded - began)
        timings["relax"] = 1e3 * (time.perf_counter() - decoded)

    def _go_on(self, alpha: float) -> None:
        """Fine vertices between updates: the last one, carried on as the coarse garment went."""
        began = time.perf_counter()
        if not self._made:
            self._make(1.0)
            self._velocity[:, :3] = self.simulation.state.velocity
            self._upsample_velocity(self._filter(self._velocity), self._going)
            np.copyto(self._updated, self.vertices)
            self._made = True
        else:
            self.timings["relax"] = 0.0
        np.multiply(self._going, np.float32(self._idle - (1.0 - alpha) * self._dt), out=self.vertices)
        self.vertices += self._updated
        self.timings["decode"] = 1e3 * (time.perf_counter() - began) - self.timings["relax"]

    def drag(self, vertex: int, target: np.ndarray | None) -> None:
        """Hold a coarse vertex at a point in the world [m], shape (3,); None lets it go.

        Raises:
            InputError: no such vertex, or a bad target.
        """
        if target is not None and (np.shape(target) != (3,) or not np.isfinite(target).all()):
            raise InputError("bad target", key="target", received=target, expected="three finite numbers [m]")
        count = self.levels.subdivision.coarse_count
        if not 0 <= vertex < count:
            raise InputError("no such coarse vertex", key="vertex", received=vertex, expected=f"0..{count - 1}")
        self.simulation.drag(vertex, target)
        if self._coarser is not None and self._detail.level:
            self._coarser.hold()

    def _check_pose(self, pose: np.ndarray) -> None:
        if np.shape(pose) != self._pose_shape:
            raise InputError("bad pose", key="pose", received=np.shape(pose), expected=f"shape {self._pose_shape}")
        if not np.isfinite(pose).all():
            raise InputError("bad pose", key="pose", received="values that are not finite", expected="finite numbers")

    def _warm_up(self, pose: np.ndarray) -> None:
        """Load or compile every kernel by a step that is taken back: the first frame is as fast as the others."""
        simulation = self.simulation
        start = simulation.state.copy()
        self.step(pose, 1.0 / self.database.frame_rate)
        simulation.state = start
        simulation.place_body(pose)
        self._before[:] = start.position
        self.timings = dict.fromkeys(self.timings, 0.0)
