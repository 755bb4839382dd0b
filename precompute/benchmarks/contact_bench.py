"""What contact of a cloth with itself costs: a square draped over a sphere."""

import time

import numpy as np

from pbd import ClothMesh, Colliders, Fabric, ModelOptions, Solver, SolverOptions, Sphere, State, build_model
from pbd.crossings import crossings
from pbd.mesh import lattice_faces
from precompute.experiment.measures import FRAME_RATE

__all__ = ["self_collision_cost"]

FRAMES, JUDGED = 300, 60  # of the run, and last ones whose median counts
RADIUS = 0.3  # of the sphere [m]


def self_collision_cost(side: int = 64, *, frames: int = FRAMES) -> dict[str, float]:
    """Drape a square of 1 m with friction 0.3 over a sphere.

    Args:
        side: vertices along a side.
        frames: of the run.

    Returns:
        ``self_collision_ms_SIDE``: processor time of a frame less that of the same frame without self-collision, median
        of the last second [ms]; ``self_collision_crossings_SIDE``: edges that go through faces at the end;
        ``self_collision_top_mm_SIDE``: highest point above the sphere at the end [mm].
    """
    step = 1.0 / (side - 1)
    x, z = (part.ravel() * step - 0.5 for part in np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
    index = np.arange(side * side).reshape(side, side)
    faces = lattice_faces(index, alternating=False)[:, [0, 2, 1]]  # z grows downwards where x grows to the right
    mesh = ClothMesh.from_surface(np.stack([x, 0 * x + RADIUS + 0.01, z], axis=1), faces, warp=(1.0, 0.0, 0.0))
    model = build_model(mesh, Fabric(friction=0.3), options=ModelOptions(tether_slack=0.0), bend_factor=1 / 3)
    colliders, state = Colliders([Sphere((0.0, 0.0, 0.0), RADIUS)]), State.at_rest(model)
    solvers = [Solver(model, SolverOptions(self_collision=on)) for on in (False, True)]
    for solver in solvers:
        solver.step(state.copy(), colliders, 1.0 / FRAME_RATE)  # compiles
    times = np.zeros((frames, 2))
    for frame in range(frames):
        after = state
        for which, solver in enumerate(solvers):
            after = state.copy()
            begin = time.process_time()
            solver.step(after, colliders, 1.0 / FRAME_RATE)
            times[frame, which] = time.process_time() - begin
        state = after
    world, last = state.world(), times[-JUDGED:]
    return {
        f"self_collision_ms_{side}": float(np.median(last[:, 1] - last[:, 0])) * 1e3,
        f"self_collision_crossings_{side}": float(len(crossings(world, faces))),
        f"self_collision_top_mm_{side}": float(world[:, 1].max() - RADIUS) * 1e3,
    }
