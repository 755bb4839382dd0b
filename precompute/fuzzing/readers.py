"""Every reader of a file that comes from somebody else, and small good files that the project makes for it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from ezdxf.document import Drawing
from ezdxf.enums import InsertUnits

from assets.fabrics import PRESETS, load_fabric
from assets.io.bvh import read_bvh
from assets.io.retarget import load_joint_table
from assets.io.scene import load_scene
from assets.io.sequence import load_sequence
from assets.loading import load_animation, load_character, load_garment
from assets.painted_limits import load_limits
from assets.patterns.load import load_pattern
from assets.procedural.mannequin import DATA, builtin_mannequin
from assets.seams import load_seams
from pbd import State, build_model
from pbd.mesh import ClothMesh, lattice_faces
from precompute.fabric_lab.fabric_fit import read_curves
from runtime.detail.cost_table import read_cost_table
from runtime.export.animation_files import bake_glb, bake_mdd, bake_pc2, bake_usd
from runtime.export.recording_file import links_of, quantised, read_recording, recording_bytes
from wrinkles.database_file import read_database

__all__ = ["READERS", "write_good_files"]

COUNT = 25  # vertices of the good meshes


def _with_mesh(path: Path) -> Path:
    """A point cache with a good mesh beside it, which it does not hold itself."""
    path.with_suffix(".obj").write_bytes((path.parent / "sheet.obj").read_bytes())
    return path


def _with_seams(path: Path) -> Path:
    """A drawing with a good file of seams beside it."""
    path.with_suffix(".seams.toml").write_text(SEAMS, encoding="utf-8")
    return path


READERS: Mapping[str, tuple[Callable[[Path], Any], ...]] = {
    ".glb": (load_character, load_garment, lambda path: load_animation(path, ())),
    ".gltf": (load_character, load_garment, lambda path: load_animation(path, ())),
    ".obj": (load_garment, lambda path: load_garment(path, pattern=True)),
    ".toml": (load_scene,),
    ".h5": (read_database,),
    ".npz": (load_sequence, load_garment, lambda path: State.load(str(path))),
    ".csv": (
        lambda path: load_seams(path, COUNT), lambda path: load_limits(path, COUNT), load_joint_table,
        lambda path: [(curve.deformation, curve.load) for curve in read_curves(path).values()],
    ),
    ".pc2": (lambda path: load_sequence(_with_mesh(path), 30.0),),
    ".mdd": (lambda path: load_sequence(_with_mesh(path)),),
    ".bvh": (read_bvh,),
    ".usdc": (load_character, load_sequence, lambda path: load_animation(path, ())),
    ".usda": (load_character, load_sequence, lambda path: load_animation(path, ())),
    ".json": (load_fabric, load_pattern, read_cost_table),
    ".svg": (lambda path: load_pattern(_with_seams(path)),),
    ".dxf": (lambda path: load_pattern(_with_seams(path)),),
    ".rec": (lambda path: read_recording(path.read_bytes()),),
}  # fmt: skip
"""What reads a file, by the ending of its name."""

SCENE = """
[[garment]]
name = "skirt"
mesh = "{mesh}"
fabric = {{ areal_density = 0.2, bend_warp = 1e-5, friction = 0.3 }}
ease = [0.05, 0.0]
subdivisions = 2
attach = [0]
limits = "limits.csv"

[character]
file = "builtin:mannequin"
clip = "walk"

[training]
procedural_seconds = 4.0
fabrics = ["denim"]

[[training.held_out]]
file = "builtin:mannequin"
clip = "walk"
start = 0.5
end = 1.5

[wind]
velocity = [1.0, 0.0, 2.0]
turbulence = 0.3

[solver]
frame_rate = 60
gravity = [0.0, -9.81, 0.0]
"""
BVH = """HIERARCHY
ROOT hips
{
  OFFSET 0.0 0.9 0.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT spine
  {
    OFFSET 0.0 0.3 0.0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0.0 0.2 0.0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 0.9 0 0 0 0 10 0 0
0 0.9 0.1 5 0 0 12 1 0
"""
SEAMS = 'seams = [["front", 0, "back", 0], ["front", 2, "back", 2]]\n'
SVG = """<svg xmlns="http://www.w3.org/2000/svg" width="40cm" height="60cm" viewBox="0 0 40 60">
<path id="front" d="M 0 0 L 40 0 C 40 20 38 40 40 60 L 0 60 Z"/><rect id="back" x="50" y="0" width="40" height="60"/>
</svg>
"""


def _sheet(side: int = 5) -> tuple[np.ndarray, np.ndarray]:
    across, along = np.meshgrid(np.linspace(0.0, 0.4, side), np.linspace(0.6, 1.0, side))
    return np.stack([across.ravel(), along.ravel(), 0.2 + 0.0 * across.ravel()], axis=1), lattice_faces(
        np.arange(side * side).reshape(side, side)
    )


def write_good_files(folder: Path) -> list[Path]:
    """Write one small good file or more of every kind but the database, which only learning makes."""
    folder.mkdir(parents=True, exist_ok=True)
    vertices, faces = _sheet()
    frames = np.stack([vertices, vertices + [0.0, 0.0, 0.05]]).astype(np.float32)
    lines = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in vertices]
    lines += [f"vt {x:.4f} {y:.4f}" for x, y, _ in vertices]
    lines += ["f " + " ".join(f"{c + 1}/{c + 1}" for c in face) for face in faces.tolist()]
    written = {
        "sheet.obj": "\n".join(lines) + "\n",
        "limits.csv": "vertex,maximum_distance,backstop,stiffness\n0,0.05,0.01,100\n3,0.1,,\n",
        "seams.csv": "v,a,b,w\n0,5,6,0.25\n4,9,8,0.5\n",
        "joints.csv": "part,joint,bvh\nleft hand,hand_l,LeftHand\nleft foot,,LeftFoot\n",
        "curves.csv": "instrument,direction,deformation,load\ntension,warp,0.01,20\nbending,warp,100,0.001\n",
        "motion.bvh": BVH,
        "panel.svg": SVG,
        "fabric.json": json.dumps(
            {"density": 0.2, "stretching": [[100.0, 10.0, 90.0, 20.0]] * 6, "bending": [[1e-5] * 5] * 3}
        ),
        "scene.toml": SCENE.format(mesh="sheet.obj"),
    }
    for name, text in written.items():
        (folder / name).write_text(text, encoding="utf-8")
    drawing = Drawing.new("R2010")
    drawing.units = InsertUnits.Centimeters
    for number, name in enumerate(("front", "back")):
        corners = [(50.0 * number + x, y) for x, y in ((0, 0), (40, 0), (40, 60), (0, 60))]
        drawing.modelspace().add_lwpolyline(corners, close=True, dxfattribs={"layer": name})
    drawing.saveas(folder / "panel.dxf")
    shutil.copy(DATA / "skirt.npz", folder)
    np.savez(folder / "sequence.npz", vertices=frames, faces=faces, dt=np.float64(1 / 30))
    mesh = ClothMesh.from_surface(vertices, faces)
    State.at_rest(build_model(mesh, PRESETS["wool"], bend_factor=1 / 3)).save(str(folder / "state.npz"))
    bake_pc2(folder / "a.pc2", faces, frames)
    bake_mdd(folder / "b.mdd", faces, frames, 30.0)
    body = builtin_mannequin()
    poses = np.stack([body.bind_pose()] * 2)
    bake_glb(folder / "body.glb", faces, frames, 30.0, body=body, poses=poses)
    bake_glb(folder / "cloth.glb", faces, frames[:1], 30.0)
    bake_usd(folder / "cloth.usdc", faces, frames, 30.0)
    moving = quantised("positions", frames, 0.01, differences=1, links="links")
    (folder / "a.rec").write_bytes(recording_bytes({"name": "a"}, {"links": links_of(frames[0]), "positions": moving}))
    return sorted(path for path in folder.iterdir() if path.suffix in READERS)
