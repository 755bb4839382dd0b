"""How fine cloth lies on a body: the distance that it keeps from the body, and the side that faces outwards."""

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from pbd import ClothMesh

__all__ = ["clearances", "facing"]

MAX_EXTRA_CLEARANCE = 0.004  # added to the thickness where the body bulges [m]


def clearances(vertices: np.ndarray, faces: np.ndarray, spacing: np.ndarray | float, thickness: float) -> np.ndarray:
    """Distance that cloth vertices keep from a body, at each of the body's vertices [m], float32, shape (b,).

    The middle of a cloth edge sinks into a convex body, so the ends must keep more distance there. The surroundings of
    a body vertex are the vertices nearer than one edge of the cloth. A vertex that lies above the mean of its
    surroundings (weighted by area) adds its height above the mean to the clearance of all of them.

    Args:
        vertices: of the body, in any pose [m], shape (b, 3).
        faces: int, counter-clockwise seen from outside, shape (k, 3).
        spacing: length of the cloth's edges near each vertex [m], shape (b,), or one length for all.
        thickness: distance kept from a flat body [m].
    """
    count = len(vertices)
    if not len(faces):
        return np.full(count, thickness, np.float32)
    normals, areas = _normals(vertices, faces)
    tree = cKDTree(vertices)
    reach = np.broadcast_to(spacing, count)
    pairs = tree.query_pairs(float(reach.max()), output_type="ndarray")
    # A vertex whose normal points the opposite way belongs to another part of the body, not to the surroundings.
    pairs = pairs[np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]]) > 0.0]
    pairs = np.concatenate([pairs, pairs[:, ::-1], np.repeat(np.arange(count)[:, None], 2, axis=1)])
    one, other = pairs[np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1) <= reach[pairs[:, 0]]].T
    near = csr_matrix((areas[other], (one, other)), (count, count))
    total = np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1e-20)
    height = ((vertices - (near @ vertices) / total[:, None]) * normals).sum(axis=1)
    height[areas == 0.0] = 0.0
    sag = np.clip(height, 0.0, MAX_EXTRA_CLEARANCE)
    widest = sag.copy()
    np.maximum.at(widest, one, sag[other])
    return (thickness + widest).astype(np.float32)


def facing(mesh: ClothMesh, vertices: np.ndarray, faces: np.ndarray) -> float:
    """Orientation of a garment's faces in the bind pose: 1 if their normals point away from the body, -1 if into it.

    Args:
        mesh: of the garment.
        vertices, faces: of the body, as for :func:`clearances`.
    """
    if not len(faces):
        return 1.0
    nearest = cKDTree(vertices).query(mesh.vertices)[1]
    cloth, areas = _normals(mesh.vertices, mesh.faces)
    along = (cloth * _normals(vertices, faces)[0][nearest]).sum(axis=1)
    return 1.0 if along @ areas >= 0.0 else -1.0


def _normals(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vertex normals, shape (n, 3), and a third of the area around each vertex [m2], shape (n,)."""
    corners = vertices[faces]
    area_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 6.0
    normals, areas = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for corner in range(3):
        np.add.at(normals, faces[:, corner], area_normals)
        np.add.at(areas, faces[:, corner], np.linalg.norm(area_normals, axis=1))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20), areas
