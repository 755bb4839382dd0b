"""The truth of a motion: converged fine runs of it, and what others are judged by against them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from assets.character import Character
from assets.io.sequence import Sequence as VertexSequence
from assets.motion import Motion
from pbd import InputError, ModelOptions
from pbd.bending import hinge_calibration
from pbd.wind import CALM, Air
from precompute.learning.decoding import bands_of
from precompute.learning.in_time import Pause
from precompute.learning.options import DEFAULT, LearningOptions
from precompute.learning.run_recording import Recording, Run, record_runs
from precompute.workers import Workers
from runtime.play.simulation import body_source, poses_of
from runtime.setup.garment_setup import fine_substep_of
from runtime.setup.opened_start import opened_fine
from runtime.setup.playback_inputs import PlaybackInputs
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import Levels
from wrinkles.low_frequency import LowFrequency
from wrinkles.ridges import RidgeCoherence
from wrinkles.spectrum import BandedEnergy, LowPass

__all__ = [
    "SETTLE",
    "Truth",
    "database_run",
    "fine_run",
    "judged_from",
    "settled",
    "truth_of",
    "truth_runs",
]

SETTLE = 1.5  # the blend from the bind pose is not judged [s]


def fine_run(
    levels: Levels,
    body: Character | VertexSequence,
    motion: Motion,
    database_like,
    *,
    substep: float,
    wind: Air = CALM,
    primitives: tuple = (),
) -> Run:
    """The converged fine simulation of a motion.

    Args:
        levels: of the garment.
        body: what moves.
        motion: how.
        database_like: gives ``fabric``, ``options``, ``solver`` and ``frame_rate``.
        substep: of the fine run [s].
        wind: velocity of the air [m/s].
        primitives: what the garment meets besides the body.
    """
    dt = 1.0 / database_like.frame_rate
    return Run(
        motion.name,
        levels,
        True,
        body,
        poses_of(motion, dt),
        dt,
        database_like.fabric,
        ModelOptions(pressure=database_like.options.pressure),
        replace(database_like.solver, substep=substep),
        bend_factor=_fine_bend(levels),
        wind=wind,
        primitives=primitives,
        lead_in=motion.lead_in,
    )


def database_run(database: WrinkleDatabase, inputs: PlaybackInputs, motion: Motion) -> Run:
    """The converged fine simulation of a motion with which a database is played: the same run as in learning it.

    Args:
        database: what was learned.
        inputs: body, wind and colliders.
        motion: of that body.
    """
    source, substep = body_source(inputs.body), fine_substep_of(database)
    levels = database.levels(source.vertices, source.faces)
    if database.solver.self_collision:
        solver = replace(database.solver, substep=substep)
        levels = opened_fine(levels, database.fabric, solver, source.vertices, source.faces)
    return fine_run(
        replace(levels, pattern=inputs.pattern),
        inputs.body,
        motion,
        database,
        wind=inputs.wind,
        primitives=inputs.primitives,
        substep=substep,
    )


_BENDS: dict[str, float] = {}


def _fine_bend(levels: Levels) -> float:
    """The hinge factor of a fine mesh, measured once and not by every run."""
    key = hashlib.sha256(levels.fine.flat.tobytes()).hexdigest()
    if key not in _BENDS:
        _BENDS[key] = hinge_calibration(levels.fine)
    return _BENDS[key]


@dataclass(frozen=True)
class Truth:
    """Converged fine runs of one motion and what they are judged by.

    Attributes:
        run: the first.
        levels: of the garment.
        recording: the first run, settled frames only.
        floor: positions of one in finer steps [m], float32, shape (f, N, 3).
        energy: of the truth by frame and octave band.
        others: positions of more runs that differ from the first by their starts alone, as ``floor``.
    """

    run: Run
    levels: Levels
    recording: Recording
    floor: np.ndarray
    energy: np.ndarray
    others: tuple[np.ndarray, ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        # Filters of a mesh are larger than all else: another process makes its own.
        return {one.name: getattr(self, one.name) for one in fields(self)}

    @property
    def bands(self) -> BandedEnergy:
        """Octave bands of the fine mesh."""
        return bands_of(self.levels)

    @cached_property
    def low_pass(self) -> LowPass:
        """What coarse and fine have in common."""
        return LowPass(self.levels.fine, self.levels.cutoff)

    @property
    def frames(self) -> np.ndarray:
        return self.recording.positions

    @cached_property
    def low_frequency(self) -> LowFrequency:
        """Measures the large motion of free runs against all true ones."""
        return LowFrequency(self.low_pass, (self.frames, *self.others), self.floor)

    @cached_property
    def ridges(self) -> RidgeCoherence:
        """Measures how far folds run."""
        return RidgeCoherence(self.levels.fine)

    @cached_property
    def ridge_coherence(self) -> np.ndarray:
        """Of the truth, within each radius [-]."""
        return self.ridges(self.frames)

    def until(self, seconds: float) -> Truth:
        """The start of it.

        Raises:
            InputError: nothing of it is left to judge.
        """
        last = round(seconds / self.run.dt)
        keep = self.recording.frames <= last
        if not keep.any():
            raise InputError(
                "too short", key="seconds", received=seconds, expected=f"above {judged_from(self.run):g} [s]"
            )
        return replace(
            self,
            run=replace(self.run, poses=self.run.poses[: last + 1]),
            recording=self.recording.where(keep),
            floor=self.floor[keep],
            energy=self.energy[keep],
            others=tuple(frames[keep] for frames in self.others),
        )


def _floor_run(run: Run) -> Run:
    return replace(run, name=f"{run.name} (floor)", solver=replace(run.solver, substep=run.solver.substep / 1.5))


@threadpool_limits.wrap(limits=1, user_api="blas")
def truth_of(
    run: Run, cache: Path, workers: Workers | int, report: Callable[[str], None] | None = None, *, count: int = 1
) -> Truth:
    """Record (or read) the fine run, others from ``count`` starts in all, and one with substeps two thirds as long."""
    moved = [replace(run, name=f"{run.name} (start {start})", start=start) for start in range(1, count)]
    first, *others, finer = (
        settled(one, run) for one in record_runs([run, *moved, _floor_run(run)], cache, workers, report=report)
    )
    energy = bands_of(run.levels).energy(first.positions)
    return Truth(run, run.levels, first, finer.positions, energy, tuple(one.positions for one in others))


def judged_from(run: Run) -> float:
    """Time after which a run is judged [s]: the garment has settled, and what leads to the motion is over."""
    return max(SETTLE, run.lead_in)


def settled(recording: Recording, run: Run) -> Recording:
    """Recorded frames after the blend from the bind pose."""
    keep = recording.frames * run.dt > judged_from(run)
    if not keep.any():
        keep[:] = True
    return recording.where(keep)


def truth_runs(run: Run, options: LearningOptions = DEFAULT) -> list[Run]:
    """All fine runs that a motion is judged by: the truth, the floor's and the one that pauses."""
    return [run, _floor_run(run), Pause.of(run, judged_from(run), options.still_s, piece=options.piece_s).run]
