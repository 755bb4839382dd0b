"""A short run to be recorded."""

from __future__ import annotations

import numpy as np

from pbd import Fabric, ModelOptions, SolverOptions
from precompute.learning.run_recording import Run
from runtime.play.simulation import poses_of
from tests.runtime.players import skirt_stage

__all__ = ["CHUNK", "FRAMES", "skirt_run"]

FRAMES, CHUNK = 40, 10


def skirt_run(fine: bool = False) -> Run:
    """The skirt on a mannequin that is carried off at 3 m/s, so that the origin moves along."""
    stage = skirt_stage()
    poses = poses_of(stage.motion(), 1 / 60, FRAMES / 60)
    poses[:, :, 2, 3] += 0.05 * np.arange(FRAMES + 1)[:, None]
    solver = SolverOptions(substep=1 / 240)
    return Run("walk", stage.levels, fine, stage.body, poses, 1 / 60, Fabric(), ModelOptions(), solver, bend_factor=0.4)
