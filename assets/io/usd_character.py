"""Skinned characters out of USD files (UsdSkel): skeleton, bind pose, weights and animations."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.character import Animation, Character, Clip
from assets.io.skin import MAX_SAMPLES, best_influences, merge_pieces
from assets.io.usd import (
    matrix,
    mesh_faces,
    numbers,
    open_stage,
    point_cache_of,
    prims,
    require_unit,
    sample_times,
    to_metres,
    transform_times,
)
from assets.transform import decompose
from assets.weld import check_unit
from pbd.errors import InputError

__all__ = ["animation_of", "character_of", "read_all", "read_animation", "read_character"]

Floats = NDArray[np.float64]


def read_character(path: Path, name: str | None) -> Character:
    """Read the character of a file: all meshes that are bound to its one skeleton.

    Every animation (SkelAnimation) that moves a joint of the skeleton becomes a clip of the animation's name. Blend
    shapes whose weights in the skeleton's animation never change are part of the bind pose; others and meshes without a
    skeleton are left out.

    Args:
        path: a .usd, .usda, .usdc or .usdz file.
        name: name for messages; None takes the file's name without its suffix.

    Raises:
        InputError: as :func:`assets.loading.load_character`.
    """
    with open_stage(path) as stage:
        return character_of(stage, path, name or path.stem)


def character_of(stage: Any, path: Path, name: str) -> Character:
    """The character of an open stage; see :func:`read_character`."""
    skeleton, cache, targets = _skinned(stage, path)
    query = cache.GetSkelQuery(skeleton)
    key = str(skeleton.GetPath())
    joints, parents = _joints(query, path, key)
    bind, rest_local = _bind_pose(skeleton, parents, path, key)
    root = to_metres(stage, path) @ _to_world(skeleton.GetPrim(), None, path)
    weights = _still_weights(query.GetAnimQuery(), path)
    pieces = [_piece(target, joints, root, weights, path) for target in targets]
    vertices, faces, influences, texture = merge_pieces(pieces)
    require_unit(stage, vertices, path)
    check_unit(vertices, path)
    joint_indices, joint_weights = best_influences(influences)
    return Character(
        name=name,
        vertices=vertices,
        faces=faces,
        joint_names=tuple(_short_names(joints)),
        joint_parents=parents,
        joint_indices=joint_indices,
        joint_weights=joint_weights,
        rest_local=rest_local,
        inverse_bind=np.linalg.inv(root @ bind).astype(np.float64),
        root_transform=root,
        clips=_clips(stage, cache, skeleton, joints, rest_local, path),
        texture=texture,
    )


def read_animation(path: Path) -> Animation | None:
    """The animation of a file with one skeleton to which no mesh is bound; None if there is such a mesh or no clip.

    Raises:
        InputError: the file cannot be read or is damaged, or has not one skeleton.
    """
    with open_stage(path) as stage:
        return animation_of(stage, path)


def animation_of(stage: Any, path: Path) -> Animation | None:
    """The animation of an open stage; see :func:`read_animation`."""
    from pxr import UsdSkel

    bound, cache = _bound(stage)
    if bound or not prims(stage, UsdSkel.Animation):
        return None
    skeletons = prims(stage, UsdSkel.Skeleton)
    if len(skeletons) != 1:
        received = [str(prim.GetPath()) for prim in skeletons]
        raise InputError("not one skeleton", file=path, key="Skeleton", received=received, expected="one that moves")
    skeleton: Any = UsdSkel.Skeleton(skeletons[0])
    key = str(skeleton.GetPath())
    joints, parents = _joints(cache.GetSkelQuery(skeleton), path, key)
    _, rest_local = _bind_pose(skeleton, parents, path, key)
    root = to_metres(stage, path) @ _to_world(skeleton.GetPrim(), None, path)
    clips = _clips(stage, cache, skeleton, joints, rest_local, path)
    return Animation(path, tuple(_short_names(joints)), parents, root, clips)


def _bind_pose(
    skeleton: Any, parents: NDArray[np.int32], path: Path, key: str
) -> tuple[Floats, tuple[Floats, Floats, Floats]]:
    """Joints of the bind pose in the skeleton's space, shape (joints, 4, 4), and their local parts."""
    bind = matrix(skeleton.GetBindTransformsAttr().Get() or [], path, f"{key}, bindTransforms")
    if bind.shape != (len(parents), 4, 4):
        expected = f"{len(parents)}, one for each joint"
        raise InputError(
            "bad bind pose", file=path, key=f"{key}, bindTransforms", received=len(bind), expected=expected
        )
    to_parent = np.linalg.inv(np.where((parents < 0)[:, None, None], np.eye(4), bind[parents]))
    return bind, decompose(to_parent @ bind, f"{path}, {key}, bind pose")


def _skinned(stage: Any, path: Path) -> tuple[Any, Any, list[Any]]:
    """The skeleton, USD's cache of what belongs to it, and the meshes that are bound to it."""
    from pxr import UsdGeom, UsdSkel

    found, cache = _bound(stage)
    if not found and prims(stage, UsdSkel.Animation) and not prims(stage, UsdGeom.Mesh):
        problem = "no skin: no mesh is bound to a skeleton, there is only an animation"
        raise InputError(problem, file=path, expected="a character: a mesh that is bound to a skeleton")
    if not found:
        raise InputError("no skin: no mesh is bound to a skeleton", file=path, expected="a SkelRoot with both")
    if len(found) > 1:
        raise InputError("several skeletons", file=path, key="SkelRoot", received=list(found), expected="one")
    ((skeleton, meshes),) = found.values()
    return skeleton, cache, meshes


def _bound(stage: Any) -> tuple[dict[str, tuple[Any, list[Any]]], Any]:
    """Skeletons by their paths with the meshes that are bound to them, and USD's cache of what belongs to them."""
    from pxr import Usd, UsdGeom, UsdSkel

    cache: Any = UsdSkel.Cache()
    found: dict[str, tuple[Any, list[Any]]] = {}
    for prim in prims(stage, UsdSkel.Root):
        root = UsdSkel.Root(prim)
        cache.Populate(root, Usd.TraverseInstanceProxies())
        for binding in cache.ComputeSkelBindings(root, Usd.TraverseInstanceProxies()):
            skeleton = binding.GetSkeleton()
            meshes = [target for target in binding.GetSkinningTargets() if target.GetPrim().IsA(UsdGeom.Mesh)]
            found.setdefault(str(skeleton.GetPath()), (skeleton, []))[1].extend(meshes)
    return {key: bound for key, bound in found.items() if bound[1]}, cache


def _joints(query: Any, path: Path, key: str) -> tuple[list[str], NDArray[np.int32]]:
    """Paths of the joints, parents first, and the parent of each."""
    joints = [str(joint) for joint in query.GetJointOrder()] if query else []
    if not joints or len(set(joints)) != len(joints) or not query.GetTopology().Validate()[0]:
        received, expected = f"{len(joints)} joints", "different paths, parents first"
        raise InputError("bad joints", file=path, key=f"{key}, joints", received=received, expected=expected)
    return joints, np.array(query.GetTopology().GetParentIndices(), np.int32)


def _short_names(joints: list[str]) -> list[str]:
    """The last part of each joint's path where all of these differ."""
    short = [joint.rpartition("/")[2] for joint in joints]
    return short if len(set(short)) == len(short) else joints


def _to_world(prim: Any, time: float | None, path: Path) -> Floats:
    """Transform of a prim in the stage at a time code; None for the value without a time."""
    from pxr import Usd, UsdGeom

    at = Usd.TimeCode.EarliestTime() if time is None else time
    return matrix(UsdGeom.XformCache(at).GetLocalToWorldTransform(prim), path, str(prim.GetPath()))


def _still_weights(animation: Any, path: Path) -> dict[str, float]:
    """Weights of blend shapes that never change in an animation, by name; the animation may be none."""
    from pxr import Usd

    names = [str(name) for name in animation.GetBlendShapeOrder() or []] if animation else []
    if not names:
        return {}
    key = f"{animation.GetPrim().GetPath()}, blendShapeWeights"
    codes = animation.GetBlendShapeWeightTimeSamples() or [Usd.TimeCode.Default()]
    samples = [list(animation.ComputeBlendShapeWeights(code) or []) for code in codes]
    if not any(samples):
        return {}
    if {len(weights) for weights in samples} != {len(names)}:
        expected = f"{len(names)}, one for each blend shape"
        raise InputError("bad values", file=path, key=key, received=len(samples[0]), expected=expected)
    weights = numbers(samples, len(names), path, key)
    still = np.ptp(weights, axis=0) < 1e-6
    return {name: float(weights[0, index]) for index, name in enumerate(names) if still[index]}


def _shaped(points: Floats, target: Any, weights: dict[str, float], path: Path, key: str) -> Floats:
    """Points of a bound mesh, moved by its blend shapes at given weights, shape (n, 3)."""
    from pxr import UsdSkel, Vt

    names = [str(name) for name in target.GetBlendShapeOrder() or []] if target.HasBlendShapes() else []
    own = [weights.get(name, 0.0) for name in names]
    if not any(own):
        return points
    query = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(target.GetPrim()))
    found = sum(bool(query.GetBlendShape(index)) for index in range(query.GetNumBlendShapes()))
    if found != len(names) or query.GetNumBlendShapes() != len(names):
        where, expected = f"{key}, blendShapeTargets", f"{len(names)}, one for each of skel:blendShapes"
        raise InputError("missing blend shapes", file=path, key=where, received=found, expected=expected)
    offsets, indices = query.ComputeSubShapePointOffsets(), query.ComputeBlendShapePointIndices()
    points = points.copy()
    for weight, shape, part in zip(*query.ComputeSubShapeWeights(Vt.FloatArray(own)), strict=True):
        if not len(offsets[part]):  # the shape without any offsets, between which and another in-between shapes lie
            continue
        where = f"{key}, blend shape {names[shape]}"
        moves = numbers(offsets[part], 3, path, where)
        rows = np.array(indices[shape], np.int64) if len(indices[shape]) else np.arange(len(points))
        if len(rows) != len(moves) or rows.min() < 0 or rows.max() >= len(points):
            received, expected = f"{len(moves)} offsets for {len(rows)} points", f"points below {len(points)}"
            raise InputError("bad offsets", file=path, key=where, received=received, expected=expected)
        np.add.at(points, rows, weight * moves)
    return points


def _piece(
    target: Any, joints: list[str], root: Floats, weights: dict[str, float], path: Path
) -> tuple[Floats, Any, Any, Floats | None]:
    """A bound mesh in the world as :func:`merge_pieces` takes it.

    Args:
        target: the mesh's binding.
        joints: paths of the skeleton's joints.
        root: from the skeleton's space to the world, shape (4, 4).
        weights: of blend shapes, by name [-].
        path: the file, for messages.
    """
    from pxr import Usd, UsdGeom

    mesh = UsdGeom.Mesh(target.GetPrim())
    key = str(mesh.GetPath())
    method = str(target.GetSkinningMethod())
    if method != "classicLinear":
        raise InputError("another kind of skinning", file=path, key=key, received=method, expected="classicLinear")
    points = numbers(mesh.GetPointsAttr().Get(Usd.TimeCode.EarliestTime()), 3, path, f"{key}, points")
    points = _shaped(points, target, weights, path, key)
    place = root @ matrix(target.GetGeomBindTransform(), path, f"{key}, geomBindTransform")
    own = target.GetJointOrder()
    own = joints if own is None else [str(joint) for joint in own]
    unknown = [joint for joint in own if joint not in joints]
    if unknown:
        raise InputError("joints that the skeleton lacks", file=path, key=f"{key}, joints", received=unknown[:5])
    columns = np.array([joints.index(joint) for joint in own])
    influences = _weights(target, len(points), columns, len(joints), path, key)
    faces, texture = mesh_faces(mesh, points, path, np.linalg.det(place[:3, :3]) < 0.0)
    return points @ place[:3, :3].T + place[:3, 3], faces, influences, texture


def _weights(
    target: Any, count: int, columns: NDArray[np.intp], width: int, path: Path, key: str
) -> NDArray[np.float32]:
    """Weight of every joint on every vertex, shape (count, width), rows sum to 1; ``columns`` places the joints."""
    key = f"{key}, jointIndices and jointWeights"
    # USD's own ComputeVaryingJointInfluences ends the process where a damaged file gives a bad element size, and so do
    # values of a primvar that is not there.
    primvars = [target.GetJointIndicesPrimvar(), target.GetJointWeightsPrimvar()]
    values = [primvar.Get() if primvar.IsDefined() and not primvar.IsIndexed() else None for primvar in primvars]
    arrays = [np.array([] if value is None else value).ravel() for value in values]
    rows = 1 if target.IsRigidlyDeformed() else count
    size = arrays[0].size
    if size == 0 or size != arrays[1].size or size % rows or any(array.dtype.kind not in "iuf" for array in arrays):
        received, expected = [array.size for array in arrays], f"the same number for each of {rows} points, not indexed"
        raise InputError("bad influences", file=path, key=key, received=received, expected=expected)
    indices, weights = (np.broadcast_to(array.reshape(rows, -1), (count, size // rows)) for array in arrays)
    indices, weights = indices.astype(np.int64), weights.astype(np.float64)
    used = weights != 0.0
    bad = np.flatnonzero(
        (~np.isfinite(weights) | (weights < 0.0) | used & ((indices < 0) | (indices >= len(columns)))).any(axis=1)
        | (weights.sum(axis=1) < 1e-3)
    )
    if bad.size:
        point = int(bad[0])
        raise InputError(
            "bad influences",
            file=path,
            key=f"{key}, point {point}",
            received=list(zip(indices[point].tolist(), weights[point].tolist(), strict=True)),
            expected=f"joints below {len(columns)}, weights not negative, not all zero",
        )
    dense = np.zeros((count, width), np.float32)
    points, entries = np.nonzero(used)
    np.add.at(dense, (points, columns[indices[points, entries]]), weights[points, entries])
    return dense / dense.sum(axis=1, keepdims=True)


def _clips(
    stage: Any, cache: Any, skeleton: Any, joints: list[str], rest: tuple[Floats, Floats, Floats], path: Path
) -> dict[str, Clip]:
    """All animations of the file that move a joint of the skeleton, by name."""
    from pxr import UsdSkel

    place = {joint: index for index, joint in enumerate(joints)}
    clips: dict[str, Clip] = {}
    for prim in prims(stage, UsdSkel.Animation):
        query = cache.GetAnimQuery(UsdSkel.Animation(prim))
        moved = [str(joint) for joint in query.GetJointOrder()] if query else []
        if not any(joint in place for joint in moved):
            continue
        name = prim.GetName() if prim.GetName() not in clips else str(prim.GetPath())
        clips[name] = _clip(stage, query, skeleton, name, moved, place, rest, path)
    return clips


def _clip(
    stage: Any,
    query: Any,
    skeleton: Any,
    name: str,
    moved: list[str],
    place: dict[str, int],
    rest: tuple[Floats, Floats, Floats],
    path: Path,
) -> Clip:
    """An animation sampled at its own key rate. A skeleton that travels as a whole carries its root joints along."""
    from pxr import Usd

    key = f"clip {name}"
    travel = transform_times(skeleton.GetPrim())
    codes = [*query.GetJointTransformTimeSamples(), *(travel if len(set(travel)) > 1 else [])]
    most = MAX_SAMPLES // len(place)
    times, rate = sample_times(codes or [0.0], stage.GetTimeCodesPerSecond(), most, path, key)
    values = [np.tile(part, (len(times), 1, 1)) for part in rest]
    known = [index for index, joint in enumerate(moved) if joint in place]
    columns = [place[moved[index]] for index in known]
    for frame, time in enumerate(times):
        parts = query.ComputeJointLocalTransformComponents(Usd.TimeCode(time))
        for value, part, width, kind in zip(values, parts or [None] * 3, (3, 4, 3), ("t", "r", "s"), strict=True):
            what = {"t": "translations", "r": "rotations", "s": "scales"}[kind]
            components = numbers(part, width, path, f"{key}, {what} at the time code {time:g}")
            if len(components) != len(moved):
                expected = f"{len(moved)}, one for each joint"
                raise InputError(
                    "bad values", file=path, key=f"{key}, {what}", received=len(components), expected=expected
                )
            value[frame, columns] = components[known]
    lengths = np.linalg.norm(values[1], axis=2, keepdims=True)
    if lengths.min() < 0.5:
        raise InputError("a rotation that is no unit quaternion", file=path, key=f"{key}, rotations")
    values[1] /= lengths
    if len(set(travel)) > 1:
        _carry_roots(values, times, skeleton, path)
    return Clip(name, rate, *values)


def _carry_roots(values: list[Floats], times: Floats, skeleton: Any, path: Path) -> None:
    """Put the travel of the whole skeleton into its root joints."""
    from assets.transform import local_matrices

    still = np.linalg.inv(_to_world(skeleton.GetPrim(), None, path))
    roots = [joint for joint, name in enumerate(skeleton.GetJointsAttr().Get()) if "/" not in str(name)]
    for frame, time in enumerate(times):
        moved = still @ _to_world(skeleton.GetPrim(), float(time), path)
        local = moved @ local_matrices(*(value[frame, roots] for value in values))
        for value, part in zip(values, decompose(local, f"{path}, {skeleton.GetPath()}"), strict=True):
            value[frame, roots] = part


def read_all(path: Path) -> None:
    """Read all that this project reads of a file, which may be damaged, in this very process."""
    for read in (
        lambda stage: character_of(stage, path, "probe"),
        lambda stage: animation_of(stage, path),
        lambda stage: point_cache_of(stage, path),
    ):
        with suppress(InputError), open_stage(path, guarded=False) as stage:
            read(stage)
