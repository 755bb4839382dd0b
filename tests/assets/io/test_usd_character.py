"""Characters out of USD files, beside Pixar's own skinning: what is read, and what is refused."""

import random
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from assets.animation import clip_on
from assets.character import Character
from assets.io.sequence import is_sequence
from assets.loading import load_animation, load_character
from assets.skinning import skin_vertices
from pbd.errors import InputError
from tests.assets.files import bar_glb
from tests.refusals import refuses

HEIGHTS = np.repeat(np.linspace(0.0, 2.0, 5), 2)
POINTS = np.stack([np.tile([-0.25, 0.25], 5), HEIGHTS, np.zeros(10)], axis=1)
SHARE = np.where(HEIGHTS < 1.0, 1.0, np.where(HEIGHTS > 1.0, 0.0, 0.5))  # of the root; the rest is the tip's


def bar(path: Path, scale: float = 1.0) -> Any:
    """A flat bar of 2 x 5 vertices, 2 m high, on "root" and, 1 m above it, "tip", which bends by 90 degrees in 1 s.

    ``scale`` is that of all lengths in the file. The stage has yet to be saved.
    """
    stage: Any = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0 / scale)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetTimeCodesPerSecond(24.0)
    UsdSkel.Root.Define(stage, "/bar")
    skeleton = UsdSkel.Skeleton.Define(stage, "/bar/skeleton")
    skeleton.CreateJointsAttr(["root", "root/tip"])
    place = lambda height: Gf.Matrix4d().SetTranslate(Gf.Vec3d(0, height * scale, 0))  # noqa: E731
    skeleton.CreateBindTransformsAttr([place(0), place(1)])
    skeleton.CreateRestTransformsAttr([place(0), place(1)])
    bend = UsdSkel.Animation.Define(stage, "/bar/bend")
    bend.CreateJointsAttr(["root/tip"])
    for code, degrees in ((0, 0), (12, 45), (24, 90)):
        turn = Gf.Quatf(Gf.Rotation(Gf.Vec3d(0, 0, 1), degrees).GetQuat())
        bend.CreateTranslationsAttr().Set([Gf.Vec3f(0, scale, 0)], code)
        bend.CreateRotationsAttr().Set([turn], code)
        bend.CreateScalesAttr().Set([Gf.Vec3h(1, 1, 1)], code)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(["/bar/bend"])
    mesh = UsdGeom.Mesh.Define(stage, "/bar/mesh")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy((POINTS * scale).astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr([4] * 4)
    mesh.CreateFaceVertexIndicesAttr([2 * k + corner for k in range(4) for corner in (0, 1, 3, 2)])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/bar/skeleton"])
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * 10)
    weights = np.stack([SHARE, 1.0 - SHARE], axis=1).astype(np.float32)
    binding.CreateJointWeightsPrimvar(False, 2).Set(Vt.FloatArray.FromNumpy(weights.ravel()))
    return stage


def load(stage: Any, path: Path) -> Character:
    stage.Save()
    return load_character(path)


def posed(character: Character, frame: int, clip: str = "bend") -> np.ndarray:
    motion = character.clip(clip)
    parts = motion.translation[frame], motion.rotation[frame], motion.scale[frame]
    return skin_vertices(character, character.pose_from_local(*parts))


def by_pixar(stage: Any, code: float, root: str = "/bar") -> np.ndarray:
    """Vertices in the stage's world after USD's own skinning, in the stage's units."""
    stage.SetEditTarget(stage.GetSessionLayer())
    assert UsdSkel.BakeSkinning(UsdSkel.Root.Get(stage, root))
    mesh = UsdGeom.Mesh.Get(stage, f"{root}/mesh")
    points = np.array(mesh.GetPointsAttr().Get(code), np.float64)
    matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(mesh.GetPrim()))
    return points @ matrix[:3, :3] + matrix[3, :3]


def test_a_bar_bends_at_its_joint(tmp_path: Path) -> None:
    path = tmp_path / "bar.usdc"
    character = load(bar(path), path)
    assert not is_sequence(path)
    assert (character.name, character.joint_names) == ("bar", ("root", "tip"))
    assert character.joint_parents.tolist() == [-1, 0]
    assert character.faces.shape == (8, 3)
    clip = character.clip("bend")
    assert (clip.rate, clip.frame_count, clip.duration) == (2.0, 3, 1.0)
    np.testing.assert_allclose(character.vertices, POINTS, atol=1e-6)
    np.testing.assert_allclose(posed(character, 0), POINTS, atol=1e-6)
    np.testing.assert_allclose(posed(character, 2)[-2:], [[-1.0, 0.75, 0.0], [-1.0, 1.25, 0.0]], atol=1e-6)
    stage: Any = Usd.Stage.Open(str(path))
    np.testing.assert_allclose(posed(character, 1), by_pixar(stage, 12), atol=1e-6)


def test_a_character_without_a_unit_is_read_in_centimetres_or_refused(tmp_path: Path) -> None:
    for scale in (100.0, 1.0):
        stage = bar(tmp_path / f"{scale}.usda", scale)
        stage.ClearMetadata("metersPerUnit")
        stage.Save()
    np.testing.assert_allclose(load_character(tmp_path / "100.0.usda").vertices, POINTS, atol=1e-6)
    refuses(r"does not say its unit .*0\.02 m tall.*expected 1 \(metres\)", load_character, tmp_path / "1.0.usda")


def test_centimetres_z_up_and_a_skeleton_that_travels(tmp_path: Path) -> None:
    path = tmp_path / "bar.usda"
    stage = bar(path, scale=100.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    root = UsdGeom.Xformable(stage.GetPrimAtPath("/bar"))
    slide = root.AddTranslateOp()
    slide.Set(Gf.Vec3d(0, 0, 0), 0)
    slide.Set(Gf.Vec3d(300, 0, 0), 24)
    root.AddRotateXOp().Set(90.0)
    character = load(stage, path)
    np.testing.assert_allclose(character.vertices, POINTS, atol=1e-6)
    stage = Usd.Stage.Open(str(path))
    for frame, code in ((0, 0), (2, 24)):
        baked = by_pixar(Usd.Stage.Open(str(path)), code) / 100.0
        expected = np.stack([baked[:, 0], baked[:, 2], -baked[:, 1]], axis=1)
        np.testing.assert_allclose(posed(character, frame), expected, atol=1e-5)
    np.testing.assert_allclose(posed(character, 2)[0], [-0.25 + 3.0, 0.0, 0.0], atol=1e-5)


def add_shape(stage: Any, name: str, offsets: list[Any], points: list[int]) -> Any:
    """Give the bar's mesh one more blend shape."""
    shape = UsdSkel.BlendShape.Define(stage, f"/bar/mesh/{name}")
    shape.CreateOffsetsAttr(offsets)
    shape.CreatePointIndicesAttr(points)
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath("/bar/mesh"))
    binding.CreateBlendShapesAttr([*(binding.GetBlendShapesAttr().Get() or []), name])
    binding.CreateBlendShapeTargetsRel().AddTarget(shape.GetPath())
    return shape


def weigh(stage: Any, names: list[str], *samples: list[float]) -> None:
    """Give blend shapes their weights: one sample for all times, or one for each second."""
    bend = UsdSkel.Animation(stage.GetPrimAtPath("/bar/bend"))
    bend.CreateBlendShapesAttr(names)
    for second, weights in enumerate(samples):
        code = 24.0 * second if len(samples) > 1 else Usd.TimeCode.Default()
        bend.CreateBlendShapeWeightsAttr().Set(weights, code)


@pytest.mark.parametrize("samples", [[[0.3, 0.25]], [[0.1, 0.25], [0.9, 0.25]]])
def test_blend_shapes_with_a_still_weight_shape_the_bind_pose(tmp_path: Path, samples: list[list[float]]) -> None:
    path = tmp_path / "bar.usda"
    stage = bar(path)
    shape = add_shape(stage, "wide", [(1, 0, 0), (2, 0, 0)], [8, 9])
    shape.CreateInbetween("half").SetWeight(0.5)
    shape.GetInbetween("half").SetOffsets([(0, 0, 1), (0, 0, 1)])
    weigh(stage, ["absent", "wide"], *samples)
    character = load(stage, path)
    expected = POINTS.copy()
    expected[8:, 2] += 0.5  # half way to the shape in between
    np.testing.assert_allclose(character.vertices, expected, atol=1e-6)
    np.testing.assert_allclose(posed(character, -1), by_pixar(Usd.Stage.Open(str(path)), 24), atol=1e-6)


def test_blend_shapes_with_a_weight_that_changes_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "bar.usda"
    stage = bar(path)
    add_shape(stage, "smile", [(1, 0, 0)] * 10, [])
    add_shape(stage, "tall", [(0, 1, 0)] * 10, [])
    weigh(stage, ["smile", "tall"], [0.0, 0.5], [1.0, 0.5])
    np.testing.assert_allclose(load(stage, path).vertices, POINTS + [0, 0.5, 0], atol=1e-6)


def test_a_mesh_of_its_own_place_and_order_of_joints(tmp_path: Path) -> None:
    path = tmp_path / "bar.usda"
    stage = bar(path)
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath("/bar/mesh"))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d().SetTranslate(Gf.Vec3d(0.5, 0, 0)))
    binding.CreateJointsAttr(["root/tip", "root"])
    binding.GetJointIndicesPrimvar().Set([1, 0] * 10)
    character = load(stage, path)
    np.testing.assert_allclose(character.vertices, POINTS + [0.5, 0, 0], atol=1e-6)
    np.testing.assert_allclose(posed(character, 2), by_pixar(Usd.Stage.Open(str(path)), 24), atol=1e-6)


def test_a_rigid_mesh_and_meshes_without_a_skin(tmp_path: Path) -> None:
    path = tmp_path / "bar.usda"
    stage = bar(path)
    UsdGeom.Cube.Define(stage, "/bar/eye")
    UsdGeom.Mesh.Define(stage, "/bar/hat")
    hand = UsdGeom.Mesh.Define(stage, "/bar/hand")
    hand.CreatePointsAttr([(0, 2, 1), (1, 2, 1), (1, 3, 1)])
    hand.CreateFaceVertexCountsAttr([3])
    hand.CreateFaceVertexIndicesAttr([0, 1, 2])
    binding = UsdSkel.BindingAPI.Apply(hand.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/bar/skeleton"])
    binding.CreateJointIndicesPrimvar(True, 1).Set([1])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    character = load(stage, path)
    assert len(character.vertices) == 13 and len(character.faces) == 9
    np.testing.assert_allclose(posed(character, 2)[-3:], [[-1, 1, 1], [-1, 2, 1], [-2, 2, 1]], atol=1e-6)


def test_a_clip_without_a_mesh_is_put_on_characters_of_both_formats(tmp_path: Path) -> None:
    path = tmp_path / "bend.usda"
    stage = bar(path, scale=100.0)
    stage.RemovePrim("/bar/mesh")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.Xformable(stage.GetPrimAtPath("/bar")).AddRotateXOp().Set(90.0)
    stage.Save()
    refuses("no mesh is bound to a skeleton, there is only an animation", load_character, path)
    found = load_animation(path, ())
    assert found is not None
    inner = load(bar(tmp_path / "inner.usda", scale=100.0), tmp_path / "inner.usda")
    for character in (inner, load_character(bar_glb().write(tmp_path / "bar.glb"))):
        expected = posed(character, 2)
        np.testing.assert_allclose(expected[-2:], [[-1.0, 0.75, 0.0], [-1.0, 1.25, 0.0]], atol=1e-6)
        put_on = replace(character, clips={"bend": clip_on(character, found, "bend")})
        np.testing.assert_allclose(posed(put_on, 2), expected, atol=1e-5)


def test_other_files_of_usd_are_no_animation(tmp_path: Path) -> None:
    path = tmp_path / "bar.usda"
    stage = bar(path)
    stage.Save()
    assert load_animation(path, ()) is None
    stage.RemovePrim("/bar/mesh")
    stage.RemovePrim("/bar/skeleton")
    stage.Save()
    refuses(r"Skeleton: not one skeleton \(received \[\], expected one that moves", load_animation, path, ())
    stage.RemovePrim("/bar/bend")
    stage.Save()
    assert load_animation(path, ()) is None


def attribute(stage: Any, prim: str, name: str) -> Any:
    return stage.GetPrimAtPath(f"/bar/{prim}").GetAttribute(name)


def second_skeleton(stage: Any) -> None:
    stage.DefinePrim("/other").GetReferences().AddInternalReference("/bar")
    stage.GetPrimAtPath("/other").SetTypeName("SkelRoot")


def shaped(stage: Any, offsets: int, points: list[int], weights: list[float]) -> None:
    add_shape(stage, "wide", [(1, 0, 0)] * offsets, points)
    weigh(stage, ["wide"], weights)


WEIGHTS = [1.0, 0.0] * 10
SPOILED: dict[str, tuple[Callable[[Any], Any], str]] = {
    "no skin": (lambda s: s.RemovePrim("/bar/mesh"), "no skin: no mesh is bound to a skeleton"),
    "two": (second_skeleton, "SkelRoot: several skeletons (received ['/bar/skeleton', '/other/skeleton']"),
    "bind": (lambda s: attribute(s, "skeleton", "bindTransforms").Set([Gf.Matrix4d(1)]),
             "/bar/skeleton, bindTransforms: bad bind pose (received 1, expected 2, one for each joint)"),
    "bind not finite": (lambda s: attribute(s, "skeleton", "bindTransforms").Set([Gf.Matrix4d(np.nan), Gf.Matrix4d(1)]),
                        "/bar/skeleton, bindTransforms: a transform that is not finite"),
    "joints": (lambda s: attribute(s, "skeleton", "joints").Set(["root/tip", "root"]),
               "/bar/skeleton, joints: bad joints"),
    "points": (lambda s: attribute(s, "mesh", "points").Set(Vt.Vec3fArray(10, Gf.Vec3f(np.inf))),
               "/bar/mesh, points[0]: values that are not finite"),
    "no points": (lambda s: attribute(s, "mesh", "points").Clear(), "/bar/mesh, points: missing or bad values"),
    "weights": (lambda s: attribute(s, "mesh", "primvars:skel:jointWeights").Set([1.0] * 7),
                "/bar/mesh, jointIndices and jointWeights: bad influences"),
    "negative": (
        lambda s: attribute(s, "mesh", "primvars:skel:jointWeights").Set([*WEIGHTS[:6], -1.0, 2.0, *WEIGHTS[8:]]),
        "point 3: bad influences (received [(0, -1.0), (1, 2.0)]",
    ),
    "zero": (lambda s: attribute(s, "mesh", "primvars:skel:jointWeights").Set([*WEIGHTS[:18], 0.0, 0.0]),
             "point 9: bad influences (received [(0, 0.0), (1, 0.0)]"),
    "joint": (lambda s: attribute(s, "mesh", "primvars:skel:jointIndices").Set([2, 1] * 10),
              "point 0: bad influences (received [(2, 1.0), (1, 0.0)], expected joints below 2"),
    "other joints": (lambda s: UsdSkel.BindingAPI(s.GetPrimAtPath("/bar/mesh")).CreateJointsAttr(["root", "tail"]),
                     "/bar/mesh, joints: joints that the skeleton lacks (received ['tail'])"),
    "quaternions": (
        lambda s: s.GetPrimAtPath("/bar/mesh").CreateAttribute(
            "primvars:skel:skinningMethod", Sdf.ValueTypeNames.Token
        ).Set("dualQuaternion"),
        "/bar/mesh: another kind of skinning (received 'dualQuaternion', expected classicLinear)",
    ),
    "shape's point": (lambda s: shaped(s, 2, [3, 10], [1.0]),
                      "/bar/mesh, blend shape wide: bad offsets (received '2 offsets for 2 points', expected points"),
    "shape's offsets": (lambda s: shaped(s, 9, [], [1.0]),
                        "/bar/mesh, blend shape wide: bad offsets (received '9 offsets for 10 points'"),
    "shape's weight": (lambda s: shaped(s, 2, [3, 4], [np.nan]), "/bar/bend, blendShapeWeights[0]: values that are"),
    "shapes' weights": (lambda s: shaped(s, 2, [3, 4], [1.0, 1.0]),
                        "/bar/bend, blendShapeWeights: bad values (received 2, expected 1, one for each blend shape)"),
    "no shape": (lambda s: (shaped(s, 2, [3, 4], [1.0]), s.RemovePrim("/bar/mesh/wide")),
                 "/bar/mesh, blendShapeTargets: missing blend shapes (received 0, expected 1, one for each of"),
    "rotations": (lambda s: attribute(s, "bend", "rotations").Set([Gf.Quatf(0)], 12),
                  "clip bend, rotations: a rotation that is no unit quaternion"),
    "translations": (lambda s: attribute(s, "bend", "translations").Clear(), "clip bend"),
    "endless": (lambda s: attribute(s, "bend", "rotations").Set([Gf.Quatf(1)], 1e12), "clip bend: too long to sample"),
    "shear": (lambda s: UsdGeom.Xformable(s.GetPrimAtPath("/bar")).AddScaleOp().Set(Gf.Vec3f(1, 2, 1)),
              "a root transform that shears or scales unevenly"),
}  # fmt: skip


@pytest.mark.parametrize("case", SPOILED)
def test_refused(tmp_path: Path, case: str) -> None:
    spoil, message = SPOILED[case]
    path = tmp_path / "bar.usda"
    stage = bar(path)
    spoil(stage)
    refuses(re.escape(message), load, stage, path)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.6, 0.9, 0.999])
def test_a_truncated_file_is_refused(tmp_path: Path, share: float) -> None:
    bar(tmp_path / "bar.usdc").Save()
    data = (tmp_path / "bar.usdc").read_bytes()
    (tmp_path / "cut.usdc").write_bytes(data[: int(len(data) * share)])
    refuses(r"cut\.usdc: no USD, truncated or damaged", load_character, tmp_path / "cut.usdc")


@pytest.mark.parametrize("number", [20, 67, 122, 130])  # of the two in the middle USD 26.11 ends a process
def test_a_damaged_file_loads_or_is_refused(tmp_path: Path, guarded: None, number: int) -> None:
    bar(tmp_path / "bar.usdc").Save()
    data, draw = (tmp_path / "bar.usdc").read_bytes(), random.Random(number == 67)
    spoiled = bytearray(data)
    for _ in range(number + 1):
        spoiled = bytearray(data)
        for _ in range(draw.choice([1, 3, 10])):
            spoiled[draw.randrange(len(data))] = draw.randrange(256)
    (tmp_path / "damaged.usdc").write_bytes(spoiled)
    try:
        character = load_character(tmp_path / "damaged.usdc")
    except InputError as error:
        assert "damaged.usdc" in str(error)
    else:
        assert np.isfinite(character.vertices).all()
