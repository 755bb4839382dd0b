"""Pleats that are narrower than a coarse mesh can hold: its faces are made as narrow as they are on average."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pbd import ClothMesh

__all__ = ["gathered", "gathers_of", "no_gathers"]

LEAST = 0.3  # share of a side's length that is left of it at least
NARROWEST, WIDEST = 0.05, 1.2  # of a face's squared stretches


def no_gathers(face_count: int) -> np.ndarray:
    """Gathers that change nothing: float32, shape (m, 3)."""
    return np.tile(np.array([1.0, 0.0, 1.0], np.float32), (face_count, 1))


def gathers_of(mesh: ClothMesh, positions: np.ndarray) -> np.ndarray:
    """The symmetric stretch of each face's rest shape with which its sides are as long as they are on average.

    Cloth with folds narrower than its mesh has their width in its rest shape and nowhere to put it: it crumples. Sides
    are only made shorter; what is stretched on average is left as it is.

    Args:
        mesh: the coarse garment with its rest shape.
        positions: of its vertices in filtered fine runs [m], shape (f, n, 3).

    Returns:
        (U11, U12, U22) of each face in (warp, weft), float32, shape (m, 3); see :func:`gathered`.
    """
    one, two = mesh.flat[:, :, 0], mesh.flat[:, :, 1]
    sides = np.stack([one, two - one, two], axis=1)  # (m, 3, 2)
    rest = np.linalg.norm(sides, axis=2)
    ends = positions[:, mesh.faces]  # (f, m, 3, 3)
    lengths = [np.linalg.norm(ends[:, :, b] - ends[:, :, a], axis=2).mean(axis=0) for a, b in ((0, 1), (1, 2), (0, 2))]
    wanted = rest * np.clip(np.stack(lengths, axis=1) / rest, LEAST, 1.0)
    # A symmetric metric has three numbers, and three squared lengths say them.
    rows = np.stack([sides[:, :, 0] ** 2, 2.0 * sides[:, :, 0] * sides[:, :, 1], sides[:, :, 1] ** 2], axis=2)
    metric = np.linalg.solve(rows, (wanted**2)[:, :, None])[:, :, 0]
    squares, axes = np.linalg.eigh(metric[:, [[0, 1], [1, 2]]])
    stretch = np.einsum("mik,mk,mjk->mij", axes, np.sqrt(np.clip(squares, NARROWEST, WIDEST)), axes)
    return stretch[:, [0, 0, 1], [0, 1, 1]].astype(np.float32)


def gathered(mesh: ClothMesh, gathers: np.ndarray) -> ClothMesh:
    """The mesh with the rest shape of each face stretched, see :func:`gathers_of`."""
    stretch = np.asarray(gathers, float)[:, [[0, 1], [1, 2]]]
    return replace(mesh, flat=stretch @ mesh.flat)
