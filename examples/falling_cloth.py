"""A square of cotton falls on a ball and drapes over it.

Shows the solver alone: a mesh, a fabric, colliders, steps. It takes a few seconds, most of them for compiling.
"""

import numpy as np

import gube

RADIUS, BALL = 0.3, np.array([0.0, 0.5, 0.0])

mesh = gube.ClothMesh.grid(1.0, 1.0, 30, 30, centre=(0.0, 1.0, 0.0), level=True)
model = gube.build_model(mesh, gube.load_fabric("cotton"))
cloth = gube.Simulation(model, primitives=[gube.Sphere(BALL, RADIUS), gube.Plane((0.0, 0.0, 0.0))])
for _ in range(240):
    cloth.step(dt=1.0 / 60.0)

vertices = cloth.vertices
above_ball = np.linalg.norm(vertices - BALL, axis=1) - RADIUS
edges, rest_lengths = mesh.edge_lengths()
lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
speed = np.linalg.norm(cloth.state.velocity, axis=1)
print(f"lowest corner {vertices[:, 1].min():.2f} m, mean speed {speed.mean():.3f} m/s")

assert above_ball.min() > 0.0, "no vertex is inside the ball"
assert above_ball.min() < 2.0 * model.fabric.thickness, "the cloth lies on the ball"
assert vertices[:, 1].min() < BALL[1] < vertices[:, 1].max(), "its corners hang down around the ball"
assert np.percentile(np.abs(lengths / rest_lengths - 1.0), 99) < 0.05, "cotton hardly stretches"
assert speed.mean() < 0.1, "it has come to rest"
