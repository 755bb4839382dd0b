"""The body that a garment is sewn on: a closed surface that stands still.

A body of many shells (head, clothes and eyes apart, jointed parts) is sewn on its outer surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from assets.facing import standing_frame
from assets.shells import count_shells, join_seams, open_share, outer_surface
from pbd.errors import InputError

__all__ = ["StandingBody", "closed_body"]

MAX_OPEN_SHARE = 0.02  # of a body's edges that may belong to one face only


@dataclass(frozen=True, eq=False)
class StandingBody:
    """A body as it stands.

    Attributes:
        name: for messages.
        vertices: [m], shape (n, 3), float64.
        faces: counter-clockwise from outside, int32, shape (m, 3).
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]


def closed_body(
    name: str, vertices: NDArray[np.float64], faces: NDArray[np.int32], file: str | Path | None = None
) -> StandingBody:
    """A body to sew on: the mesh as it is, or the outer surface of its shells.

    Args:
        name: for messages.
        vertices: [m], shape (n, 3).
        faces: shape (m, 3).
        file: that holds the mesh, for messages.

    Raises:
        InputError: the only shell is not closed, or the shells enclose nothing.
    """
    share = open_share(faces)
    if share > 0.0:  # along seams of its texture, perhaps
        vertices, faces = join_seams(vertices, faces)
        share = open_share(faces)
    if count_shells(faces) > 1:
        frame = standing_frame(vertices, faces)
        outside, faces = outer_surface(frame.local(vertices), faces)
        if not len(faces):
            raise InputError("a body that is not closed", file=file, expected="shells that enclose something")
        return StandingBody(name, frame.world(outside), faces)
    if share > MAX_OPEN_SHARE:
        received, expected = f"{100.0 * share:.1f} % of its edges are borders", f"at most {100.0 * MAX_OPEN_SHARE:g} %"
        raise InputError("a body that is not closed", file=file, received=received, expected=expected)
    return StandingBody(name, vertices, faces)
