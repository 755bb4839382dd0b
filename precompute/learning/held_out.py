"""What mappings are judged on: a motion that nothing was learned from, with and without its coarse states given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets.io.scene import Scene
from pbd import InputError
from precompute.learning.decoding import FrameDecoder, decoded_frames
from precompute.learning.evaluation import free_figures
from precompute.learning.pipeline import scene_run
from precompute.learning.run_recording import Recording, Run
from precompute.learning.training import Layer
from precompute.learning.truth import Truth, settled, truth_of
from runtime.play.player import Player
from runtime.setup.garment_setup import GarmentSetup
from wrinkles.charts import leading_vertices
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.database import WrinkleDatabase
from wrinkles.metrics import given_coarse_figures
from wrinkles.temporal_sharpening import TemporalSharpening

__all__ = ["JUDGED", "HeldOut", "held_out_truth", "require_held_out"]

EVERY = 4  # recorded frames from one that is judged to the next: their figures change slowly
JUDGED = slice(EVERY // 2, None, EVERY)


def held_out_truth(
    path: Path, stage: GarmentSetup, scene: Scene, cache: Path, report: Callable[[str], None] | None = None
) -> Truth:
    """The converged fine runs of a scene's first held-out motion.

    Raises:
        InputError: as :func:`require_held_out`.
    """
    require_held_out(path, scene)
    return truth_of(scene_run(stage, scene, stage.motion(scene.training.held_out[0])), cache, 2, report)


def require_held_out(path: Path, scene: Scene) -> None:
    """Refuse a scene without a held-out motion.

    Raises:
        InputError: nothing is held out; ``path`` is the file that the message names.
    """
    if not scene.training.held_out:
        raise InputError("nothing is held out", file=path, key="training.held_out", expected="a clip to compare on")


def _coarse_recording(database: WrinkleDatabase, run: Run) -> Recording:
    """The coarse garment running freely over a fine run's poses: ``positions`` as it is, ``coarse`` sharpened."""
    player = Player(database, run.body, run.poses[0], run.primitives)
    sharpen = TemporalSharpening(player.levels)
    sharpen.begin(player.simulation.state.position)
    frames, times = np.arange(run.every, run.frame_count + 1, run.every), []
    positions, sharp, contact, nearest = [], [], [], []
    for frame in range(1, run.frame_count + 1):
        player.step(run.poses[frame], run.dt, run.wind)
        times.append(player.timings["coarse"])
        state = player.simulation.state
        sharpen.follow(state.position, run.dt)
        if frame % run.every == 0:
            positions.append(state.world().astype(np.float32))
            sharp.append((sharpen(state.position)[:, :3] + state.origin).astype(np.float32))
            contact.append(state.contact.copy())
            nearest.append(state.nearest.copy())
    found = [np.array(rows) for rows in (positions, sharp, contact, nearest)]
    return Recording(f"{run.name} (coarse)", frames, *found, step_ms=float(np.median(times)))


@dataclass(frozen=True)
class HeldOut:
    """A held-out motion, and the coarse garment running freely over it, recorded once for every way that decodes it.

    Every way is shown all settled frames in order; every EVERYth of them is judged.

    Attributes:
        truth: all settled frames.
        judged: the frames that are judged.
        plain, free: the free run of the coarse garment, as it is, and sharpened and filtered as by the player.
    """

    truth: Truth
    judged: Truth
    plain: Recording
    free: Recording

    @classmethod
    def of(
        cls,
        database: WrinkleDatabase,
        truth: Truth,
    ) -> HeldOut:
        """Play the coarse garment.

        Args:
            database: gives the coarse model.
            truth: of the motion.
        """
        free = settled(_coarse_recording(database, truth.run), truth.run)
        recording, floor, energy = truth.recording.where(JUDGED), truth.floor[JUDGED], truth.energy[JUDGED]
        judged = replace(truth, recording=recording, floor=floor, energy=energy)
        matrix = CoarseFilter(truth.levels).matrix
        seen = np.stack([matrix @ frame for frame in free.coarse]).astype(np.float32)
        return cls(truth, judged, replace(free, coarse=free.positions), replace(free, coarse=seen))

    def show(self, layer: Layer, lift: FrameDecoder, recording: Recording) -> tuple[np.ndarray, np.ndarray, float]:
        """Show recorded coarse states to one way, from the first to the last.

        Args:
            layer, lift: as for :func:`precompute.learning.decoding.decoded_frames`.
            recording: the truth's own, ``plain`` or ``free``.

        Returns:
            smooth and decoded garment at the judged frames [m], float32, shape (f, N, 3) each, and the median
            processor time from the smooth surface to the relaxed one [ms].
        """
        wanted = set(range(len(recording.frames))[JUDGED])
        smooth, decoded, times = [], [], []
        for number, frame in enumerate(decoded_frames(layer, lift, self.truth.run, recording)):
            times.append(frame[2])
            if number in wanted:
                smooth.append(frame[0])
                decoded.append(frame[1])
        return np.array(smooth), np.array(decoded), float(np.median(times))

    def given_figures(self, smooth: np.ndarray, decoded: np.ndarray) -> dict[str, float]:
        """Figures of judged frames, decoded from the truth's own coarse states: [m], shape (f, N, 3) each."""
        levels = self.truth.levels
        owner = leading_vertices(levels.subdivision)[:, 0]
        figures = given_coarse_figures(decoded, self.judged.frames, smooth, levels.fine.faces, owner)
        ratios = self.judged.bands.band_ratios(self.judged.bands.energy(decoded), self.judged.energy)
        return {name: float(value) for name, value in figures.items()} | {
            f"given_band_ratio_{name.replace(' ', '_')}": float(value) for name, value in ratios.items()
        }

    def free_figures(self, frames: np.ndarray) -> dict[str, float]:
        """Figures of judged frames of a free run [m], shape (f, N, 3)."""
        figures = free_figures(self.judged, frames)
        del figures["jitter_px"]  # asks for every recorded frame
        return figures
