"""The body as it is drawn: without the faces that a garment always covers, which could only show through it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.character import Character
from assets.io.sequence import Sequence

__all__ = ["shown_body", "visible_faces"]


def visible_faces(faces: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Faces of a body that are drawn.

    Args:
        faces: of the whole body, int, shape (k, 3).
        covered: numbers of those that are not drawn, see :attr:`runtime.player.Player.covered_faces`, int, shape (c,).
    """
    return np.delete(faces, covered, axis=0)


def shown_body(body: Character | Sequence, covered: np.ndarray) -> Character | Sequence:
    """The body with its :func:`visible_faces` alone; nothing collides with it."""
    return replace(body, faces=visible_faces(body.faces, covered))
