"""USD files: checked access to stages, meshes and numbers in them, and meshes whose points move.

USD's own library reads the file. Every value that is used is checked first, since a value may be missing, of another
length or not finite in a file that the library opens. Lengths are turned into metres and the up axis into Y.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.body_checks import HEIGHTS, UNITS
from assets.extras import require_extra
from assets.io.usd_guard import require_sound
from assets.polygons import triangulate
from assets.text import read_text
from pbd.errors import InputError

__all__ = [
    "require_unit",
    "has_skeleton",
    "matrix",
    "mesh_faces",
    "numbers",
    "open_stage",
    "prims",
    "point_cache_of",
    "read_point_cache",
    "sample_times",
    "to_metres",
    "transform_times",
]

Floats = NDArray[np.float64]

_MAX_NUMBERS = 2**30  # in a vertex sequence: more is a damaged file


@contextmanager
def open_stage(path: Path, guarded: bool = True) -> Iterator[Any]:
    """Open a .usd, .usda, .usdc or .usdz file with all that it refers to, and turn what USD raises into InputError.

    USD reads values when they are asked for: also inside the block a damaged file may come to light.

    Args:
        path: the file.
        guarded: whether it is first read in another process, see :mod:`assets.io.usd_guard`.

    Raises:
        InputError: the file cannot be read, is damaged, or refers to something that cannot be opened; no USD installed.
    """
    require_extra("usd", path)
    from pxr import Tf, Usd

    try:
        with path.open("rb"):
            pass
    except OSError as error:
        problem = f"cannot be read: {(error.strerror or str(error)).lower()}"
        raise InputError(problem, file=path, expected="a USD file") from error
    if guarded:
        require_sound(path)
    try:
        stage: Any = Usd.Stage.Open(_layer(path))
        broken = stage.GetCompositionErrors()
        if broken:
            raise InputError(f"a reference that cannot be opened: {_error_line(broken[0])}", file=path)
        rate = stage.GetTimeCodesPerSecond()
        if not 0.0 < rate < np.inf:
            raise InputError("bad rate", file=path, key="timeCodesPerSecond", received=rate, expected="more than 0")
        yield stage
    except (Tf.ErrorException, RuntimeError, UnicodeDecodeError) as error:
        raise InputError(
            f"no USD, truncated or damaged: {_error_line(error)}", file=path, expected="a USD file"
        ) from error


def _layer(path: Path) -> Any:
    """What a stage is opened from: the file's path, or its text as a layer, if a byte order mark stands before it.

    Raises:
        InputError: text in another encoding than UTF-8.
    """
    from pxr import Sdf

    with path.open("rb") as file:
        start = file.read(len(codecs.BOM_UTF8))
    if not start.startswith((codecs.BOM_UTF8, codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return str(path)
    text = read_text(path, "a USD file")  # USD itself would not know the kind of file
    layer: Any = Sdf.Layer.Find(str(path)) or Sdf.Layer.New(Sdf.FileFormat.FindByExtension("usda"), str(path))
    layer.ImportFromString(text)
    return layer


def _error_line(error: Any) -> str:
    """One line of what USD says about an error."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    text = lines[-1] if lines else type(error).__name__
    return re.sub(r"^Error in '[^']*' at line \d+ in file \S+ : ", "", text).strip("'")[:200]


def prims(stage: Any, schema: Any) -> list[Any]:
    """All prims of a kind, also those inside instances, in the order of the stage."""
    from pxr import Usd

    return [prim for prim in stage.Traverse(Usd.TraverseInstanceProxies()) if prim.IsA(schema)]


def has_skeleton(path: Path) -> bool:
    """Whether a file has a skeleton, and so holds a character rather than a vertex sequence.

    Raises:
        InputError: as :func:`open_stage`.
    """
    with open_stage(path) as stage:
        from pxr import UsdSkel

        return bool(prims(stage, UsdSkel.Skeleton))


def to_metres(stage: Any, path: Path) -> Floats:
    """The transform from the stage's units and up axis to metres and Y up, shape (4, 4).

    Raises:
        InputError: a unit that is not positive.
    """
    from pxr import UsdGeom

    unit = UsdGeom.GetStageMetersPerUnit(stage)
    if not 0.0 < unit < np.inf:
        raise InputError("bad unit", file=path, key="metersPerUnit", received=unit, expected="more than 0")
    turned = np.eye(4)
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z:
        turned[1:3, 1:3] = [[0.0, 1.0], [-1.0, 0.0]]  # Z becomes Y, Y becomes -Z
    return turned @ np.diag([unit, unit, unit, 1.0])


def require_unit(stage: Any, vertices: NDArray[Any], path: Path) -> None:
    """Refuse a body of a stage that does not say its unit, unless it has a body's height in USD's own, the centimetre.

    Args:
        stage: of the file.
        vertices: of the body [m], with the unit that the file has or USD takes, shape (n, 3).
        path: the file, for the message.

    Raises:
        InputError: no unit, and in centimetres no body; the message names units that would make it one.
    """
    from pxr import UsdGeom

    height = float(np.ptp(vertices[:, 1]))
    if UsdGeom.StageHasAuthoredMetersPerUnit(stage) or HEIGHTS[0] <= height <= HEIGHTS[1]:
        return
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    likely = [f"{x:g} ({name})" for name, x in UNITS.items() if HEIGHTS[0] <= height * x / unit <= HEIGHTS[1]]
    received = f"none, and with USD's own, {unit:g}, a body {height:.3g} m tall"
    expected = f"{' or '.join(likely) or 'the unit of the file in metres'}, written in the file"
    raise InputError("a file that does not say its unit", file=path, key="metersPerUnit", received=received,
                     expected=expected)  # fmt: skip


def matrix(value: Any, path: Path, key: str) -> Floats:
    """USD's matrices, which act on row vectors, as matrices that act on columns, shape (..., 4, 4).

    Raises:
        InputError: values that are not finite, or a matrix that flattens space.
    """
    columns = np.swapaxes(np.array(value, np.float64), -1, -2)
    if not np.isfinite(columns).all() or (np.abs(np.linalg.det(columns)) < 1e-15).any():
        raise InputError("a transform that is not finite or flattens space", file=path, key=key)
    return columns


def numbers(value: Any, width: int, path: Path, key: str) -> Floats:
    """Numbers of an attribute, shape (n, width).

    Raises:
        InputError: they are missing, of another kind or not finite; the message names the first such element.
    """
    try:
        array: Floats = np.array(value, np.float64)
    except (TypeError, ValueError):
        array = np.zeros((0, 0))
    if array.size == 0 or array.ndim != 2 or array.shape[1] != width:
        received = "nothing" if value is None else f"{type(value).__name__} of {array.size} numbers"
        raise InputError("missing or bad values", file=path, key=key, received=received, expected=f"{width} a row")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if bad.size:
        key, received = f"{key}[{bad[0]}]", array[bad[0]].tolist()
        raise InputError("values that are not finite", file=path, key=key, received=received)
    return array


def mesh_faces(mesh: Any, points: Floats, path: Path, mirrored: bool) -> tuple[NDArray[np.int32], Floats | None]:
    """Faces of a mesh, cut into triangles and wound counter-clockwise outside, and their texture coordinates.

    Args:
        mesh: a UsdGeom.Mesh.
        points: its points, shape (n, 3).
        path: the file, for messages.
        mirrored: whether its transform to the world mirrors it.

    Returns:
        faces, shape (m, 3), and the primvar ``st``, or else the first texture coordinates, shape (m, 3, 2); None
        without any.

    Raises:
        InputError: faces that are missing, have fewer than three corners, or name points that do not exist; texture
            coordinates that are not one for each corner or point.
    """
    from pxr import UsdGeom

    key = f"{mesh.GetPath()}, faces"
    counts = _whole(mesh.GetFaceVertexCountsAttr().Get())
    corners = _whole(mesh.GetFaceVertexIndicesAttr().Get())
    if not counts.size or counts.min() < 3 or counts.sum() != corners.size:
        received = f"{counts.size} faces with {counts.sum()} corners and {corners.size} indices"
        raise InputError("faces and their corners disagree", file=path, key=key, received=received)
    if corners.min() < 0 or corners.max() >= len(points):
        received, expected = f"indices {corners.min()} to {corners.max()}", f"0 to {len(points) - 1}"
        raise InputError("a face with a point that does not exist", file=path, key=key, received=received,
                         expected=expected)  # fmt: skip
    cut = _triangles(counts, np.arange(corners.size), points[corners])
    left_handed = mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
    cut = cut[:, ::-1] if left_handed != mirrored else cut
    texture = _texture(mesh, corners, len(points), path)
    return corners[cut].astype(np.int32), None if texture is None else texture[cut]


def _texture(mesh: Any, corners: NDArray[np.int64], point_count: int, path: Path) -> Floats | None:
    """Texture coordinates at each corner of the polygons of a mesh, shape (corners, 2)."""
    from pxr import Sdf, Usd, UsdGeom

    names, at = Sdf.ValueTypeNames, Usd.TimeCode.EarliestTime()
    kinds = [names.TexCoord2fArray, names.TexCoord2dArray, names.TexCoord2hArray]
    old = [names.Float2Array, names.Double2Array, names.Half2Array]  # of files older than texCoord2f
    wanted = {"faceVarying": corners.size, "vertex": point_count, "varying": point_count}
    found = [
        one
        for one in UsdGeom.PrimvarsAPI(mesh).GetPrimvars()
        if one.GetTypeName() in (kinds + old if one.GetPrimvarName() == "st" else kinds)
        and one.GetInterpolation() in wanted
        and one.Get(at)
    ]
    if not found:
        return None
    primvar = min(found, key=lambda one: one.GetPrimvarName() != "st")
    key, kind = f"{mesh.GetPath()}, {primvar.GetName()}", primvar.GetInterpolation()
    values = numbers(primvar.Get(at), 2, path, key)
    index = _whole(primvar.GetIndices(at)) if primvar.IsIndexed() else np.arange(len(values))
    if len(index) != wanted[kind] or index.min() < 0 or index.max() >= len(values):
        received, expected = f"{len(index)}, {kind}", "one of the values for each corner or point"
        raise InputError("bad texture coordinates", file=path, key=key, received=received, expected=expected)
    return values[index if kind == "faceVarying" else index[corners]]


def _whole(value: Any) -> NDArray[np.int64]:
    array = np.array([] if value is None else value)
    return array.astype(np.int64) if array.dtype.kind in "iu" else np.zeros(0, np.int64)


def _triangles(counts: NDArray[np.int64], corners: NDArray[np.int64], points: Floats) -> NDArray[np.int32]:
    """Polygons cut into triangles; quads along their shorter diagonal, if it lies inside."""
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    pieces, owners = [corners[starts[counts == 3][:, None] + np.arange(3)]], [np.flatnonzero(counts == 3)]
    quads = np.flatnonzero(counts == 4)
    cornered = corners[starts[quads][:, None] + np.arange(4)]
    a, b, c, d = np.moveaxis(points[cornered], 1, 0)
    normal = np.cross(c - a, d - b)
    inside = [(np.cross(b - a, c - a) * normal).sum(axis=1), (np.cross(c - a, d - a) * normal).sum(axis=1)]
    inside += [(np.cross(a - d, b - d) * normal).sum(axis=1), (np.cross(c - b, d - b) * normal).sum(axis=1)]
    along = np.linalg.norm(c - a, axis=1) <= np.linalg.norm(d - b, axis=1)
    first, second = np.minimum(*inside[:2]) > 0.0, np.minimum(*inside[2:]) > 0.0
    along = np.where(first & second, along, first | ~second)
    for chosen, order in ((along, [0, 1, 2, 0, 2, 3]), (~along, [3, 0, 1, 1, 2, 3])):
        pieces.append(cornered[chosen][:, order].reshape(-1, 3))
        owners.append(np.repeat(quads[chosen], 2))
    for face in np.flatnonzero(counts > 4):
        polygon = corners[starts[face] : starts[face] + counts[face]]
        pieces.append(polygon[np.array(triangulate(points[polygon]))])
        owners.append(np.full(counts[face] - 2, face))
    order = np.argsort(np.concatenate(owners), kind="stable")  # as in the file
    return np.concatenate(pieces)[order].astype(np.int32)


def transform_times(prim: Any) -> list[float]:
    """Time codes at which the transform of a prim in the world has samples."""
    from pxr import UsdGeom

    times: list[float] = []
    while prim and not prim.IsPseudoRoot():
        if prim.IsA(UsdGeom.Xformable):
            times += UsdGeom.Xformable(prim).GetTimeSamples()
        prim = prim.GetParent()
    return times


def sample_times(codes: list[float], rate: float, most: int, path: Path, key: str) -> tuple[Floats, float]:
    """Uniform time codes from the first to the last key, at the rate of the keys, and that rate [Hz].

    Args:
        codes: time codes of all keys, in any order, at least one.
        rate: time codes a second.
        most: number of samples above which the file must be damaged.
        path, key: for messages.

    Raises:
        InputError: too many samples.
    """
    keys = np.unique(np.array(codes))
    gaps = np.diff(keys)
    gaps = gaps[gaps > 1e-3]  # samples of different values round the same time differently
    if not gaps.size:
        return keys[:1], rate
    frame = float(np.median(gaps[gaps < 1.5 * gaps.min()]))  # also where keys were left out
    count = max(round((keys[-1] - keys[0]) / frame), 1) + 1
    if count > most:
        raise InputError("too long to sample", file=path, key=key, received=f"{count} frames", expected=f"{most}")
    return np.linspace(keys[0], keys[-1], count), rate * (count - 1) / (keys[-1] - keys[0])


def read_point_cache(path: Path) -> tuple[NDArray[np.float32], NDArray[np.int32], Floats | None, float]:
    """The one mesh of a file that moves by its points or by its transform.

    Returns:
        vertices in the world [m], shape (f, n, 3); faces and their texture coordinates, as :func:`mesh_faces` gives
        them; time from frame to frame [s].

    Raises:
        InputError: the file cannot be read, a mesh is skinned, no mesh moves or several do, the number of points
            changes, or values are missing or bad.
    """
    with open_stage(path) as stage:
        return point_cache_of(stage, path)


def point_cache_of(stage: Any, path: Path) -> tuple[NDArray[np.float32], NDArray[np.int32], Floats | None, float]:
    """The same of an open stage."""
    from pxr import UsdGeom, UsdSkel

    moving = {}
    for prim in prims(stage, UsdGeom.Mesh):
        codes = [*UsdGeom.Mesh(prim).GetPointsAttr().GetTimeSamples(), *transform_times(prim)]
        if UsdSkel.BindingAPI(prim).GetJointIndicesAttr().HasAuthoredValue():
            expected = "no skin: a file with a skeleton is read as a character"
            raise InputError("a skinned mesh", file=path, key=str(prim.GetPath()), expected=expected)
        if len(set(codes)) > 1:
            moving[str(prim.GetPath())] = (prim, codes)
    if len(moving) != 1:
        problem = "no mesh that moves" if not moving else "several meshes that move"
        raise InputError(problem, file=path, received=list(moving) or None, expected="one mesh with points over time")
    ((key, (prim, codes)),) = moving.items()
    mesh, place = UsdGeom.Mesh(prim), to_metres(stage, path)
    first = numbers(mesh.GetPointsAttr().Get(min(codes)), 3, path, f"{key}, points")
    times, rate = sample_times(codes, stage.GetTimeCodesPerSecond(), _MAX_NUMBERS // first.size, path, key)
    frames = np.zeros((len(times), len(first), 3), np.float32)
    for frame, time in enumerate(times):
        points = numbers(mesh.GetPointsAttr().Get(time), 3, path, f"{key}, points at the time code {time:g}")
        if len(points) != len(first):
            raise InputError(
                "a number of points that changes",
                file=path,
                key=f"{key}, points at the time code {time:g}",
                received=len(points),
                expected=f"{len(first)}, as at the start",
            )
        world = place @ matrix(UsdGeom.XformCache(time).GetLocalToWorldTransform(prim), path, key)
        frames[frame] = points @ world[:3, :3].T + world[:3, 3]
    require_unit(stage, frames[0], path)
    return frames, *mesh_faces(mesh, first, path, np.linalg.det(world[:3, :3]) < 0.0), 1.0 / rate
