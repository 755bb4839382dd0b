"""Compiles the kernels that most tests need: processes that run side by side then find them in Taichi's cache.

Without it each would compile them for itself, the player's in half a minute and those of a batch in one.
Run as ``python -m tests.kernels player`` or ``batch``.
"""

from __future__ import annotations

import sys

from runtime.player import Player
from runtime.simulation import poses_of
from tests.pbd.batches import OPTIONS, sheets, together
from tests.runtime.players import skirt_database, skirt_stage

DT = 1.0 / 60.0  # [s]


def player() -> None:
    """A frame of a player."""
    poses = poses_of(skirt_stage().motion(), DT, 2.0 * DT)
    Player(skirt_database(), skirt_stage().body, poses[0]).update(poses[1], DT)


def batch() -> None:
    """A frame of several garments at once."""
    together(sheets(), OPTIONS, 1)


if __name__ == "__main__":
    {"player": player, "batch": batch}[sys.argv[1]]()
