"""The baselines of a wrinkle database: the same garment simulated outright, on every mesh of its chain.

Costs are processor times, not times of day: another program that takes turns with a method must not make it look slow.
On an idle machine both are the same, as everything runs on one core. Methods that are compared play some frames each in
turn (:func:`take_turns`), so that what the machine does besides hits all alike.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from pbd import InputError, Model, SolverOptions
from pbd.attachment import Attachment
from pbd.geometry import surface_normals
from pbd.taichi_internals import Launch
from precompute.learning.run_recording import Run, move_start
from precompute.learning.truth import Truth
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.plain_cloth import middle_levels, plain_model
from runtime.play.plain_surface import PlainSurface
from runtime.play.player import Player
from runtime.play.simulation import BodySource, Simulation, body_source
from wrinkles.database import WrinkleDatabase
from wrinkles.decoder import Upsampler
from wrinkles.levels import Levels

__all__ = [
    "PROBE_FRAMES",
    "TURN",
    "Cloth",
    "ClothTurn",
    "Played",
    "PlayerTurn",
    "coarse_cloth",
    "fine_cloth",
    "middle_cloth",
    "plain_cloths",
    "player_times",
    "take_turns",
    "typical_ms",
]

PROBE_FRAMES = 90  # frames of a run that only a cost is measured on
BURST_STRETCH, BURST_SHARE = 10.0, 0.01  # cloth has burst where more edges than this share are so many times too long
TURN = 8  # frames that a method plays before it is the next one's turn


@dataclass(frozen=True)
class Played:
    """A run of a simulated garment.

    Attributes:
        frames: fine vertices [m], float32, shape (f, N, 3), at the truth's recorded frames; fewer where it broke.
        frame_ms: median processor time of a frame: skinning, simulation, upsampling, normals [ms].
        broke_at: when it burst [s]: a vertex was not finite, or many edges were far too long; None if that never was.
    """

    frames: np.ndarray
    frame_ms: float
    broke_at: float | None


@dataclass(frozen=True)
class Cloth:
    """A garment that is simulated on one mesh and shown on the fine one.

    Attributes:
        model: of the simulated mesh.
        attachment: of its held vertices.
        source: the body.
        run: gives the poses.
        options: of the solver.
        fine_faces: of the fine mesh.
        levels: from the simulated mesh to the fine one; None where they are the same.
        passes: of relaxation of the fine mesh for what is shown.
    """

    model: Model
    attachment: Attachment
    source: BodySource
    run: Run
    options: SolverOptions
    fine_faces: np.ndarray
    levels: Levels | None
    passes: int = 0

    def simulation(self, options: SolverOptions) -> Simulation:
        """One at the first pose."""
        return Simulation(self.model, self.attachment, self.source, self.run.poses[0], options, self.run.primitives)

    def with_substeps(self, substeps: int) -> Cloth:
        """The same with so many substeps a frame."""
        return replace(self, options=replace(self.options, substep=self.run.dt / substeps))

    @property
    def substeps(self) -> int:
        """Substeps a frame."""
        return max(1, int(np.ceil(self.run.dt / self.options.substep - 1e-6)))

    def play(self, keep: np.ndarray, frame_count: int | None = None) -> Played:
        """Run freely along the poses.

        Args:
            keep: numbers of the frames that are kept, int, shape (f,).
            frame_count: stop after so many; None plays all.
        """
        turn = ClothTurn(self, keep)
        turn.advance(frame_count or self.run.frame_count)
        return turn.played

    def cost(self) -> float:
        """Processor time of a frame, from a short run [ms]."""
        count = min(PROBE_FRAMES, self.run.frame_count)
        return self.play(np.zeros(0, int), count).frame_ms


class Turn(Protocol):
    """A method that plays a motion some frames at a time."""

    def advance(self, count: int) -> None:
        """Play so many frames more, or those that are left."""


def take_turns(turns: Sequence[Turn], frame_count: int, played: Callable[[int], None] = lambda count: None) -> None:
    """Let methods play a motion of so many frames, :data:`TURN` frames each in turn.

    Args:
        turns: the methods.
        frame_count: of the motion.
        played: called with the number of frames that all have played since the last time.
    """
    for first in range(0, frame_count, TURN):
        count = min(TURN, frame_count - first)
        for turn in turns:
            turn.advance(count)
        played(count)


class ClothTurn:
    """A garment that is simulated outright, some frames at a time.

    Args:
        cloth: what is simulated.
        keep: numbers of the frames that are kept, int, shape (f,).
        folder: where they are kept; None keeps them in memory.
        start: number of its start, see :func:`precompute.learning.run_recording.move_start`.
    """

    def __init__(self, cloth: Cloth, keep: np.ndarray, folder: Path | None = None, start: int = 0) -> None:
        self._cloth, self._simulation = cloth, cloth.simulation(cloth.options)
        move_start(self._simulation.state, start)
        run = cloth.run
        self._surface: PlainSurface | None = None
        count = cloth.model.vertex_count
        if cloth.levels is not None:
            self._surface = PlainSurface(cloth.levels, run.fabric, run.bend_factor, cloth.source, cloth.passes)
            count = cloth.levels.subdivision.fine_count
        self._vertices, self._normals = np.zeros((2, count, 3), np.float32)
        self._shade = Launch(surface_normals)  # as the player calls it, so that baselines do not pay for calls
        self._keeping = _Keeping(keep, count, folder)
        self._edges, lengths = cloth.model.mesh.edge_lengths()
        self._burst = BURST_STRETCH * lengths
        self._frame = 0

    def advance(self, count: int) -> None:
        """Play so many frames more, or those that are left; none once it has burst."""
        run, keeping = self._cloth.run, self._keeping
        for frame in range(self._frame + 1, min(self._frame + count, run.frame_count) + 1):
            if keeping.broke_at is not None:
                return
            self._frame = frame
            began = time.process_time()
            self._simulation.step(run.poses[frame], run.dt, run.wind)
            state = self._simulation.state
            body = self._simulation.body
            if self._surface is None:
                self._vertices[:] = state.position[:, :3]
            else:
                self._surface(state.position, state, body, body.current, self._vertices)
            self._shade(self._vertices, self._cloth.fine_faces, self._normals)
            spent = 1e3 * (time.process_time() - began)
            one, other = state.position[self._edges.T, :3]
            whole = np.isfinite(state.velocity).all()
            whole &= (np.linalg.norm(one - other, axis=1) > self._burst).mean() < BURST_SHARE  # limbs hook some edges
            keeping.frame(frame, spent, self._vertices + state.origin, None if whole else frame * run.dt)

    @property
    def played(self) -> Played:
        """What was played."""
        return self._keeping.played


class PlayerTurn:
    """A garment that is played from a database, with and without its wrinkles, some frames at a time.

    Args:
        database: what was learned.
        run: gives body and poses.
        keep: numbers of the frames that are kept, int, shape (f,).
        detail: of the player; None takes all that there is.
        player: at the first pose; None makes one.
        folder: where frames are kept; None keeps them in memory.
        start: number of its start, see :func:`precompute.learning.run_recording.move_start`.
    """

    def __init__(
        self,
        database: WrinkleDatabase,
        run: Run,
        keep: np.ndarray,
        detail: LevelOfDetail | None = None,
        player: Player | None = None,
        folder: Path | None = None,
        start: int = 0,
    ) -> None:
        self._run = run
        self._player = player or Player(database, run.body, run.poses[0], run.primitives)
        move_start(self._player.simulation.state, start)
        if detail is not None:
            self._player.change(detail, fade=False)
        levels = self._player.levels
        self._upsample, self._shade = Upsampler(levels.subdivision), Launch(surface_normals)
        self._vertices, self._normals = (np.zeros_like(self._player.vertices) for _ in range(2))
        count = levels.subdivision.fine_count
        self._ours, self._smooth = _Keeping(keep, count, folder), _Keeping(keep, count, folder)
        self._frame = 0

    @property
    def times_ms(self) -> np.ndarray:
        """Processor time of each frame [ms], shape (f,)."""
        return self._ours.times

    @property
    def smooth_times_ms(self) -> np.ndarray:
        """The same of the smooth surface alone."""
        return self._smooth.times

    def advance(self, count: int) -> None:
        """Play so many frames more, or those that are left; none once it has broken."""
        run, player = self._run, self._player
        for frame in range(self._frame + 1, min(self._frame + count, run.frame_count) + 1):
            if self._ours.broke_at is not None:
                return
            self._frame = frame
            marks = [time.process_time()]
            try:
                player.step(run.poses[frame], run.dt, run.wind)
            except InputError:  # the cloth is no longer finite
                self._ours.broke_at = self._smooth.broke_at = frame * run.dt
                return
            marks.append(time.process_time())
            player.decode()
            marks.append(time.process_time())
            self._upsample(player.simulation.state.position, self._vertices)
            self._shade(self._vertices, player.levels.fine.faces, self._normals)
            marks.append(time.process_time())
            step, decode, smooth = 1e3 * np.diff(marks)
            self._ours.frame(frame, step + decode, player.vertices + player.origin)
            self._smooth.frame(frame, step + smooth, self._vertices + player.origin)

    @property
    def played(self) -> Played:
        """What was played, with wrinkles."""
        return self._ours.played

    @property
    def smooth(self) -> Played:
        """The smooth surface of the same coarse states, at what it would cost alone."""
        return self._smooth.played


class _Keeping:
    """Times of all frames and vertices of some, shape (``count``, 3), in a file where a folder is named."""

    def __init__(self, keep: np.ndarray, count: int, folder: Path | None) -> None:
        self._wanted, self._count = set(keep.tolist()), count
        self._kept: list[np.ndarray] = []
        self._times: list[float] = []
        self._file: Path | None = None
        if folder is not None:
            descriptor, name = tempfile.mkstemp(".f32", dir=folder)
            os.close(descriptor)
            self._file = Path(name)
        self.broke_at: float | None = None

    def frame(self, number: int, spent_ms: float, vertices: np.ndarray, broke_at: float | None = None) -> None:
        self._times.append(spent_ms)
        self.broke_at = broke_at
        if broke_at is None and number in self._wanted:
            if self._file is None:
                self._kept.append(vertices.astype(np.float32))
            else:
                with self._file.open("ab") as file:  # not mapped: a full disk would end the process without a word
                    file.write(np.ascontiguousarray(vertices, np.float32).data)

    @property
    def times(self) -> np.ndarray:
        return np.array(self._times)

    @property
    def played(self) -> Played:
        if self._file is not None and self._file.stat().st_size > 0:
            frames: np.ndarray = np.memmap(self._file, np.float32, "r").reshape(-1, self._count, 3)
        else:
            frames = np.array(self._kept, np.float32).reshape(-1, self._count, 3)
        return Played(frames, typical_ms(self._times), self.broke_at)


def typical_ms(times: Sequence[float] | np.ndarray) -> float:
    """Median of the second half: the first gets going [ms]."""
    return float(np.median(times[len(times) // 2 :]))


def player_times(database: WrinkleDatabase, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """What the player takes, and what its smooth surface alone takes, measured side by side.

    Returns:
        processor time of each frame of the truth's motion [ms], shapes (f,), (f,).
    """
    turn = PlayerTurn(database, truth.run, np.zeros(0, int))
    turn.advance(truth.run.frame_count)
    return turn.times_ms, turn.smooth_times_ms


def fine_cloth(run: Run) -> Cloth:
    """The garment and the settings of the fine simulation itself."""
    levels = run.levels
    model = levels.model(run.fabric, run.options, bend_factor=run.bend_factor, fine=True)
    return Cloth(model, levels.fine_attachment, body_source(run.body), run, run.solver, levels.fine.faces, None)


def coarse_cloth(database: WrinkleDatabase, run: Run) -> Cloth:
    """The garment on the coarse mesh."""
    return _plain_cloth(database, run, run.levels, 0)


def middle_cloth(database: WrinkleDatabase, run: Run) -> Cloth | None:
    """The garment on the coarse mesh subdivided once, converged as far as a fine run is; None where that is fine."""
    levels = middle_levels(database, body_source(run.body))
    return None if levels is None else _plain_cloth(database, run, levels, 1)


def plain_cloths(database: WrinkleDatabase, run: Run) -> dict[str, Cloth]:
    """The garment as plain cloth, of the fabric itself, by the mesh that is simulated: coarse, middle, fine.

    A garment that is subdivided more than twice has several middle meshes, middle_1 the coarsest.
    """
    found = {"coarse": coarse_cloth(database, run)}
    for cuts in range(1, database.subdivisions):
        levels = middle_levels(database, body_source(run.body), cuts)
        assert levels is not None
        name = "middle" if database.subdivisions == 2 else f"middle_{cuts}"
        found[name] = _plain_cloth(database, run, levels, cuts)
    return found | {"fine": fine_cloth(run)}


def _plain_cloth(database: WrinkleDatabase, run: Run, levels: Levels, cuts: int) -> Cloth:
    """The garment on the coarse mesh of some levels, which is the database's subdivided so many times."""
    # The stretch law of small steps asks for h N: one subdivision halves the edges, and so the substep.
    solver = replace(database.solver, substep=database.solver.substep / 2.0**cuts)
    source = body_source(run.body)
    model = plain_model(database, levels)
    return Cloth(model, levels.coarse_attachment, source, run, solver, levels.fine.faces, levels)
