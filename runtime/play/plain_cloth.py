"""The garment of a wrinkle database as plain cloth: a finer mesh is simulated, and no learned wrinkles are added."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pbd import InputError, Model, ModelOptions
from runtime.play.simulation import BodySource
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import Levels, held_between, levels_of
from wrinkles.surface import Subdivision

__all__ = ["PlainCloth", "middle_levels", "plain_choice", "plain_model"]


class PlainCloth(NamedTuple):
    """A way to play a garment as plain cloth.

    Attributes:
        cuts: how often the database's coarse mesh is subdivided before it is simulated: 0 for the coarse mesh, the
            database's ``subdivisions`` for the fine one.
        substeps: in a tick.
        passes: of relaxation of the fine mesh for what is shown; 0 shows the smooth surface.
    """

    cuts: int
    substeps: int
    passes: int = 0

    def check(self, database: WrinkleDatabase) -> None:
        """Refuse what a database cannot be played as.

        Raises:
            InputError: see above.
        """
        most = database.subdivisions
        possible = self.passes == 0 if self.cuts == most else self.passes >= 0
        if not (0 <= self.cuts <= most and self.substeps >= 1 and possible):
            expected = f"0 to {most} cuts, at least 1 substep, no passes where the fine mesh is simulated"
            raise InputError("no such plain cloth", key="cloth", received=tuple(self), expected=expected)


def plain_choice(database: WrinkleDatabase) -> PlainCloth | None:
    """The plain cloth that a comparison found cheaper than the wrinkles and as good; None if there is none."""
    quality = database.quality
    if quality.get("cost_advantage", np.inf) >= 1.0 or quality["cost_advantage_is_at_least"]:
        return None
    for cuts in range(database.subdivisions + 1):
        if _vertex_count(database, cuts) == quality["plain_vertex_count"]:
            return PlainCloth(cuts, int(quality["plain_substeps"]), int(quality["plain_passes"]))
    return None  # of another mesh, as files of earlier versions may name it


def _vertex_count(database: WrinkleDatabase, cuts: int) -> int:
    coarse = len(database.coarse_vertices)
    return Subdivision.of(database.coarse_faces, coarse, cuts).fine_count if cuts else coarse


def middle_levels(database: WrinkleDatabase, source: BodySource, cuts: int = 1) -> Levels | None:
    """Levels from the coarse mesh subdivided ``cuts`` times to the fine mesh, whose numbering is the same.

    The middle mesh has the fine one's side lengths, as the coarse mesh has. None where so many subdivisions make the
    fine mesh already.
    """
    if database.subdivisions <= cuts:
        return None
    one = Subdivision.of(database.coarse_faces, len(database.coarse_vertices), cuts)
    # Points of the smooth surface, so that the smooth surface through them is the same.
    plain = replace(database, binding=None)
    vertices = plain.subdivision.upsample(database.coarse_vertices)[: one.fine_count]
    held = held_between(one, database.held)
    limits = database.limits.between(one.matrix)
    sewn = None if database.sewn is None else database.sewn.subdivided(cuts)
    body = (source.vertices, source.faces)
    left = database.subdivisions - cuts
    layers = database.layers
    if layers is not None:
        layers = layers.subdivided(one)
    return levels_of(
        vertices,
        one.faces,
        held,
        *body,
        left,
        database.warp,
        binding=database.binding,
        limits=limits,
        sewn=sewn,
        layers=layers,
    )


def plain_model(database: WrinkleDatabase, levels: Levels) -> Model:
    """The garment of the fabric itself, uncalibrated, on the coarse mesh of some levels.

    Args:
        database: gives fabric and pressure.
        levels: of the database, or its middle levels.
    """
    return levels.model(database.fabric, ModelOptions(pressure=database.options.pressure))
