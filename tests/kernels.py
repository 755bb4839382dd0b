"""Compiles the kernels that most tests need: processes that run side by side then find them in Taichi's cache.

Without it each would compile them for itself, half a minute for the solver alone: `python -m tests.kernels`.
"""

from __future__ import annotations

from runtime.player import Player
from runtime.simulation import poses_of
from tests.pbd.batches import OPTIONS, sheets, together
from tests.runtime.players import skirt_database, skirt_stage

DT = 1.0 / 60.0

if __name__ == "__main__":
    poses = poses_of(skirt_stage().motion(), DT, 2.0 * DT)
    Player(skirt_database(), skirt_stage().body, poses[0]).update(poses[1], DT)
    together(sheets(), OPTIONS, 1)
