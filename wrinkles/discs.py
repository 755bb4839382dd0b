"""Places spread evenly over a garment, and discs of the cloth around them."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import dijkstra

from pbd.mesh import ClothMesh

__all__ = ["along_cloth", "disc_means", "spread_points"]


def spread_points(points: np.ndarray, among: np.ndarray, count: int) -> np.ndarray:
    """Numbers of points that are spread evenly: each is the furthest from those before (Gonzalez 1985).

    Args:
        points: shape (n, 3).
        among: numbers of those that may be taken, int, shape (k,).
        count: that are taken at most.
    """
    chosen, some = [int(among[0])], points[among]
    away = np.linalg.norm(some - points[chosen[0]], axis=1)
    for _ in range(min(count, len(among)) - 1):
        chosen.append(int(among[away.argmax()]))
        away = np.minimum(away, np.linalg.norm(some - points[chosen[-1]], axis=1))
    return np.array(chosen)


def along_cloth(mesh: ClothMesh, centres: np.ndarray, limit: float) -> np.ndarray:
    """Distance of every vertex from some vertices along edges [m], shape (c, n); infinite beyond a limit [m]."""
    edges, lengths = mesh.edge_lengths()
    paths = csr_matrix((lengths, edges.T), (len(mesh.vertices),) * 2)
    return dijkstra(paths, directed=False, indices=centres, limit=limit)


def disc_means(away: np.ndarray, radius: float, areas: np.ndarray) -> csr_matrix:
    """Matrix from values at vertices to their means over discs, weighted by area: shape (c, n).

    Args:
        away: distance of every vertex from each centre [m], shape (c, n).
        radius: of the discs [m].
        areas: of the vertices [m2], shape (n,).
    """
    disc, vertex = np.nonzero(away <= radius)
    sums = csr_matrix((areas[vertex], (disc, vertex)), away.shape)
    return (diags(1.0 / np.asarray(sums.sum(axis=1)).ravel()) @ sums).tocsr()
