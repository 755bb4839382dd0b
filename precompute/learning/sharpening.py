"""How sharply the coarse garment is shown: so that it folds as much as the fine one does in training motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from precompute.learning.decoding import bands_of, blocks_of, decode_recording
from precompute.learning.recording import Recording, Run
from precompute.learning.training import Layer, spread_frames
from precompute.workers import Workers
from runtime.player import Player
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import Levels

__all__ = ["Sharpness", "filtered", "fit_sharpness", "record_coarse"]

TRIED = 0.5  # sharpness beside 0 at which the folds are measured [-]
MOST = 1.0  # [-]
LEAST_ENERGY = 1e-3  # of the whole: bands of the fine garment that have less are not counted


@dataclass(frozen=True)
class Sharpness:
    """What was found.

    Attributes:
        sharpness: with which octaves have the right amplitude [-].
    """

    sharpness: float


def fit_sharpness(
    layer: Layer,
    databases: Sequence[WrinkleDatabase],
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    workers: Workers,
    frames: int,
) -> Sharpness:
    """The sharpness of :class:`wrinkles.coarse_filter.CoarseFilter` with which octaves have the right amplitude.

    The garment runs freely over the training motions. Its folds are raised in proportion to the sharpness, and so is
    the amplitude of each octave, the root of its bending energy. The sharpness is the one with the least sum of squares
    of the relative errors of all amplitudes.

    Args:
        layer: of the garment.
        databases: what was learned, in the fabric of each run.
        runs: fine training runs.
        recordings: of these runs.
        workers: that play and decode.
        frames: that are decoded, at most.
    """
    free = workers.run([partial(record_coarse, one, run) for one, run in zip(databases, runs, strict=True)])
    kept = [one.where(np.isin(one.frames, fine.frames)) for one, fine in zip(free, recordings, strict=True)]
    blocks = [blocks_of(runs, spread_frames(some, frames)) for some in (kept, recordings)]
    jobs = [
        partial(_energies, layer, databases[0], run, coarse, fine.positions)
        for (run, coarse), (_, fine) in zip(*blocks, strict=True)
    ]
    truth, plain, sharp = np.sum(workers.run(jobs), axis=0)
    counted = truth > LEAST_ENERGY * truth.sum()
    amplitude, tried = np.sqrt(plain[counted] / truth[counted]), np.sqrt(sharp[counted] / truth[counted])
    gained = (tried - amplitude) / TRIED
    wanted = gained @ (1.0 - amplitude) / max(gained @ gained, 1e-12)
    return Sharpness(float(np.clip(wanted, 0.0, MOST)))


def record_coarse(database: WrinkleDatabase, run: Run) -> Recording:
    """The coarse garment running freely over a fine run's poses, as the player moves it."""
    player = Player(database, run.body, run.poses[0], run.primitives)
    frames, times = np.arange(run.every, run.frame_count + 1, run.every), []
    positions, contact, nearest = [], [], []
    for frame in range(1, run.frame_count + 1):
        player.step(run.poses[frame], run.dt, run.wind)
        times.append(player.timings["coarse"])
        if frame % run.every == 0:
            state = player.simulation.state
            positions.append(state.world().astype(np.float32))
            contact.append(state.contact.copy())
            nearest.append(state.nearest.copy())
    where, name = np.array(positions), f"{run.name} (coarse)"
    return Recording(name, frames, where, where, np.array(contact), np.array(nearest), float(np.median(times)))


def filtered(levels: Levels, sharpness: float, recording: Recording) -> Recording:
    """A recorded coarse garment as the player filters it."""
    matrix = CoarseFilter(levels, sharpness).matrix
    return replace(recording, coarse=np.stack([matrix @ frame for frame in recording.coarse]).astype(np.float32))


def _energies(
    layer: Layer, database: WrinkleDatabase, run: Run, coarse: Recording, positions: np.ndarray
) -> np.ndarray:
    """Bending energy by octave, summed over frames: of the truth, of ours not sharpened, of ours sharpened; (3, b)."""
    bands, predict, atoms = bands_of(layer.levels), database.mapping.predict, database.atoms
    found = [bands.energy(positions)]
    for sharpness in (0.0, TRIED):
        _, decoded = decode_recording(layer, predict, atoms, run, filtered(layer.levels, sharpness, coarse))
        found.append(bands.energy(decoded))
    return np.array([energy.sum(axis=0) for energy in found])
