"""Garments that were made for one body on another body of the same rig."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.character import Character
from assets.garment import Garment
from assets.io.scene import parse_scene
from assets.loading import load_garment
from assets.motion import ClipMotion
from assets.procedural.mannequin import builtin_mannequin
from pbd.attachment import smooth_normals
from pbd.mesh import edges_of
from runtime.export.animation_files import bake_glb
from runtime.setup.fitting import fitted
from runtime.setup.garment_setup import GarmentSetup
from runtime.setup.scene_simulation import simulation_of
from tests.refusals import refuses

SCENE = """
[[garment]]
name = "tshirt"
mesh = "builtin:tshirt"
made_for = "builtin:mannequin"
subdivisions = 1

[character]
file = "{body}"
clip = "{clip}"
"""


def tall(body: Character, size: float) -> Character:
    translation, rotation, scale = body.rest_local
    inverse_bind, root = body.inverse_bind.copy(), body.root_transform.copy()
    inverse_bind[:, :3, 3] *= size
    root[:3, 3] *= size
    local = size * translation, rotation, scale
    return replace(
        body, name="tall", vertices=size * body.vertices, rest_local=local, inverse_bind=inverse_bind,
        root_transform=root, clips={},
    )  # fmt: skip


def wide(body: Character, more: float) -> Character:
    normals = smooth_normals(body.vertices, body.faces) * [1.0, 0.0, 1.0]
    return replace(body, name="wide", vertices=body.vertices + more * normals)


def lengths(garment: Garment) -> np.ndarray:
    edges, _ = edges_of(garment.faces)
    return np.linalg.norm(garment.vertices[edges[:, 0]] - garment.vertices[edges[:, 1]], axis=1)


def sides(pattern: np.ndarray) -> np.ndarray:
    return np.linalg.norm(pattern[:, 1:] - pattern[:, :1], axis=2)


@pytest.mark.parametrize("name", ["tshirt", "trousers", "skirt", "shirt"])
@pytest.mark.parametrize("size", [0.85, 1.1])
def test_on_a_body_of_another_size_the_garment_has_that_size(name: str, size: float) -> None:
    garment, body = load_garment(f"builtin:{name}"), builtin_mannequin()
    larger = fitted(garment, body, tall(body, size), "body")
    assert lengths(larger) / lengths(garment) == pytest.approx(size, rel=0.01)
    assert sides(larger.pattern) / sides(garment.pattern) == pytest.approx(size, rel=0.01)


@pytest.mark.parametrize(("more", "grown"), [(0.03, (1.03, 1.2)), (-0.02, (0.88, 0.98))])
def test_on_a_wider_body_the_garment_is_wider(more: float, grown: tuple[float, float]) -> None:
    garment, body = load_garment("builtin:tshirt"), builtin_mannequin()
    other = fitted(garment, body, wide(body, more), "body")
    kept = fitted(garment, body, wide(body, more), "lengths")
    assert grown[0] < np.median(lengths(other) / lengths(garment)) < grown[1]
    assert grown[0] < np.median(sides(other.pattern) / sides(garment.pattern)) < grown[1]
    np.testing.assert_array_equal(kept.pattern, garment.pattern)
    np.testing.assert_array_equal(kept.vertices, other.vertices)


def test_without_a_pattern_the_mesh_that_was_keeps_the_lengths() -> None:
    garment, body = replace(load_garment("builtin:tshirt"), pattern=None, layers=None), builtin_mannequin()
    kept = fitted(garment, body, wide(body, 0.03), "lengths")
    side = np.linalg.norm(garment.vertices[garment.faces[:, 1]] - garment.vertices[garment.faces[:, 0]], axis=1)
    assert sides(kept.pattern)[:, 0] == pytest.approx(side, rel=1e-6)
    assert fitted(garment, body, wide(body, 0.03), "body").pattern is None


def test_what_cannot_fit_is_refused() -> None:
    garment, body = load_garment("builtin:trousers"), builtin_mannequin()
    names = tuple(f"other_{name}" for name in body.joint_names)
    refuses("made_for: a body of another rig.*lacks", fitted, garment, body, replace(body, joint_names=names), "body")
    twin = replace(body, joint_names=tuple(name.replace("Left", "Right") for name in body.joint_names))
    for other in (body, twin):
        refuses("made_for: joints of one name .*'RightUpLeg'", fitted, garment, twin, other, "body")
    flat = replace(body, name="pancake", vertices=body.vertices * [6.0, 1.0, 1.0])
    refuses("does not fit pancake.*the worst at", fitted, garment, body, flat, "body")


def test_a_scene_fits_its_garment_and_plays_it(tmp_path: Path) -> None:
    body = wide(builtin_mannequin(), 0.03)
    poses = np.array([ClipMotion(body, "walk").pose(k / 30) for k in range(12)])
    place = np.zeros((12, 3, 3)) + np.eye(3)
    bake_glb(tmp_path / "wide.glb", np.array([[0, 1, 2]]), place, 30.0, body=body, poses=poses)
    scene = parse_scene(SCENE.format(body="wide.glb", clip="animation"), str(tmp_path / "a.toml"))
    clips = GarmentSetup.of(replace(scene, character=replace(scene.character, clip=None))).body
    assert isinstance(clips, Character)
    scene = replace(scene, character=replace(scene.character, clip=next(iter(clips.clips))))
    simulation, motion = simulation_of(scene)
    assert motion is not None
    own = load_garment("builtin:tshirt")
    girth = np.ptp(simulation.model.mesh.vertices[:, 0]) / np.ptp(own.vertices[:, 0])
    assert 1.02 < girth < 1.3
    for frame in range(1, 8):
        simulation.step(motion.pose(frame / 60), 1 / 60)
    assert np.isfinite(simulation.state.position).all()
    assert simulation.state.contact.min() > -0.005


def test_a_garment_of_another_body_needs_joints(tmp_path: Path) -> None:
    body = builtin_mannequin()
    np.savez(tmp_path / "body.npz", vertices=np.stack([body.vertices] * 2), faces=body.faces, dt=1.0 / 30.0)
    text = SCENE.replace('file = "{body}"', 'sequence = "body.npz"').replace('clip = "{clip}"', "")
    refuses("a garment of another body", GarmentSetup.of, parse_scene(text, str(tmp_path / "a.toml")))
