"""The built-in clothes: a flag, a tablecloth, and garments that were sewn for the built-in mannequin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from assets.garment import BUILTIN_GARMENTS, Garment
from assets.procedural.mannequin import DATA
from pbd.errors import InputError
from pbd.mesh import lattice_faces

__all__ = ["builtin_garment"]

_SHEET_EDGE = 0.04  # of flag and tablecloth [m]


def builtin_garment(name: str) -> Garment:
    """One of the built-in clothes.

    `flag` is upright, 1.2 m long, its pole at x = 0, its lower edge 1 m up. `tablecloth` is level, 1.2 m square,
    0.75 m up. The others are worn by :func:`~assets.procedural.mannequin.builtin_mannequin` in its bind pose: they were
    drafted for it, cut flat, sewn and draped, see :mod:`assets.procedural.builtin_sewing`.

    Raises:
        InputError: there is none of that name.
    """
    if name == "flag":
        return _sheet(name, (1.2, 0.8), np.array([0.0, 1.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    if name == "tablecloth":
        return _sheet(name, (1.2, 1.2), np.array([-0.6, 0.75, 0.6]), np.array([0.0, 0.0, -1.0]))
    if name not in BUILTIN_GARMENTS:
        expected = "one of " + ", ".join(BUILTIN_GARMENTS)
        raise InputError("no such built-in garment", received=name, expected=expected)
    from assets.sewing.sewn_file import read_sewn  # loads much that a scene without clothes of its own does not need

    return replace(read_sewn(DATA / f"{name}.npz").garment, source=f"builtin:{name}")


def _sheet(name: str, size: tuple[float, float], corner: NDArray[np.float64], up: NDArray[np.float64]) -> Garment:
    """A rectangle from a corner along X and `up`: squares cut along diagonals that alternate, for no bias."""
    columns, rows = (round(length / _SHEET_EDGE) for length in size)
    index = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    row, column = np.divmod(np.arange(index.size), columns + 1)
    flat = _SHEET_EDGE * np.stack([column, row], axis=1).astype(np.float64)
    vertices = corner + flat[:, :1] * [1.0, 0.0, 0.0] + flat[:, 1:] * up
    # Faces stand in the order of the vertices, row after row.
    faces = lattice_faces(index.T).reshape(columns, rows, 2, 3).swapaxes(0, 1).reshape(-1, 3)
    return Garment(name, vertices, faces, flat[faces], f"builtin:{name}", texture=flat[faces])
