"""Wrinkle databases with random weights for built-in garments on the mannequin."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from assets.io.scene import parse_scene, scene_text
from assets.procedural.builtin import builtin_garment
from pbd import SolverOptions
from runtime.setup.garment_mesh import texture_of
from runtime.setup.garment_setup import GarmentSetup
from tests.wrinkles.databases import placed, small_database
from wrinkles.database import WrinkleDatabase, body_hash
from wrinkles.rest_shape import RestShapeCorrection
from wrinkles.surface import Subdivision

__all__ = [
    "OUTFIT",
    "SCENE",
    "TROUSERS",
    "WORN",
    "outfit_database",
    "random_database",
    "skirt_database",
    "skirt_stage",
    "tube",
]

WORN = """
[[garment]]
name = "skirt"
mesh = "builtin:skirt"
attach = "top"
subdivisions = 1

[character]
file = "builtin:mannequin"
clip = "walk"
"""
SCENE = f"""{WORN}
[[training.clips]]
file = "builtin:mannequin"
clip = "sway"

[[training.held_out]]
file = "builtin:mannequin"
clip = "walk"
"""
TROUSERS = """
[[garment]]
name = "trousers"
mesh = "builtin:trousers"
fabric = "denim"
subdivisions = 1
"""
OUTFIT = TROUSERS + SCENE


@cache
def skirt_stage() -> GarmentSetup:
    return GarmentSetup.of(parse_scene(SCENE, "skirt.toml"))


@cache
def outfit_database() -> WrinkleDatabase:
    """A skirt over trousers."""
    return random_database(GarmentSetup.of(parse_scene(OUTFIT, "outfit.toml")))


def skirt_database(**changes: Any) -> WrinkleDatabase:
    """The skirt, with fields replaced by ``changes``."""
    return random_database(skirt_stage(), **changes)


def random_database(stage: GarmentSetup, **changes: Any) -> WrinkleDatabase:
    """The garments of a scene, with fields replaced by ``changes``."""
    coarse = stage.levels.coarse
    subdivisions = changes.get("subdivisions", stage.settings.subdivisions)
    database = small_database(subdivisions=subdivisions)
    rng = np.random.default_rng(1)
    place = 0.01 * rng.standard_normal((len(coarse.vertices), database.mapping.place_bias.shape[1]))
    fine_count = Subdivision.of(coarse.faces, len(coarse.vertices), subdivisions).fine_count
    vertex_mean = 0.001 * rng.standard_normal((fine_count, 3))
    fields: dict[str, Any] = {
        "garment_name": stage.name,
        "coarse_vertices": coarse.vertices,
        "coarse_faces": coarse.faces,
        "rest_shape": RestShapeCorrection.none(coarse.faces),
        "sewn": stage.levels.sewn,
        "layers": stage.levels.layers,
        "subdivisions": subdivisions,
        "limits": stage.levels.coarse_limits,
        "held": stage.levels.coarse_held.astype(np.int32),
        "warp": (0.0, 1.0, 0.0),
        "fabric": stage.settings.fabric,
        "solver": SolverOptions(self_collision=True),  # as scenes have it
        "atoms": replace(database.atoms, vertex_mean=vertex_mean.astype(np.float32)),
        "mapping": placed(database.mapping, place),
        "cutoff": stage.levels.cutoff,
        "body_hash": body_hash(stage.body),
        "body_vertex_count": len(stage.body.vertices),
        "held_out": ("walk",),
        "trained_on": ("sway",),
        "scene": scene_text(stage.scene),
        "texture": texture_of(stage.scene),
    }
    return replace(database, **(fields | changes))


def tube() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A short wide skirt of few vertices: vertices, faces and its upper ring."""
    skirt = builtin_garment("skirt").vertices
    top, around, rows = skirt[skirt[:, 1] > skirt[:, 1].max() - 0.01], 16, 4
    centre, radius = top.mean(axis=0), np.linalg.norm((top - top.mean(axis=0))[:, [0, 2]], axis=1).max()
    row, column = np.divmod(np.arange(rows * around), around)
    angle = 2.0 * np.pi * column / around
    wide = radius + 0.03 + 0.05 * row
    vertices = centre + np.stack([wide * np.sin(angle), -0.09 * row, wide * np.cos(angle)], axis=1)
    a = np.arange((rows - 1) * around)
    b = a - a % around + (a + 1) % around
    faces = np.concatenate([np.stack([a, a + around, b], axis=1), np.stack([b, a + around, b + around], axis=1)])
    return vertices, faces.astype(np.int32), np.arange(around)
