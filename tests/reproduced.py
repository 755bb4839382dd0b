"""Scenes that must end in the same bits wherever they run: `python -m tests.reproduced` prints a line for each.

Between them they take every way through the solver: coarser levels, a body, friction, self-collision, internal
friction, held vertices, a waistband, wind, and a player with its wrinkles.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from pbd import Capsule, Colliders, Fabric, Solver, SolverOptions, Sphere, State, build_model
from runtime.output.terminal import say
from runtime.play.player import Player
from runtime.play.simulation import poses_of
from tests.pbd.meshes import body_of, cloth, free_model, grid, icosphere
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


def held(frames: int = 60) -> str:
    """A sheet in the wind, held by one side over a ball that sways and a rod; its other side is a waistband."""
    flat, faces = grid(10, 12, 0.04)
    start = flat[:, [0, 2, 1]]
    band = flat[faces][:, :, 0].min(axis=1) > flat[:, 0].max() - 0.05
    sheet = replace(cloth(start, faces), max_stretch=np.where(band, 1.0, 1.5))
    model = build_model(sheet, Fabric(stretch_warp=1e5, stretch_weft=1e5), np.flatnonzero(flat[:, 0] < 1e-9))
    solver, state = Solver(model), State.at_rest(model)
    ball, triangles = icosphere(3, 0.15)
    body = body_of(ball + [0.2, -0.153, 0.2], triangles, state)
    colliders = Colliders([Capsule((0.3, -0.05, -1.0), (0.3, -0.05, 1.0), 0.03)], body)
    for frame in range(frames):
        sway = np.array([0.0, 0.02 * np.sin(frame), 0.0])
        body.advance((ball + [0.2, -0.153, 0.2] + sway - state.origin).astype(np.float32))
        solver.step(state, colliders, DT, start[model.held] + sway, (0.0, -2.0, 0.5))
    return state.hash()


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


SCENES = {"folds": folds, "held": held, "player": player}

if __name__ == "__main__":
    for name, scene in SCENES.items():
        say(f"{name} {scene()}")
