from __future__ import annotations

import numpy as np
import pytest

from precompute.wrinkle_comparison.wrinkle_meshes import WrinkleMesh, WrinkleMeshOptions
from tests.runtime.players import skirt_stage
from wrinkles.levels import build_levels

STAGE = skirt_stage()
# The skirt with its mesh as the rest shape; a sewn one is stretched a little where it hangs.
LEVELS = build_levels(
    STAGE.garment.vertices, STAGE.garment.faces, STAGE.levels.coarse_held, STAGE.body.vertices, STAGE.body.faces, 1
)
EDGES, LENGTHS = LEVELS.fine.edge_lengths()
EDGE = float(LENGTHS.mean())


def pressed() -> np.ndarray:
    """The skirt 5 % too short, a little crumpled: flat cloth would not know which way to fold."""
    rng = np.random.default_rng(0)
    vertices = LEVELS.fine.vertices * (1.0, 0.95, 1.0) + 0.02 * EDGE * rng.standard_normal(LEVELS.fine.vertices.shape)
    vertices[LEVELS.fine_held] = LEVELS.fine.vertices[LEVELS.fine_held] * (1.0, 0.95, 1.0)
    return vertices.astype(np.float32)


def off(vertices: np.ndarray) -> float:
    """Mean error of the edges, relative."""
    sides = np.linalg.norm(np.subtract(*vertices[EDGES.T]), axis=1)
    return float(np.abs(sides / LENGTHS - 1.0).mean())


def test_edges_get_their_lengths_back_by_folding() -> None:
    smooth = pressed()
    folded, settled = smooth.copy(), WrinkleMesh(LEVELS, WrinkleMeshOptions(radius=1.0, bending=0.1, iterations=10))
    settled(folded)
    assert off(folded) < 0.75 * off(smooth)
    again = smooth.copy()
    settled(again)  # goes on from the last frame
    assert off(again) < 0.95 * off(folded)


@pytest.mark.parametrize("radius", [0.02, 0.1])
def test_no_vertex_leaves_its_radius_and_held_ones_stay(radius: float) -> None:
    smooth = pressed()
    folded = smooth.copy()
    WrinkleMesh(LEVELS, WrinkleMeshOptions(radius=radius))(folded)
    away = np.linalg.norm(folded - smooth, axis=1)
    assert 0.99 * radius * EDGE < away.max() < 1.001 * radius * EDGE
    assert np.all(away[LEVELS.fine_held] == 0.0)


def test_cloth_at_rest_stays_at_rest() -> None:
    rest = LEVELS.fine.vertices.astype(np.float32)
    settled = rest.copy()
    WrinkleMesh(LEVELS, WrinkleMeshOptions())(settled)
    assert np.abs(settled - rest).max() < 1e-5
