"""Pleats that are narrower than a coarse mesh can hold: it rests as narrow as it is on average, and bent as it is.

Cloth with folds narrower than its mesh has their width in its rest shape and nowhere to put it: it crumples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pbd import ClothMesh
from pbd.bending import bends_of
from pbd.mesh import hinges_of

__all__ = ["Gathers"]

LEAST = 0.3  # share of a side's length that is left of it at least
NARROWEST, WIDEST = 0.05, 1.2  # of a face's squared stretches
CHUNK = 64  # frames worked on at once: bounds the memory
SHARPEST = 1.0  # bend at rest over the length of its edge, about its angle [rad]


@dataclass(frozen=True)
class Gathers:
    """How a coarse mesh rests where it does not rest as its pattern says.

    Attributes:
        stretch: symmetric stretch of each face's rest shape, (U11, U12, U22) in (warp, weft), float32, shape (m, 3).
        bends: of each hinge at rest, see :func:`pbd.bending.bends_of` [m], float32, shape (b,).
    """

    stretch: np.ndarray
    bends: np.ndarray

    @classmethod
    def none(cls, faces: np.ndarray) -> Gathers:
        """Gathers that change nothing."""
        stretch = np.tile(np.array([1.0, 0.0, 1.0], np.float32), (len(faces), 1))
        return cls(stretch, np.zeros(len(hinges_of(faces)), np.float32))

    @classmethod
    def of(cls, mesh: ClothMesh, positions: np.ndarray) -> Gathers:
        """Gathers with which the sides of faces are as long, and hinges as bent, as they are on average.

        Sides are only made shorter; what is stretched on average is left as it is.

        Args:
            mesh: the coarse garment with its rest shape.
            positions: of its vertices in filtered fine runs [m], shape (f, n, 3).
        """
        stretched = cls(_stretch(mesh, positions), cls.none(mesh.faces).bends)
        shape = stretched.applied(mesh)
        parts = [positions[at : at + CHUNK] for at in range(0, len(positions), CHUNK)]
        bends = sum(bends_of(shape, part).sum(axis=0) for part in parts) / len(positions)
        most = SHARPEST * _edge_lengths(mesh.vertices, mesh.faces)
        return replace(stretched, bends=np.clip(bends, -most, most).astype(np.float32))

    def applied(self, mesh: ClothMesh) -> ClothMesh:
        """The mesh with this rest shape, and as much cloth in each face as before."""
        stretch = np.asarray(self.stretch, float)[:, [[0, 1], [1, 2]]]
        return replace(mesh, flat=stretch @ mesh.flat, rest_bends=self.bends, cloth_areas=mesh.face_areas)

    def figures(self, vertices: np.ndarray, faces: np.ndarray) -> tuple[float, float]:
        """Mean area of a face at rest over its pattern's [-], and RMS angle of the hinges at rest [deg]."""
        one, across, two = self.stretch.T.astype(float)
        angles = np.degrees(self.bends / np.maximum(_edge_lengths(vertices, faces), 1e-9))
        return float((one * two - across**2).mean()), float(np.sqrt((angles**2).mean())) if len(angles) else 0.0


def _edge_lengths(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Of the hinges [m], shape (b,)."""
    ends = np.asarray(vertices, float)[hinges_of(faces)[:, :2]]
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def _stretch(mesh: ClothMesh, positions: np.ndarray) -> np.ndarray:
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
