"""How far folds run: whether curvature keeps its direction around a place, as in folds, or not, as in lumps."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags

from pbd.mesh import ClothMesh
from wrinkles.discs import along_cloth, disc_means, spread_points
from wrinkles.mesh_measures import vertex_normals

__all__ = ["RADII", "RidgeCoherence"]

RADII = (0.03, 0.06)  # of discs, along the cloth [m]
CENTRES = 192  # discs, spread evenly over the garment
FRAMES = 48  # of a motion that are measured, spread evenly


class RidgeCoherence:
    """Coherence of the structure tensor of the normals (Bigun and Granlund 1987), in discs of the cloth.

    How the normals turn along warp and weft gives a tensor at each vertex. Its mean over a disc has two eigenvalues
    a > b, and (a - b) / (a + b) is 1 where all folds of the disc run one way and 0 where they run every way.

    Args:
        mesh: the fine mesh in its bind pose. Its flat faces have the directions.
    """

    def __init__(self, mesh: ClothMesh) -> None:
        self._faces, self._inverse = mesh.faces, np.linalg.inv(mesh.flat)
        count, areas = len(mesh.vertices), 0.5 * np.abs(np.linalg.det(mesh.flat))
        weights = (np.repeat(areas, 3), (mesh.faces.ravel(), np.repeat(np.arange(len(areas)), 3)))
        around = csr_matrix(weights, (count, len(areas)))
        self._around = (diags(1.0 / np.maximum(np.asarray(around.sum(axis=1)).ravel(), 1e-12)) @ around).tocsr()
        away = along_cloth(mesh, spread_points(mesh.vertices, np.arange(count), CENTRES), max(RADII))
        self._means = [disc_means(away, radius, mesh.vertex_areas) for radius in RADII]

    def __call__(self, frames: np.ndarray) -> np.ndarray:
        """Coherence within each of :data:`RADII` [-], means over discs and frames in which sharp folds count for more.

        Args:
            frames: vertices [m], shape (f, N, 3).
        """
        of_ridges, of_all = np.zeros((2, len(RADII)))
        frames = frames[np.unique(np.linspace(0, len(frames) - 1, FRAMES).round().astype(int))]
        for frame in frames:
            normals = vertex_normals(np.asarray(frame, float)[None], self._faces)[0]
            corner = normals[self._faces]
            sides = np.stack([corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]], axis=-1)
            # At the vertices, since the sides of a face are half an edge from one another in the phase of a fold.
            slopes = (self._around @ (sides @ self._inverse).reshape(-1, 6)).reshape(-1, 3, 2)  # along warp, weft [1/m]
            tensor = np.stack([*(slopes**2).sum(axis=1).T, slopes.prod(axis=2).sum(axis=1)], axis=1)
            for number, means in enumerate(self._means):
                a, b, c = (means @ tensor).T
                of_ridges[number] += np.sqrt((a - b) ** 2 + 4.0 * c**2).sum()
                of_all[number] += (a + b).sum()
        return of_ridges / np.maximum(of_all, 1e-30)
