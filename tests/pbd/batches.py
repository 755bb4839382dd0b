"""Sheets to be stepped alone and together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pbd import Body, Capsule, Colliders, Fabric, Solver, SolverOptions, State, build_model
from pbd.xpbd.batch_solver import BatchSolver
from tests.pbd.meshes import body_of, cloth, grid, icosphere

__all__ = ["OPTIONS", "Sheet", "sheets", "together"]

OPTIONS = SolverOptions(substep=1 / 240, coarse_sweeps=2)


class Sheet:
    """A sheet held by one side, which moves, over a ball and a rod; its edges are tested for contact in their middle.

    Args:
        along, across: its edges.
        shift: of the ball [m].
        with_body: whether the ball is there.
    """

    def __init__(self, along: int, across: int, shift: float, with_body: bool = True) -> None:
        flat, faces = grid(along, across, 0.04)
        self.start = flat[:, [0, 2, 1]]
        held = np.flatnonzero(flat[:, 0] < 1e-9)
        sheet = cloth(self.start, faces)
        band = flat[faces][:, :, 0].min(axis=1) > flat[:, 0].max() - 0.05  # along the side opposite to the held one
        sheet = replace(sheet, max_stretch=np.where(band, 1.0, 1.5))
        self.model = build_model(sheet, Fabric(stretch_warp=1e5, stretch_weft=1e5), held)
        self.ball, self.ball_faces = icosphere(3, 0.15)
        self.ball = self.ball + [0.2, -0.153, 0.2 + shift]
        self.with_body = with_body
        self.state = State.at_rest(self.model)
        self.body: Body | None = body_of(self.ball, self.ball_faces, self.state) if with_body else None
        self.rod = Capsule((0.3, -0.05, -1.0), (0.3, -0.05, 1.0), 0.03)
        self.colliders = Colliders([self.rod], self.body)
        self.wind = (0.0, -2.0, shift)

    def advance(self, frame: int) -> np.ndarray:
        """Move what moves it; where the held vertices go."""
        up = 0.02 * np.sin(frame)
        if self.body is not None:
            self.body.advance((self.ball + [0.0, up, 0.0] - self.state.origin).astype(np.float32))
        self.rod.start, self.rod.end = (0.3, up - 0.05, -1.0), (0.3, up - 0.05, 1.0)
        return self.start[self.model.held] + [0.0, up, 0.0]


def sheets() -> list[Sheet]:
    return [Sheet(10, 12, 0.0), Sheet(7, 9, 0.03), Sheet(9, 9, 0.01, with_body=False)]


def together(garments: list[Sheet], options: SolverOptions, frames: int, threads_each: int = 1) -> list[State]:
    batch = BatchSolver([Solver(sheet.model, options) for sheet in garments], threads_each)
    states, colliders = [sheet.state for sheet in garments], [sheet.colliders for sheet in garments]
    for frame in range(frames):
        targets = [sheet.advance(frame) for sheet in garments]
        batch.step(states, colliders, 1 / 60, targets, [sheet.wind for sheet in garments])
    return states
