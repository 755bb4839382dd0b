"""Overlapping patches: each coarse vertex carries a small grid of displacements; neighbouring grids blend."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, diags

from pbd.mesh import ClothMesh
from wrinkles.binding import Binding
from wrinkles.charts import Charts, fine_places
from wrinkles.surface import Subdivision

__all__ = ["NODES", "Patches", "slope_metric"]

SIDE = 11
NODES = SIDE * SIDE
REACH = 1.1  # of a patch's blend, in coarse edges
LEAST_TURNING = 0.02  # smaller weights of frames are left out
CELLS_PER_SPACING = 4  # a coarse edge is as long as four grid cells: the fine edges of two subdivisions


@dataclass(frozen=True)
class Patches:
    """Where each fine vertex reads the grids of the three coarse vertices around it.

    Attributes:
        corners: coarse vertices, int32, shape (N, 3).
        blend: partition of unity, float32, shape (N, 3).
        cell: lower node of the grid cell in each patch, int32, shape (N, 3).
        within: place in the cell along both axes in 0..1, float32, shape (N, 6).
        spacing: of the grid's nodes [m].
        turning: weights of the coarse vertices' frames in the frame of each fine vertex, rows sum to one, shape (N, n):
            the blend's, which on a delivered mesh change smoothly in the pattern however places jump.
        smoothing: of what a delivered mesh reads, where its places crowd, shape (N, N); None for others.
    """

    corners: np.ndarray
    blend: np.ndarray
    cell: np.ndarray
    within: np.ndarray
    spacing: float
    turning: csr_matrix
    smoothing: csr_matrix | None = None

    @classmethod
    def of(cls, subdivision: Subdivision, charts: Charts) -> Patches:
        """Patches of a garment, for the vertices of its fine mesh."""
        mesh: ClothMesh = charts.mesh
        spacing = float(mesh.edge_lengths()[1].mean()) / CELLS_PER_SPACING
        face, place = fine_places(subdivision)
        grid = charts.locate(face, place) / spacing + SIDE // 2
        grid = np.clip(grid, 0.0, SIDE - 1 - 1e-5)
        lower = grid.astype(np.int64)
        blend, binding = _blend(place), subdivision.binding
        read = cls(
            np.ascontiguousarray(mesh.faces[face], np.int32),
            np.ascontiguousarray(blend, np.float32),
            np.ascontiguousarray(lower[..., 0] * SIDE + lower[..., 1], np.int32),
            np.ascontiguousarray((grid - lower).reshape(len(face), 6), np.float32),
            spacing,
            _turning(binding, mesh.faces[face], blend, len(mesh.vertices)),
        )
        if binding is None:
            return read
        corners = subdivision.cut_surface(mesh.vertices)[subdivision.cut[binding.face]]
        crowded = binding.crowded(np.einsum("pc,pci->pi", binding.place, corners))
        return replace(read, smoothing=binding.smoothing_where(crowded))

    def fits(self, coarse_count: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each coarse vertex the fine vertices of its patch and the matrix that fits a grid to values there.

        Returns:
            a list of (fine vertices int, shape (k,); matrix, shape (NODES, k)): least squares with bilinear reading,
            weighted by the blend, smooth where no vertex is.
        """
        smooth = 1e-3 * _second_differences()
        members: list[list[tuple[int, int]]] = [[] for _ in range(coarse_count)]
        for vertex, row in enumerate(self.corners.tolist()):
            for corner, coarse in enumerate(row):
                members[coarse].append((vertex, corner))
        result = []
        for rows in members:
            vertex, corner = np.array(rows).T
            reading = self._bilinear(vertex, corner)
            weight = self.blend[vertex, corner].astype(float) + 0.02
            left = reading.T @ (weight[:, None] * reading) + smooth + 1e-6 * np.eye(NODES)
            result.append((vertex, np.linalg.solve(left, reading.T * weight)))
        return result

    def _bilinear(self, vertex: np.ndarray, corner: np.ndarray) -> np.ndarray:
        """Matrix that reads grid values at fine vertices, shape (k, NODES)."""
        rows = np.arange(len(vertex))
        node = self.cell[vertex, corner]
        u = self.within[vertex, 2 * corner].astype(float)
        v = self.within[vertex, 2 * corner + 1].astype(float)
        reading = np.zeros((len(vertex), NODES))
        reading[rows, node] = (1 - u) * (1 - v)
        reading[rows, node + SIDE] = u * (1 - v)
        reading[rows, node + 1] = (1 - u) * v
        reading[rows, node + SIDE + 1] = u * v
        return reading


def _blend(place: np.ndarray) -> np.ndarray:
    """Weights of three patches by the distance from their centres, as if triangles were equilateral: shape (N, 3).

    The wider the blend, the more patches have a say everywhere: what neighbours do not agree on is averaged instead of
    showing as ribs one coarse edge apart. (1 - (r / REACH)^2)^2 has no kink where a coarse edge is crossed. Patches
    beyond the corners of the vertex's own face are left out; they would weigh 9 % at most, in the middle of an edge.

    Args:
        place: barycentric weights, shape (N, 3).
    """
    before, after = np.roll(place, 1, axis=1), np.roll(place, -1, axis=1)
    squared = before**2 + after**2 + before * after
    weight = np.clip(1.0 - squared / REACH**2, 0.0, None) ** 2
    return weight / weight.sum(axis=1, keepdims=True)


def _turning(binding: Binding | None, corners: np.ndarray, blend: np.ndarray, coarse_count: int) -> csr_matrix:
    """The blend's weights of the patches, smoothed as a bound surface is: shape (N, n)."""
    rows = np.repeat(np.arange(len(corners)), 3)
    weights = csr_matrix((blend.ravel(), (rows, corners.ravel())), (len(corners), coarse_count))
    smooth = weights if binding is None else (binding.smoothing @ weights).tocsr()
    smooth.data[smooth.data < LEAST_TURNING] = 0.0
    smooth.eliminate_zeros()
    return (diags(1.0 / np.asarray(smooth.sum(axis=1)).ravel()) @ smooth).tocsr()


def _second_differences() -> np.ndarray:
    """Quadratic form of the second differences along both axes, shape (NODES, NODES)."""
    line = np.zeros((SIDE - 2, SIDE))
    for i in range(SIDE - 2):
        line[i, i : i + 3] = (1.0, -2.0, 1.0)
    both = np.kron(line, np.eye(SIDE)), np.kron(np.eye(SIDE), line)
    return both[0].T @ both[0] + both[1].T @ both[1]


def slope_metric() -> np.ndarray:
    """Cholesky factor L of the metric in which patches are compared, shape (NODES, NODES): error = |L^T d|^2.

    What the eye sees of a wrinkle is its slope: squared differences of neighbouring nodes count in full, displacement
    itself as the slope that it has over one coarse edge. Nodes count by the share that the blend gives them.
    """
    axis = (np.arange(SIDE) - SIDE // 2) / CELLS_PER_SPACING
    share = np.clip(1.0 - np.abs(axis), 0.05, None)
    window = np.sqrt(np.outer(share, share)).ravel()
    line = np.diff(np.eye(SIDE), axis=0)
    slopes = np.concatenate([np.kron(line, np.eye(SIDE)), np.kron(np.eye(SIDE), line)])
    # A difference counts by the window between its two nodes.
    between = np.abs(slopes) @ window / 2.0
    slopes *= between[:, None]
    values = np.diag(window / CELLS_PER_SPACING)
    metric = slopes.T @ slopes + values.T @ values
    return np.linalg.cholesky(metric)
