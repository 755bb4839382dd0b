"""The baselines of a wrinkle database: the same garment simulated outright, on the fine mesh and on a middle one.

Costs are processor times, not times of day: methods are measured one after the other, and another program that takes
turns with one of them must not make it look slow. On an idle machine both are the same, as everything runs on one core.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pbd import Model, ModelOptions, SolverOptions, build_model
from pbd.attachment import Attachment
from pbd.geometry import surface_normals
from pbd.taichi_internals import Launch
from precompute.learning.evaluation import Truth
from precompute.learning.recording import Run, body_source
from runtime.player import Player
from runtime.simulation import BodySource, Simulation
from wrinkles.database import WrinkleDatabase
from wrinkles.decoder import Upsampler
from wrinkles.levels import Levels, held_between, levels_of
from wrinkles.surface import Subdivision

__all__ = [
    "PROBE_FRAMES",
    "Cloth",
    "Played",
    "coarse_cloth",
    "equal_cost_substeps",
    "fine_cloth",
    "middle_cloth",
    "middle_levels",
    "player_times",
    "typical_ms",
]

PROBE_FRAMES = 90  # frames of a run that only a cost is measured on
BURST_EXTENTS = 10.0  # cloth that is further away than so many extents of the garment has burst
FIRST_GUESS = 8  # substeps that are tried after one
MAX_SUBSTEPS = 128  # that are tried to fill a frame's time


@dataclass(frozen=True)
class Played:
    """A run of a simulated garment.

    Attributes:
        frames: fine vertices [m], float32, shape (f, N, 3), at the truth's recorded frames; fewer where it broke.
        frame_ms: median processor time of a frame: skinning, simulation, upsampling, normals [ms].
        broke_at: when it burst [s]: a vertex was no longer finite or all over the place; None if that never was.
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
        subdivision: from the simulated mesh to the fine one; None where they are the same.
        fine_faces: of the fine mesh.
    """

    model: Model
    attachment: Attachment
    source: BodySource
    run: Run
    options: SolverOptions
    subdivision: Subdivision | None
    fine_faces: np.ndarray

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
        simulation = self.simulation(self.options)
        upsample = None if self.subdivision is None else Upsampler(self.subdivision)
        count = self.model.vertex_count if self.subdivision is None else self.subdivision.fine_count
        vertices, normals = np.zeros((2, count, 3), np.float32)
        shade = Launch(surface_normals)  # as the player calls it, so that baselines do not pay for calls
        wanted, kept, times = set(keep.tolist()), [], []
        burst = BURST_EXTENTS * np.ptp(self.model.mesh.vertices, axis=0).max()
        for frame in range(1, (frame_count or self.run.frame_count) + 1):
            began = time.process_time()
            simulation.step(self.run.poses[frame], self.run.dt, self.run.wind)
            state = simulation.state
            if upsample is None:
                vertices[:] = state.position[:, :3]
            else:
                upsample(state.position, vertices)
            shade(vertices, self.fine_faces, normals)
            times.append(1e3 * (time.process_time() - began))
            if not (np.isfinite(state.velocity).all() and np.ptp(state.position[:, :3], axis=0).max() < burst):
                return Played(_stacked(kept, count), typical_ms(times), frame * self.run.dt)
            if frame in wanted:
                kept.append((vertices + state.origin).astype(np.float32))
        return Played(_stacked(kept, count), typical_ms(times), None)

    def cost(self) -> float:
        """Processor time of a frame, from a short run [ms]."""
        count = min(PROBE_FRAMES, self.run.frame_count)
        return self.play(np.zeros(0, int), count).frame_ms


def _stacked(frames: list[np.ndarray], count: int) -> np.ndarray:
    return np.array(frames, np.float32).reshape(-1, count, 3)


def typical_ms(times: Sequence[float] | np.ndarray) -> float:
    """Median of the second half: the first gets going [ms]."""
    return float(np.median(times[len(times) // 2 :]))


def player_times(database: WrinkleDatabase, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """What the player takes, and what its smooth surface alone takes, measured side by side.

    Returns:
        processor time of each frame of the truth's motion [ms], shapes (f,), (f,).
    """
    run = truth.run
    player = Player(database, run.body, run.poses[0], run.primitives)
    upsample = Upsampler(player.levels.subdivision)
    vertices, normals = np.zeros((2, *player.vertices.shape), np.float32)
    shade, marks = Launch(surface_normals), []
    for pose in run.poses[1:]:
        begun = time.process_time()
        player.step(pose, run.dt, run.wind)
        stepped = time.process_time()
        player.decode()
        decoded = time.process_time()
        upsample(player.simulation.state.position, vertices)
        shade(vertices, player.levels.fine.faces, normals)
        marks.append((begun, stepped, decoded, time.process_time()))
    step, decode, smooth = np.diff(1e3 * np.array(marks), axis=1).T
    return step + decode, step + smooth


def equal_cost_substeps(cost: Callable[[int], float], budget: float) -> int:
    """Whole number of substeps a frame, at least one, whose cost is nearest to a budget.

    Args:
        cost: of a frame with so many substeps, growing [ms].
        budget: [ms].
    """
    at = lru_cache(maxsize=None)(cost)
    if at(1) >= budget:
        return 1
    low, high, guess = 1, MAX_SUBSTEPS + 1, FIRST_GUESS
    while high - low > 1:
        low, high = (guess, high) if at(guess) < budget else (low, guess)
        # What a frame costs besides its substeps is the same for any number: a line through two costs nearly hits it.
        each = max((at(guess) - at(1)) / (guess - 1), 1e-9)
        guess = int(np.clip(1.0 + (budget - at(1)) / each, low + 1, max(low + 1, high - 1)))
    if high > MAX_SUBSTEPS:
        return low
    return low if budget - at(low) <= at(high) - budget else high


def fine_cloth(run: Run) -> Cloth:
    """The garment and the settings of the fine simulation itself."""
    levels = run.levels
    model = build_model(levels.fine, run.fabric, levels.fine_held, run.options, run.bend_factor, levels.fine_limits)
    return Cloth(model, levels.fine_attachment, body_source(run.body), run, run.solver, None, levels.fine.faces)


def coarse_cloth(database: WrinkleDatabase, run: Run) -> Cloth:
    """The coarse garment of a fine run with its calibrated model."""
    levels = run.levels
    model = build_model(
        database.rest_shape.applied(levels.coarse),
        database.fabric,
        levels.coarse_held,
        database.options,
        database.bend_factor,
        levels.coarse_limits,
    )
    source = body_source(run.body)
    faces = levels.fine.faces
    return Cloth(model, levels.coarse_attachment, source, run, database.solver, levels.subdivision, faces)


def middle_levels(database: WrinkleDatabase, run: Run) -> Levels | None:
    """Levels from the coarse mesh subdivided once to the fine mesh, whose numbering is the same.

    The middle mesh has the fine one's side lengths, as the coarse mesh has. None where a single subdivision makes the
    fine mesh already.
    """
    if database.subdivisions < 2:
        return None
    source = body_source(run.body)
    body = (source.vertices, source.faces)
    one = Subdivision.of(database.coarse_faces, len(database.coarse_vertices), 1)
    # Points of the smooth surface, so that the smooth surface through them is the same.
    plain = replace(database, binding=None)
    vertices = plain.subdivision.upsample(database.coarse_vertices)[: one.fine_count]
    held = held_between(one, database.held)
    limits = database.limits.between(one.matrix)
    sewn = None if database.sewn is None else database.sewn.subdivided(1)
    return levels_of(
        vertices, one.faces, held, *body, database.subdivisions - 1, database.warp, database.binding, limits, sewn
    )


def middle_cloth(database: WrinkleDatabase, run: Run, options: ModelOptions | None = None) -> Cloth | None:
    """The garment on the middle mesh, converged as far as a fine run is; None where there is no such mesh."""
    levels = middle_levels(database, run)
    if levels is None:
        return None
    options = options or ModelOptions(pressure=database.options.pressure)
    model = build_model(levels.coarse, database.fabric, levels.coarse_held, options, limits=levels.coarse_limits)
    # The stretch law of small steps asks for h N: one subdivision halves the edges, and so the substep.
    solver = replace(database.solver, substep=database.solver.substep / 2.0)
    source = body_source(run.body)
    return Cloth(model, levels.coarse_attachment, source, run, solver, levels.subdivision, levels.fine.faces)
