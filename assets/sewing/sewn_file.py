"""The file of a sewn garment: arrays in an .npz archive, which is never unpickled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.garment import Garment, check_faces
from assets.sewing.sewn_garment import SewnGarment
from assets.weld import check_unit
from pbd.errors import InputError
from pbd.storage import BROKEN_NPZ, replacing

__all__ = ["read_sewn", "write_sewn"]

FORMAT = 2
WITHOUT_BANDS = 1  # the version before: without max_stretch, so that waistbands give way

# Kinds of numbers and shapes; n vertices, m faces, e edges, p panels, None for a plain value.
_LAYOUT: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "format": ("iu", ()),
    "vertices": ("f", ("n", 3)),
    "faces": ("iu", ("m", 3)),
    "pattern": ("f", ("m", 3, 2)),
    "layers": ("f", ("m",)),
    "max_stretch": ("f", ("m",)),
    "panel_of_face": ("iu", ("m",)),
    "panel_names": ("U", ("p",)),
    "seams": ("iu", ("e", 2)),
    "fabric": ("U", ()),
}


def write_sewn(path: Path, sewn: SewnGarment) -> None:
    """Write a sewn garment, beside the file first and then renamed."""
    garment = sewn.garment
    assert garment.pattern is not None and garment.layers is not None and garment.max_stretch is not None
    arrays = {
        "format": np.array(FORMAT),
        "vertices": garment.vertices,
        "faces": garment.faces,
        "pattern": garment.pattern,
        "layers": garment.layers,
        "max_stretch": garment.max_stretch,
        "panel_of_face": sewn.panel_of_face,
        "panel_names": np.array(sewn.panel_names),
        "seams": sewn.seams,
        "fabric": np.array(sewn.fabric),
    }
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)


def read_sewn(path: Path) -> SewnGarment:
    """Read what :func:`write_sewn` wrote; files of format 1 have no waistbands that hold.

    Raises:
        InputError: the file cannot be read, is of another kind or version, lacks a key, or holds numbers that make no
            garment; the message names the key.
    """
    found = _read_arrays(path)
    _check_layout(path, found)
    vertices, faces = found["vertices"].astype(float), found["faces"].astype(np.int32)
    for name in ("vertices", "pattern", "layers", "max_stretch"):
        if name in found and not np.isfinite(found[name]).all():
            raise InputError("numbers that are not finite", file=path, key=name, expected="finite numbers")
    if found["layers"].min() <= 0.0:
        received = float(found["layers"].min())
        raise InputError("no layer of cloth", file=path, key="layers", received=received, expected="above 0")
    max_stretch = found["max_stretch"].astype(float) if "max_stretch" in found else None
    if max_stretch is not None and max_stretch.min() < 1.0:
        received = float(max_stretch.min())
        problem, expected = "edges that must be shorter than at rest", "at least 1"
        raise InputError(problem, file=path, key="max_stretch", received=received, expected=expected)
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
    texture = np.stack([-pattern[..., 1], pattern[..., 0]], axis=2)  # the weft runs to the left of the warp
    garment = Garment(
        path.stem, vertices, faces, pattern, str(path), found["layers"].astype(float), max_stretch, texture
    )
    names = tuple(str(name) for name in found["panel_names"])
    return SewnGarment(
        garment, names, found["panel_of_face"].astype(np.int32), found["seams"].astype(np.int32), str(found["fabric"])
    )


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with open(path, "rb") as file, np.lib.npyio.NpzFile(file, allow_pickle=False) as archive:
            names = _names(path, archive)
            missing = [name for name in names if name not in archive]
            if missing:
                received, expected = sorted(archive), "a file of gube sew"
                raise InputError("a missing key", file=path, key=missing[0], received=received, expected=expected)
            return {name: archive[name] for name in names}
    except OSError as error:
        problem = f"cannot be read: {(error.strerror or str(error)).lower()}"
        raise InputError(problem, file=path, expected="a file of gube sew") from error
    except InputError:
        raise
    except BROKEN_NPZ as error:
        reason = str(error).partition(". ")[0].partition(":")[0]  # without numpy's advice
        raise InputError(
            f"truncated, damaged or no arrays of numbers: {reason}", file=path, expected="a file of gube sew"
        ) from error


def _names(path: Path, archive: np.lib.npyio.NpzFile) -> list[str]:
    """Keys of the version that a file is of; those of this one where it names none.

    Raises:
        InputError: a version that is not read.
    """
    version = archive["format"].tolist() if "format" in archive else FORMAT
    if version == WITHOUT_BANDS:
        return [name for name in _LAYOUT if name != "max_stretch"]
    if version != FORMAT:
        expected = f"{WITHOUT_BANDS} or {FORMAT}: a file that this version of gube sew reads"
        raise InputError("another version of the file", file=path, key="format", received=version, expected=expected)
    return list(_LAYOUT)


def _check_layout(path: Path, found: dict[str, NDArray[Any]]) -> None:
    """Refuse arrays of another kind or shape."""
    sizes: dict[str, int] = {}
    for name, array in found.items():
        kinds, shape = _LAYOUT[name]
        fits = array.dtype.kind in kinds and array.ndim == len(shape)
        for wanted, size in zip(shape, array.shape, strict=False):
            fits &= size == (wanted if isinstance(wanted, int) else sizes.setdefault(wanted, size))
        if not fits or (name == "faces" and not len(array)):
            expected = f"({', '.join(str(sizes.get(str(part), part)) for part in shape)}) of kind {kinds}"
            raise InputError(
                "a bad array", file=path, key=name, received=f"{array.dtype} {array.shape}", expected=expected
            )
