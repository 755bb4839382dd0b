"""How the built-in garments of the mannequin are made: drafted for it, cut, sewn and draped.

``make garments`` (``python -m assets.procedural.builtin_sewing``) writes their files anew, in a minute or two. Playing
only reads them (see :mod:`assets.procedural.builtin`).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from assets.anthropometry import measure
from assets.patterns.drafts import draft
from assets.procedural.mannequin import DATA, builtin_mannequin
from assets.sewing.body import closed_body
from assets.sewing.sewing import sew
from assets.sewing.sewn_file import write_sewn
from assets.sewing.sewn_garment import SewnGarment

__all__ = ["CUTS", "BuiltinCut", "sewn_builtin", "write_garments"]


class BuiltinCut(NamedTuple):
    """How a built-in garment is cut.

    Attributes:
        draft: name of the draft.
        parameters: of the draft, besides its defaults.
        fabric: that it is draped in.
        edge_length: of its triangles [m]: long, for it is the coarse mesh of a garment with wrinkles.
    """

    draft: str
    parameters: Mapping[str, float]
    fabric: str
    edge_length: float


CUTS: Mapping[str, BuiltinCut] = {
    # The skirt of demo and tests: about as many vertices as a frame of a game can pay for.
    "skirt": BuiltinCut("circle_skirt", {"circle": 0.4}, "wool", 0.04),
    "circle_skirt": BuiltinCut("circle_skirt", {}, "wool", 0.035),
    "tshirt": BuiltinCut("tshirt", {}, "jersey", 0.03),
    "shirt": BuiltinCut("shirt", {}, "cotton", 0.03),
    "trousers": BuiltinCut("trousers", {}, "cotton", 0.03),
}
"""The built-in garments that are sewn, by name."""


def sewn_builtin(name: str) -> SewnGarment:
    """A built-in garment, sewn anew on the mannequin.

    Raises:
        KeyError: no such garment is sewn.
        SewingError: it does not come out whole.
    """
    cut, mannequin = CUTS[name], builtin_mannequin()
    body = closed_body(mannequin.name, mannequin.vertices, mannequin.faces)
    pattern = draft(cut.draft, measure(body), **cut.parameters)
    return sew(pattern, body, cut.fabric, edge_length=cut.edge_length)


def write_garments(folder: Path = DATA) -> None:
    """Sew all built-in garments and write their files."""
    for name in CUTS:
        write_sewn(folder / f"{name}.npz", sewn_builtin(name))


if __name__ == "__main__":
    write_garments()
