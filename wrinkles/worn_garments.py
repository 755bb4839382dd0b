"""Some garments of an outfit alone: what is left of its database when others are taken off."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from assets.texture import joined
from pbd import InputError
from pbd.mesh import hinges_of
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import Layers
from wrinkles.rest_shape import RestShapeCorrection
from wrinkles.surface import SewnRest

__all__ = ["garment_names", "with_garments"]


def garment_names(database: WrinkleDatabase) -> tuple[str, ...]:
    """Names of the garments of a database, from the innermost outwards."""
    return (database.garment_name,) if database.layers is None else database.layers.names


def with_garments(database: WrinkleDatabase, names: Iterable[str]) -> WrinkleDatabase:
    """A database of some garments of an outfit, without figures: they were measured with all garments on.

    The vertices that are left keep their order, on the coarse mesh and on the fine one.

    Args:
        database: of an outfit, or of one garment.
        names: of :func:`garment_names`, in any order.

    Raises:
        InputError: no garment, or one that the database does not have.
    """
    wanted, known = set(names), garment_names(database)
    if not wanted or not wanted <= set(known):
        expected = "at least one of " + ", ".join(known)
        raise InputError("no such garments", key="garments", received=sorted(wanted), expected=expected)
    layers = database.layers
    if layers is None or wanted == set(known):
        return database
    numbers = [number for number, name in enumerate(known) if name in wanted]
    fabrics = [(database.fabric, *layers.fabrics)[number] for number in numbers]
    vertices = np.isin(layers.layer, numbers)
    faces = vertices[database.coarse_faces[:, 0]]
    own_number = np.cumsum(vertices, dtype=np.int32) - 1
    hinges = vertices[hinges_of(database.coarse_faces)[:, 0]]
    fine = np.isin(layers.subdivided(database.subdivision).layer, numbers)
    left = Layers(
        tuple(known[number] for number in numbers),
        tuple(fabrics[1:]),
        np.searchsorted(numbers, layers.layer[vertices]).astype(np.int32),
        own_number[layers.fastened[vertices[layers.fastened]]],
    )
    mapping, sewn = database.mapping, database.sewn
    return replace(
        database,
        garment_name=" + ".join(left.names),
        coarse_vertices=database.coarse_vertices[vertices],
        coarse_faces=own_number[database.coarse_faces[faces]],
        rest_shape=RestShapeCorrection(database.rest_shape.stretch[faces], database.rest_shape.bends[hinges]),
        held=own_number[database.held[vertices[database.held]]],
        limits=database.limits.part(np.flatnonzero(vertices)),
        sewn=None if sewn is None else SewnRest(sewn.pattern[faces], sewn.layers[faces], sewn.max_stretch[faces]),
        layers=left if len(numbers) > 1 else None,
        fabric_name=database.fabric_name if numbers[0] == 0 else "own",
        fabric=fabrics[0],
        atoms=replace(database.atoms, vertex_mean=database.atoms.vertex_mean[fine]),
        mapping=replace(mapping, place=mapping.place[vertices], region=mapping.region[vertices]),
        quality={},
        texture=None if database.texture is None else joined([(database.texture[faces], int(faces.sum()))]),
    )
