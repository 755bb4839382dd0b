"""Texture coordinates from the files of a garment and a body to every kind of file that is written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom

import assets.io.usd
from assets.character import Character
from assets.io.scene import parse_scene
from assets.io.sequence import Sequence, load_sequence
from assets.loading import load_character, load_garment
from runtime.export.animation_baking import write_baked
from runtime.export.animation_files import bake_glb, bake_mdd, bake_obj, bake_usd
from runtime.setup.garment_mesh import subdivided, texture_of
from tests.assets.files import bar_glb
from tests.assets.panels import two_panels
from tests.refusals import refuses
from tests.runtime.baking import waving_sheet
from wrinkles.surface import Subdivision, cut_corners

SIDES, ROWS, RADIUS, HEIGHT = 8, 3, 0.2, 0.6
BODY_TEXTURE = np.arange(48.0).reshape(8, 3, 2) ** 2 / 64.0  # each triangle has its own place


def tube_texture(corners: np.ndarray) -> np.ndarray:
    """Where points on the flat sides of the tube are in its texture, from positions alone, shape (m, 3, 2).

    One turn goes from u = 0.1 to 0.9, so that there is a seam at the angle 0; the height goes from v = 0.2 to 0.7.
    """
    middle = corners.mean(axis=1)
    side = np.floor(np.arctan2(middle[:, 2], middle[:, 0]) % (2 * np.pi) / (2 * np.pi / SIDES))
    ends = [2 * np.pi / SIDES * (side + k) for k in (0, 1)]
    start, end = (RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1) for angle in ends)
    along = np.einsum("mci,mi->mc", corners[..., [0, 2]] - start[:, None], end - start)
    along /= ((end - start) ** 2).sum(axis=1)[:, None]
    u = 0.1 + 0.8 * (side[:, None] + along) / SIDES
    return np.stack([u, 0.2 + 0.5 * corners[..., 1] / HEIGHT], axis=2)


def tube_obj(path: Path) -> Path:
    """A tube of quads with one column of texture coordinates more than of vertices."""
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    lines = [
        f"v {RADIUS * np.cos(a):.9f} {HEIGHT * row / ROWS:.9f} {RADIUS * np.sin(a):.9f}"
        for row in range(ROWS + 1)
        for a in angle
    ]
    lines += [
        f"vt {0.1 + 0.8 * k / SIDES:.9f} {0.2 + 0.5 * row / ROWS:.9f}"
        for row in range(ROWS + 1)
        for k in range(SIDES + 1)
    ]
    for row in range(ROWS):
        for k in range(SIDES):
            corners = [(row, k), (row + 1, k), (row + 1, k + 1), (row, k + 1)]
            words = [f"{r * SIDES + c % SIDES + 1}/{r * (SIDES + 1) + c + 1}" for r, c in corners]
            lines.append("f " + " ".join(words))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(autouse=True)
def unguarded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files that the tests write are sound: reading each in another process first takes a second."""
    monkeypatch.setattr(assets.io.usd, "require_sound", lambda path: None)


@pytest.fixture(scope="module")
def tube(tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces of the tube, cut in four twice, frames with their vertices on its flat sides, texture coordinates."""
    garment = load_garment(tube_obj(tmp_path_factory.mktemp("tube") / "tube.obj"))
    subdivision = Subdivision.of(garment.faces, len(garment.vertices), 2)
    face, place = subdivision.places
    vertices = np.einsum("pc,pci->pi", place, garment.vertices[garment.faces[face]])
    texture = subdivision.flat_corners(garment.texture)
    assert texture is not None
    return subdivision.faces, np.repeat(vertices.astype(np.float32)[None], 3, axis=0), texture


@pytest.fixture(scope="module")
def bar(tmp_path_factory: pytest.TempPathFactory) -> Character:
    return load_character(bar_glb(texture=BODY_TEXTURE).write(tmp_path_factory.mktemp("bar") / "bar.glb"))


def meshes(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray | None]]:
    """By the name of each mesh of a file positions (m, 3, 3) and texture coordinates (m, 3, 2) of its corners."""
    found: dict[str, tuple[np.ndarray, np.ndarray | None]] = {}
    if path.suffix == ".usdc":
        stage: Any = Usd.Stage.Open(str(path))
        for prim in stage.Traverse():
            if prim.IsA(UsdGeom.Mesh):
                mesh, primvar = UsdGeom.Mesh(prim), UsdGeom.PrimvarsAPI(prim).GetPrimvar("st")
                faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
                places = np.array(primvar.Get()).reshape(-1, 3, 2) if primvar.IsDefined() else None
                points = np.array(mesh.GetPointsAttr().Get(Usd.TimeCode.EarliestTime()))
                found[prim.GetPath().pathString.split("/")[2]] = points[faces], places
        return found
    scene: Any = trimesh.load(str(path), process=False, force="scene")
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        points, places = trimesh.transform_points(mesh.vertices, matrix), getattr(mesh.visual, "uv", None)
        found[name] = points[mesh.faces], None if places is None else np.asarray(places)[mesh.faces]
    return found


def close(found: np.ndarray | None, expected: np.ndarray, tolerance: float = 1e-6) -> None:
    """The texture coordinates are there, and are the expected ones."""
    assert found is not None
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("ending", [".glb", ".usdc", ".obj", ".mdd", ".pc2"])
def test_every_corner_keeps_its_place_in_the_texture(
    ending: str, tube: tuple[np.ndarray, np.ndarray, np.ndarray], bar: Character, tmp_path: Path
) -> None:
    faces, frames, texture = tube
    poses = np.repeat(bar.bind_pose()[None], len(frames), axis=0)
    write_baked(tmp_path / f"a{ending}", faces, frames, 30.0, body=bar, poses=poses, texture=texture)
    written = {".obj": "a_0000.obj", ".mdd": "a.obj", ".pc2": "a.obj"}.get(ending, f"a{ending}")
    found = meshes(tmp_path / written)
    if ending in (".glb", ".usdc"):
        positions, places = found.pop("body")
        np.testing.assert_allclose(positions, bar.vertices[bar.faces], atol=1e-6)
        close(places, BODY_TEXTURE)
    ((positions, places),) = found.values()
    assert places is not None and len(places) == len(faces) == 16 * 2 * SIDES * ROWS
    np.testing.assert_allclose(places, tube_texture(positions), atol=1e-5)
    assert places[..., 0].min() < 0.1 + 1e-6 and places[..., 0].max() > 0.9 - 1e-6  # both sides of the seam


def test_a_file_that_is_read_and_written_again_has_the_same_coordinates(
    tube: tuple[np.ndarray, np.ndarray, np.ndarray], bar: Character, tmp_path: Path
) -> None:
    faces, frames, texture = tube
    bake_obj(tmp_path / "a.obj", faces, frames, texture)
    close(load_garment(tmp_path / "a_0000.obj").texture, texture, 1e-8)
    for _ in range(2):  # 1 - v, there and back
        bake_glb(tmp_path / "a.glb", faces, frames, 30.0, texture=texture)
        garment = load_garment(tmp_path / "a.glb")
        np.testing.assert_array_equal(garment.faces, faces)
        close(garment.texture, texture, 1e-7)
        assert garment.texture is not None
        texture = garment.texture
    poses = np.repeat(bar.bind_pose()[None], 3, axis=0)
    for name, bake in (("a.glb", bake_glb), ("a.usdc", bake_usd)):
        bake(tmp_path / name, faces, frames, 30.0, body=bar, poses=poses)
        np.testing.assert_array_equal(load_character(tmp_path / name).texture, BODY_TEXTURE)


def test_a_vertex_sequence_is_a_body_with_texture_coordinates(tmp_path: Path) -> None:
    faces, frames = waving_sheet(3)
    texture = frames[0][faces][..., :2].astype(np.float64)
    texture[: len(faces) // 2] += 3.0  # a seam
    bake_usd(tmp_path / "a.usdc", faces, frames, 30.0, texture=texture)
    bake_mdd(tmp_path / "a.mdd", faces, frames, 30.0, texture)
    for name in ("a.usdc", "a.mdd"):
        body = load_sequence(tmp_path / name)
        assert isinstance(body, Sequence)
        close(body.texture, texture)
        for written, bake in (("b.glb", bake_glb), ("b.usdc", bake_usd)):
            bake(tmp_path / written, faces, frames, 30.0, body=body, poses=body.vertices)
            found = meshes(tmp_path / written)
            assert found["garment"][1] is None
            close(found["body"][1], texture)


def test_garments_of_an_outfit_have_their_own_coordinates_or_none(tmp_path: Path) -> None:
    faces, frames = waving_sheet(2)
    count = frames.shape[1]
    both = np.concatenate([frames, frames + np.array([0, 0, 0.1], np.float32)], axis=1)
    all_faces = np.concatenate([faces, faces + count])
    own = frames[0][faces][..., :2].astype(float)
    texture = np.concatenate([np.full(own.shape, np.nan), own])
    garments = {"skirt": np.arange(count), "shirt": np.arange(count, 2 * count)}
    for name, bake in (("a.glb", bake_glb), ("a.usdc", bake_usd)):
        bake(tmp_path / name, all_faces, both, 30.0, garments=garments, texture=texture)
        found = meshes(tmp_path / name)
        assert found["skirt"][1] is None
        close(found["shirt"][1], own)
    bake_obj(tmp_path / "a.obj", all_faces, both, texture)
    lines = [line for line in (tmp_path / "a_0000.obj").read_text().splitlines() if line.startswith("f ")]
    assert ["/" in line for line in lines] == [False] * len(faces) + [True] * len(faces)


def test_without_coordinates_nothing_is_written(tmp_path: Path) -> None:
    faces, frames = waving_sheet(2)
    for texture in (None, np.full((len(faces), 3, 2), np.nan)):
        for name, bake in (("a.glb", bake_glb), ("a.usdc", bake_usd)):
            bake(tmp_path / name, faces, frames, 30.0, texture=texture)
            assert meshes(tmp_path / name)["garment"][1] is None
        bake_obj(tmp_path / "a.obj", faces, frames, texture)
        assert "vt" not in (tmp_path / "a_0000.obj").read_text()


@pytest.mark.parametrize("ending", [".glb", ".usdc", ".obj", ".mdd", ".pc2"])
def test_coordinates_that_are_not_those_of_the_faces_are_refused(ending: str, tmp_path: Path) -> None:
    faces, frames = waving_sheet(2)
    texture = np.zeros((len(faces), 3, 2))
    texture[3, 1, 0] = np.inf
    for wrong, problem in ((texture[1:], "texture: bad shape .*127, 3, 2"), (texture, r"texture\[.*not finite")):
        refuses(problem, write_baked, tmp_path / f"a{ending}", faces, frames, 30.0, texture=wrong)
    assert not list(tmp_path.iterdir())


def test_the_simulated_mesh_of_a_scene_has_coordinates(tmp_path: Path) -> None:
    tube = load_garment(tube_obj(tmp_path / "tube.obj"))
    assert tube.texture is not None
    text = f'[[garment]]\nname = "tube"\nmesh = "{tmp_path / "tube.obj"}"\ncoarse_subdivisions = 1\nsubdivisions = 2\n'
    once = cut_corners(tube.texture)
    np.testing.assert_array_equal(texture_of(parse_scene(text, "a.toml")), once)
    np.testing.assert_array_equal(texture_of(parse_scene(text, "a.toml"), fine=True), cut_corners(cut_corners(once)))
    np.testing.assert_array_equal(subdivided(tube, np.zeros(0, int), None, 1)[0].texture, once)
    (tmp_path / "plain.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    plain = f'[[garment]]\nname = "plain"\nmesh = "{tmp_path / "plain.obj"}"\nsubdivisions = 3\n'
    assert texture_of(parse_scene(plain, "a.toml")) is None
    both = texture_of(parse_scene(text + plain, "a.toml"), fine=True)
    assert both is not None and len(both) == 4**3 * len(tube.faces) * 4 + 4**3
    assert np.isnan(both).all(axis=(1, 2)).sum() == 4**3


def test_a_delivered_mesh_has_its_own_coordinates_and_its_coarse_mesh_none(tmp_path: Path) -> None:
    vertices, faces, _ = two_panels(10, 10, 9)
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"vt {x} {y}" for x, y, _ in vertices]
    lines += ["f " + " ".join(f"{corner}/{corner}" for corner in face) for face in (faces + 1).tolist()]
    (tmp_path / "panels.obj").write_text("\n".join(lines) + "\n")
    text = f'[[garment]]\nname = "a"\nmesh = "{tmp_path / "panels.obj"}"\npattern = true\ncoarse_vertices = 50\n'
    scene = parse_scene(text, "a.toml")
    np.testing.assert_array_equal(texture_of(scene, fine=True), vertices[faces][..., :2])
    assert texture_of(scene) is None
