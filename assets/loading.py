"""Loads what a scene names: characters and their clips, garments, and bodies to sew on, from files or built in.

A package that only some files need is imported where it is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from assets.body_checks import check_right_side_out
from assets.character import CHARACTER_SUFFIXES, SEQUENCE_SUFFIXES, USD_SUFFIXES, Animation, Character
from assets.garment import Faces, Floats, Garment, StoredSurface, checked_garment
from assets.io.gltf import read_document
from assets.io.obj import read_obj
from assets.io.sequence import is_sequence, load_sequence
from assets.procedural.builtin import builtin_garment
from assets.procedural.mannequin import builtin_mannequin
from assets.sewing.body import StandingBody, closed_body
from assets.texture import joined
from assets.weld import check_unit
from pbd.errors import InputError

__all__ = ["load_animation", "load_character", "load_garment", "load_standing_body", "read_surface"]


def load_character(path: str | PathLike[str], name: str | None = None) -> Character:
    """A skinned character with all its clips from a glTF 2.0 or USD file, in metres, Y up.

    A glTF file (.glb or .gltf) is in metres and Y up; a USD file (.usd, .usda, .usdc, .usdz) names its unit and its up
    axis and is turned. All skinned meshes are merged. Vertices at one position with the same weights become one, so
    that texture seams close; parts that touch but move apart stay apart. Of more than four influences the best four
    stay. Morph targets (blend shapes) are part of the bind pose at the weights that the file gives; their animation and
    meshes without a skin are left out.

    Args:
        path: the file, or "builtin:mannequin" for the built-in character.
        name: name for messages; the file's name without its suffix if None.

    Raises:
        InputError: the file cannot be read, has no skin or no weights, holds values that are not finite, looks like
            centimetres, does not say its unit, is inside out, or asks for something that is not supported; the message
            names the element.
    """
    if str(path).startswith("builtin:"):
        if str(path) != "builtin:mannequin":
            raise InputError("no such built-in character", received=str(path), expected="builtin:mannequin")
        mannequin = builtin_mannequin()
        return mannequin if name is None else replace(mannequin, name=name)
    path = Path(path)
    if path.suffix.lower() in USD_SUFFIXES:
        from assets.io.usd_character import read_character  # needs usd-core, which building a character does not
    else:
        from assets.io.gltf_character import read_character
    character = read_character(path, name)
    check_right_side_out(character.vertices, character.faces, path)
    return character


def load_animation(path: str | PathLike[str], joint_names: Sequence[str]) -> Animation | None:
    """The animation in a glTF or USD file without a skinned mesh; None if it has such a mesh or no clip.

    Args:
        path: the file.
        joint_names: joints of the character that it is meant for.

    Raises:
        InputError: the file cannot be read or is damaged, or a USD file has not one skeleton.
    """
    path = Path(path)
    if path.suffix.lower() in USD_SUFFIXES:
        from assets.io.usd_character import read_animation as read_usd

        return read_usd(path)
    from assets.io.gltf_character import read_animation

    return read_animation(path, joint_names)


def load_garment(path: str | PathLike[str], *, pattern: bool = False) -> Garment:
    """Load, weld and check a garment from an .obj, .glb or .gltf file in metres, or a sewn one from its .npz file.

    Vertices at exactly the same position become one, so that seams of the texture close; the vertices of an .obj file
    with a pattern stay as they are, since its panels may touch before they are stitched. Polygons are cut into
    triangles, faces that are wound against their neighbours are turned, vertices that no face uses are dropped. The
    order of vertices and faces stays.

    Args:
        path: the file; or "builtin:skirt" for one of the built-in clothes
            (:data:`assets.garment.BUILTIN_GARMENTS`), which have a pattern of their own.
        pattern: whether the texture coordinates are a flat pattern in metres.

    Raises:
        InputError: the file cannot be read or is truncated; no faces; vertices that are not finite; a face with an
            index out of range, without area, or twice; an edge of more than two faces; a surface with one side only; a
            size that cannot be metres; or, with ``pattern``, texture coordinates that are missing or no pattern. The
            message names the vertex, the face (counted from 0, after triangulation) or the edge.
    """
    if str(path).startswith("builtin:"):
        return builtin_garment(str(path).removeprefix("builtin:"))
    path = Path(path)
    if path.suffix.lower() == ".npz":
        from assets.sewing.sewn_file import (
            read_sewn,  # loads much that a scene without clothes of its own does not need
        )

        return read_sewn(path).garment
    return checked_garment(read_surface(path), pattern=pattern)


def read_surface(path: Path) -> StoredSurface:
    """Read the surface of an .obj, .glb or .gltf file.

    Raises:
        InputError: another kind of file, one that cannot be read or is damaged, or one without faces.
    """
    if path.suffix.lower() == ".obj":
        mesh = read_obj(path)
        vertices, faces, texture, lines = mesh.vertices, mesh.faces, mesh.texture, mesh.lines
        label = lambda face: f"face {face} (line {lines[face]})"  # noqa: E731
    elif path.suffix.lower() in (".glb", ".gltf"):
        vertices, faces, texture = _read_gltf(path)
        label = lambda face: f"face {face}"  # noqa: E731
    else:
        raise InputError(
            "an unknown kind of file", file=path, received=path.suffix, expected=".obj, .glb, .gltf or .npz"
        )
    if not len(faces):
        received = f"{len(vertices)} vertices"
        raise InputError("a mesh without faces", file=path, received=received, expected="a whole file with faces")
    return StoredSurface(path, vertices, faces, texture, label)


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


def _read_gltf(path: Path) -> tuple[Floats, Faces, Floats | None]:
    """All triangles of the scene in world space, with their texture coordinates; see :class:`StoredSurface`."""
    document = read_document(path)
    vertices, faces, texture = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int32)], []
    for node in document.mesh_nodes():
        matrix = document.world_matrix(node)
        for primitive in document.primitives(node):
            placed, corners, coordinates = primitive.placed(matrix)
            faces.append(corners + sum(map(len, vertices)))
            vertices.append(placed)
            texture.append((coordinates, len(corners)))
    return np.concatenate(vertices), np.concatenate(faces), joined(texture)
