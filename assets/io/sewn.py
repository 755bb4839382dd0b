"""The file of a sewn garment: arrays in an .npz archive, which is never unpickled."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.garment import Garment, check_faces
from assets.sewing.garment import SewnGarment
from assets.weld import check_unit
from pbd.errors import InputError
from pbd.storage import replacing

__all__ = ["read_sewn", "write_sewn"]

FORMAT = 1

# Kinds of numbers and shapes; n vertices, m faces, e edges, p panels, None for a plain value.
_LAYOUT: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "format": ("iu", ()),
    "vertices": ("f", ("n", 3)),
    "faces": ("iu", ("m", 3)),
    "pattern": ("f", ("m", 3, 2)),
    "layers": ("f", ("m",)),
    "panel_of_face": ("iu", ("m",)),
    "panel_names": ("U", ("p",)),
    "seams": ("iu", ("e", 2)),
    "fabric": ("U", ()),
}


def write_sewn(path: Path, sewn: SewnGarment) -> None:
    """Write a sewn garment, beside the file first and then renamed."""
    garment = sewn.garment
    assert garment.pattern is not None and garment.layers is not None
    arrays = {
        "format": np.array(FORMAT),
        "vertices": garment.vertices,
        "faces": garment.faces,
        "pattern": garment.pattern,
        "layers": garment.layers,
        "panel_of_face": sewn.panel_of_face,
        "panel_names": np.array(sewn.panel_names),
        "seams": sewn.seams,
        "fabric": np.array(sewn.fabric),
    }
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)


def read_sewn(path: Path) -> SewnGarment:
    """Read what :func:`write_sewn` wrote.

    Raises:
        InputError: the file cannot be read, is of another kind or version, lacks a key, or holds numbers that make no
            garment; the message names the key.
    """
    found = _read_arrays(path)
    _check_layout(path, found)
    if int(found["format"]) != FORMAT:
        expected = f"{FORMAT}: a file that this version of gube sew wrote"
        raise InputError(
            "another version of the file", file=path, key="format", received=found["format"], expected=expected
        )
    vertices, faces = found["vertices"].astype(float), found["faces"].astype(np.int32)
    for name in ("vertices", "pattern", "layers"):
        if not np.isfinite(found[name]).all():
            raise InputError("numbers that are not finite", file=path, key=name, expected="finite numbers")
    if found["layers"].min() <= 0.0:
        received = float(found["layers"].min())
        raise InputError("no layer of cloth", file=path, key="layers", received=received, expected="above 0")
    for name, high in (
        ("faces", len(vertices)),
        ("seams", len(vertices)),
        ("panel_of_face", len(found["panel_names"])),
    ):
        values = found[name]
        if values.size and not 0 <= values.min() <= values.max() < high:
            bad = int(values.min() if values.min() < 0 else values.max())
            raise InputError("a number out of range", file=path, key=name, received=bad, expected=f"0 to {high - 1}")
    check_unit(vertices, path)
    check_faces(vertices, faces, path, lambda face: f"face {face}")
    pattern = found["pattern"].astype(float)
    sides = pattern[:, 1:] - pattern[:, :1]
    bad = np.flatnonzero(np.linalg.det(sides) <= 0.0)
    if bad.size:
        received, expected = pattern[bad[0]].tolist(), "corners counter-clockwise"
        raise InputError(
            "a face without area", file=path, key=f"pattern, face {bad[0]}", received=received, expected=expected
        )
    garment = Garment(path.stem, vertices, faces, pattern, str(path), found["layers"].astype(float))
    names = tuple(str(name) for name in found["panel_names"])
    return SewnGarment(
        garment, names, found["panel_of_face"].astype(np.int32), found["seams"].astype(np.int32), str(found["fabric"])
    )


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with open(path, "rb") as file, np.lib.npyio.NpzFile(file, allow_pickle=False) as archive:
            missing = [name for name in _LAYOUT if name not in archive]
            if missing:
                received, expected = sorted(archive), "a file of gube sew"
                raise InputError("a missing key", file=path, key=missing[0], received=received, expected=expected)
            return {name: archive[name] for name in _LAYOUT}
    except OSError as error:
        problem = f"cannot be read: {(error.strerror or str(error)).lower()}"
        raise InputError(problem, file=path, expected="a file of gube sew") from error
    except InputError:
        raise
    except (ValueError, RuntimeError, MemoryError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        reason = str(error).partition(". ")[0].partition(":")[0]  # without numpy's advice
        raise InputError(
            f"truncated, damaged or no arrays of numbers: {reason}", file=path, expected="a file of gube sew"
        ) from error


def _check_layout(path: Path, found: dict[str, NDArray[Any]]) -> None:
    """Refuse arrays of another kind or shape."""
    sizes: dict[str, int] = {}
    for name, (kinds, shape) in _LAYOUT.items():
        array = found[name]
        fits = array.dtype.kind in kinds and array.ndim == len(shape)
        for wanted, size in zip(shape, array.shape, strict=False):
            fits &= size == (wanted if isinstance(wanted, int) else sizes.setdefault(wanted, size))
        if not fits or (name == "faces" and not len(array)):
            expected = f"({', '.join(str(sizes.get(str(part), part)) for part in shape)}) of kind {kinds}"
            raise InputError(
                "a bad array", file=path, key=name, received=f"{array.dtype} {array.shape}", expected=expected
            )
