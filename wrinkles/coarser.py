"""A mesh below the coarse one, for garments that are seen from far away: the coarse mesh is bound to it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import splu

from assets.remesh import decimated
from pbd import ClothMesh, InputError
from pbd.attachment import closest_points
from pbd.mesh import edges_of, flatten_by_lengths, hinges_of
from wrinkles.binding import faces_around, label_of, nearest_places
from wrinkles.levels import Levels, held_between
from wrinkles.surface import Subdivision

__all__ = ["Coarser", "coarser_of"]

SHARE = 3  # coarse vertices for each of its own
FEWEST = 16  # vertices of its own; with fewer a garment has no shape left
ROUNDS = 4  # of binding and fitting
HELD = 100.0  # weight of the places of held vertices in it
PIECES = 4  # of a side, laid on the coarse mesh's surface
STAY = 0.02  # weight on staying, for vertices that carry next to nothing


@dataclass(frozen=True)
class Coarser:
    """A mesh with about a third of the coarse vertices. The coarse ones hang on its smooth surface.

    Attributes:
        mesh: with the rest metric of the coarse mesh; the areas of both sum to the same.
        held: its attached vertices, int, shape (p,).
        matrix: coarse vertices from its own, rows sum to one, shape (n, k).
        inverse: its own vertices for coarse ones, by least squares over the area: what is bound to it comes back as it
            was, shape (k, n).
        nearest: the coarse vertex that leans most on each of its own, int, shape (k,).
        leading: the one of its own that each coarse vertex leans on most, int32, shape (n,).
    """

    mesh: ClothMesh
    held: np.ndarray
    matrix: csr_matrix
    inverse: np.ndarray
    nearest: np.ndarray
    leading: np.ndarray


def coarser_of(levels: Levels, warp: tuple[float, float, float] = (0.0, 1.0, 0.0)) -> Coarser | None:
    """The mesh below the coarse one of a garment; None where it is too small, or decimated comes to no mesh.

    Args:
        levels: of the garment.
        warp: direction of the warp in space, shape (3,).
    """
    coarse, middle = levels.coarse, levels.subdivision.middle
    count = len(coarse.vertices) // SHARE
    if count < FEWEST:
        return None
    places = middle.upsample(coarse.vertices)
    held = held_between(middle, levels.coarse_held)
    try:
        chosen, faces = decimated(places, middle.faces, count, np.union1d(held, levels.coarse_held))
        plain = Subdivision.of(faces, len(chosen), 1)
        weight = np.where(np.isin(np.arange(len(coarse.vertices)), levels.coarse_held), HELD, 1.0)
        vertices, face, place = _bound(plain, places, middle.faces, chosen, coarse.vertices, weight)
        matrix = (_weights(plain, face, place) @ plain.matrix).tocsr()
        mesh = _in_metric(vertices, plain.coarse_faces, coarse, middle, abs(matrix), warp)
        hinges_of(mesh.faces)
    except (InputError, ValueError):  # straps and tatters of which too little is left
        return None
    area = diags(coarse.vertex_areas)
    inverse = splu((matrix.T @ area @ matrix).tocsc()).solve((matrix.T @ area).toarray())
    size = np.abs(matrix.toarray())
    at = np.flatnonzero(np.isin(chosen, held))
    return Coarser(mesh, at, matrix, inverse, size.argmax(axis=0), size.argmax(axis=1).astype(np.int32))


def _bound(
    plain: Subdivision,
    surface: np.ndarray,
    faces: np.ndarray,
    chosen: np.ndarray,
    points: np.ndarray,
    weight: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices whose smooth surface fits some points, the first of ``surface``, best, by their
    weights; and where on it each point is.

    In turn, points take the nearest place of the surface, and vertices fit them, as in :func:`wrinkles.binding.bind`.

    Returns:
        vertices [m], shape (k, 3); face of the surface, shape (n,), and weights of its corners, shape (n, 3).
    """
    near = faces_around(plain.coarse_faces, label_of(surface, faces, chosen)[: len(points)])
    vertices = surface[chosen]
    for _ in range(ROUNDS):
        face, place = nearest_places(plain, plain.upsample(vertices), vertices, points, near)
        near = faces_around(plain.coarse_faces, plain.coarse_faces[face // 4])
        matrix = (_weights(plain, face, place) @ plain.matrix).tocsr()
        right = matrix.T @ diags(weight)
        left = right @ matrix + STAY * identity(len(vertices))
        vertices = splu(left.tocsc()).solve(right @ points + STAY * vertices)
    return np.ascontiguousarray(vertices), face, place


def _weights(plain: Subdivision, face: np.ndarray, place: np.ndarray) -> csr_matrix:
    """Points from the vertices of the smooth surface, shape (n, q)."""
    corners = plain.cut[face]
    rows = np.repeat(np.arange(len(corners)), 3)
    return csr_matrix((place.ravel(), (rows, corners.ravel())), (len(corners), plain.fine_count))


def _in_metric(
    vertices: np.ndarray,
    faces: np.ndarray,
    coarse: ClothMesh,
    middle: Subdivision,
    near: csr_matrix,
    warp: tuple[float, float, float],
) -> ClothMesh:
    """The mesh with sides as long as the ways below them on the coarse mesh's surface, in its metric.

    Ways on the mesh's own smooth surface would not do: where triangles are uneven it creeps in its plane, and lengths
    that fit no flat surface make the cloth buckle.

    Args:
        vertices, faces: the mesh.
        coarse: what hangs on it.
        middle: the coarse mesh cut once.
        near: how much each coarse vertex has to do with each vertex, shape (n, k).
        warp: direction of the warp in space, shape (3,).
    """
    mesh = ClothMesh.from_surface(vertices, faces, warp)
    own, side_edge = edges_of(faces)
    along = np.linspace(0.0, 1.0, PIECES + 1)[:, None, None]
    ways = (1.0 - along) * vertices[own[:, 0]] + along * vertices[own[:, 1]]
    surface = middle.upsample(coarse.vertices)
    face, weights = closest_points(ways.reshape(-1, 3), surface, middle.faces)
    ways = np.einsum("pc,pci->pi", weights, surface[middle.faces[face]]).reshape(ways.shape)
    lengths = np.linalg.norm(np.diff(ways, axis=0), axis=2).sum(axis=0)
    # How much longer the cloth is at rest than it is drawn: not at all, but for patterns that are draped.
    drawn = middle.meshes(coarse.vertices, warp)[0]
    edges, rest = coarse.edge_lengths()
    ratio = np.repeat(rest / drawn.edge_lengths()[1], 2)
    longer = np.bincount(edges.ravel(), ratio) / np.bincount(edges.ravel())
    longer = (near.T @ longer) / np.maximum(near.T @ np.ones(len(longer)), 1e-12)
    flat = flatten_by_lengths(mesh.flat, faces, lengths * longer[own].mean(axis=1), side_edge)
    mesh = replace(mesh, flat=flat)
    return replace(mesh, flat=flat * np.sqrt(coarse.face_areas.sum() / mesh.face_areas.sum()))
