"""An outfit on a character, baked and played by Blender and by USD's own library: every vertex of every frame."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel

from assets.character import Character
from assets.io.scene import parse_scene
from assets.skinning import skin_vertices
from runtime.draw.shown_body import shown_body
from runtime.export.animation_baking import simulated_frames, write_baked
from runtime.setup.garment_mesh import texture_of
from runtime.setup.garment_setup import GarmentSetup
from runtime.setup.scene_body import body_of
from runtime.setup.scene_simulation import garments_of, simulation_of
from tests.blender import POSED_VERTICES, require_blender
from tests.runtime.baking import angles_deg
from wrinkles.mesh_measures import vertex_normals

SCENE = """
[[garment]]
name = "skirt"
mesh = "builtin:skirt"
attach = "top"
subdivisions = 1

[[garment]]
name = "tshirt"
mesh = "builtin:tshirt"
subdivisions = 1

[character]
file = "builtin:mannequin"
clip = "walk"

[[training.clips]]
file = "builtin:mannequin"
clip = "walk"
"""


class Baked(NamedTuple):
    """An outfit in files, and what is in them.

    Attributes:
        folder: with ``a.glb`` and ``a.usdc``.
        faces: of both garments, shape (m, 3).
        frames: their vertices in the world [m], shape (f, n, 3); ``normals`` of them.
        garments: vertices of each by its name.
        texture: texture coordinates of each face corner, shape (m, 3, 2).
        body: as it is drawn, thinner under the garments; ``skinned``: its vertices at each frame [m], shape (f, b, 3).
    """

    folder: Path
    faces: np.ndarray
    frames: np.ndarray
    normals: np.ndarray
    garments: dict[str, np.ndarray]
    texture: np.ndarray
    body: Character
    skinned: np.ndarray

    def corners_of(self, name: str) -> np.ndarray:
        """Texture coordinates of the face corners of a garment, shape (c, 2)."""
        return self.texture[np.isin(self.faces, self.garments[name]).all(axis=1)].reshape(-1, 2)


@pytest.fixture(scope="module")
def outfit(tmp_path_factory: pytest.TempPathFactory) -> Baked:
    folder = tmp_path_factory.mktemp("outfit")
    scene = parse_scene(SCENE, folder / "scene.toml")
    simulation, motion = simulation_of(scene, False)
    frames, poses, rate, _ = simulated_frames(simulation, motion, scene, 0.7)
    assert poses is not None and rate == pytest.approx(30.0)
    faces, garments = simulation.model.mesh.faces, garments_of(scene, simulation)
    texture, normals = texture_of(scene, False), vertex_normals(frames, simulation.model.mesh.faces)
    body = shown_body(body_of(scene), GarmentSetup.of(scene).levels)
    assert garments is not None and texture is not None and isinstance(body, Character)
    assert np.abs(body.vertices - body_of(scene).vertices).max() > 0.004  # it is thinner
    more: Any = {"body": body, "poses": poses, "garments": garments, "texture": texture}
    for ending in ("glb", "usdc"):
        write_baked(folder / f"a.{ending}", faces, frames, rate, normals, **more)
    skinned = np.array([skin_vertices(body, pose) for pose in poses])
    return Baked(folder, faces, frames, normals, garments, texture, body, skinned)


SCRIPT = (
    POSED_VERTICES
    + """
import sys

folder, names, count = sys.argv[1], sys.argv[2].split(","), int(sys.argv[3])

def corners(item, kind):
    mesh = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    if kind == "normal":
        found = np.zeros(3 * len(mesh.loops), np.float32)
        mesh.corner_normals.foreach_get("vector", found)
        turned = found.reshape(-1, 3) @ np.linalg.inv(np.array(item.matrix_world)[:3, :3])
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        return np.stack([turned[:, 0], turned[:, 2], -turned[:, 1]], axis=1)
    if kind == "vertex":
        found = np.zeros(len(mesh.loops), np.int32)
        mesh.loops.foreach_get("vertex_index", found)
        return found
    found = np.zeros(2 * len(mesh.loops), np.float32)
    mesh.uv_layers[0].data.foreach_get("uv", found)
    return found.reshape(-1, 2)

for ending in ("glb", "usdc"):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = 30
    (bpy.ops.import_scene.gltf if ending == "glb" else bpy.ops.wm.usd_import)(filepath=folder + "/a." + ending)
    found = {}
    items = {name: bpy.data.objects[name] for name in names}
    items["body"] = bpy.data.objects["body" if ending == "glb" else "mesh"]
    for name, item in items.items():
        places, normals = [], []
        for number in range(count):
            scene.frame_set(number)
            places.append(posed_vertices(item))
            normals.append(corners(item, "normal"))
        found[name] = np.array(places)
        found[name + "_normals"] = np.array(normals)
        found[name + "_corners"] = corners(item, "vertex")
        if name != "body":
            found[name + "_texture"] = corners(item, "texture")
    np.savez(folder + "/blender_" + ending + ".npz", **found, length_unit=scene.unit_settings.scale_length)
"""
)


@pytest.mark.proof
def test_blender(outfit: Baked) -> None:
    require_blender()
    words = [str(outfit.folder), ",".join(outfit.garments), str(len(outfit.frames))]
    # A process of its own: Blender brings its own LLVM.
    result = subprocess.run([sys.executable, "-c", SCRIPT, *words], capture_output=True, text=True, timeout=300)
    for ending, exact in (("glb", 3e-5), ("usdc", 1e-6)):
        assert (outfit.folder / f"blender_{ending}.npz").exists(), result.stderr
        with np.load(outfit.folder / f"blender_{ending}.npz") as played:
            assert played["length_unit"] == 1.0
            assert np.abs(played["body"][:, : len(outfit.body.vertices)] - outfit.skinned).max() < 1e-6
            for name, vertices in outfit.garments.items():
                faces = outfit.faces[np.isin(outfit.faces, vertices).all(axis=1)]
                corners = played[name][:, played[f"{name}_corners"]]
                assert np.abs(played[name][:, : len(vertices)] - outfit.frames[:, vertices]).max() < exact
                assert np.abs(corners - outfit.frames[:, faces.ravel()]).max() < exact
                assert np.abs(played[f"{name}_texture"] - outfit.corners_of(name)).max() < 1e-6
                turned = angles_deg(played[f"{name}_normals"], outfit.normals[:, faces.ravel()])
                sys.stdout.write(f"{ending}, {name}: normals {turned.mean():.2f} degrees, at most {turned.max():.0f}\n")
                # From a GLB Blender takes the first frame's normals, and turns them with the faces. At a seam of the
                # texture it turns them with the faces of one side.
                assert turned.mean() < (1.5 if ending == "glb" else 0.01)
                assert ending == "glb" or turned.max() < 0.2


@pytest.mark.proof
def test_usd_core(outfit: Baked) -> None:
    stage: Any = Usd.Stage.Open(str(outfit.folder / "a.usdc"))
    assert UsdSkel.BakeSkinning(UsdSkel.Root.Get(stage, "/World/body"))
    for number in range(len(outfit.frames)):
        body = UsdGeom.Mesh.Get(stage, "/World/body/mesh").GetPointsAttr().Get(number)
        assert np.abs(np.array(body) - outfit.skinned[number]).max() < 1e-5
        for name, vertices in outfit.garments.items():
            places = UsdGeom.Mesh.Get(stage, f"/World/{name}").GetPointsAttr().Get(number)
            assert np.abs(np.array(places) - outfit.frames[number, vertices]).max() < 1e-6
    for name in outfit.garments:
        texture = UsdGeom.PrimvarsAPI.Get(stage, f"/World/{name}").GetPrimvar("st").ComputeFlattened()
        assert np.abs(np.array(texture) - outfit.corners_of(name)).max() < 1e-6
