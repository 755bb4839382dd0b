"""The file of a wrinkle database, in HDF5: written, read, checked and measured.

Its values and their layout are in ``wrinkles.schema``.
"""

from __future__ import annotations

import io
import time
from collections.abc import Mapping
from dataclasses import fields
from operator import attrgetter
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from pbd import Fabric, InputError, Limits, SolverOptions
from pbd.storage import replacing
from wrinkles.binding import Binding
from wrinkles.database import WrinkleDatabase
from wrinkles.dictionary import Atoms, CoefficientNetwork
from wrinkles.levels import Layers
from wrinkles.novelty import NoveltyScore
from wrinkles.rest_shape import RestShapeCorrection
from wrinkles.schema import (
    ADDED,
    ENTRIES,
    FORMAT,
    SCHEMA_VERSION,
    TEXT,
    UNITS,
    VERSION_BEFORE,
    check_layout,
    check_values,
    content_hash,
    pack,
    quantised,
    topology_hash,
    unpack,
)
from wrinkles.surface import SewnRest

__all__ = ["as_stored", "database_figures", "read_database", "write_database"]

MIN_COMPRESSED_SIZE = 4096  # arrays of this size or more are stored in compressed chunks [bytes]
HDF5_VERSIONS = ("v110", "v110")  # lowest and highest; headers of 1.10 take a third of the space of older ones
COMPRESSION = {"chunks": True, "shuffle": True, "compression": "gzip"}


def as_stored(database: WrinkleDatabase) -> WrinkleDatabase:
    """The database as it is after writing and reading: atoms and weights are rounded to steps of a byte."""
    return _unpacked(_arrays(database))


def write_database(path: str | Path, database: WrinkleDatabase) -> None:
    """Write a database. Reading it gives :func:`as_stored` of it.

    The file is written beside the path and then renamed, so that no half-written file ever lies there.

    Raises:
        InputError: a value that :func:`read_database` would refuse.
        OSError: the file cannot be written, for instance to a full disk; an older file at the path stays as it was.
    """
    arrays = _arrays(database)
    check_layout({name: (array.dtype, array.shape) for name, array in arrays.items()}, path)
    check_values(arrays, path)
    image = io.BytesIO()  # on a full disk HDF5 fails while closing the file, or ends the process
    with h5py.File(image, "w", libver=HDF5_VERSIONS) as file:
        for entry in ENTRIES:
            array = arrays[entry.name]
            if entry.dtype == TEXT:
                array = array.astype(h5py.string_dtype("utf-8", array.dtype.itemsize))
            if entry.in_header:
                file.attrs[entry.name] = array
            else:
                storage = COMPRESSION if array.ndim and array.nbytes >= MIN_COMPRESSED_SIZE else {}
                file.create_dataset(entry.name, data=array, **storage).attrs["unit"] = np.bytes_(entry.unit)
    with replacing(path) as temporary:
        temporary.write_bytes(image.getbuffer())


def read_database(path: str | Path) -> WrinkleDatabase:
    """Read a database that :func:`write_database` wrote, with the same bits every time. Nothing is ever unpickled.

    Raises:
        InputError: a file that cannot be read, is no database, is of another schema version, lacks a key, has one too
            many, or holds values of a wrong type, shape or size, or values that are not possible.
    """
    path = Path(path)
    try:
        with h5py.File(path, "r") as file:
            arrays = _read_arrays(file, path)
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError("no such file", file=path, expected="a database of `gube precompute`") from error
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:  # h5py's errors for damaged files
        raise InputError(
            f"cannot be read, truncated, damaged or not HDF5: {error}",
            file=path,
            expected="a database of `gube precompute`",
        ) from error
    check_values(arrays, path)
    try:
        return _unpacked(arrays)
    except InputError as error:  # Fabric and solver options refuse a value without naming the file
        raise InputError(
            error.problem, file=path, key=error.key, received=error.received, expected=error.expected
        ) from error


def database_figures(path: str | Path) -> dict[str, float]:
    """Measure the size of a database and the time to read it.

    Returns:
        ``database_mb``: size of the file [10^6 bytes]; ``mesh_mb``: the part of it for the meshes (the coarse one, and
        a delivered fine one with its pattern and stitches); ``bytes_per_fine_vertex``: the rest per fine vertex;
        ``compression_ratio``: bytes of all numbers in float32 and of all text over bytes of the file [-]; and
        ``load_s``: time to read it [s].
    """
    start = time.perf_counter()
    database = read_database(path)
    load = time.perf_counter() - start
    size = Path(path).stat().st_size
    with h5py.File(path) as file:
        mesh = sum(
            file[e.name].id.get_storage_size()
            for e in ENTRIES
            if e.name in file and e.name.startswith(("binding/", "coarse_", "sewn/", "texture"))
        )
    arrays = _arrays(database)
    scales = {f"{entry.name}_scale" for entry in ENTRIES if entry.scaled_along is not None}
    raw = sum(a.nbytes if a.dtype.kind == "S" else 4 * a.size for name, a in arrays.items() if name not in scales)
    return {
        "database_mb": size / 1e6,
        "mesh_mb": mesh / 1e6,
        "bytes_per_fine_vertex": (size - mesh) / database.fine_vertex_count,
        "compression_ratio": raw / size,
        "load_s": load,
    }


def _arrays(database: WrinkleDatabase) -> dict[str, np.ndarray]:
    """All values of the file as arrays, by the names of :data:`ENTRIES`."""
    quality = {name: value for name, value in database.quality.items() if np.isfinite(value)}
    values = {
        "format": FORMAT,
        "schema_version": SCHEMA_VERSION,
        "units": UNITS,
        "topology_hash": topology_hash(database.coarse_faces, database.subdivisions, len(database.coarse_vertices)),
        "content_hash": "",
        "quality/names": tuple(quality),
        "quality/values": np.array(list(quality.values()), float),
        "texture": np.zeros((0, 3, 2)) if database.texture is None else database.texture,
        **_binding_values(database.binding),
        **_sewn_values(database.sewn),
        **_layers_values(database.layers),
        **_other_fabrics_values(database.other_fabrics),
    }
    for entry in ENTRIES:
        if entry.name not in values:
            values[entry.name] = attrgetter(entry.name.replace("/", "."))(database)
        if entry.scaled_along is not None:
            values |= quantised(entry, values[entry.name])
    arrays = {entry.name: pack(entry, values[entry.name]) for entry in ENTRIES}
    arrays["content_hash"] = np.array(content_hash(arrays).encode())
    return arrays


def _binding_values(binding: Binding | None) -> dict[str, np.ndarray]:
    """Entries of a binding; without one they are empty.

    Weights and pattern were rounded when the binding was made, so that single precision holds them exactly.
    """
    if binding is None:
        index, pairs = np.zeros((0, 3), np.int32), np.zeros((0, 2))
        binding = Binding(index[:, 0], np.zeros((0, 3)), index, pairs, index, pairs[:, 0])
    values = vars(binding) | {"place": binding.place[:, 1:]}  # the three weights sum to one
    return {f"binding/{field.name}": values[field.name] for field in fields(Binding)}


def _binding_of(values: dict[str, np.ndarray]) -> Binding | None:
    """The binding that :func:`_binding_values` stored."""
    if not len(values["face"]):
        return None
    place, flat = values["place"].astype(float), values["flat"].astype(float)
    place = np.concatenate([1.0 - place.sum(axis=1, keepdims=True), place], axis=1)
    return Binding(**(values | {"place": place, "flat": flat}))


def _sewn_values(sewn: SewnRest | None) -> dict[str, np.ndarray]:
    """Entries of a sewn garment; of any other they are empty."""
    sewn = sewn or SewnRest(np.zeros((0, 3, 2)), np.zeros(0), np.zeros(0))
    return {f"sewn/{field.name}": getattr(sewn, field.name) for field in fields(SewnRest)}


def _layers_values(layers: Layers | None) -> dict[str, Any]:
    """Entries of the garments of an outfit; of one garment they are empty."""
    layers = layers or Layers((), (), *np.zeros((2, 0), np.int32))
    columns: dict[str, Any] = {f"layers/{name}": getattr(layers, name) for name in ("names", "layer", "fastened")}
    for field in fields(Fabric):
        values = [getattr(fabric, field.name) for fabric in layers.fabrics]
        columns[f"layers/fabrics/{field.name}"] = np.array(values, float)
    return columns


def _layers_of(
    names: tuple[str, ...], layer: np.ndarray, fastened: np.ndarray, fabrics: dict[str, np.ndarray]
) -> Layers | None:
    """The garments that :func:`_layers_values` stored."""
    if not names:
        return None
    rows = [{name: column[k].item() for name, column in fabrics.items()} for k in range(len(names) - 1)]
    return Layers(names, tuple(Fabric(**row) for row in rows), layer, fastened)


def _other_fabrics_values(others: Mapping[str, Fabric]) -> dict[str, Any]:
    """Entries of the other fabrics: a column for each of their fields."""
    columns: dict[str, Any] = {"other_fabrics/name": tuple(others)}
    for field in fields(Fabric):
        values = [getattr(fabric, field.name) for fabric in others.values()]
        columns[f"other_fabrics/fabric/{field.name}"] = np.array(values, float)
    return columns


def _other_fabrics_of(names: tuple[str, ...], columns: Mapping[str, np.ndarray]) -> dict[str, Fabric]:
    """The fabrics that :func:`_other_fabrics_values` stored."""
    rows = ({name: column[k].item() for name, column in columns.items()} for k in range(len(names)))
    return {name: Fabric(**row) for name, row in zip(names, rows, strict=True)}


def _unpacked(arrays: dict[str, np.ndarray]) -> WrinkleDatabase:
    """The database of the file's arrays, by the names of :data:`ENTRIES`."""
    values = {entry.name: unpack(entry, arrays[entry.name]) for entry in ENTRIES}
    for entry in ENTRIES:
        if entry.scaled_along is not None:
            scale = np.expand_dims(values.pop(f"{entry.name}_scale"), entry.scaled_along)
            values[entry.name] = values[entry.name] * scale
    groups: dict[str, dict[str, Any]] = {"": {}}
    for name, value in values.items():
        group, _, leaf = name.rpartition("/")
        groups.setdefault(group, {})[leaf] = value
    root = groups[""]
    for derived in ("format", "schema_version", "units", "topology_hash", "content_hash"):
        del root[derived]
    root["texture"] = root["texture"] if len(root["texture"]) else None
    groups["solver"]["self_collision"] = bool(groups["solver"]["self_collision"])
    return WrinkleDatabase(
        **root,
        binding=_binding_of(groups["binding"]),
        sewn=SewnRest(**groups["sewn"]) if len(groups["sewn"]["layers"]) else None,
        layers=_layers_of(**groups["layers"], fabrics=groups["layers/fabrics"]),
        rest_shape=RestShapeCorrection(**groups["rest_shape"]),
        limits=Limits(**groups["limits"]),
        fabric=Fabric(**groups["fabric"]),
        other_fabrics=_other_fabrics_of(groups["other_fabrics"]["name"], groups["other_fabrics/fabric"]),
        solver=SolverOptions(**groups["solver"]),
        atoms=Atoms(**groups["atoms"]),
        mapping=CoefficientNetwork(**groups["mapping"]),
        novelty=NoveltyScore(**groups["novelty"]),
        quality=dict(zip(groups["quality"]["names"], groups["quality"]["values"].tolist(), strict=True)),
    )


def _read_arrays(file: h5py.File, path: Path) -> dict[str, np.ndarray]:
    """All values in the file, after its kind, version, keys, types and shapes have been checked."""
    _check_kind(file, path)
    groups = {entry.name.rpartition("/")[0] for entry in ENTRIES}
    found: dict[str, Any] = {name: file.attrs.get_id(name) for name in file.attrs}
    file.visititems(lambda name, item: found.__setitem__(name, item if isinstance(item, h5py.Dataset) else None))
    absent = ADDED if _plain(file.attrs["schema_version"]) == VERSION_BEFORE else {}
    known = {entry.name: entry for entry in ENTRIES if entry.name not in absent}
    errors = [InputError("missing", file=path, key=name) for name in known if found.get(name) is None]
    errors += [
        InputError("unknown key", file=path, key=name, expected="only what this version writes")
        for name, item in found.items()
        if name not in known and (item is not None or name not in groups)
    ]
    if errors:
        raise InputError.join(errors)
    check_layout(
        {name: (item.dtype, item.shape) for name, item in ({n: found[n] for n in known} | absent).items()}, path
    )
    for entry in known.values():
        if not entry.in_header and (unit := _plain(file[entry.name].attrs.get("unit"))) != entry.unit:
            raise InputError("wrong unit", file=path, key=entry.name, received=unit, expected=repr(entry.unit))
    arrays = {e.name: np.asarray(file.attrs[e.name] if e.in_header else file[e.name][()]) for e in known.values()}
    return arrays | absent


def _check_kind(file: h5py.File, path: Path) -> None:
    """Refuse a file that is no wrinkle database, or one of another schema version."""
    kind, version = _plain(file.attrs.get("format")), _plain(file.attrs.get("schema_version"))
    if kind != FORMAT:
        raise InputError("not a wrinkle database", file=path, key="format", received=kind, expected=repr(FORMAT))
    if version not in (SCHEMA_VERSION, VERSION_BEFORE):
        newer = isinstance(version, int) and version > SCHEMA_VERSION
        raise InputError(
            "written by a newer version of gube" if newer else "written in a layout that is no longer read",
            file=path,
            key="schema_version",
            received=version,
            expected=f"{SCHEMA_VERSION}; " + ("update gube" if newer else "precompute the database again"),
        )


def _plain(value: Any) -> Any:
    """An attribute of the file as a Python number or text."""
    value = value.item() if isinstance(value, np.generic) else value
    return value.decode(errors="replace") if isinstance(value, bytes) else value
