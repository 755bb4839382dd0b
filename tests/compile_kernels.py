"""Compiles the kernels that most tests need, before they start: `python -m tests.compile_kernels`.

Taichi keeps what a process has compiled on the disk when the process ends, and another process sees what was there when
it began. Tests that begin together would compile the same kernels each for itself, a minute of each.
"""

from __future__ import annotations

from precompute.learning.truth import fine_run
from runtime.play.player import Player
from tests.runtime.players import outfit_database, skirt_database, skirt_stage

DT = 1.0 / 60.0


def compile_kernels() -> None:
    """Play a skirt and an outfit, and simulate the skirt finely, for two frames each."""
    stage = skirt_stage()
    motion = stage.motion()
    for database in (skirt_database(), outfit_database()):
        player = Player(database, stage.body, motion.pose(0.0))
        for frame in (1, 2):
            player.update(motion.pose(frame * DT), DT)
    run = fine_run(stage.levels, stage.body, motion, skirt_database(), substep=DT / 8.0)
    simulation = run.simulation()
    for frame in (1, 2):
        simulation.step(run.poses[frame], run.dt)


if __name__ == "__main__":
    compile_kernels()
