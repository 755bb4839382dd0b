"""Masses and springs on lattices, with stiffness from E h and the mesh (Lloyd, Szekely, Harders 2007).

A lattice of springs has one modulus and the Poisson ratio 1/3, also for other fabrics: E h is the geometric mean of
warp and weft.
"""

from __future__ import annotations

import numpy as np

from pbd.errors import InputError
from pbd.fabric import Fabric
from pbd.mesh import ClothMesh, edges_of, hinges_of
from pbd.models.elements import ElementEnergy

__all__ = ["Springs", "square_springs", "triangle_springs"]

SHARE = 3 / 8  # stiffness of a square's sides and diagonals, per square and over E h [-]
SQUARE = 1e-3  # a cell is square if its sides and angles are, to this part [-]


class Springs(ElementEnergy):
    """Sum of k/2 (|x_i - x_j| - l)^2.

    Args:
        elements: ends (i, j), int, shape (m, 2).
        vertex_count: n.
        stiffness: k [N/m], shape (m,).
        lengths: l [m], shape (m,).
    """

    per_element = ("stiffness", "lengths")

    def __init__(self, elements: np.ndarray, vertex_count: int, stiffness: np.ndarray, lengths: np.ndarray) -> None:
        super().__init__(elements, vertex_count)
        self.stiffness, self.lengths = stiffness, lengths

    def values(self, corners: np.ndarray) -> np.ndarray:
        return 0.5 * self.stiffness * (self._lengths(corners)[0] - self.lengths) ** 2

    def slopes(self, corners: np.ndarray) -> np.ndarray:
        length, unit = self._lengths(corners)
        pull = (self.stiffness * (length - self.lengths))[:, None] * unit
        return np.stack([pull, -pull], axis=1)

    def curvatures(self, corners: np.ndarray, positive: bool) -> np.ndarray:
        length, unit = self._lengths(corners)
        along = unit[:, :, None] * unit[:, None, :]
        across = 1.0 - self.lengths / length
        if positive:
            across = np.maximum(across, 0.0)
        block = self.stiffness[:, None, None] * (along + across[:, None, None] * (np.eye(3) - along))
        return np.einsum("ab,mij->maibj", np.array([[1.0, -1.0], [-1.0, 1.0]]), block)

    @staticmethod
    def _lengths(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        offset = corners[:, 0] - corners[:, 1]
        length = np.maximum(np.linalg.norm(offset, axis=1), 1e-12)
        return length, offset / length[:, None]


def triangle_springs(mesh: ClothMesh, fabric: Fabric) -> Springs:
    """Springs along the edges: k = E h A/l^2 from each triangle at the edge (Van Gelder 1998).

    On equilateral triangles that is sqrt(3)/4 E h per triangle, and E and nu = 1/3 are exact; on others it is a guess.
    """
    edges, side_edge = edges_of(mesh.faces)
    share = _modulus(fabric) * mesh.face_areas[:, None] / mesh.side_lengths() ** 2
    stiffness = np.bincount(side_edge.ravel(), share.ravel(), len(edges))
    return Springs(edges, len(mesh.vertices), stiffness, mesh.edge_lengths()[1])


def square_springs(mesh: ClothMesh, fabric: Fabric) -> Springs:
    """Sides and both diagonals of a square lattice, all with their natural lengths.

    k = 3/4 E h for a side between two squares, 3/8 E h for a side at the border and for a diagonal.

    Raises:
        InputError: triangles that do not pair up to squares.
    """
    edges, side_edge = edges_of(mesh.faces)
    sides = mesh.side_lengths()
    long = np.argmax(sides, axis=1)
    rows = np.arange(len(sides))
    diagonal = side_edge[rows, long]
    legs = np.stack([sides[rows, (long + k) % 3] for k in (1, 2)], axis=1)
    right = np.abs(legs * np.sqrt(2.0) / sides[rows, long][:, None] - 1.0).max(axis=1) < SQUARE
    whole = np.bincount(diagonal, minlength=len(edges))[diagonal] == 2
    if not np.all(right & whole):
        face = int(np.argmin(right & whole))
        expected = "halves of squares, each beside its other half"
        raise InputError("no square lattice", key=f"face {face}", received=sides[face].tolist(), expected=expected)
    hinges = hinges_of(mesh.faces)
    pairs = np.sort(hinges[:, :2], axis=1)
    inner = hinges[np.isin(pairs @ [len(mesh.vertices), 1], edges[diagonal] @ [len(mesh.vertices), 1])]
    lengths = mesh.edge_lengths()[1]
    other = np.sqrt(2.0) * np.bincount(diagonal, legs.mean(axis=1), len(edges))  # twice, by both halves
    faces_at = np.bincount(side_edge.ravel(), minlength=len(edges)).astype(float)
    faces_at[diagonal] = 1.0  # one square
    order = np.searchsorted(edges @ [len(mesh.vertices), 1], np.sort(inner[:, :2], axis=1) @ [len(mesh.vertices), 1])
    return Springs(
        np.concatenate([edges, inner[:, 2:]]),
        len(mesh.vertices),
        _modulus(fabric) * SHARE * np.concatenate([faces_at, np.ones(len(inner))]),
        np.concatenate([lengths, 0.5 * other[order]]),
    )


def _modulus(fabric: Fabric) -> float:
    """E h [N/m]."""
    return float(np.sqrt(fabric.stretch_warp * fabric.stretch_weft))
