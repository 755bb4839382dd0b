"""A USD file with meshes that move: by points at time samples, or by a skeleton (UsdSkel)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from assets.character import Character
from assets.extras import require_extra
from assets.skinning import skin_vertices
from assets.transform import decompose, local_matrices
from pbd.errors import InputError
from pbd.storage import replacing
from runtime.export.glb import Color, Track, unit_normals
from wrinkles.mesh_measures import vertex_normals

__all__ = ["UsdFile"]

_ROOT = "/World"
_ROUGHNESS = 0.85


class UsdFile:
    """A USD stage while it grows: metres, Y up, frame k at the time code k.

    Args:
        rate_hz: frames a second; time codes and frames are the same.
        frame_count: number of frames.
    """

    def __init__(self, rate_hz: float, frame_count: int) -> None:
        require_extra("usd")
        from pxr import Usd, UsdGeom

        self._stage: Any = Usd.Stage.CreateInMemory()
        UsdGeom.SetStageMetersPerUnit(self._stage, 1.0)
        UsdGeom.SetStageUpAxis(self._stage, UsdGeom.Tokens.y)
        self._stage.SetTimeCodesPerSecond(rate_hz)
        self._stage.SetFramesPerSecond(rate_hz)
        self._stage.SetStartTimeCode(0.0)
        self._stage.SetEndTimeCode(frame_count - 1.0)
        self._stage.SetDefaultPrim(UsdGeom.Xform.Define(self._stage, _ROOT).GetPrim())
        UsdGeom.Scope.Define(self._stage, f"{_ROOT}/materials")

    def add(self, track: Track) -> None:
        """A mesh with points and normals at every time code; single precision, so positions are exact to 1e-7."""
        from pxr import Tf, Vt

        name = Tf.MakeValidIdentifier(track.name)
        while self._stage.GetPrimAtPath(f"{_ROOT}/{name}"):  # other names may have become the same identifier
            name += "_"
        mesh = self._mesh(f"{_ROOT}/{name}", name, track.faces, track.texture, track.color, track.double_sided)
        points, normals = mesh.CreatePointsAttr(), mesh.CreateNormalsAttr()
        frames = track.frames.astype(np.float32)
        for code, (vertices, directions) in enumerate(zip(frames, track.normals, strict=True)):
            points.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(vertices)), code)
            normals.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(directions)), code)
        _set_extents(mesh, frames)

    def add_character(self, body: Character, poses: np.ndarray, color: Color) -> None:
        """A skinned mesh, its skeleton with the character's own tree of joints, and one animation of it.

        A joint's place in the bind pose is the character's without its scale: any bind place will do, and scales are
        stored in half precision, which is exact for 1.

        Raises:
            InputError: the poses are not the character's, or a joint shears against its parent.
        """
        from pxr import UsdSkel, Vt

        poses = np.asarray(poses, np.float64)
        if poses.shape[1:] != (body.joint_count, 3, 4) or not np.isfinite(poses).all():
            expected = f"finite matrices of shape (f, {body.joint_count}, 3, 4)"
            raise InputError("not poses of this character", key="poses", received=poses.shape, expected=expected)
        root = UsdSkel.Root.Define(self._stage, f"{_ROOT}/body")
        skeleton = UsdSkel.Skeleton.Define(self._stage, f"{_ROOT}/body/skeleton")
        names = _joint_paths(body)
        bind = _unscaled(np.linalg.inv(body.inverse_bind))
        skeleton.CreateJointsAttr(names)
        skeleton.CreateBindTransformsAttr(_matrices(bind))
        skeleton.CreateRestTransformsAttr(_matrices(_against_parents(bind, body.joint_parents)))
        placed = np.zeros((*poses.shape[:2], 4, 4))
        placed[:, :, :3], placed[:, :, 3, 3] = poses @ bind, 1.0
        animation = UsdSkel.Animation.Define(self._stage, f"{_ROOT}/body/skeleton/animation")
        _animate(animation, names, decompose(_against_parents(placed, body.joint_parents), "poses"))
        UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])

        mesh = self._mesh(f"{_ROOT}/body/mesh", "body", body.faces, body.texture, color, False)
        vertices = body.vertices.astype(np.float32)
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(vertices))
        mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(unit_normals(vertex_normals(vertices[None], body.faces))[0]))
        _set_extents(mesh, vertices[None])
        binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
        binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        width = body.joint_weights.shape[1]
        binding.CreateJointIndicesPrimvar(False, width).Set(Vt.IntArray.FromNumpy(body.joint_indices.ravel()))
        weights = body.joint_weights / body.joint_weights.sum(axis=1, keepdims=True)
        binding.CreateJointWeightsPrimvar(False, width).Set(Vt.FloatArray.FromNumpy(weights.ravel()))
        _set_extents(root, np.array([skin_vertices(body, pose) for pose in poses], np.float32))

    def write(self, path: Path) -> None:
        """Write the stage as a binary .usdc file, which appears whole or not at all.

        Raises:
            InputError: the file cannot be written.
        """
        from pxr import Tf

        with replacing(path) as beside:
            named = beside.with_suffix(".usdc")  # the format goes by the ending
            try:
                self._stage.GetRootLayer().Export(str(named))
                os.replace(named, beside)
            except Tf.ErrorException as error:
                raise InputError(f"cannot be written: {str(error).strip()[:200]}", file=path) from error
            finally:
                Path(named).unlink(missing_ok=True)

    def _mesh(
        self, path: str, name: str, faces: np.ndarray, texture: np.ndarray | None, color: Color, double_sided: bool
    ) -> Any:
        """A mesh without points, with its own material: metalness 0, the colour in linear light."""
        from pxr import Gf, Sdf, UsdGeom, UsdShade, Vt

        mesh = UsdGeom.Mesh.Define(self._stage, path)
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreateDoubleSidedAttr(double_sided)
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces, np.int32).ravel()))
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        if texture is not None:
            kind, at = Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
            places = np.nan_to_num(texture).reshape(-1, 2).astype(np.float32)
            UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, at).Set(Vt.Vec2fArray.FromNumpy(places))
        material = UsdShade.Material.Define(self._stage, f"{_ROOT}/materials/{name}")
        surface = UsdShade.Shader.Define(self._stage, f"{_ROOT}/materials/{name}/surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*color[:3]))
        surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(_ROUGHNESS)
        surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
        material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
        mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set(Vt.Vec3fArray([Gf.Vec3f(*color[:3])]))
        return mesh


def _set_extents(boundable: Any, frames: np.ndarray) -> None:
    """Bounding boxes of vertices, float32 [m], shape (f, n, 3): one a frame, or one for all times if f is 1."""
    from pxr import Vt

    extent = boundable.CreateExtentAttr()
    boxes = np.stack([frames.min(axis=1), frames.max(axis=1)], axis=1)
    if len(boxes) == 1:
        extent.Set(Vt.Vec3fArray.FromNumpy(boxes[0]))
        return
    for code, box in enumerate(boxes):
        extent.Set(Vt.Vec3fArray.FromNumpy(box), code)


def _animate(animation: Any, names: list[str], parts: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Local translation (f, joints, 3), rotation (f, joints, 4) and scale (f, joints, 3) at every time code."""
    from pxr import Vt

    animation.CreateJointsAttr(names)
    translations, rotations, scales = (
        animation.CreateTranslationsAttr(),
        animation.CreateRotationsAttr(),
        animation.CreateScalesAttr(),
    )
    for code, (translation, rotation, scale) in enumerate(zip(*parts, strict=True)):
        translations.Set(Vt.Vec3fArray.FromNumpy(translation.astype(np.float32)), code)
        rotations.Set(Vt.QuatfArray.FromNumpy(rotation.astype(np.float32)), code)
        scales.Set(Vt.Vec3hArray.FromNumpy(scale.astype(np.float16)), code)


def _joint_paths(body: Character) -> list[str]:
    """Names of joints as USD asks: the path from the root, of names made of letters, digits and underscores."""
    from pxr import Tf

    paths: list[str] = []
    for name, parent in zip(body.joint_names, body.joint_parents, strict=True):
        plain = Tf.MakeValidIdentifier(name)
        path = f"{paths[parent]}/{plain}" if parent >= 0 else plain
        paths.append(path if path not in paths else f"{path}_{len(paths)}")
    return paths


def _unscaled(matrices: np.ndarray) -> np.ndarray:
    translation, rotation, _ = decompose(matrices)
    return local_matrices(translation, rotation, np.ones_like(translation))


def _against_parents(world: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Transforms of joints against their parents, from those in the world; both shape (..., joints, 4, 4)."""
    local = world.copy()
    below = parents >= 0
    local[..., below, :, :] = np.linalg.inv(world[..., parents[below], :, :]) @ world[..., below, :, :]
    return local


def _matrices(columns: np.ndarray) -> Any:
    """USD's matrices, which act on row vectors, from those that act on columns, shape (joints, 4, 4)."""
    from pxr import Vt

    return Vt.Matrix4dArray.FromNumpy(np.ascontiguousarray(np.swapaxes(columns, 1, 2)))
