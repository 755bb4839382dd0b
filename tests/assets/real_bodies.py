"""Bodies of several makers, as their files hold them: closed ones and ones of many shells."""

from __future__ import annotations

from assets.io.obj import read_obj
from assets.io.sequence import load_sequence
from assets.loading import load_character
from assets.sewing.body import StandingBody
from tests.data import data_path

__all__ = ["BODIES", "SHELLS", "raw"]

BODIES = {
    "mannequin": "builtin:mannequin",
    "woman": "characters/mh_female_bandai_NC.glb",
    "heavy": "characters/mh_female_heavy.glb",
    "thin": "characters/mh_female_thin.glb",
    "scanned": "patterns/mean_all.obj",
    "quaternius": "characters/quaternius_mannequin_44clips.glb",
    "rumba": "sequences/cipc_body_rumba_dancing.npz",
    "arcsim": "characters/arcsim_female_dance_NC.glb",
}
SHELLS = ("quaternius", "rumba", "arcsim")  # bodies of many shells


def raw(name: str) -> StandingBody:
    """The mesh of a file, of as many shells as it has."""
    if name.endswith(".obj"):
        mesh = read_obj(data_path(name))
        return StandingBody(name, mesh.vertices, mesh.faces)
    if name.endswith(".npz"):
        sequence = load_sequence(data_path(name))
        return StandingBody(name, sequence.vertices[0].astype(float), sequence.faces)
    character = load_character(name if name.startswith("builtin") else data_path(name))
    return StandingBody(name, character.vertices, character.faces)
