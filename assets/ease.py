"""Gives a garment that was modelled on a body another size: its surface is drawn out by direction, away from the body.

Cloth that starts on the body compressed buckles once, and friction keeps that fold. The surface itself is therefore
enlarged, so that the cloth starts loose around the body, without strain; its rest metric follows from the surface.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu

from assets.garment import Garment
from assets.seams import Seams
from pbd.attachment import push_outside
from pbd.errors import InputError
from pbd.mesh import flatten_by_surface

__all__ = ["eased", "stretch_by_direction"]

_UP = np.array([0.0, 1.0, 0.0])
_SEAM = 100.0  # stiffness of a stitch, as a share of the mean diagonal
_STEPS = 20  # of rotations and positions in turns
_ANCHOR = 1e-6  # stiffness that keeps a garment without held vertices in place, as a share of the mean diagonal
_CLEARANCE = 0.003  # from the body [m], as wrinkles.levels keeps it
_MAX_STRETCH = 0.02  # mean stretch that the body may force on a garment; more is a garment smaller than the body


def eased(
    garment: Garment,
    ease: tuple[float, float],
    held: np.ndarray,
    body_vertices: np.ndarray,
    body_faces: np.ndarray,
    seams: Seams | None = None,
) -> Garment:
    """The garment in another size: wider around the body, longer along it.

    "Along" is the vertical direction laid into each face, the warp; "around" is at right angles to it. A flat pattern
    is scaled by the same shares, and the surface in space with it. Local and global steps in turns find the surface
    whose faces are nearest to the wanted ones (Liu et al. 2008, "A local/global approach to mesh parameterization",
    with faces in space).

    Args:
        garment: as it was modelled on the body.
        ease: shares (around, along) that are added to its lengths [-].
        held: vertices that stay where they are, int, shape (p,).
        body_vertices: [m], shape (b, 3).
        body_faces: int, shape (k, 3); no faces for a garment without a body.
        seams: stitches between its panels, which stay closed as far as they are; None where there are none.

    Raises:
        InputError: a garment that would be smaller than the body.
    """
    scale = 1.0 + np.array([ease[1], ease[0]])
    wanted = flatten_by_surface(garment.vertices, garment.faces, _UP) * scale[:, None]
    vertices = _embedded(garment, wanted, scale, np.asarray(held, np.int64), seams)
    if len(body_faces):
        vertices = push_outside(vertices, body_vertices, body_faces, _CLEARANCE)
        _check_size(garment, vertices, wanted, ease)
    # The pattern of a sewn garment counts (warp, weft), texture coordinates count (weft, warp), see wrinkles.binding.
    by_axis = scale if garment.layers is not None else scale[::-1]
    pattern = None if garment.pattern is None else garment.pattern * by_axis
    return replace(garment, vertices=vertices, pattern=pattern)


def stretch_by_direction(vertices: np.ndarray, faces: np.ndarray, flat: np.ndarray) -> tuple[float, float]:
    """Mean lengths over rest lengths, less 1, (around, along): of fibres along the weft and the warp [-].

    Args:
        vertices: [m], shape (n, 3).
        faces: int, shape (m, 3).
        flat: rest shapes, as :func:`pbd.mesh.flatten_by_surface` gives, shape (m, 2, 2).
    """
    fibres = np.linalg.norm(_sides(vertices, faces) @ np.linalg.inv(flat), axis=1)
    along, around = np.average(fibres, axis=0, weights=np.linalg.det(flat)) - 1.0
    return float(around), float(along)


def _sides(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Sides 0-1 and 0-2 of faces as columns, shape (m, 3, 2)."""
    corner = vertices[faces]
    return np.stack([corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]], axis=2)


def _embedded(
    garment: Garment, wanted: np.ndarray, scale: np.ndarray, held: np.ndarray, seams: Seams | None
) -> np.ndarray:
    """Vertices of the surface whose faces are nearest to the wanted flat ones [m], shape (n, 3)."""
    faces, count = garment.faces, len(garment.vertices)
    # Gradient of positions over each wanted face: sum over corners of x_c g_c, with g_1, g_2 the rows of the inverse.
    inverse = np.linalg.inv(wanted)
    gradient = np.stack([-inverse.sum(axis=1), inverse[:, 0], inverse[:, 1]], axis=1)  # (m, 3 corners, 2)
    area = 0.5 * np.linalg.det(wanted)
    stiffness = np.einsum("f,fai,fbi->fab", area, gradient, gradient)
    rows, columns = np.repeat(faces, 3, axis=1).ravel(), np.tile(faces, 3).ravel()
    matrix = coo_matrix((stiffness.ravel(), (rows, columns)), (count, count)).tocsc()
    mean = matrix.diagonal().mean()
    anchor = np.full(count, _ANCHOR * mean)
    anchor[held] = 1e6 * mean
    if seams is not None:
        row = np.repeat(np.arange(len(seams.weights)), 3)
        gap = np.stack([np.ones(len(seams.weights)), seams.weights - 1.0, -seams.weights], axis=1)
        apart = coo_matrix((gap.ravel(), (row, seams.vertices.ravel())), (len(seams.weights), count)).tocsc()
        matrix = matrix + _SEAM * mean * (apart.T @ apart)
    solver = splu((matrix + diags(anchor)).tocsc())
    vertices = garment.vertices.astype(float)
    # The first step keeps the faces' directions and only stretches them, so that a tube stays a tube.
    turned = _sides(vertices, faces) @ np.linalg.inv(wanted / scale[:, None])
    for _ in range(_STEPS):
        pull = np.einsum("f,fai,fci->fac", area, gradient, turned)
        right = np.stack([np.bincount(faces.ravel(), pull[:, :, c].ravel(), count) for c in range(3)], axis=1)
        vertices = solver.solve(right + anchor[:, None] * garment.vertices)
        left, _, across = np.linalg.svd(_sides(vertices, faces) @ inverse, full_matrices=False)
        turned = left @ across
    return vertices


def _check_size(garment: Garment, vertices: np.ndarray, wanted: np.ndarray, ease: tuple[float, float]) -> None:
    """Refuse a size that the body stretches."""
    stretch = stretch_by_direction(vertices, garment.faces, wanted)
    if max(stretch) > _MAX_STRETCH:
        fits = [share + max(over, 0.0) if share < 0.0 else share for share, over in zip(ease, stretch, strict=True)]
        raise InputError(
            "a garment smaller than the body",
            key="ease",
            received=list(ease),
            expected="about [{:.2f}, {:.2f}] or more, at which it lies on the body".format(*fits),
        )
