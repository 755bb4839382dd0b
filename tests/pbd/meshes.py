"""Sheets of cloth for physics tests, bodies for them, how to run them, and what is measured of them."""

from __future__ import annotations

import numpy as np

from pbd import Body, ClothMesh, Colliders, Fabric, Model, ModelOptions, Solver, SolverOptions, State, build_model
from tests.wrinkles.meshes import icosphere

__all__ = [
    "RADIUS", "THICKNESS", "bodies", "body_of", "cloth", "free_model", "grid", "icosphere", "level", "level_sheet",
    "momentum", "run", "thrown_sheet", "to_triangles", "turn", "wavy",
]  # fmt: skip

THICKNESS = Fabric.thickness  # of cloth that is not told another [m]
RADIUS = 0.15  # of the balls under it [m]


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
    return build_model(mesh, fabric, held, options=ModelOptions(tether_slack=0.0), bend_factor=bend_factor)


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


def wavy(place: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A sheet with waves both ways, turned, at a distance along x and y [m]."""
    vertices, faces = grid(12, 10, 0.04, "equilateral")
    vertices[:, 2] = 0.03 * np.sin(9.0 * vertices[:, 0]) * np.cos(7.0 * vertices[:, 1])
    return vertices @ turn((1.0, 2.0, 0.5), 40.0).T + [place, place, 0.0], faces


def momentum(model: Model, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Linear momentum [kg m/s] and angular momentum about the centre of mass [kg m2/s], each shape (3,)."""
    mass, velocity, position = model.mass[:, None], state.velocity.astype(float), state.world()
    total = (mass * velocity).sum(axis=0)
    arm = position - (mass * position).sum(axis=0) / mass.sum()
    return total, np.cross(arm, mass * (velocity - total / mass.sum())).sum(axis=0)


def level_sheet(edges: int, size: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Level sheet, normals up, a little off the middle so that nothing is balanced."""
    vertices, faces = grid(edges, edges, size / edges)
    return vertices[:, [1, 2, 0]] + [0.013 - size / 2, height, -0.007 - size / 2], faces


def level(along: int, across: int, step: float, height: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A sheet in the x-z plane, normals up, about a point above the origin."""
    vertices, faces = grid(along, across, step)
    vertices = vertices[:, [1, 2, 0]]
    return vertices - vertices.mean(axis=0) + [0.0, height, 0.0], faces


def bodies(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Ellipsoids, lumpy balls and boxes, from fine to coarser than the distance searched."""
    rng = np.random.default_rng(seed)
    if seed % 3 == 2:
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * rng.uniform(0.05, 0.2, 3)
        quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
        faces = np.array([[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)], np.int32)
        return corners, faces
    vertices, faces = icosphere(int(rng.integers(1, 5)), 0.15)
    vertices = vertices * rng.uniform(0.4, 1.3, 3)
    if seed % 3 == 1:
        vertices = vertices * (1.0 + 0.08 * np.sin(20.0 * vertices[:, :1]) * np.cos(25.0 * vertices[:, 1:2]))
    return vertices, faces


def to_triangles(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance [m] of points to a mesh and the closest points, by trying all faces: each inside, then at its sides."""
    a, b, c = (vertices[faces[:, k]][None] for k in range(3))
    p = points[:, None, :]
    normal = np.cross(b - a, c - a)
    normal = normal / np.linalg.norm(normal, axis=2, keepdims=True)
    foot = p - ((p - a) * normal).sum(axis=2, keepdims=True) * normal
    inside = np.ones(foot.shape[:2], bool)
    best, best_distance = np.zeros_like(foot), np.full(foot.shape[:2], np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        side = end - start
        inside &= (np.cross(side, foot - start) * normal).sum(axis=2) >= 0
        t = np.clip(((p - start) * side).sum(axis=2) / (side**2).sum(axis=2), 0.0, 1.0)
        on_side = start + t[..., None] * side
        distance = np.linalg.norm(on_side - p, axis=2)
        nearer = distance < best_distance
        best[nearer], best_distance[nearer] = on_side[nearer], distance[nearer]
    best[inside], best_distance[inside] = foot[inside], np.linalg.norm(foot - p, axis=2)[inside]
    face = best_distance.argmin(axis=1)
    rows = np.arange(len(points))
    return best_distance[rows, face], best[rows, face]


def thrown_sheet() -> tuple[Solver, State]:
    """A sheet whose parts are thrown at one another."""
    vertices, faces = grid(24, 24, 0.02)
    model = free_model(cloth(vertices, faces), Fabric(thickness=0.003, friction=0.3))
    solver = Solver(model, SolverOptions(gravity=(0.0, 0.0, 0.0), self_collision=True))
    state = State.at_rest(model)
    waves = np.random.default_rng(5).normal(0.0, 1.0, (8, 6))
    for wave in waves:
        state.velocity[:] += 4.0 * np.sin(vertices @ (12.0 * wave[:3]) + wave[3])[:, None] * wave[3:]
    return solver, state
