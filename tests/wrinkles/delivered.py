"""Two panels, sewn and bent, as a delivered mesh bound to a coarse one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pbd import Limits
from tests.assets.panels import two_panels
from tests.wrinkles.databases import small_database
from wrinkles.coarsening import bind
from wrinkles.database import WrinkleDatabase
from wrinkles.levels import Levels, build_levels
from wrinkles.surface import Subdivision

__all__ = ["NOBODY", "bent", "delivered_database", "delivered_levels", "delivered_panels"]

NOBODY = (np.zeros((0, 3)), np.zeros((0, 3), np.int32))
HEIGHT = 0.02


def delivered_panels() -> tuple[np.ndarray, np.ndarray, np.ndarray, Subdivision]:
    """Delivered vertices, their faces, coarse vertices, the subdivision between them."""
    vertices, faces, seams = two_panels(20, 20, 17)
    coarse, subdivision = bind(bent(vertices), faces, vertices[:, :2], seams, 60, 2)
    return bent(vertices), faces, coarse, subdivision


def delivered_levels(coarse: np.ndarray, subdivision: Subdivision) -> Levels:
    """Both meshes, held along one side."""
    held = np.flatnonzero(coarse[:, 0] < 0.02)
    return build_levels(coarse, subdivision.coarse_faces, held, *NOBODY, 2, binding=subdivision.binding)


def delivered_database(coarse: np.ndarray, subdivision: Subdivision, **changes: Any) -> WrinkleDatabase:
    """A delivered mesh with random weights, held nowhere, with fields replaced by ``changes``."""
    mapping = small_database().mapping
    place, region = (
        np.resize(mapping.place, (len(coarse), mapping.place.shape[1])),
        np.resize(mapping.region, len(coarse)),
    )
    fields = {
        "mapping": replace(mapping, place=place, region=region),
        "coarse_vertices": coarse,
        "coarse_faces": subdivision.coarse_faces,
        "binding": subdivision.binding,
        "held": np.zeros(0, np.int32),
        "limits": Limits.none(),
    }
    return small_database(**(fields | changes))


def bent(flat: np.ndarray) -> np.ndarray:
    """A gentle arch over the two panels, without stretch along it to first order."""
    return np.stack([flat[:, 0], flat[:, 1], HEIGHT * np.sin(np.pi * flat[:, 0] / 0.48)], axis=1)
