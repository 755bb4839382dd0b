"""Makes the smooth fine surface of a coarse mesh by Loop subdivision, and fits a coarse mesh to a fine surface.

The upsampling is corrected, so that the fine surface passes close to the coarse vertices and does not shrink.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, identity
from scipy.sparse.linalg import splu

from pbd import ClothMesh
from pbd.mesh import edges_of, flatten_by_lengths, flatten_by_surface
from wrinkles.binding import Binding

__all__ = ["SewnRest", "Subdivision", "csr_arrays", "cut_corners", "cut_faces", "loop_step"]


def loop_step(faces: np.ndarray, vertex_count: int) -> tuple[csr_matrix, np.ndarray]:
    """One step of Loop subdivision with boundary rules (Loop 1987; boundary masks after Hoppe et al. 1994).

    Old vertices keep their numbers; the new vertex of edge e is ``vertex_count + e``.

    Args:
        faces: int, shape (m, 3).
        vertex_count: number of vertices n.

    Returns:
        The matrix that gives new vertices, shape (n + e, n), and the new faces, shape (4 m, 3): three at the corners of
        each face and one in its middle.
    """
    edges, side_edge = edges_of(faces)
    edge_count = len(edges)
    sides = np.bincount(side_edge.ravel(), minlength=edge_count)
    rim = sides == 1
    # New edge vertices: 3/8 of both ends and 1/8 of both opposite corners; 1/2 of both ends on the rim.
    opposite = np.roll(faces, 1, axis=1)  # the corner opposite to side s
    inner_side = ~rim[side_edge.ravel()]
    end_weight = np.where(rim, 0.5, 0.375)
    rows = [np.repeat(vertex_count + np.arange(edge_count), 2), vertex_count + side_edge.ravel()[inner_side]]
    columns = [edges.ravel(), opposite.ravel()[inner_side]]
    values = [np.repeat(end_weight, 2), np.full(inner_side.sum(), 0.125)]
    # Old vertices: Loop's weight beta of each neighbour inside; 3/4 and twice 1/8 on the rim.
    valence = np.bincount(edges.ravel(), minlength=vertex_count)
    on_rim = np.zeros(vertex_count, bool)
    on_rim[edges[rim].ravel()] = True
    with np.errstate(divide="ignore"):
        beta = (0.625 - (0.375 + 0.25 * np.cos(2.0 * np.pi / np.maximum(valence, 1))) ** 2) / np.maximum(valence, 1)
    both = np.concatenate([edges, edges[:, ::-1]])
    rim_both = np.concatenate([rim, rim])
    at_inner = ~on_rim[both[:, 0]]
    along_rim = on_rim[both[:, 0]] & rim_both
    rows += [both[at_inner, 0], both[along_rim, 0], np.arange(vertex_count)]
    columns += [both[at_inner, 1], both[along_rim, 1], np.arange(vertex_count)]
    values += [
        beta[both[at_inner, 0]],
        np.full(along_rim.sum(), 0.125),
        np.where(on_rim, 0.75, 1.0 - valence * beta),
    ]
    matrix = csr_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
        (vertex_count + edge_count, vertex_count),
    )
    return matrix, cut_faces(faces, vertex_count + side_edge)


def cut_faces(faces: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Four faces from each: three at its corners and one in its middle, int32, shape (4 m, 3).

    Args:
        faces: int, shape (m, 3).
        middle: new vertices on the sides 0-1, 1-2 and 2-0, int, shape (m, 3).
    """
    a, b, c = faces.T
    ab, bc, ca = middle.T
    parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.stack([np.stack(p, axis=1) for p in parts], axis=1).reshape(-1, 3).astype(np.int32)


def cut_corners(corners: np.ndarray) -> np.ndarray:
    """Values at the corners of faces, shape (m, 3, k), at those of the faces of :func:`cut_faces`: (4 m, 3, k)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.stack([np.stack(p, axis=1) for p in parts], axis=1).reshape(-1, 3, corners.shape[2])


@dataclass(frozen=True, eq=False)
class SewnRest:
    """How the coarse faces of a sewn garment rest.

    Attributes:
        pattern: their corners (warp, weft) [m], shape (m, 3, 2).
        layers: of cloth in each [-], shape (m,).
        max_stretch: greatest length of their edges over the rest length [-], shape (m,): waistbands hardly give way.
    """

    pattern: np.ndarray
    layers: np.ndarray
    max_stretch: np.ndarray

    def subdivided(self, levels: int) -> SewnRest:
        """The same of the faces of :func:`cut_faces`, so many times."""
        pattern = self.pattern
        for _ in range(levels):
            pattern = cut_corners(pattern)
        return SewnRest(pattern, *(np.repeat(values, 4**levels) for values in (self.layers, self.max_stretch)))

    def mesh(self, vertices: np.ndarray, faces: np.ndarray) -> ClothMesh:
        """The garment at given vertices [m], shape (n, 3)."""
        mesh = ClothMesh.from_pattern(vertices, faces, self.pattern, self.layers)
        return replace(mesh, max_stretch=self.max_stretch)


@dataclass(frozen=True)
class Subdivision:
    """A coarse mesh and its smooth refinement.

    Upsampling is quasi-interpolating: it is Loop subdivision of 2 x - S x, where S x are the positions to which plain
    subdivision would move the coarse vertices x. The coarse vertices then lie on the smooth surface to second order,
    and the surface does not shrink into the body as a plain Loop surface does.

    Attributes:
        coarse_faces: int32, shape (m, 3).
        coarse_count: number of coarse vertices n.
        steps: Loop matrices, one for each level, see :func:`loop_step`.
        cut: faces of the subdivided mesh, int32, shape (m 4^levels, 3). Coarse vertices come first in its numbering.
        binding: of a delivered fine mesh; None where the subdivided mesh is the fine one.
    """

    coarse_faces: np.ndarray
    coarse_count: int
    steps: tuple[csr_matrix, ...]
    cut: np.ndarray
    binding: Binding | None = None

    @classmethod
    def of(cls, faces: np.ndarray, vertex_count: int, levels: int, binding: Binding | None = None) -> Subdivision:
        """Make the subdivision of a mesh.

        Args:
            faces: of the coarse mesh, int, shape (m, 3).
            vertex_count: number of coarse vertices n.
            levels: number of times that each face is cut in four.
            binding: of a delivered fine mesh, if there is one.
        """
        steps, fine, count = [], np.asarray(faces, np.int32), vertex_count
        for _ in range(levels):
            matrix, fine = loop_step(fine, count)
            steps.append(matrix)
            count = matrix.shape[0]
        return cls(np.asarray(faces, np.int32), vertex_count, tuple(steps), fine, binding)

    @property
    def fine_count(self) -> int:
        """Number N of fine vertices."""
        return self.matrix.shape[0]

    @property
    def faces(self) -> np.ndarray:
        """Faces of the fine mesh as it is drawn, with closed seams: int32, shape (M, 3)."""
        return self.cut if self.binding is None else self.binding.sewn.faces

    @property
    def stands_for(self) -> np.ndarray | None:
        """The vertex that replaces each fine vertex in ``faces``, int, shape (N,); None if no vertex is replaced.

        Closing a seam merges vertices of its two sides.
        """
        return None if self.binding is None else self.binding.sewn.one

    @cached_property
    def middle(self) -> Subdivision:
        """The coarse mesh cut once: wrinkles are added to its q vertices, and edge lengths are corrected on it."""
        return Subdivision.of(self.coarse_faces, self.coarse_count, 1)

    @cached_property
    def to_middle(self) -> csr_matrix:
        """Matrix that gives corrected middle vertices from coarse ones, shape (q, n)."""
        return (self.steps[0] @ self.correction).tocsr()

    @cached_property
    def from_middle(self) -> csr_matrix:
        """Matrix that gives fine positions from middle ones, shape (N, q)."""
        matrix = identity(self.steps[0].shape[0], format="csr")
        for step in self.steps[1:]:
            matrix = (step @ matrix).tocsr()
        if self.binding is None:
            return matrix
        corners = self.cut[self.binding.face]
        rows = np.repeat(np.arange(len(corners)), 3)
        bound = csr_matrix((self.binding.place.ravel(), (rows, corners.ravel())), (len(corners), matrix.shape[0]))
        return (self.binding.smoothing @ (bound @ matrix)).tocsr()

    @cached_property
    def correction(self) -> csr_matrix:
        """Matrix 2 I - S of the coarse vertices, shape (n, n)."""
        plain = self._plain[: self.coarse_count]
        return (2.0 * identity(self.coarse_count, format="csr") - plain).tocsr()

    @cached_property
    def _plain(self) -> csr_matrix:
        """Matrix of plain Loop subdivision, from the coarse to the subdivided mesh."""
        matrix = identity(self.coarse_count, format="csr")
        for step in self.steps:
            matrix = (step @ matrix).tocsr()
        return matrix

    @cached_property
    def matrix(self) -> csr_matrix:
        """Matrix that gives fine positions from coarse ones, shape (N, n)."""
        if self.binding is None:
            return (self._plain @ self.correction).tocsr()
        return (self.from_middle @ self.to_middle).tocsr()

    def upsample(self, coarse: np.ndarray) -> np.ndarray:
        """Fine vertices on the smooth surface [m], shape (..., N, 3).

        Args:
            coarse: coarse vertices [m], shape (..., n, 3).
        """
        return _apply(self.matrix, coarse)

    def cut_surface(self, coarse: np.ndarray) -> np.ndarray:
        """Vertices of the subdivided mesh, with or without a delivered mesh; shapes as for :meth:`upsample`."""
        return _apply((self._plain @ self.correction).tocsr(), coarse)

    def fit(self, fine: np.ndarray) -> np.ndarray:
        """Coarse vertices whose smooth surface is nearest to fine vertices in the least-squares sense.

        Args:
            fine: fine vertices [m], shape (N, 3).

        Returns:
            coarse vertices [m], shape (n, 3).
        """
        return splu((self.matrix.T @ self.matrix).tocsc()).solve(self.matrix.T @ np.asarray(fine, float))

    def meshes(
        self, coarse_vertices: np.ndarray, warp: tuple = (0.0, 1.0, 0.0), *, sewn: SewnRest | None = None
    ) -> tuple[ClothMesh, ClothMesh]:
        """Make the coarse and the fine mesh with one rest metric: that of the smooth fine mesh, or of a sewn pattern.

        A coarse edge is as long as the fine edges along it, so that both meshes have the same area; the straight edge
        itself is shorter than the cloth. With a delivered fine mesh, coarse edges take the lengths of its pattern, see
        :meth:`wrinkles.binding.Binding.coarse_lengths`.

        Args:
            coarse_vertices: [m], shape (n, 3).
            warp: direction of the warp in space, shape (3,).
            sewn: how the coarse faces of a sewn garment rest; the warp is then that of the pattern.
        """
        fine_vertices = self.upsample(coarse_vertices)
        if sewn is not None:
            coarse = sewn.mesh(np.asarray(coarse_vertices, float), self.coarse_faces)
            return coarse, sewn.subdivided(len(self.steps)).mesh(fine_vertices, self.cut)
        if self.binding is None:
            smooth, fine = fine_vertices, ClothMesh.from_surface(fine_vertices, self.cut, warp)
        else:
            smooth = self.cut_surface(coarse_vertices)
            fine = self.binding.mesh(fine_vertices)
        edges, side_edge = edges_of(self.coarse_faces)
        lengths = np.zeros(len(edges))
        for path in self._edge_paths(edges):
            lengths += np.linalg.norm(smooth[path[:, 1]] - smooth[path[:, 0]], axis=1)
        flat = flatten_by_surface(np.asarray(coarse_vertices, float), self.coarse_faces, np.asarray(warp))
        flat = flatten_by_lengths(flat, self.coarse_faces, lengths, side_edge)
        if self.binding is not None:
            mesh = ClothMesh(np.asarray(coarse_vertices, float), self.coarse_faces, flat)
            lengths = self.binding.coarse_lengths(mesh, *self.places)
            flat = flatten_by_lengths(flat, self.coarse_faces, lengths, side_edge)
        return ClothMesh(np.asarray(coarse_vertices, float), self.coarse_faces, flat), fine

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Coarse face and barycentric weights of each fine vertex: int, shape (N,), and float, shape (N, 3)."""
        parent = np.arange(len(self.coarse_faces))
        weights = np.broadcast_to(np.eye(3), (len(parent), 3, 3))
        for _ in self.steps:
            weights = cut_corners(weights)
            parent = np.repeat(parent, 4)
        if self.binding is not None:
            face = self.binding.face
            return parent[face].astype(np.int64), np.einsum("pc,pci->pi", self.binding.place, weights[face])
        face = np.zeros(self.fine_count, np.int64)
        place = np.zeros((self.fine_count, 3))
        # Any face around a fine vertex would be correct; writing in reverse order keeps the first one.
        corner = self.cut.ravel()[::-1]
        face[corner] = np.repeat(parent, 3)[::-1]
        place[corner] = weights.reshape(-1, 3)[::-1]
        return face, place

    def flat_corners(self, pattern: np.ndarray | None) -> np.ndarray | None:
        """Place of each corner of ``faces`` in the flat pattern [m], shape (M, 3, 2); None without a pattern.

        Args:
            pattern: the same of the coarse faces, or their texture coordinates, shape (m, 3, 2); a delivered mesh has
                its pattern for both.
        """
        if self.binding is not None:
            return self.binding.sewn.flat
        if pattern is None:
            return None
        for _ in self.steps:
            pattern = cut_corners(pattern)
        return pattern

    @cached_property
    def at_coarse(self) -> np.ndarray:
        """The fine vertex at each coarse vertex, or on a delivered mesh nearest to it: int, shape (n,).

        The nearest one is that with the greatest barycentric weight on the coarse vertex.
        """
        if self.binding is None:
            return np.arange(self.coarse_count)
        face, place = self.places
        order = np.argsort(place.ravel(), kind="stable")
        at = np.zeros(self.coarse_count, np.int64)
        # Written in ascending order of weight, so that the greatest remains.
        at[self.coarse_faces[face].ravel()[order]] = order // 3
        return at

    def _edge_paths(self, edges: np.ndarray) -> list[np.ndarray]:
        """Fine edges along each coarse edge, in pieces: a list of 2^levels arrays of vertices, int, shape (e, 2).

        Args:
            edges: of the coarse mesh, int, shape (e, 2).
        """
        pieces, faces, count = [edges], self.coarse_faces, self.coarse_count
        for step in self.steps:
            level_edges, side_edge = edges_of(faces)
            key = level_edges[:, 0].astype(np.int64) * count + level_edges[:, 1]
            order = np.argsort(key)
            halves = []
            for piece in pieces:
                low, high = piece.min(axis=1).astype(np.int64), piece.max(axis=1)
                middle = count + order[np.searchsorted(key[order], low * count + high)]
                halves += [np.stack([piece[:, 0], middle], axis=1), np.stack([middle, piece[:, 1]], axis=1)]
            pieces = halves
            faces = cut_faces(faces, count + side_edge)
            count = step.shape[0]
        return pieces


def _apply(matrix: csr_matrix, values: np.ndarray) -> np.ndarray:
    """Product of a sparse matrix, shape (k, n), with the vertex axis of values (..., n, 3): shape (..., k, 3)."""
    values = np.asarray(values, float)
    columns = np.moveaxis(values, -2, 0).reshape(values.shape[-2], -1)
    result = (matrix @ columns).reshape(matrix.shape[0], *values.shape[:-2], 3)
    return np.moveaxis(result, 0, -2)


def csr_arrays(matrix: csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row starts (int32), columns (int32) and values (float32) of a sparse matrix, for kernels."""
    matrix = matrix.tocsr()
    matrix.sort_indices()
    return matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32), matrix.data.astype(np.float32)
