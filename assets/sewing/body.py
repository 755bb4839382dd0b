"""The body that a garment is sewn on: a closed surface that stands still."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from assets.body_checks import check_right_side_out
from assets.character import CHARACTER_SUFFIXES, SEQUENCE_SUFFIXES, load_character
from assets.io.obj import read_obj
from assets.io.sequence import is_sequence, load_sequence
from assets.weld import check_unit, weld
from pbd.errors import InputError
from pbd.mesh import edges_of

__all__ = ["StandingBody", "load_standing_body"]

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
            (.npz, .mdd, USD), or a closed surface (.obj).

    Raises:
        InputError: the file cannot be read, or its surface is not closed or inside out.
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
        vertices, faces, _ = weld(mesh.vertices, mesh.faces)
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        check_right_side_out(vertices, faces, Path(path))
        name = Path(path).stem
    else:
        expected = f"{', '.join(dict.fromkeys([*CHARACTER_SUFFIXES, *SEQUENCE_SUFFIXES]))}, .obj or builtin:mannequin"
        raise InputError("an unknown kind of body", file=path, received=suffix, expected=expected)
    edges, side_edge = edges_of(faces)
    share = float(np.mean(np.bincount(side_edge.ravel(), minlength=len(edges)) != 2))
    if share > MAX_OPEN_SHARE:
        received, expected = f"{100.0 * share:.1f} % of its edges are borders", f"at most {100.0 * MAX_OPEN_SHARE:g} %"
        raise InputError("a body that is not closed", file=path, received=received, expected=expected)
    return StandingBody(name, vertices, faces)
