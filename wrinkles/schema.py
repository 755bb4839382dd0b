"""The file format of a wrinkle database: name, type, shape and unit of every value, and checks of the values.

``ENTRIES`` is the only description of the file; writing, reading and checking all follow it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NoReturn, Protocol

import numpy as np

from pbd import Fabric, InputError
from pbd.mesh import edges_of
from wrinkles.features import DYNAMIC_COUNT
from wrinkles.patches import Grid

__all__ = [
    "ADDED",
    "ENTRIES",
    "FORMAT",
    "SCHEMA_VERSION",
    "TEXT",
    "UNITS",
    "VERSION_BEFORE",
    "Entry",
    "check_layout",
    "check_values",
    "content_hash",
    "pack",
    "quantised",
    "topology_hash",
    "unpack",
]

FORMAT = "gube wrinkle database"
SCHEMA_VERSION = 29
VERSION_BEFORE = 28  # files of which are read too, without ADDED
UNITS = "SI: m, kg, s"
TEXT, SINGLE, DOUBLE, INDEX, WHOLE, STEPS = "text", "float32", "float64", "int32", "int64", "int8"


@dataclass(frozen=True)
class Entry:
    """One value in the file.

    Attributes:
        name: path in the file, which is also the path of the field in :class:`wrinkles.database.WrinkleDatabase`.
        dtype: TEXT (UTF-8 of fixed length) or the name of a NumPy type.
        shape: numbers, and letters for sizes; a letter stands for the same size in all entries.
        unit: of the values; "-" for none.
        in_header: True for an attribute of the file, False for a data set.
        scaled_along: for STEPS, the axis whose values share a scale. The next entry holds the scales, and the field is
            the product of both. None for other types.
    """

    name: str
    dtype: str
    shape: tuple[int | str, ...] = ()
    unit: str = "-"
    in_header: bool = False
    scaled_along: int | None = None


def _in_steps(name: str, shape: tuple[int | str, ...], unit: str = "-", along: int = 0) -> tuple[Entry, Entry]:
    """Two entries for a float32 array: the array in steps of one byte, and its scales."""
    steps = Entry(name, STEPS, shape, scaled_along=along)
    return steps, Entry(f"{name}_scale", SINGLE, (*shape[:along], *shape[along + 1 :]), unit)


def _columns(group: str, shape: tuple[str, ...]) -> Iterator[Entry]:
    """An entry for each field of a fabric; ``shape`` ("f",) for f of them."""
    units = {"areal_density": "kg/m2", "stretch_warp": "N/m", "stretch_weft": "N/m", "shear": "N/m"}
    units |= {"bend_warp": "N m", "bend_weft": "N m", "thickness": "m"}
    units |= {"bend_hysteresis_warp": "N", "bend_hysteresis_weft": "N", "shear_hysteresis": "N/m"}
    for field in fields(Fabric):
        yield Entry(f"{group}/{field.name}", DOUBLE, shape, units.get(field.name, "-"))


ENTRIES = (
    Entry("format", TEXT, in_header=True),
    Entry("schema_version", WHOLE, in_header=True),
    Entry("units", TEXT, in_header=True),
    Entry("code_version", TEXT, in_header=True),
    Entry("seed", WHOLE, in_header=True),
    Entry("created", TEXT, in_header=True),
    Entry("topology_hash", TEXT, in_header=True),
    Entry("content_hash", TEXT, in_header=True),
    Entry("garment_name", TEXT),
    Entry("coarse_vertices", DOUBLE, ("n", 3), "m"),
    Entry("coarse_faces", INDEX, ("m", 3)),
    Entry("subdivisions", WHOLE),
    Entry("rest_shape/stretch", SINGLE, ("m", 3)),
    Entry("rest_shape/bends", SINGLE, ("b",), "m"),
    Entry("held", INDEX, ("p",)),
    Entry("limits/vertices", INDEX, ("l",)),
    Entry("limits/maximum_distance", SINGLE, ("l",), "m"),
    Entry("limits/backstop", SINGLE, ("l",), "m"),
    Entry("limits/stiffness", SINGLE, ("l",), "N/m3"),
    Entry("warp", DOUBLE, (3,)),
    Entry("binding/face", INDEX, ("N",)),
    Entry("binding/place", SINGLE, ("N", 2)),
    Entry("binding/panels", INDEX, ("M", 3)),
    Entry("binding/flat", SINGLE, ("N", 2), "m"),
    Entry("binding/stitches", INDEX, ("s", 3)),
    Entry("binding/stitch_weights", DOUBLE, ("s",)),
    Entry("sewn/pattern", DOUBLE, ("w", 3, 2), "m"),
    Entry("sewn/layers", DOUBLE, ("w",)),
    Entry("sewn/max_stretch", DOUBLE, ("w",)),
    Entry("layers/names", TEXT, ("i",)),
    Entry("layers/layer", INDEX, ("o",)),
    Entry("layers/fastened", INDEX, ("k",)),
    *_columns("layers/fabrics", ("e",)),
    Entry("fabric_name", TEXT),
    *_columns("fabric", ()),
    Entry("pressure", DOUBLE, unit="Pa"),
    Entry("other_fabrics/name", TEXT, ("f",)),
    *_columns("other_fabrics/fabric", ("f",)),
    Entry("bend_factor", DOUBLE),
    Entry("solver/substep", DOUBLE, unit="s"),
    Entry("solver/gravity", DOUBLE, (3,), "m/s2"),
    Entry("solver/coarse_sweeps", WHOLE),
    Entry("solver/self_collision", WHOLE),
    Entry("solver/contact_refreshes", DOUBLE, unit="Hz"),
    Entry("solver/local_damping", DOUBLE, unit="1/s"),
    Entry("solver/linear_inertia", DOUBLE),
    Entry("solver/angular_inertia", DOUBLE),
    Entry("frame_rate", DOUBLE, unit="Hz"),
    *_in_steps("atoms/shapes", ("K", "g"), "m", along=1),
    Entry("atoms/mean", SINGLE, ("g",), "m"),
    Entry("atoms/kept", DOUBLE),
    Entry("atoms/vertex_mean", SINGLE, ("v", 3), "m"),
    Entry("mapping/center", SINGLE, (DYNAMIC_COUNT,)),
    Entry("mapping/scale", SINGLE, (DYNAMIC_COUNT,)),
    *_in_steps("mapping/place", ("n", "d")),
    Entry("mapping/region", INDEX, ("n",)),
    *_in_steps("mapping/weights_1", (DYNAMIC_COUNT, "h1")),
    *_in_steps("mapping/place_weights", ("d", "h1")),
    Entry("mapping/bias_1", SINGLE, ("h1",)),
    *_in_steps("mapping/weights_2", ("r", "h1", "h2"), along=1),
    Entry("mapping/bias_2", SINGLE, ("r", "h2")),
    *_in_steps("mapping/weights_3", ("r", "h2", "K"), along=1),
    Entry("mapping/bias_3", SINGLE, ("r", "K")),
    *_in_steps("novelty/weights_1", ("h1", "u")),
    Entry("novelty/bias_1", SINGLE, ("u",)),
    Entry("novelty/weights_2", SINGLE, ("u",)),
    Entry("novelty/bias_2", DOUBLE),
    Entry("novelty/fade_from", DOUBLE, unit="deg"),
    Entry("cutoff", DOUBLE, unit="m"),
    Entry("body_hash", TEXT),
    Entry("body_vertex_count", WHOLE),
    Entry("quality/names", TEXT, ("q",)),
    Entry("quality/values", DOUBLE, ("q",)),
    Entry("held_out", TEXT, ("h",)),
    Entry("trained_on", TEXT, ("t",)),
    Entry("training_minutes", DOUBLE, unit="min"),
    Entry("machine", TEXT),
    Entry("scene", TEXT),
    Entry("texture", SINGLE, ("T", 3, 2)),
)
# What the version before did not write, and what stands for it.
ADDED = {"texture": np.zeros((0, 3, 2), np.float32), "machine": np.array(b"an unknown processor")}
MAX_STEP = 127  # of int8
# Sizes that may be zero: every garment has vertices, but it may have no pins and no limits, only one fabric, a
# subdivided fine mesh instead of a delivered one, no pattern by which it was sewn, no texture coordinates, or nothing
# of the body always under it.
SIZES_THAT_MAY_BE_ZERO = ("b", "p", "l", "q", "h", "t", "N", "M", "s", "f", "w", "i", "o", "k", "e", "c", "T")
POSITIVE_ENTRIES = ("novelty/fade_from", "bend_factor", "frame_rate", "cutoff")


def topology_hash(faces: np.ndarray, subdivisions: int, vertex_count: int) -> str:
    """SHA-256 of the data that determine the numbering of the fine vertices.

    Args:
        faces: of the coarse mesh, int, shape (m, 3).
        subdivisions: number of times that each coarse face is cut in four.
        vertex_count: number of coarse vertices.
    """
    digest = hashlib.sha256(f"{vertex_count} {subdivisions}".encode())
    digest.update(np.ascontiguousarray(faces, "<i4").tobytes())
    return digest.hexdigest()


def content_hash(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of all entries except the hash itself and those that the file's version lacks.

    Args:
        arrays: by the names of :data:`ENTRIES`.
    """
    digest = hashlib.sha256()
    left_out = {"content_hash"} | (set(ADDED) if arrays["schema_version"] == VERSION_BEFORE else set())
    for entry in ENTRIES:
        if entry.name not in left_out:
            array = arrays[entry.name]
            digest.update(f"{entry.name} {array.dtype} {array.shape} ".encode())
            digest.update(array.tobytes())
    return digest.hexdigest()


def quantised(entry: Entry, values: np.ndarray) -> dict[str, np.ndarray]:
    """Quantise a field to steps of one byte: values = steps * scale, with an error of at most half a step.

    Scales have 16 bits, so that up to 127 steps are exact in float32, and quantising the result changes nothing.

    Args:
        entry: of the steps, with ``scaled_along``.
        values: of the shape of the entry.

    Returns:
        steps, int8, and scales, float32, by the names of their entries.

    Raises:
        InputError: values that are not finite.
    """
    assert entry.scaled_along is not None
    peaks = np.abs(np.asarray(values, float)).max(axis=entry.scaled_along, keepdims=True, initial=0.0)
    if not np.isfinite(peaks).all():
        bad = float(peaks[~np.isfinite(peaks)][0])
        raise InputError("not finite", key=entry.name, received=bad, expected="finite numbers")
    mantissa, exponent = np.frexp(peaks / MAX_STEP)
    scale = np.ldexp(np.ceil(mantissa * 2.0**16), exponent - 16)
    scale[scale < np.finfo(np.float32).tiny] = 1.0  # all values are zero
    return {
        entry.name: np.rint(values / scale).astype(np.int8),
        f"{entry.name}_scale": scale.squeeze(entry.scaled_along).astype(np.float32),
    }


def pack(entry: Entry, value: Any) -> np.ndarray:
    """A value in the type that the file stores.

    Raises:
        InputError: a value of another kind than the entry's.
    """
    if entry.dtype == TEXT:
        return np.array(value.encode() if isinstance(value, str) else [text.encode() for text in value], "S")
    array = np.asarray(value)
    if not np.can_cast(array.dtype, entry.dtype, "same_kind"):
        raise InputError("wrong type", key=entry.name, received=str(array.dtype), expected=entry.dtype)
    return array.astype(entry.dtype)


def unpack(entry: Entry, array: np.ndarray) -> Any:
    """A stored value in the type of its field in :class:`wrinkles.database.WrinkleDatabase`."""
    if entry.dtype == TEXT:
        return array.item().decode() if array.ndim == 0 else tuple(text.decode() for text in array.tolist())
    if entry.shape == ():
        return array.item()
    return tuple(array.tolist()) if (entry.shape, entry.dtype) == ((3,), DOUBLE) else array


def check_layout(layout: Mapping[str, tuple[np.dtype, tuple[int, ...] | None]], path: str | Path) -> None:
    """Check types and shapes, which is possible before any large array is read.

    Args:
        layout: type and shape of every entry of :data:`ENTRIES` by its name.
        path: of the file, for the message.

    Raises:
        InputError: every entry whose type or shape is wrong, all of them at once.
    """
    errors: list[InputError] = []
    sizes: dict[str, int] = {}
    for entry in ENTRIES:
        dtype, shape = layout[entry.name]
        fits = dtype.kind == "S" if entry.dtype == TEXT else dtype == np.dtype(entry.dtype)
        if not fits:
            errors.append(
                InputError("wrong type", file=path, key=entry.name, received=str(dtype), expected=entry.dtype)
            )
        if shape is None or len(shape) != len(entry.shape):
            wanted = entry.shape
        else:
            wanted = tuple(
                size if isinstance(size, int) else sizes.setdefault(size, got)
                for size, got in zip(entry.shape, shape, strict=True)
            )
        sizes_of_entry = zip(entry.shape, wanted, strict=True)
        empty = any(size == 0 and name not in SIZES_THAT_MAY_BE_ZERO for name, size in sizes_of_entry)
        if wanted != shape or empty:
            letters = ", ".join(f"{s} = {sizes[s]}" for s in entry.shape if isinstance(s, str) and sizes.get(s))
            errors.append(
                InputError(
                    "wrong shape",
                    file=path,
                    key=entry.name,
                    received=shape,
                    expected=f"({', '.join(map(str, entry.shape))})" + (f" with {letters}" if letters else ""),
                )
            )
    if errors:
        raise InputError.join(errors)


def _subdivided_count(vertices: int, faces: np.ndarray, levels: int) -> int:
    """Number of vertices of a mesh after each face was cut in four ``levels`` times."""
    edges, count = len(edges_of(faces)[0]), len(faces)
    for _ in range(levels):
        vertices, edges, count = vertices + edges, 2 * edges + 3 * count, 4 * count
    return vertices


def check_values(arrays: Mapping[str, np.ndarray], path: str | Path) -> None:
    """Refuse values of the right types and shapes that are not possible in a database.

    Args:
        arrays: every entry of :data:`ENTRIES` by its name.
        path: of the file, for the message.

    Raises:
        InputError: the first such value; the message has its key, the value and the expected values.
    """

    def refuse(problem: str, key: str, received: Any, expected: str) -> NoReturn:
        raise InputError(problem, file=path, key=key, received=received, expected=expected)

    _check_numbers(arrays, refuse)
    _check_indices(arrays, refuse)
    _check_rest_shape(arrays, refuse)
    _check_fine_mesh(arrays, refuse)
    names = [arrays["fabric_name"].item(), *arrays["other_fabrics/name"].tolist()]
    if len(set(names)) < len(names):
        refuse("the same name twice", "other_fabrics/name", [name.decode() for name in names], "different names")
    if not arrays["warp"].any():
        refuse("no direction", "warp", arrays["warp"].tolist(), "a vector that is not zero")
    if arrays["units"].item().decode() != UNITS:
        refuse("other units", "units", arrays["units"].item().decode(), repr(UNITS))
    stored, computed = arrays["content_hash"].item().decode(), content_hash(arrays)
    if stored != computed:
        refuse("damaged or changed by hand", "content_hash", stored, computed)


class _Refuse(Protocol):
    """Raises the :class:`pbd.InputError` of a bad value."""

    def __call__(self, problem: str, key: str, received: Any, expected: str) -> NoReturn: ...


def _check_numbers(arrays: Mapping[str, np.ndarray], refuse: _Refuse) -> None:
    """Texts are UTF-8, numbers are finite and in their ranges."""
    for name, array in arrays.items():
        if array.dtype.kind == "S":
            try:
                np.char.decode(array, "utf-8")
            except UnicodeDecodeError as error:
                refuse("not UTF-8", name, error.object, "text")
        if name == "texture":
            array = np.nan_to_num(array, posinf=np.inf, neginf=-np.inf)  # NaN: a garment of an outfit without any
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
            refuse("not finite", f"{name}{list(place) if place else ''}", float(array[place]), "finite numbers")
    for name in (*POSITIVE_ENTRIES, *(entry.name for entry in ENTRIES if entry.name.endswith("scale"))):
        if (lowest := arrays[name].min(initial=np.inf)) <= 0:
            refuse("out of range", name, lowest.item(), "above 0")
    for name in ("maximum_distance", "backstop", "stiffness"):
        if (lowest := arrays[f"limits/{name}"].min(initial=0.0)) < 0:
            refuse("out of range", f"limits/{name}", lowest.item(), "at least 0")
    levels = arrays["subdivisions"].item()
    if not 1 <= levels <= 4:
        refuse("out of range", "subdivisions", levels, "1 to 4")


def _check_indices(arrays: Mapping[str, np.ndarray], refuse: _Refuse) -> None:
    """Every index points to something that exists, and lists of vertices ascend."""
    count, faces, fine = len(arrays["coarse_vertices"]), arrays["coarse_faces"], len(arrays["binding/face"])
    cut_count = len(faces) * 4 ** arrays["subdivisions"].item()
    for name, limit, kind in (
        ("coarse_faces", count, "a vertex"),
        ("held", count, "a vertex"),
        ("limits/vertices", count, "a vertex"),
        ("mapping/region", len(arrays["mapping/bias_2"]), "a region"),
        ("layers/layer", len(arrays["layers/names"]), "a garment"),
        ("layers/fastened", len(arrays["layers/layer"]), "a vertex"),
        ("binding/face", cut_count, "an index"),
        ("binding/panels", fine, "an index"),
        ("binding/stitches", fine, "an index"),
    ):
        index = arrays[name]
        if index.size and not 0 <= index.min() <= index.max() < limit:
            bad = int(index.min() if index.min() < 0 else index.max())
            refuse(f"{kind} that does not exist", name, bad, f"0 to {limit - 1}")
    garments, fabrics, layer = (len(arrays[f"layers/{n}"]) for n in ("names", "fabrics/thickness", "layer"))
    if (garments, layer) not in ((0, 0), (fabrics + 1, count)):
        expected = f"none, or {fabrics + 1} garments and a number for each of {count} vertices"
        refuse("garments that do not fit one another", "layers", (garments, layer), expected)
    for name in ("held", "limits/vertices", "layers/fastened"):
        if (np.diff(arrays[name]) <= 0).any():
            refuse("not in ascending order", name, arrays[name].tolist()[:8], "each vertex once, ascending")


def _check_rest_shape(arrays: Mapping[str, np.ndarray], refuse: _Refuse) -> None:
    """The corrected rest shape has an area in each face and a bend at each hinge."""
    faces = arrays["coarse_faces"]
    one, across, two = arrays["rest_shape/stretch"].T.astype(float)
    flat = (np.minimum(one, two) <= 0.0) | (one * two <= across**2)
    if flat.any():
        bad = int(np.argmax(flat))
        received = arrays["rest_shape/stretch"][bad].tolist()
        refuse("a face without area", f"rest_shape/stretch[{bad}]", received, "a positive definite stretch")
    bends, hinges = len(arrays["rest_shape/bends"]), 3 * len(faces) - len(edges_of(faces)[0])
    if bends != hinges:
        refuse("another number of hinges", "rest_shape/bends", bends, str(hinges))


def _check_fine_mesh(arrays: Mapping[str, np.ndarray], refuse: _Refuse) -> None:
    """The fine mesh, subdivided or delivered, belongs to the coarse one and has all of its values."""
    count, faces, fine = len(arrays["coarse_vertices"]), arrays["coarse_faces"], len(arrays["binding/face"])
    if (fine == 0) != (len(arrays["binding/panels"]) == 0):
        refuse("a mesh without a binding, or one without a mesh", "binding", fine, "both or none")
    levels = arrays["subdivisions"].item()
    stored, computed = arrays["topology_hash"].item().decode(), topology_hash(faces, levels, count)
    if stored != computed:
        refuse("does not belong to these faces and subdivisions", "topology_hash", stored, computed)
    _check_sewn(arrays, refuse)
    if len(arrays["texture"]) not in (0, len(faces)):
        refuse("another number of faces", "texture", len(arrays["texture"]), f"0 or {len(faces)}")
    vertices, means = fine or _subdivided_count(count, faces, levels), len(arrays["atoms/vertex_mean"])
    if means != vertices:
        refuse("another number of fine vertices", "atoms/vertex_mean", means, str(vertices))
    size, wanted = len(arrays["atoms/mean"]), 3 * Grid.of(levels).nodes
    if size != wanted:
        refuse("another grid than that of these subdivisions", "atoms/mean", size, str(wanted))


def _check_sewn(arrays: Mapping[str, np.ndarray], refuse: _Refuse) -> None:
    """How a sewn garment rests belongs to its coarse faces, all of which have an area."""
    pattern, layers, count = arrays["sewn/pattern"], arrays["sewn/layers"], len(arrays["coarse_faces"])
    if not len(layers):
        return
    if len(layers) != count:
        refuse("another number of faces", "sewn/pattern", len(layers), f"0 or {count}")
    flat = np.linalg.det(pattern[:, 1:] - pattern[:, :1]) <= 0.0
    if flat.any():
        bad = int(np.argmax(flat))
        refuse("a face without area", f"sewn/pattern[{bad}]", pattern[bad].tolist(), "corners counter-clockwise")
    for name, least in (("layers", 0.0), ("max_stretch", 1.0)):
        if (lowest := arrays[f"sewn/{name}"].min()) < least or lowest == 0.0:
            refuse(
                "out of range", f"sewn/{name}", lowest.item(), f"{'above' if least == 0.0 else 'at least'} {least:g}"
            )
