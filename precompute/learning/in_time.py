"""Wrinkles in time: jitter at rest, memory of the way there, popping."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from precompute.learning.run_recording import Run
from wrinkles.mesh_measures import jitter_px
from wrinkles.metrics import rmse_mm

__all__ = ["Pause", "popping"]

SLOWED = 3  # so many times slower does the body go on and back after it has stood still


@dataclass(frozen=True)
class Pause:
    """A motion that stops dead, stands still, and then goes slowly on and back.

    Attributes:
        run: the fine run of it; every frame is recorded, so that frame k is the one at pose k + 1.
        still: frames in which the body has stood still for a while.
        there, back: frames at the same poses, the further from the turn the earlier.
    """

    run: Run
    still: slice
    there: slice
    back: slice

    @classmethod
    def of(cls, run: Run, start: float, still: float = 3.0, *, piece: float = 0.5) -> Pause:
        """A pause ``start`` [s] after a run's beginning, or as late as the run is long.

        Args:
            run: the fine run of the motion.
            start: when the body stops [s].
            still: for how long it stands; the last third is judged [s].
            piece: how much of the motion it then goes on and back [s].
        """
        last = len(run.poses) - 1
        turn = min(round(start / run.dt), last - 1)
        count, stand = SLOWED * min(round(piece / run.dt), last - turn), round(still / run.dt)
        steps = turn + np.arange(1, count + 1) / SLOWED
        lower = np.minimum(steps.astype(int), last - 1)
        part = (steps - lower).reshape(-1, *[1] * (run.poses.ndim - 1))
        there = (1.0 - part) * run.poses[lower] + part * run.poses[lower + 1]
        standing = np.repeat(run.poses[turn : turn + 1], stand, axis=0)
        poses = np.concatenate([run.poses[: turn + 1], standing, there, there[-2::-1], standing[:1]])
        begin, half = turn + stand, count // 2
        return cls(
            replace(run, name=f"{run.name} (pause)", poses=poses.astype(run.poses.dtype), every=1),
            slice(begin - stand // 3, begin),
            slice(begin, begin + half),
            slice(begin + 2 * count - 2, begin + 2 * count - 2 - half, -1),
        )

    def figures(self, frames: np.ndarray, prefix: str = "") -> dict[str, float]:
        """Jitter at rest [px a frame] and distance of vertices at the same poses, there and back [mm].

        Args:
            frames: vertices at each pose after the first [m], shape (f, N, 3).
            prefix: of the figures' names.
        """
        gap = rmse_mm(frames[self.back], frames[self.there])
        return {
            f"{prefix}rest_jitter_px": jitter_px(frames[self.still]),
            f"{prefix}reverse_gap_mm": float(np.sqrt((gap**2).mean())),
        }

    def rest_speed(self, coarse: np.ndarray) -> float:
        """Mean speed of the coarse vertices while the body stands still [mm/s].

        Args:
            coarse: coarse vertices at each pose after the first [m], shape (f, n, 3).
        """
        moved = np.linalg.norm(np.diff(coarse[self.still].astype(float), axis=0), axis=2)
        return 1e3 * float(moved.mean()) / self.run.dt


def popping(displacements: np.ndarray, frames: np.ndarray, patches: np.ndarray) -> float:
    """Largest change of a patch's wrinkles from one frame to the next, over the RMS of all wrinkles [-].

    Args:
        displacements: from the smooth surface, in space [m], shape (f, N, 3).
        frames: of the coarse vertices, rows (warp, weft, normal), shape (f, n, 9).
        patches: coarse vertex of each fine one, in whose frame it is seen, int, shape (N,).
    """
    own = frames.reshape(*frames.shape[:2], 3, 3)[:, patches]
    local = np.einsum("fnai,fni->fna", own, displacements)
    change = (np.diff(local, axis=0) ** 2).sum(axis=2)
    size = np.bincount(patches, minlength=frames.shape[1])
    mean_of = csr_matrix((1.0 / size[patches], (patches, np.arange(len(patches)))), shape=(len(size), len(patches)))
    return float(np.sqrt((mean_of @ change.T).max() / (local**2).sum(axis=2).mean()))
