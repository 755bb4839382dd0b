"""The same bits whatever the number of threads, and in every process."""

from tests.processes import python

SCRIPT = """
import numpy as np
from pbd import Capsule, ClothMesh, Colliders, Fabric, Plane, Solver, State, build_model
from tests.pbd.meshes import body_of, icosphere

# A tube held at its upper edge by a hip that sways, over a leg that kicks.
around, down = 36, 16
angle, depth = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(down + 1.0), indexing="ij")
radius = 0.13 + 0.006 * depth
vertices = np.stack([radius * np.cos(angle), 0.5 - 0.03 * depth, radius * np.sin(angle)], axis=-1).reshape(-1, 3)
i, j = (part.ravel() for part in np.meshgrid(np.arange(around), np.arange(down), indexing="ij"))
corner = lambda a, b: (a % around) * (down + 1) + b
faces = np.concatenate([
    np.stack([corner(i, j), corner(i + 1, j), corner(i + 1, j + 1)], axis=1),
    np.stack([corner(i, j), corner(i + 1, j + 1), corner(i, j + 1)], axis=1),
])
held = np.flatnonzero(vertices[:, 1] > 0.5 - 1e-9)
model = build_model(ClothMesh.from_surface(vertices, faces), Fabric(), held)
state, solver = State.at_rest(model), Solver(model)
hip, hip_faces = icosphere(3, 0.14)
body = body_of(hip + [0.0, 0.4, 0.0], hip_faces, state)
leg = Capsule((0.0, 0.3, 0.0), (0.0, -0.2, 0.0), 0.06)
colliders = Colliders([leg, Plane((0.0, -0.05, 0.0))], body)
for frame in range(1, 121):
    t = frame / 60
    sway = np.array([0.15 * np.sin(6 * t), 0.0, 0.5 * t])
    leg.start, leg.end = tuple(sway + [0.0, 0.3, 0.0]), tuple(sway + [0.0, -0.2, 0.3 * np.sin(9 * t)])
    solver.follow(state, colliders)
    body.advance((hip + [0.0, 0.4, 0.0] + sway - state.origin).astype(np.float32))
    solver.step(state, colliders, 1 / 60, vertices[held] + sway, wind=(0.0, 0.0, -2.0))
assert np.isfinite(state.position).all() and (state.contact < 0.0031).sum() > 3
print(state.hash())
"""


def test_threads_do_not_change_a_bit() -> None:
    one, two = (python(SCRIPT, GUBE_THREADS=threads).split()[-1] for threads in "12")
    assert one == two and len(one) == 64
