"""Corrections of a coarse mesh's rest shape, for pleats and gathers that are narrower than the mesh can represent.

The pattern contains the cloth in these folds. A coarse mesh that rests as its pattern has no room for this cloth and
crumples. It therefore rests as narrow, and as bent, as the cloth is on average in filtered fine runs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pbd import ClothMesh
from pbd.bending import bends_of
from pbd.mesh import hinges_of

__all__ = ["RestShapeCorrection"]

MIN_SIDE_RATIO = 0.3  # corrected over original length of a face's side [-]
MIN_SQUARED_STRETCH, MAX_SQUARED_STRETCH = 0.05, 1.2  # principal values of a face's correction [-]
CHUNK_FRAMES = 64  # frames that are processed at once: bounds the memory
MAX_BEND_ANGLE = 1.0  # bend at rest over the length of its edge, which is about the hinge's angle [rad]


@dataclass(frozen=True)
class RestShapeCorrection:
    """Corrections of a coarse mesh's rest shape against its pattern.

    Attributes:
        stretch: symmetric stretch of each face's pattern, (U11, U12, U22) in (warp, weft) [-], float32, shape (m, 3).
        bends: bend of each hinge at rest, see :func:`pbd.bending.bends_of` [m], float32, shape (b,).
    """

    stretch: np.ndarray
    bends: np.ndarray

    @classmethod
    def none(cls, faces: np.ndarray) -> RestShapeCorrection:
        """Make corrections that change nothing.

        Args:
            faces: of the coarse mesh, int, shape (m, 3).
        """
        stretch = np.tile(np.array([1.0, 0.0, 1.0], np.float32), (len(faces), 1))
        return cls(stretch, np.zeros(len(hinges_of(faces)), np.float32))

    @classmethod
    def of(cls, mesh: ClothMesh, positions: np.ndarray) -> RestShapeCorrection:
        """Make corrections that give sides of faces and hinges their mean length and mean bend in some frames.

        Sides become shorter only; a side that is stretched on average keeps its length.

        Args:
            mesh: the coarse garment with its pattern as the rest shape.
            positions: of its vertices in filtered fine runs [m], shape (f, n, 3).
        """
        stretched = cls(_stretch(mesh, positions), cls.none(mesh.faces).bends)
        shape = stretched.applied(mesh)
        parts = [positions[at : at + CHUNK_FRAMES] for at in range(0, len(positions), CHUNK_FRAMES)]
        bends = sum(bends_of(shape, part).sum(axis=0) for part in parts) / len(positions)
        max_bends = MAX_BEND_ANGLE * _edge_lengths(mesh.vertices, mesh.faces)
        return replace(stretched, bends=np.clip(bends, -max_bends, max_bends).astype(np.float32))

    def applied(self, mesh: ClothMesh) -> ClothMesh:
        """The mesh with the corrected rest shape; each face keeps its area of cloth, and with it its mass."""
        stretch = np.asarray(self.stretch, float)[:, [[0, 1], [1, 2]]]
        return replace(mesh, flat=stretch @ mesh.flat, rest_bends=self.bends, cloth_areas=mesh.face_areas)

    def figures(self, vertices: np.ndarray, faces: np.ndarray) -> tuple[float, float]:
        """Mean ratio of a face's corrected area to its pattern's [-], and RMS angle of the hinges at rest [deg].

        Args:
            vertices, faces: of the coarse mesh [m], shapes (n, 3), (m, 3).
        """
        one, across, two = self.stretch.T.astype(float)
        angles = np.degrees(self.bends / np.maximum(_edge_lengths(vertices, faces), 1e-9))
        return float((one * two - across**2).mean()), float(np.sqrt((angles**2).mean())) if len(angles) else 0.0


def _edge_lengths(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Lengths of the hinges' edges [m], shape (b,)."""
    ends = np.asarray(vertices, float)[hinges_of(faces)[:, :2]]
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def _stretch(mesh: ClothMesh, positions: np.ndarray) -> np.ndarray:
    """Stretch of each face with which its sides have their mean lengths, see :class:`RestShapeCorrection`."""
    one, two = mesh.flat[:, :, 0], mesh.flat[:, :, 1]
    sides = np.stack([one, two - one, two], axis=1)  # (m, 3, 2)
    rest = np.linalg.norm(sides, axis=2)
    ends = positions[:, mesh.faces]  # (f, m, 3, 3)
    lengths = [np.linalg.norm(ends[:, :, b] - ends[:, :, a], axis=2).mean(axis=0) for a, b in ((0, 1), (1, 2), (0, 2))]
    wanted = rest * np.clip(np.stack(lengths, axis=1) / rest, MIN_SIDE_RATIO, 1.0)
    # Three squared lengths determine the three numbers of a symmetric metric: s^T M s = |s|^2 for each side s.
    rows = np.stack([sides[:, :, 0] ** 2, 2.0 * sides[:, :, 0] * sides[:, :, 1], sides[:, :, 1] ** 2], axis=2)
    metric = np.linalg.solve(rows, (wanted**2)[:, :, None])[:, :, 0]
    squares, axes = np.linalg.eigh(metric[:, [[0, 1], [1, 2]]])
    roots = np.sqrt(np.clip(squares, MIN_SQUARED_STRETCH, MAX_SQUARED_STRETCH))
    stretch = np.einsum("mik,mk,mjk->mij", axes, roots, axes)
    return stretch[:, [0, 0, 1], [0, 1, 1]].astype(np.float32)
