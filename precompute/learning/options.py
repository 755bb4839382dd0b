"""How much is done to learn a database: one set of numbers for the whole of a precompute."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DEFAULT", "LearningOptions"]


@dataclass(frozen=True)
class LearningOptions:
    """Numbers that decide how well and how long a precompute learns; the defaults are for real garments.

    Attributes:
        training_frames: recorded frames that are learned from, at most.
        epochs: passes over them at most, from half of them on; fewer frames are learned from more often.
        most_epochs: passes at most where there are few frames.
        mean_frames: recorded frames that the means of vertices are fitted to, at most.
        score_frames: recorded frames that the score for unfamiliar states is fitted to, at most.
        still_s: for which the body stands still after the held-out motion, to judge what moves at rest [s].
        free_runs: free runs from starts that differ by 0.01 mm, over which figures are means.
        piece_s: of the held-out motion that is then played slowly there and back [s].
    """

    training_frames: int = 2400
    epochs: int = 6
    most_epochs: int = 24
    mean_frames: int = 400
    score_frames: int = 800
    still_s: float = 3.0
    free_runs: int = 4
    piece_s: float = 0.5

    def epochs_for(self, frame_count: int) -> int:
        """Passes over so many training frames, at most."""
        return max(self.epochs, min(self.most_epochs, self.epochs * self.training_frames // (2 * frame_count)))


DEFAULT = LearningOptions()  # of a whole precompute
