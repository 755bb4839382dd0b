"""The built-in skirt on the built-in mannequin, which walks. The animation is written to skirt.glb, for Blender.

Shows a scene, a garment that a body carries, and baking. It takes some seconds, most of them for compiling.
"""

import numpy as np

import gube

SCENE = """
[[garment]]
name = "skirt"
mesh = "builtin:skirt"
fabric = "wool"
attach = "top"

[character]
file = "builtin:mannequin"
"""
RATE = 60.0  # frames a second

skirt, _ = gube.simulation_of(gube.parse_scene(SCENE))
mannequin = gube.load_character("builtin:mannequin")
walk = gube.ClipMotion(mannequin, "walk")
waist, hem = skirt.model.held, np.argmin(skirt.vertices[:, 1])
frames, poses, gaps = [skirt.vertices], [walk.pose(0.0)], []
for frame in range(1, 181):
    poses.append(walk.pose(frame / RATE))
    skirt.step(poses[-1], 1.0 / RATE)
    frames.append(skirt.vertices)
    gaps.append(skirt.state.contact.min())  # distance to the body
gube.bake_glb(
    "skirt.glb",
    skirt.model.mesh.faces,
    np.array(frames[::2]),
    RATE / 2.0,
    body=mannequin,
    poses=np.array(poses[::2]),
    texture=gube.load_garment("builtin:skirt").texture,
)

path = np.array([frame[waist].mean(axis=0) for frame in frames])
swing = np.array([frame[hem] for frame in frames]) - path
speed = np.linalg.norm(path[-1] - path[-61]) * RATE / 60.0
print(f"{len(frames)} frames, the waistband moves at {speed:.2f} m/s")

assert abs(speed - 1.2) < 0.1, "the waistband goes along with the body, which walks at 1.2 m/s"
assert path[:, 1].min() > 0.9, "and stays at the height of the waist"
assert np.ptp(swing[:, 2]) > 0.02, "the hem swings"
assert min(gaps) > 0.5 * skirt.model.fabric.thickness, "the cloth keeps its thickness from the body"
