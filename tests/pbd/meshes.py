"""Sheets of cloth for physics tests, and how to run them."""

from __future__ import annotations

import numpy as np

from pbd import Body, ClothMesh, Colliders, Fabric, Model, ModelOptions, Solver, SolverOptions, State, build_model
from tests.wrinkles.meshes import icosphere

__all__ = ["body_of", "cloth", "free_model", "grid", "icosphere", "run", "turn"]


def grid(along: int, across: int, step: float, kind: str = "alternating") -> tuple[np.ndarray, np.ndarray]:
    """Flat sheet in the x-y plane, normals along z: (vertices [m], faces).

    Args:
        along, across: edges along x and y.
        step: length of an edge along y [m].
        kind: "diagonal" (one diagonal throughout), "alternating", or "equilateral" (steps along x times sqrt(3)/2).
    """
    x, y = np.meshgrid(np.arange(along + 1.0), np.arange(across + 1.0), indexing="ij")
    if kind == "equilateral":
        y += 0.5 * (x % 2)
        x *= np.sqrt(0.75)
    vertices = step * np.stack([x, y, 0.0 * x], axis=-1).reshape(-1, 3)
    i, j = (part.ravel() for part in np.meshgrid(np.arange(along), np.arange(across), indexing="ij"))
    a, b, c, d = (
        i * (across + 1) + j,
        (i + 1) * (across + 1) + j,
        (i + 1) * (across + 1) + j + 1,
        i * (across + 1) + j + 1,
    )
    rising = {"diagonal": i >= 0, "alternating": (i + j) % 2 == 0, "equilateral": i % 2 == 1}[kind][:, None]
    first = np.where(rising, np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    second = np.where(rising, np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    return vertices, np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int32)


def turn(axis: tuple, degrees: float) -> np.ndarray:
    """Rotation matrix about an axis."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def cloth(vertices: np.ndarray, faces: np.ndarray, warp: tuple = (1.0, 0.0, 0.0)) -> ClothMesh:
    return ClothMesh.from_surface(vertices, faces, warp=warp)


def free_model(mesh: ClothMesh, fabric: Fabric, held: np.ndarray | None = None, bend_factor: float = 1 / 3) -> Model:
    """Model without tethers, which are no part of the fabric's physics."""
    return build_model(mesh, fabric, held, ModelOptions(tether_slack=0.0), bend_factor)


def run(
    model: Model,
    state: State,
    frames: int,
    substeps: int = 20,
    gravity: float = 9.81,
    colliders: Colliders | None = None,
    keep: float = 1.0,
    rate: float = 60.0,
    sweeps: int = SolverOptions.coarse_sweeps,
) -> None:
    """Advance a state by frames of 1/rate s; ``keep``: part of the velocity kept after each, below 1 to settle."""
    colliders = colliders or Colliders()
    options = SolverOptions(substep=1.0 / (rate * substeps), gravity=(0.0, -gravity, 0.0), coarse_sweeps=sweeps)
    solver = Solver(model, options)
    for _ in range(frames):
        solver.follow(state, colliders)
        solver.step(state, colliders, 1.0 / rate)
        if keep < 1.0:
            state.velocity *= np.float32(keep)


def body_of(vertices: np.ndarray, faces: np.ndarray, state: State) -> Body:
    """Body that stands still, in world coordinates, about the origin of a state."""
    body = Body(faces, len(vertices))
    body.origin = state.origin.copy()
    body.place((vertices - state.origin).astype(np.float32))
    return body
