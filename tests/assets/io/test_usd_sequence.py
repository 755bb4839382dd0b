"""Meshes that move in USD files: what is read, and what is refused with the element named."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from assets.io.sequence import is_sequence, load_sequence
from assets.io.usd import mesh_faces
from pbd.errors import InputError
from tests.refusals import refuses


def rising(path: Path, unit: float = 1.0, up: str = "Y") -> Any:
    """A stage with a square at /set/square that rises by 0.1 m in four time codes, 25 a second; to be saved."""
    stage: Any = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    UsdGeom.SetStageUpAxis(stage, up)
    stage.SetTimeCodesPerSecond(25.0)
    UsdGeom.Xform.Define(stage, "/set")
    mesh = UsdGeom.Mesh.Define(stage, "/set/square")
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    for code in (0, 2, 4):
        mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy((square(0.025 * code) / unit).astype(np.float32)), code)
    return stage


def square(height: float) -> np.ndarray:
    return np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64) + [0.0, height, 0.0]


@pytest.mark.parametrize("ending", ["usda", "usdc", "usd"])
def test_points_over_time_are_a_vertex_sequence(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a.{ending}"
    rising(path).Save()
    assert is_sequence(path)
    sequence = load_sequence(path)
    assert sequence.dt == pytest.approx(2 / 25)
    assert sequence.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    np.testing.assert_allclose(sequence.vertices, [square(0.0), square(0.05), square(0.1)], atol=1e-6)


def test_centimetres_and_an_up_axis_are_turned(tmp_path: Path) -> None:
    """Z up in centimetres: what was along Z stands up, what was along Y points away."""
    stage = rising(tmp_path / "a.usda", unit=0.01, up="Z")
    stage.Save()
    expected = [np.stack([s[:, 0], s[:, 2], -s[:, 1]], axis=1) for s in (square(0.0), square(0.05), square(0.1))]
    np.testing.assert_allclose(load_sequence(tmp_path / "a.usda").vertices, expected, atol=1e-6)


def test_without_a_unit_a_body_is_read_in_centimetres_or_refused(tmp_path: Path) -> None:
    stage = rising(tmp_path / "a.usda", unit=0.01)
    stage.ClearMetadata("metersPerUnit")
    stage.Save()
    np.testing.assert_allclose(load_sequence(tmp_path / "a.usda").vertices[0], square(0.0), atol=1e-6)
    received = "none, and with USD's own, 0.01, a body 0.01 m tall"
    for unit, message in (
        (1.0, f'metersPerUnit: a file that does not say its unit (received "{received}", expected 1 (metres), written'),
        (0.001, "expected 0.001 (millimetres), written in the file)"),
        (1e-5, "expected the unit of the file in metres, written in the file)"),
    ):
        stage = rising(tmp_path / f"{unit}.usda", unit=unit)
        stage.ClearMetadata("metersPerUnit")
        stage.Save()
        refuses(re.escape(message), load_sequence, tmp_path / f"{unit}.usda")


def test_a_transform_over_time_moves_a_mesh(tmp_path: Path) -> None:
    stage = rising(tmp_path / "a.usda")
    mesh = stage.GetPrimAtPath("/set/square")
    mesh.GetAttribute("points").Clear()
    mesh.GetAttribute("points").Set(Vt.Vec3fArray.FromNumpy(square(0.0).astype(np.float32)))
    slide = UsdGeom.Xformable(stage.GetPrimAtPath("/set")).AddTranslateOp()
    slide.Set(Gf.Vec3d(0, 0, 0), 0)
    slide.Set(Gf.Vec3d(0, 0, 3), 1)
    UsdGeom.Xformable(mesh).AddScaleOp().Set(Gf.Vec3f(-1, 1, 1))
    stage.Save()
    sequence = load_sequence(tmp_path / "a.usda")
    np.testing.assert_allclose(sequence.vertices[1], square(0.0) * [-1, 1, 1] + [0, 0, 3], atol=1e-6)
    assert sequence.faces.tolist() == [[2, 1, 0], [3, 2, 0]]  # mirrored, so that the other side faces outwards


def test_references_and_instances_are_followed(tmp_path: Path) -> None:
    stage = rising(tmp_path / "part.usda")
    stage.SetDefaultPrim(stage.GetPrimAtPath("/set"))
    stage.Save()
    whole: Any = Usd.Stage.CreateNew(str(tmp_path / "whole.usda"))
    UsdGeom.SetStageMetersPerUnit(whole, 1.0)
    whole.SetTimeCodesPerSecond(25.0)
    prim = whole.DefinePrim("/copy")
    prim.GetReferences().AddReference("./part.usda")
    prim.SetInstanceable(True)
    whole.Save()
    np.testing.assert_allclose(load_sequence(tmp_path / "whole.usda").vertices[-1], square(0.1), atol=1e-6)


def test_polygons_are_cut_inside() -> None:
    """A quad that is not convex is cut from its inner corner; a pentagon into three triangles."""
    stage: Any = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    points = np.array([[0, 0, 0], [2, 0, 0], [0.4, 0.4, 0], [0, 2, 0], [5, 0, 0], [6, 0, 0], [6, 1, 0], [5, 1, 0]])
    points = np.concatenate([points, [[5.5, 1.5, 0.0]]])
    mesh.CreateFaceVertexCountsAttr([4, 3, 5])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3, 4, 5, 6, 4, 5, 6, 8, 7])
    faces, texture = mesh_faces(mesh, points, Path("a.usd"), mirrored=False)
    assert texture is None
    assert faces[:3].tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert (areas > 0).all() and areas[3:].sum() == pytest.approx(1.25)
    mesh.CreateOrientationAttr("leftHanded")
    assert np.array_equal(mesh_faces(mesh, points, Path("a.usd"), mirrored=False)[0], faces[:, ::-1])


def quads() -> tuple[Any, np.ndarray]:
    """Two squares beside one another, and points."""
    stage: Any = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreateFaceVertexCountsAttr([4, 4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 4, 3, 1, 2, 5, 4])
    return (stage, mesh), np.array([[x, y, 0.0] for y in (0, 1) for x in (0, 1, 2)])


def put_texture(mesh: Any, values: Any, interpolation: str, name: str = "st", kind: Any = None) -> Any:
    kind = kind or Sdf.ValueTypeNames.TexCoord2fArray
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, kind, interpolation)
    primvar.Set([Gf.Vec2f(*map(float, value)) for value in values])
    return primvar


@pytest.mark.parametrize("orientation", ["rightHanded", "leftHanded"])
@pytest.mark.parametrize("interpolation", ["vertex", "varying", "faceVarying", "indexed"])
def test_texture_coordinates_go_with_their_corners(interpolation: str, orientation: str) -> None:
    """u = x and v = y + 2, of every way to store them."""
    (_stage, mesh), points = quads()
    mesh.CreateOrientationAttr(orientation)
    values = points[:, :2] + [0, 2]
    corners = [0, 1, 4, 3, 1, 2, 5, 4]
    if interpolation == "indexed":
        put_texture(mesh, values[::-1], "faceVarying").SetIndices(Vt.IntArray([5 - corner for corner in corners]))
    else:
        put_texture(mesh, values[corners] if interpolation == "faceVarying" else values, interpolation)
    faces, texture = mesh_faces(mesh, points, Path("a.usd"), mirrored=False)
    np.testing.assert_array_equal(texture, points[faces][..., :2] + [0, 2])


def test_the_set_named_st_counts_or_else_the_first_one() -> None:
    names = Sdf.ValueTypeNames
    (_stage, mesh), points = quads()
    put_texture(mesh, points[:, :2] + 7, "vertex", "weights", names.Float2Array)  # no texture coordinates
    put_texture(mesh, points[:1, :2], "constant", "flat")  # the same for all of the mesh
    assert mesh_faces(mesh, points, Path("a.usd"), mirrored=False)[1] is None
    put_texture(mesh, points[:, :2] + 1, "vertex", "UVMap")
    put_texture(mesh, points[:, :2] + 2, "vertex", "a_later")
    first = UsdGeom.PrimvarsAPI(mesh).GetPrimvars()[0].GetPrimvarName()
    faces, texture = mesh_faces(mesh, points, Path("a.usd"), mirrored=False)
    np.testing.assert_array_equal(texture, points[faces][..., :2] + {"UVMap": 1, "a_later": 2}[first])
    put_texture(mesh, points[:, :2] + 3, "vertex", "st", names.Float2Array)  # as older files have it
    _, texture = mesh_faces(mesh, points, Path("a.usd"), mirrored=False)
    np.testing.assert_array_equal(texture, points[faces][..., :2] + 3)


@pytest.mark.parametrize(
    ("count", "interpolation", "index"),
    [(5, "vertex", None), (6, "faceVarying", None), (6, "vertex", 6), (6, "vertex", -1)],
)
def test_texture_coordinates_that_fit_no_corner_are_refused(count: int, interpolation: str, index: int | None) -> None:
    (_stage, mesh), points = quads()
    primvar = put_texture(mesh, points[:count, :2], interpolation)
    if index is not None:
        primvar.SetIndices(Vt.IntArray([0, 1, 2, 3, 4, index]))
    with pytest.raises(InputError, match=r"a\.usd: /mesh, primvars:st: bad texture coordinates"):
        mesh_faces(mesh, points, Path("a.usd"), mirrored=False)


def points_at(stage: Any, code: float, values: np.ndarray) -> None:
    stage.GetPrimAtPath("/set/square").GetAttribute("points").Set(Vt.Vec3fArray.FromNumpy(values.astype("f4")), code)


def copy_square(stage: Any) -> None:
    other = UsdGeom.Mesh.Define(stage, "/set/other")
    for code in (0, 1):
        other.CreatePointsAttr().Set(Vt.Vec3fArray(1), code)


SPOILED: dict[str, tuple[Callable[[Any], Any], str]] = {
    "still": (lambda s: s.GetPrimAtPath("/set/square").GetAttribute("points").Clear(), "no mesh that moves"),
    "two": (copy_square, "several meshes that move (received ['/set/square', '/set/other'], expected one mesh"),
    "not finite": (lambda s: points_at(s, 2, square(np.nan)),
                   "/set/square, points at the time code 2[0]: values that are not finite"),
    "count": (lambda s: points_at(s, 4, square(0.0)[:3]),
              "points at the time code 4: a number of points that changes (received 3, expected 4, as at the start)"),
    "endless": (lambda s: points_at(s, 1e12, square(0.0)), "/set/square: too long to sample (received '5000000000"),
    "corner": (
        lambda s: s.GetPrimAtPath("/set/square").GetAttribute("faceVertexIndices").Set([0, 1, 2, 4]),
        "/set/square, faces: a face with a point that does not exist (received 'indices 0 to 4', expected 0 to 3)",
    ),
    "counts": (lambda s: s.GetPrimAtPath("/set/square").GetAttribute("faceVertexCounts").Set([3]),
               "faces and their corners disagree (received '1 faces with 3 corners and 4 indices')"),
    "no faces": (lambda s: s.GetPrimAtPath("/set/square").RemoveProperty("faceVertexCounts"),
                 "faces and their corners disagree"),
    "unit": (lambda s: UsdGeom.SetStageMetersPerUnit(s, -1.0), "metersPerUnit: bad unit (received -1.0"),
    "scale": (lambda s: UsdGeom.SetStageMetersPerUnit(s, 100.0), "not in metres: looks like centimetres"),
    "rate": (lambda s: s.SetTimeCodesPerSecond(0.0), "timeCodesPerSecond: bad rate (received 0.0"),
    "flat": (lambda s: UsdGeom.Xformable(s.GetPrimAtPath("/set")).AddScaleOp().Set(Gf.Vec3f(0, 1, 1)),
             "/set/square: a transform that is not finite or flattens space"),
    "reference": (lambda s: s.GetPrimAtPath("/set").GetReferences().AddReference("./absent.usda"),
                  "a reference that cannot be opened"),
}  # fmt: skip


@pytest.mark.parametrize("case", SPOILED)
def test_refused(tmp_path: Path, case: str) -> None:
    spoil, message = SPOILED[case]
    stage = rising(tmp_path / "a.usda")
    spoil(stage)
    stage.Save()
    assert "a.usda" in refuses(re.escape(message), load_sequence, tmp_path / "a.usda")


def test_points_of_another_kind_are_refused(tmp_path: Path) -> None:
    rising(tmp_path / "a.usda").Save()
    text = (tmp_path / "a.usda").read_text()
    (tmp_path / "b.usda").write_text(text.replace("point3f[] points", "string[] points").replace("(0, 0, 0)", '"x"'))
    refuses(r"b\.usda", load_sequence, tmp_path / "b.usda")


def test_other_files_are_refused(tmp_path: Path) -> None:
    refuses(r"absent\.usdc: cannot be read", load_sequence, tmp_path / "absent.usdc")
    (tmp_path / "a.usdc").write_bytes(b"PK\x03\x04 no stage")
    refuses(r"a\.usdc: no USD, truncated or damaged", load_sequence, tmp_path / "a.usdc")
    refuses(r"a\.usdc: no USD, truncated or damaged", is_sequence, tmp_path / "a.usdc")
