"""A mesh with a third of the coarse vertices, for garments that are seen from far away.

The solver moves this mesh instead of the coarse one, and the coarse mesh is bound to its smooth surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import splu

from assets.remesh import decimated
from pbd import ClothMesh, InputError
from pbd.attachment import closest_points
from pbd.mesh import edges_of, flatten_by_lengths, hinges_of
from wrinkles.coarsening import faces_around, label_of, nearest_places
from wrinkles.levels import Levels, held_between
from wrinkles.surface import Subdivision

__all__ = ["ProxyMesh", "proxy_mesh_of"]

REDUCTION = 3  # coarse vertices for each vertex of this mesh
MIN_VERTICES = 16  # of this mesh; with fewer a garment loses its shape
FIT_ROUNDS = 4  # alternations of binding the coarse vertices and fitting this mesh
HELD_WEIGHT = 100.0  # of held coarse vertices in the fit; the others have 1
STAY_WEIGHT = 0.02  # of a vertex's last position in the fit, for vertices that carry almost nothing
PIECES_PER_EDGE = 4  # straight pieces in which an edge is laid on the coarse mesh's surface


@dataclass(frozen=True)
class ProxyMesh:
    """A mesh with about a third of the coarse vertices, and the coarse vertices' binding to its smooth surface.

    Attributes:
        mesh: the mesh, with the rest metric and the total area of the coarse mesh.
        held: its attached vertices, int, shape (p,).
        matrix: gives coarse vertices from those of the mesh; rows sum to one, shape (n, k).
        inverse: gives vertices of the mesh from coarse ones, by least squares over its cloth; inverse @ matrix is the
            identity, shape (k, n).
        nearest: the coarse vertex that depends most on each vertex of the mesh, int, shape (k,).
        leading: the vertex of the mesh that each coarse vertex depends on most, int32, shape (n,).
    """

    mesh: ClothMesh
    held: np.ndarray
    matrix: csr_matrix
    inverse: np.ndarray
    nearest: np.ndarray
    leading: np.ndarray


def proxy_mesh_of(levels: Levels, warp: tuple[float, float, float] = (0.0, 1.0, 0.0)) -> ProxyMesh | None:
    """Make the mesh below the coarse one of a garment.

    Returns:
        None for an outfit, and for a mesh that is too small or cannot be decimated.

    Args:
        levels: of the garment.
        warp: direction of the warp in space, shape (3,).
    """
    coarse, middle = levels.coarse, levels.subdivision.middle
    count = len(coarse.vertices) // REDUCTION
    if count < MIN_VERTICES or levels.layers is not None:
        return None
    surface = middle.upsample(coarse.vertices)
    held = held_between(middle, levels.coarse_held)
    try:
        chosen, faces = decimated(surface, middle.faces, count, np.union1d(held, levels.coarse_held))
        plain = Subdivision.of(faces, len(chosen), 1)
        weight = np.where(np.isin(np.arange(len(coarse.vertices)), levels.coarse_held), HELD_WEIGHT, 1.0)
        vertices, face, place = _bound(plain, surface, middle.faces, chosen, coarse.vertices, weight)
        matrix = (_weights(plain, face, place) @ plain.matrix).tocsr()
        mesh = _in_metric(vertices, plain.coarse_faces, coarse, middle, abs(matrix), warp)
        mesh = _sewn_as(coarse, mesh, abs(matrix))
        hinges_of(mesh.faces)
    except (InputError, ValueError):  # too little is left of straps and of scattered small parts
        return None
    area = diags(coarse.vertex_cloth_areas)  # as its mass, so that momentum stays the same
    inverse = splu((matrix.T @ area @ matrix).tocsc()).solve((matrix.T @ area).toarray())
    size = np.abs(matrix.toarray())
    at = np.flatnonzero(np.isin(chosen, held))
    return ProxyMesh(mesh, at, matrix, inverse, size.argmax(axis=0), size.argmax(axis=1).astype(np.int32))


def _bound(
    plain: Subdivision,
    surface: np.ndarray,
    faces: np.ndarray,
    chosen: np.ndarray,
    points: np.ndarray,
    weight: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit vertices, so that their smooth surface comes closest to some points, and bind the points to that surface.

    Binding and fitting alternate, as in :func:`wrinkles.coarsening.bind`.

    Args:
        plain: subdivision of the mesh to be fitted.
        surface, faces: vertices [m], shape (q, 3), and faces of the mesh that was decimated, int, shape (m, 3).
        chosen: the vertices of ``surface`` that decimation kept, int, shape (k,).
        points: the first n vertices of ``surface``, at which the fit is measured [m], shape (n, 3).
        weight: of each point in the fit, shape (n,).

    Returns:
        vertices [m], shape (k, 3); face of the surface, shape (n,), and weights of its corners, shape (n, 3).
    """
    near = faces_around(plain.coarse_faces, label_of(surface, faces, chosen)[: len(points)])
    vertices = surface[chosen]
    for _ in range(FIT_ROUNDS):
        face, place = nearest_places(plain, plain.upsample(vertices), vertices, points, near)
        near = faces_around(plain.coarse_faces, plain.coarse_faces[face // 4])
        matrix = (_weights(plain, face, place) @ plain.matrix).tocsr()
        right = matrix.T @ diags(weight)
        left = right @ matrix + STAY_WEIGHT * identity(len(vertices))
        vertices = splu(left.tocsc()).solve(right @ points + STAY_WEIGHT * vertices)
    return np.ascontiguousarray(vertices), face, place


def _weights(plain: Subdivision, face: np.ndarray, place: np.ndarray) -> csr_matrix:
    """Matrix that gives bound points from the vertices of the subdivided mesh, shape (n, q)."""
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
    """The mesh with the rest metric of the coarse one: edges take the length of their path on the coarse surface.

    Paths on the mesh's own smooth surface are not used: where triangles are uneven, subdivision moves vertices within
    the surface, and lengths that fit no flat surface make the cloth buckle.

    Args:
        vertices, faces: the mesh [m], shapes (k, 3), (m, 3).
        coarse: the coarse mesh.
        middle: the coarse mesh cut once.
        near: size of each coarse vertex's weight on each vertex, shape (n, k).
        warp: direction of the warp in space, shape (3,).
    """
    mesh = ClothMesh.from_surface(vertices, faces, warp)
    own, side_edge = edges_of(faces)
    along = np.linspace(0.0, 1.0, PIECES_PER_EDGE + 1)[:, None, None]
    polylines = (1.0 - along) * vertices[own[:, 0]] + along * vertices[own[:, 1]]
    surface = middle.upsample(coarse.vertices)
    face, weights = closest_points(polylines.reshape(-1, 3), surface, middle.faces)
    polylines = np.einsum("pc,pci->pi", weights, surface[middle.faces[face]]).reshape(polylines.shape)
    lengths = np.linalg.norm(np.diff(polylines, axis=0), axis=2).sum(axis=0)
    # Rest length over length in the bind pose: 1, except for patterns that were draped.
    drawn = middle.meshes(coarse.vertices, warp)[0]
    edges, rest = coarse.edge_lengths()
    ratio = np.repeat(rest / drawn.edge_lengths()[1], 2)
    longer = np.bincount(edges.ravel(), ratio) / np.bincount(edges.ravel())
    longer = (near.T @ longer) / np.maximum(near.T @ np.ones(len(longer)), 1e-12)
    flat = flatten_by_lengths(mesh.flat, faces, lengths * longer[own].mean(axis=1), side_edge)
    mesh = replace(mesh, flat=flat)
    return replace(mesh, flat=flat * np.sqrt(coarse.face_areas.sum() / mesh.face_areas.sum()))


def _sewn_as(coarse: ClothMesh, mesh: ClothMesh, near: csr_matrix) -> ClothMesh:
    """The mesh with the layers of the coarse one, and all their cloth, and with waistbands that hold.

    Args:
        coarse: the coarse mesh.
        mesh: of which the coarse vertices depend.
        near: size of each coarse vertex's weight on each vertex, shape (n, k).
    """
    if coarse.layers is not None:
        layers = (near.T @ (coarse.vertex_cloth_areas / coarse.vertex_areas)) / np.asarray(near.sum(axis=0)).ravel()
        layers = layers[mesh.faces].mean(axis=1)
        layers *= coarse.face_cloth_areas.sum() / (mesh.face_areas @ layers)
        mesh = replace(mesh, layers=layers)
    if coarse.max_stretch is not None:
        limits = np.full(len(coarse.vertices), np.inf)
        np.minimum.at(limits, coarse.faces.ravel(), np.repeat(coarse.max_stretch, 3))
        # The longer faces of this mesh belong to a band where they have an edge in it.
        ends = limits[near.toarray().argmax(axis=0)][mesh.faces]
        mesh = replace(mesh, max_stretch=np.sort(ends, axis=1)[:, 1])
    return mesh
