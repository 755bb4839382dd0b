"""Scenes that must end in the same bits wherever they run: `python -m tests.reproduced` prints a line for each.

Between them they take every way through the solver: coarser levels, a body, friction, self-collision, internal
friction, garments dealt to threads, and a player with its wrinkles.
"""

from __future__ import annotations

import hashlib

import numpy as np

from pbd import Colliders, Fabric, Solver, SolverOptions, Sphere, State
from runtime.player import Player
from runtime.simulation import poses_of
from runtime.terminal import say
from tests.pbd.batches import OPTIONS, sheets, together
from tests.pbd.meshes import cloth, free_model, grid
from tests.runtime.players import skirt_database, skirt_stage

__all__ = ["SCENES"]

DT = 1.0 / 60.0  # [s]
RUBBING = Fabric(bend_hysteresis_warp=1e-3, bend_hysteresis_weft=5e-4, shear_hysteresis=1.0)


def folds(frames: int = 60) -> str:
    """A sheet that falls on a ball in folds, keeps its thickness from itself, and keeps creases."""
    vertices, faces = grid(14, 14, 0.03)
    model = free_model(cloth(vertices[:, [0, 2, 1]], faces), RUBBING)
    solver, state = Solver(model, SolverOptions(self_collision=True)), State.at_rest(model)
    colliders = Colliders([Sphere((0.2, -0.12, 0.23), 0.1)])
    for _ in range(frames):
        solver.step(state, colliders, DT)
    return state.hash()


def batch() -> str:
    """Three sheets on bodies and rods, dealt to all threads."""
    states = together(sheets(), OPTIONS, 60)
    return hashlib.sha256("".join(state.hash() for state in states).encode()).hexdigest()


def player() -> str:
    """Two seconds of a walk: the coarse state at the end, and the fine vertices of every frame."""
    poses = poses_of(skirt_stage().motion(), DT, 2.0)
    played, digest = Player(skirt_database(), skirt_stage().body, poses[0]), hashlib.sha256()
    for pose in poses[1:]:
        played.update(pose, DT)
        assert np.isfinite(played.vertices).all()
        digest.update(played.vertices.tobytes())
    digest.update(played.simulation.state.hash().encode())
    return digest.hexdigest()


SCENES = {"folds": folds, "batch": batch, "player": player}

if __name__ == "__main__":
    for name, scene in SCENES.items():
        say(f"{name} {scene()}")
