"""A garment at two levels of detail with one rest metric: what the solver moves and what is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pbd import ClothMesh, InputError
from pbd.attachment import Attachment, push_outside
from wrinkles.surface import Subdivision

__all__ = ["Levels", "build_levels"]

CLEARANCE = 0.003  # attached vertices start at least 2 mm outside the body; the smooth surface dips a little between them


@dataclass(frozen=True)
class Levels:
    """Coarse and fine mesh of one garment.

    Attributes:
        subdivision: between them.
        coarse, fine: cloth meshes in the bind pose; areas agree to 0.5 %.
        coarse_held, fine_held: attached vertices, int, shapes (p,), (P,).
        coarse_attachment, fine_attachment: how they ride on the body.
    """

    subdivision: Subdivision
    coarse: ClothMesh
    fine: ClothMesh
    coarse_held: np.ndarray
    fine_held: np.ndarray
    coarse_attachment: Attachment
    fine_attachment: Attachment


def build_levels(
    vertices: np.ndarray,
    faces: np.ndarray,
    held: np.ndarray,
    body_vertices: np.ndarray,
    body_faces: np.ndarray,
    levels: int = 2,
) -> Levels:
    """Refine a garment, move it out of the body's bind pose and attach it.

    Args:
        vertices: of the garment [m], shape (n, 3).
        faces: int, shape (m, 3).
        held: coarse vertices attached to the body, int, shape (p,).
        body_vertices: bind pose [m], shape (b, 3).
        body_faces: int, shape (k, 3).
        levels: times that each coarse face is cut in four.

    Raises:
        InputError: fewer than one level, or meshes whose areas do not agree to 0.5 %.
    """
    if not 0 <= levels <= 4:
        raise InputError("bad number of subdivisions", key="subdivisions", received=levels, expected="0..4")
    subdivision = Subdivision.of(faces, len(vertices), levels)
    vertices = np.array(vertices, float)
    if len(body_faces):
        # What shows inside is the fine surface: push it out and fit the coarse vertices to it, twice.
        for _ in range(2):
            outside = push_outside(subdivision.upsample(vertices), body_vertices, body_faces, CLEARANCE)
            vertices = subdivision.filter_down(outside)
        vertices = push_outside(vertices, body_vertices, body_faces, CLEARANCE)
    coarse, fine = subdivision.meshes(vertices)
    ratio = coarse.face_areas.sum() / fine.face_areas.sum()
    if abs(ratio - 1.0) > 0.005:
        raise InputError(
            "coarse and fine mesh differ in area", key="subdivisions", received=float(ratio), expected="1 within 0.5 %"
        )
    held = np.unique(np.asarray(held, np.int64))  # the order in which a model takes its targets
    fine_held = _between(subdivision, held)
    fine_start = fine.vertices[fine_held]
    return Levels(
        subdivision,
        coarse,
        fine,
        held,
        fine_held,
        Attachment.bind(coarse.vertices[held], body_vertices, body_faces),
        Attachment.bind(fine_start, body_vertices, body_faces),
    )


def _between(subdivision: Subdivision, held: np.ndarray) -> np.ndarray:
    """Fine vertices on coarse edges and faces whose corners are all held."""
    mark = np.zeros(subdivision.coarse_count)
    mark[held] = 1.0
    for step in subdivision.steps:
        new = step[len(mark) :]
        # Weights of both ends are the large ones (3/8 or 1/2); corners opposite carry 1/8.
        ends = new.copy()
        ends.data = (ends.data > 0.2).astype(float)
        mark = np.concatenate([mark, (ends @ mark == 2.0).astype(float)])
    return np.flatnonzero(mark)
