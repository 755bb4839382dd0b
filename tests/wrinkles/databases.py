"""A small wrinkle database with random weights."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pbd import Fabric, Limits, SolverOptions
from tests.wrinkles.meshes import flat_sheet
from wrinkles.database import WrinkleDatabase
from wrinkles.dictionary import Atoms, CoefficientNetwork
from wrinkles.features import DYNAMIC_COUNT
from wrinkles.novelty import NoveltyScore
from wrinkles.patches import Grid
from wrinkles.rest_shape import RestShapeCorrection
from wrinkles.surface import Subdivision

__all__ = ["placed", "small_database"]


def placed(mapping: CoefficientNetwork, bias: np.ndarray) -> CoefficientNetwork:
    """The mapping on another garment, with a bias of the first layer at each vertex, shape (n, h1), in two regions."""
    count, width = bias.shape
    return replace(
        mapping,
        place=bias.astype(np.float32),
        place_weights=np.eye(width, dtype=np.float32),
        bias_1=np.zeros(width, np.float32),
        region=(np.arange(count) % 2).astype(np.int32),
    )


def small_database(side: int = 7, atoms: int = 5, hidden: tuple[int, int] = (8, 6), **changes: Any) -> WrinkleDatabase:
    """A sheet held along one side, with fields replaced by ``changes``."""
    rng = np.random.default_rng(5)
    vertices, faces = flat_sheet(side, 0.6)

    def weights(*shape: int) -> np.ndarray:
        return (0.01 * rng.standard_normal(shape)).astype(np.float32)

    shown, count = changes.get("coarse_faces", faces), len(changes.get("coarse_vertices", vertices))
    subdivisions = changes.get("subdivisions", 2)
    made = Subdivision.of(shown, count, subdivisions, changes.get("binding"))
    size = 3 * Grid.of(subdivisions).nodes
    fields: dict[str, Any] = {
        "garment_name": "curtain č",
        "coarse_vertices": vertices + np.array([0.1, 1.2, -0.3]),
        "coarse_faces": faces,
        "rest_shape": RestShapeCorrection.none(shown),
        "subdivisions": 2,
        "held": np.arange(side, dtype=np.int32),
        "limits": Limits([3, side + 2], [0.05, 1e6], [1e6, 0.01], [0.0, 300.0]),
        "warp": (0.0, 0.6, 0.8),
        "binding": None,
        "sewn": None,
        "layers": None,
        "fabric_name": "muslin",
        "fabric": Fabric(areal_density=0.1 + 1e-9, bend_weft=2.3e-6),
        "pressure": 0.0,
        "other_fabrics": {},
        "bend_factor": 1.0 / 3.0,
        "solver": SolverOptions(1.0 / 900.0, (0.0, -9.81, 0.1), local_damping=1.5, linear_inertia=0.5),
        "frame_rate": 60.0,
        "atoms": Atoms(weights(atoms, size), weights(size), 0.97, weights(made.fine_count, 3)),
        "mapping": CoefficientNetwork(
            center=weights(DYNAMIC_COUNT),
            scale=1.0 + weights(DYNAMIC_COUNT),
            weights_1=weights(DYNAMIC_COUNT, hidden[0]),
            place=weights(len(vertices), 5),
            region=(np.arange(len(vertices)) % 2).astype(np.int32),
            place_weights=weights(5, hidden[0]),
            bias_1=weights(hidden[0]),
            weights_2=weights(2, *hidden),
            weights_3=weights(2, hidden[1], atoms),
            bias_2=weights(2, hidden[1]),
            bias_3=weights(2, atoms),
        ),
        "novelty": NoveltyScore(weights(hidden[0], 3), weights(3), weights(3), 1.5, 12.0),
        "cutoff": 0.4,
        "body_hash": "a1" * 32,
        "body_vertex_count": 1234,
        "quality": {"normal_error_deg": 5.5, "normal_error_smooth_deg": 11.2, "bending_energy_ratio": 1.02},
        "held_out": ("run", "dance"),
        "trained_on": ("walk", "exploration 0"),
        "training_minutes": 12.5,
        "machine": "a processor",
        "seed": 3,
        "scene": '[[garment]]\nname = "curtain"\n\n',
        "code_version": "0.1.0+0123456789ab",
        "created": "2025-01-31",
    }
    return WrinkleDatabase(**(fields | changes))
