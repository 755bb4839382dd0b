"""The body that a garment is sewn on: a closed surface that stands still.

A body of many shells (head, clothes and eyes apart, jointed parts) is sewn on its outer surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from assets.body_checks import check_right_side_out
from assets.character import CHARACTER_SUFFIXES, SEQUENCE_SUFFIXES, load_character
from assets.facing import standing_frame
from assets.io.obj import read_obj
from assets.io.sequence import is_sequence, load_sequence
from assets.shells import count_shells, join_seams, open_share, outer_surface
from assets.weld import check_unit
from pbd.errors import InputError

__all__ = ["StandingBody", "closed_body", "load_standing_body"]

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


def load_standing_body(path: str | Path) -> StandingBody:
    """Load a body to sew on.

    Args:
        path: a character (glTF, USD) in its bind pose, "builtin:mannequin", the first frame of a vertex sequence
            (.npz, .mdd, USD), or a closed surface (.obj). Of several shells, the outer surface is meshed anew.

    Raises:
        InputError: the file cannot be read, its only shell is not closed or inside out, or its shells enclose nothing.
    """
    suffix = Path(path).suffix.lower()
    sequence = suffix in SEQUENCE_SUFFIXES and is_sequence(path)
    if str(path).startswith("builtin:") or suffix in CHARACTER_SUFFIXES and not sequence:
        character = load_character(path)
        vertices, faces, name = character.vertices, character.faces, character.name
    elif sequence:
        loaded = load_sequence(path)
        vertices, faces, name = loaded.vertices[0].astype(float), loaded.faces, loaded.name
    elif suffix == ".obj":
        mesh = read_obj(Path(path))
        if not len(mesh.faces):
            raise InputError("a body without faces", file=path, received=f"{len(mesh.vertices)} vertices")
        check_unit(mesh.vertices, Path(path))
        check_right_side_out(mesh.vertices, mesh.faces, Path(path))
        vertices, faces, name = mesh.vertices, mesh.faces, Path(path).stem
    else:
        expected = f"{', '.join(dict.fromkeys([*CHARACTER_SUFFIXES, *SEQUENCE_SUFFIXES]))}, .obj or builtin:mannequin"
        raise InputError("an unknown kind of body", file=path, received=suffix, expected=expected)
    return closed_body(name, vertices, faces, path)


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
