"""Scenes that a solver's speed and accuracy are measured on: cloth that hangs, swings and must not stretch."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay

from pbd import ClothMesh, Colliders, Fabric, Model, ModelOptions, Solver, SolverOptions, State, build_model
from pbd.mesh import lattice_faces
from precompute.mechanics import FRAME_RATE

__all__ = [
    "STIFF",
    "SolverMeasurement",
    "SolverScene",
    "hanging_cloth",
    "hanging_square",
    "measure",
    "measure_steps",
]

FRAMES = 300  # of a run
JUDGED = 60  # last frames, over which the median of the stretch is taken
SWING = 120  # last frames, over which the amplitude is taken: more than one swing
TILT = 30.0  # of the square from the vertical at the start [deg]
# Isotropic with E h = 1e5 N/m, no bending, no air.
STIFF = Fabric(0.2, 1e5, 1e5, 1 / 3, 3.75e4, bend_warp=0.0, bend_weft=0.0, thickness=0.001, air_drag=0.0)


@dataclass(frozen=True)
class SolverScene:
    """Cloth at rest that is let go.

    Attributes:
        name: of the scene.
        model: without tethers, which are no part of the fabric's physics.
        forward: unit vector along which it swings, shape (3,).
    """

    name: str
    model: Model
    forward: np.ndarray


@dataclass(frozen=True)
class SolverMeasurement:
    """Time, stretch and swing of a run of 300 frames.

    Stretch is elongation along warp and weft, median over the last 60 frames [-].

    Attributes:
        frame_ms: processor time of a frame, median [ms].
        mean, p99, worst: of the stretch over all faces' warp and weft.
        amplitude: of the mean forward displacement over the last 120 frames [m].
    """

    frame_ms: float
    mean: float
    p99: float
    worst: float
    amplitude: float

    def passes(self, amplitude: float) -> bool:
        """Stretch below 1, 2 and 5 %, and an amplitude within 3 % of a given one [m]. False for what is not finite."""
        stiff = self.mean < 0.01 and self.p99 < 0.02 and self.worst < 0.05
        return bool(stiff and abs(self.amplitude / amplitude - 1.0) < 0.03)


def hanging_square(count: int, hung: str = "corners", *, mesh: str = "grid", fabric: Fabric = STIFF) -> SolverScene:
    """Square of 1 m, tilted about its upper side by 30 deg from the vertical.

    Args:
        count: vertices a side; an irregular mesh has as many in all.
        hung: "corners" (the two upper ones) or "side" (the whole upper side).
        mesh: "grid" (squares with one diagonal throughout) or "irregular" (inner vertices moved by up to 0.35 of a
            step, Delaunay triangles).
        fabric: with its warp along the upper side.
    """
    step = 1.0 / (count - 1)
    flat = np.stack(np.meshgrid(np.arange(count), np.arange(count), indexing="ij"), axis=-1).reshape(-1, 2) * step
    if mesh == "grid":
        faces = lattice_faces(np.arange(count * count).reshape(count, count), alternating=False)
    else:
        inner = ((flat > 0.5 * step) & (flat < 1.0 - 0.5 * step)).all(axis=1)
        flat += inner[:, None] * np.random.default_rng(0).uniform(-0.35, 0.35, flat.shape) * step
        faces = _delaunay(flat)
    upper = flat[:, 1] > 1.0 - 1e-9
    side = (flat[:, 0] < 1e-9) | (flat[:, 0] > 1.0 - 1e-9)
    held = np.flatnonzero(upper & side if hung == "corners" else upper)
    angle, below = np.radians(TILT), flat[:, 1] - 1.0
    vertices = np.stack([flat[:, 0] - 0.5, below * np.cos(angle), -below * np.sin(angle)], axis=1)
    cloth = ClothMesh.from_surface(vertices, faces, warp=(1.0, 0.0, 0.0))
    return hanging_cloth(f"{mesh} {count}x{count} hung by its {hung}", cloth, held, fabric, (0.0, 0.0, 1.0))


def _delaunay(flat: np.ndarray) -> np.ndarray:
    faces = Delaunay(flat).simplices
    side_1, side_2 = flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]]
    twice_area = side_1[:, 0] * side_2[:, 1] - side_1[:, 1] * side_2[:, 0]
    faces[twice_area < 0] = faces[twice_area < 0][:, ::-1]
    return faces[np.abs(twice_area) > 1e-3 * np.median(np.abs(twice_area))]  # slivers along the border


def hanging_cloth(
    name: str, mesh: ClothMesh, held: np.ndarray, fabric: Fabric, forward: tuple[float, float, float]
) -> SolverScene:
    """Any cloth, hung by some of its vertices."""
    model = build_model(mesh, fabric, held, options=ModelOptions(tether_slack=0.0), bend_factor=1 / 3)
    return SolverScene(name, model, np.array(forward))


def measure(scene: SolverScene, options: SolverOptions) -> SolverMeasurement:
    """Run a scene with our solver and judge it; see :class:`SolverMeasurement`."""
    state, colliders, solver = State.at_rest(scene.model), Colliders(), Solver(scene.model, options)
    solver.step(state.copy(), colliders, 1.0 / FRAME_RATE)  # compiles
    return measure_steps(scene, lambda: solver.step(state, colliders, 1.0 / FRAME_RATE), state.world)


def measure_steps(scene: SolverScene, step: Callable[[], None], world: Callable[[], np.ndarray]) -> SolverMeasurement:
    """Run a scene and judge it; see :class:`SolverMeasurement`.

    Args:
        scene: whose cloth it is, at rest.
        step: advances it by a frame.
        world: where its vertices are [m], shape (n, 3).
    """
    model, start = scene.model, world()
    inverse_flat = np.linalg.inv(model.mesh.flat)
    times, stretch, forward = np.zeros(FRAMES), np.full((FRAMES, 3), np.inf), np.full(FRAMES, np.inf)
    for frame in range(FRAMES):
        begin = time.process_time()
        step()
        times[frame] = time.process_time() - begin
        vertices = world()
        if not np.isfinite(vertices).all():
            return SolverMeasurement(float(np.median(times[: frame + 1])) * 1e3, *[np.inf] * 4)
        if frame >= FRAMES - SWING:
            forward[frame] = ((vertices - start) @ scene.forward).mean()
        if frame >= FRAMES - JUDGED:
            corners = vertices[model.mesh.faces]
            sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
            elongation = np.maximum(np.linalg.norm(sides @ inverse_flat, axis=1) - 1.0, 0.0)
            stretch[frame] = elongation.mean(), np.percentile(elongation, 99), elongation.max()
    mean, p99, worst = np.median(stretch[-JUDGED:], axis=0)
    amplitude = 0.5 * float(np.ptp(forward[-SWING:]))
    return SolverMeasurement(float(np.median(times)) * 1e3, float(mean), float(p99), float(worst), amplitude)
