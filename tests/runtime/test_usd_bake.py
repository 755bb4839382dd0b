"""Baked USD files, opened again by Pixar's own library: its validators, its meshes and its skinning."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade, UsdSkel, UsdValidation

from assets.skinning import skin_vertices
from pbd.errors import InputError
from runtime.export.animation_files import bake_usd
from tests.runtime.baking import angles_deg, sheet_sequence, walking_mannequin, waving_sheet
from wrinkles.mesh_measures import vertex_normals


def complaints(stage: Any) -> list[str]:
    """What the validators that `usdchecker` runs find in a stage."""
    names = [data.name for data in UsdValidation.ValidationRegistry().GetAllValidatorMetadata()]
    validators = UsdValidation.ValidationRegistry().GetOrLoadValidatorsByName(names)
    assert len(validators) > 20
    return [error.GetErrorAsString() for error in UsdValidation.ValidationContext(validators).Validate(stage)]


def points(stage: Any, path: str, time: float) -> np.ndarray:
    """Vertices of a mesh in the world at a time code."""
    mesh = UsdGeom.Mesh.Get(stage, path)
    local = np.array(mesh.GetPointsAttr().Get(time), np.float64)
    matrix = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(mesh.GetPrim()))
    return local @ matrix[:3, :3] + matrix[3, :3]


def test_a_garment_has_every_frame_at_its_time_code(tmp_path: Path) -> None:
    faces, frames = waving_sheet()
    bake_usd(tmp_path / "a.usdc", faces, frames, 25.0)
    assert (tmp_path / "a.usdc").read_bytes()[:8] == b"PXR-USDC" and len(list(tmp_path.iterdir())) == 1
    stage: Any = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0 and UsdGeom.GetStageUpAxis(stage) == "Y"
    assert (stage.GetTimeCodesPerSecond(), stage.GetEndTimeCode()) == (25.0, len(frames) - 1)
    mesh = UsdGeom.Mesh.Get(stage, "/World/garment")
    assert np.array_equal(np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), faces)
    normals = vertex_normals(frames, faces)
    for code in range(len(frames)):
        assert np.array_equal(points(stage, "/World/garment", code), frames[code])
        assert angles_deg(np.array(mesh.GetNormalsAttr().Get(code)), normals[code]).max() < 0.1
        box = np.array(mesh.GetExtentAttr().Get(code))
        assert np.array_equal(box, [frames[code].min(axis=0), frames[code].max(axis=0)])
    between = 0.25 * frames[3] + 0.75 * frames[4]
    np.testing.assert_allclose(points(stage, "/World/garment", 3.75), between, atol=1e-6)


def test_garments_of_an_outfit_are_meshes_with_valid_names(tmp_path: Path) -> None:
    faces, frames = waving_sheet()
    count = frames.shape[1]
    garments = {"long shirt": np.arange(count), "long_shirt": np.arange(count, 2 * count)}
    both = np.concatenate([frames, frames + np.float32([0.0, 0.1, 0.0])], axis=1)
    bake_usd(tmp_path / "a.usdc", np.concatenate([faces, faces + count]), both, 25.0, garments=garments)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    for name, vertices in (("long_shirt", garments["long shirt"]), ("long_shirt_", garments["long_shirt"])):
        np.testing.assert_array_equal(points(stage, f"/World/{name}", 2), both[2][vertices])


def test_a_garment_has_a_material(tmp_path: Path) -> None:
    bake_usd(tmp_path / "a.usdc", *waving_sheet(2), 30.0)
    stage: Any = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    mesh = stage.GetPrimAtPath("/World/garment")
    material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    surface, _, _ = material.ComputeSurfaceSource()
    assert surface.GetIdAttr().Get() == "UsdPreviewSurface"
    np.testing.assert_allclose(surface.GetInput("diffuseColor").Get(), [0.09, 0.21, 0.45], atol=1e-6)


def test_validators_have_nothing_to_complain_of(tmp_path: Path) -> None:
    faces, frames, sequence = sheet_sequence()
    bake_usd(tmp_path / "a.usdc", faces, frames, 30.0, body=sequence, poses=sequence.vertices)
    assert complaints(Usd.Stage.Open(str(tmp_path / "a.usdc"))) == []
    character, poses = walking_mannequin()
    bake_usd(tmp_path / "b.usdc", faces, frames, 30.0, body=character, poses=poses)
    stage: Any = Usd.Stage.Open(str(tmp_path / "b.usdc"))
    assert complaints(stage) == []
    stage.ClearMetadata("upAxis")
    stage.GetPrimAtPath("/World/body/mesh").RemoveAppliedSchema("SkelBindingAPI")
    assert len(complaints(stage)) >= 2


def test_pixars_skinning_moves_a_character_as_ours_does(tmp_path: Path) -> None:
    character, poses = walking_mannequin()
    poses[:, :, :, 3] += [0.0, 0.0, 2.0]  # also away from the origin
    bake_usd(tmp_path / "a.usdc", *waving_sheet(), 30.0, body=character, poses=poses)
    stage: Any = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    skeleton = UsdSkel.Skeleton.Get(stage, "/World/body/skeleton")
    paths = list(skeleton.GetJointsAttr().Get())
    assert [path.rpartition("/")[2] for path in paths] == list(character.joint_names)
    assert UsdSkel.Topology(paths).GetNumJoints() == character.joint_count
    assert list(UsdSkel.Topology(paths).GetParentIndices()) == character.joint_parents.tolist()
    assert UsdSkel.BakeSkinning(UsdSkel.Root.Get(stage, "/World/body"))
    for code in (0, 5, 11):
        expected = skin_vertices(character, poses[code])
        np.testing.assert_allclose(points(stage, "/World/body/mesh", code), expected, atol=1e-5)


def test_a_vertex_sequence_is_a_mesh_of_its_own(tmp_path: Path) -> None:
    faces, frames, sequence = sheet_sequence()
    bake_usd(tmp_path / "a.usdc", faces, frames, 30.0, body=sequence, poses=sequence.vertices)
    stage: Any = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    for code in (0, 7):
        assert np.array_equal(points(stage, "/World/body", code), sequence.vertices[code])


def test_names_of_joints_become_names_of_usd(tmp_path: Path) -> None:
    character, poses = walking_mannequin(2)
    names = tuple(["../evil name", "é\n", "", *character.joint_names[3:]])
    bake_usd(tmp_path / "a.usdc", *waving_sheet(2), 30.0, body=replace(character, joint_names=names), poses=poses)
    stage: Any = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    paths = list(UsdSkel.Skeleton.Get(stage, "/World/body/skeleton").GetJointsAttr().Get())
    assert len(set(paths)) == character.joint_count
    assert UsdSkel.Topology(paths).Validate()[0] and complaints(stage) == []


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.usdc").mkdir()
    with pytest.raises((InputError, OSError), match=r"a\.usdc"):
        bake_usd(tmp_path / "a.usdc", *waving_sheet(2), 30.0)
    assert [path.name for path in tmp_path.iterdir()] == ["a.usdc"]
