"""Patches of wrinkles: each coarse vertex carries a small grid of displacements, and neighbouring grids overlap.

A fine vertex reads the grids of the three coarse vertices around it and blends them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, diags

from pbd.mesh import ClothMesh
from wrinkles.binding import Binding
from wrinkles.charts import Charts, fine_places
from wrinkles.surface import Subdivision

__all__ = ["Grid", "Patches"]

BLEND_RADIUS = 1.1  # distance from a patch's centre at which its weight becomes 0, in coarse edges
MIN_FRAME_WEIGHT = 0.02  # smaller weights of a coarse vertex's frame are left out
MOST_CELLS = 4  # along a mean coarse edge


@dataclass(frozen=True)
class Grid:
    """The square grid of a patch: it reaches a mean coarse edge or more from its coarse vertex to all sides.

    Attributes:
        cells: along a mean coarse edge.
    """

    cells: int

    @classmethod
    def of(cls, subdivisions: int) -> Grid:
        """With as many cells along a coarse edge as there are fine edges, or MOST_CELLS of them."""
        return cls(min(2**subdivisions, MOST_CELLS))

    @classmethod
    def with_nodes(cls, count: int) -> Grid:
        """The grid that has so many nodes."""
        return cls((4 * (math.isqrt(count) // 2) + 4) // 5)

    @property
    def side(self) -> int:
        """Nodes along a side."""
        return 2 * (5 * self.cells // 4) + 1

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.side**2

    def slope_metric(self) -> np.ndarray:
        """Cholesky factor L of the metric in which patches d are compared, error = |L^T d|^2: shape (nodes, nodes).

        A wrinkle is visible by its slope, so the metric is the sum of squared differences of neighbouring nodes. The
        displacement itself is added with the weight of its slope over one coarse edge. Nodes are weighted by their
        share in the blend.
        """
        side = self.side
        axis = (np.arange(side) - side // 2) / self.cells
        share = np.clip(1.0 - np.abs(axis), 0.05, None)
        window = np.sqrt(np.outer(share, share)).ravel()
        line = np.diff(np.eye(side), axis=0)
        slopes = np.concatenate([np.kron(line, np.eye(side)), np.kron(np.eye(side), line)])
        # The weight of a difference is the mean window of its two nodes.
        between = np.abs(slopes) @ window / 2.0
        slopes *= between[:, None]
        values = np.diag(window / self.cells)
        return np.linalg.cholesky(slopes.T @ slopes + values.T @ values)

    def second_differences(self) -> np.ndarray:
        """Quadratic form of the second differences along both axes, shape (nodes, nodes)."""
        side = self.side
        line = np.zeros((side - 2, side))
        for i in range(side - 2):
            line[i, i : i + 3] = (1.0, -2.0, 1.0)
        both = np.kron(line, np.eye(side)), np.kron(np.eye(side), line)
        return both[0].T @ both[0] + both[1].T @ both[1]


@dataclass(frozen=True)
class Patches:
    """Where each fine vertex reads the grids of the three coarse vertices around it.

    Attributes:
        corners: the three coarse vertices, int32, shape (N, 3).
        blend: their weights, a partition of unity, float32, shape (N, 3).
        cell: lower node of the grid cell in each patch, int32, shape (N, 3).
        within: position in the cell along both axes in 0..1, float32, shape (N, 6).
        grid: that each of them has.
        spacing: distance of the grid's nodes [m].
        turning: weights of the coarse vertices' frames in the frame of each fine vertex, rows sum to one, shape (N, n).
            They are the blend's weights; on a delivered mesh they are smoothed over the pattern, so that they do not
            jump where bound points jump.
        smoothing: matrix that smooths displacements on a delivered mesh where its bound points crowd, shape (N, N);
            None for a subdivided mesh.
    """

    corners: np.ndarray
    blend: np.ndarray
    cell: np.ndarray
    within: np.ndarray
    grid: Grid
    spacing: float
    turning: csr_matrix
    smoothing: csr_matrix | None = None

    @classmethod
    def of(cls, subdivision: Subdivision, charts: Charts) -> Patches:
        """Make the patches for the fine vertices of a garment.

        Args:
            subdivision: from the coarse to the fine mesh.
            charts: of the coarse mesh.
        """
        mesh: ClothMesh = charts.mesh
        grid = Grid.of(len(subdivision.steps))
        spacing = float(mesh.edge_lengths()[1].mean()) / grid.cells
        face, place = fine_places(subdivision)
        within = charts.locate(face, place) / spacing + grid.side // 2
        within = np.clip(within, 0.0, grid.side - 1 - 1e-5)
        lower = within.astype(np.int64)
        blend, binding = _blend(place), subdivision.binding
        read = cls(
            np.ascontiguousarray(mesh.faces[face], np.int32),
            np.ascontiguousarray(blend, np.float32),
            np.ascontiguousarray(lower[..., 0] * grid.side + lower[..., 1], np.int32),
            np.ascontiguousarray((within - lower).reshape(len(face), 6), np.float32),
            grid,
            spacing,
            _turning(binding, mesh.faces[face], blend, len(mesh.vertices)),
        )
        if binding is None:
            return read
        corners = subdivision.cut_surface(mesh.vertices)[subdivision.cut[binding.face]]
        crowded = binding.crowded(np.einsum("pc,pci->pi", binding.place, corners))
        return replace(read, smoothing=binding.smoothing_where(crowded))

    def fits(self, coarse_count: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each coarse vertex, the fine vertices of its patch and the matrix that fits a grid to values at them.

        The fit is least squares with bilinear reading, weighted by the blend; nodes without a vertex near them follow
        from a small weight on second differences.

        Args:
            coarse_count: number of coarse vertices n.

        Returns:
            a list of n pairs: fine vertices, int, shape (k,), and the matrix, shape (nodes, k).
        """
        smooth = 1e-3 * self.grid.second_differences()
        members: list[list[tuple[int, int]]] = [[] for _ in range(coarse_count)]
        for vertex, row in enumerate(self.corners.tolist()):
            for corner, coarse in enumerate(row):
                members[coarse].append((vertex, corner))
        result = []
        for rows in members:
            vertex, corner = np.array(rows).T
            reading = self._bilinear(vertex, corner)
            weight = self.blend[vertex, corner].astype(float) + 0.02
            left = reading.T @ (weight[:, None] * reading) + smooth + 1e-6 * np.eye(self.grid.nodes)
            result.append((vertex, np.linalg.solve(left, reading.T * weight)))
        return result

    def _bilinear(self, vertex: np.ndarray, corner: np.ndarray) -> np.ndarray:
        """Matrix that reads grid values at fine vertices, shape (k, nodes)."""
        rows, side = np.arange(len(vertex)), self.grid.side
        node = self.cell[vertex, corner]
        u = self.within[vertex, 2 * corner].astype(float)
        v = self.within[vertex, 2 * corner + 1].astype(float)
        reading = np.zeros((len(vertex), self.grid.nodes))
        reading[rows, node] = (1 - u) * (1 - v)
        reading[rows, node + side] = u * (1 - v)
        reading[rows, node + 1] = (1 - u) * v
        reading[rows, node + side + 1] = u * v
        return reading


def _blend(place: np.ndarray) -> np.ndarray:
    """Weights of the three patches around each vertex, shape (N, 3).

    They depend on the distance r from the patches' centres, computed as if triangles were equilateral. The weight
    (1 - (r / BLEND_RADIUS)^2)^2 has no kink where a coarse edge is crossed. The wider the blend, the better it averages
    differences between neighbouring patches, which would otherwise show as ribs one coarse edge apart. Patches of other
    vertices than the corners of the face are left out; their weight would be 9 % at most, in the middle of an edge.

    Args:
        place: barycentric weights, shape (N, 3).
    """
    before, after = np.roll(place, 1, axis=1), np.roll(place, -1, axis=1)
    squared = before**2 + after**2 + before * after
    weight = np.clip(1.0 - squared / BLEND_RADIUS**2, 0.0, None) ** 2
    return weight / weight.sum(axis=1, keepdims=True)


def _turning(binding: Binding | None, corners: np.ndarray, blend: np.ndarray, coarse_count: int) -> csr_matrix:
    """Matrix of the blend's weights, with the binding's smoothing on a delivered mesh, shape (N, n).

    Args:
        binding: of a delivered mesh, or None.
        corners: coarse vertices around each fine one, int, shape (N, 3).
        blend: their weights, shape (N, 3).
        coarse_count: number of coarse vertices n.
    """
    rows = np.repeat(np.arange(len(corners)), 3)
    weights = csr_matrix((blend.ravel(), (rows, corners.ravel())), (len(corners), coarse_count))
    smooth = weights if binding is None else (binding.smoothing @ weights).tocsr()
    smooth.data[smooth.data < MIN_FRAME_WEIGHT] = 0.0
    smooth.eliminate_zeros()
    return (diags(1.0 / np.asarray(smooth.sum(axis=1)).ravel()) @ smooth).tocsr()
