"""Compiles the kernels that most tests need: processes that run side by side then find them in Taichi's cache.

Without it each would compile them for itself, some for as long as a minute. Run as ``python -m tests.kernels plain``
and ``python -m tests.kernels pairs``: no kernel that takes long is in both.
"""

from __future__ import annotations

import sys

from pbd import Colliders, Fabric, Solver, SolverOptions, State
from runtime.player import Player
from runtime.simulation import poses_of
from tests.pbd.batches import OPTIONS, sheets, together
from tests.pbd.meshes import cloth, free_model, grid
from tests.runtime.players import skirt_database, skirt_stage

DT = 1.0 / 60.0  # [s]


def plain() -> None:
    """A player, a batch of garments, and one garment without coarser levels."""
    poses = poses_of(skirt_stage().motion(), DT, 2.0 * DT)
    Player(skirt_database(), skirt_stage().body, poses[0]).update(poses[1], DT)
    step(SolverOptions(coarse_sweeps=0))
    together(sheets(), OPTIONS, 1)


def pairs() -> None:
    """Cloth that keeps its thickness from itself, with and without coarser levels."""
    step(SolverOptions(self_collision=True))
    step(SolverOptions(self_collision=True, coarse_sweeps=0))


def step(options: SolverOptions) -> None:
    model = free_model(cloth(*grid(14, 14, 0.02)), Fabric())
    Solver(model, options).step(State.at_rest(model), Colliders(), DT)


if __name__ == "__main__":
    {"plain": plain, "pairs": pairs}[sys.argv[1]]()
