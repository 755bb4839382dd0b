"""What contact of a cloth with itself costs: a square draped over a sphere."""

import numpy as np

from pbd import ClothMesh, Colliders, Fabric, Solver, SolverOptions, Sphere, State
from pbd.crossings import crossings
from pbd.mesh import lattice_faces
from precompute.experiment.measures import FRAME_RATE, TimedSteps, typical_ms
from precompute.experiment.sheets import lattice, untethered

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
    index, *places = lattice(side, side)
    x, z = (part * step - 0.5 for part in places)
    faces = lattice_faces(index, alternating=False)[:, [0, 2, 1]]  # z grows downwards where x grows to the right
    mesh = ClothMesh.from_surface(np.stack([x, 0 * x + RADIUS + 0.01, z], axis=1), faces, warp=(1.0, 0.0, 0.0))
    model = untethered(mesh, Fabric(friction=0.3))
    colliders, state = Colliders([Sphere((0.0, 0.0, 0.0), RADIUS)]), State.at_rest(model)
    solvers = [Solver(model, SolverOptions(self_collision=on)) for on in (False, True)]
    for solver in solvers:
        solver.step(state.copy(), colliders, 1.0 / FRAME_RATE)  # compiles
    both = [TimedSteps(solver.step, ()) for solver in solvers]
    for _ in range(frames):
        copies = [state.copy() for _ in both]
        for steps, copy in zip(both, copies, strict=True):
            steps(copy, colliders, 1.0 / FRAME_RATE)
        state = copies[-1]
    world, (without, within) = state.world(), (np.array(steps.times[-JUDGED:]) for steps in both)
    return {
        f"self_collision_ms_{side}": typical_ms(within - without),
        f"self_collision_crossings_{side}": float(len(crossings(world, faces))),
        f"self_collision_top_mm_{side}": float(world[:, 1].max() - RADIUS) * 1e3,
    }
