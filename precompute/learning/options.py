"""How much is done to learn a database: one set of numbers for the whole of a precompute."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["LearningOptions"]


@dataclass(frozen=True)
class LearningOptions:
    """Numbers that decide how well and how long a precompute learns; the defaults are for real garments.

    Attributes:
        training_frames: recorded frames that are learned from, at most.
        epochs: passes over them at most, from half of them on; fewer frames are learned from more often.
        most_epochs: passes at most where there are few frames.
        mean_frames: recorded frames that the means of vertices are fitted to, at most.
        score_frames: recorded frames that the score for unfamiliar states is fitted to, at most.
        coarse_models: compression compliance, shear and bending scale of the coarse models that calibration tries; the
            first is the fabric itself.
        calibration_s: of each motion, to calibrate on: enough to see it move, short enough to try many models [s].
        settle_s: start of a motion that calibration leaves out, while the garment blends from the bind pose [s].
        still_s: for which the body stands still after the held-out motion, to judge what moves at rest [s].
        nudging_strengths: that are tried to learn the correction of the coarse motion, see
            :func:`precompute.learning.nudging.learn_correction`; none leaves it out.
        free_runs: free runs from starts that differ by 0.01 mm, over which figures are means.
        piece_s: of the held-out motion that is then played slowly there and back [s].
    """

    training_frames: int = 2400
    epochs: int = 6
    most_epochs: int = 24
    mean_frames: int = 400
    score_frames: int = 800
    coarse_models: tuple[tuple[float, float, float], ...] = ((1, 1, 1), (1, 0.3, 1), (10, 1, 1), (10, 0.3, 1))
    calibration_s: float = 6.0
    settle_s: float = 1.5
    still_s: float = 3.0
    nudging_strengths: tuple[float, ...] = (0.3, 0.1)
    free_runs: int = 4
    piece_s: float = 0.5

    def epochs_for(self, frame_count: int) -> int:
        """Passes over so many training frames, at most."""
        return max(self.epochs, min(self.most_epochs, self.epochs * self.training_frames // (2 * frame_count)))
