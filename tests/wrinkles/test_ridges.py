"""Run of folds: 1 for waves of one direction, little for bumps."""

from __future__ import annotations

import numpy as np
import pytest

from pbd import ClothMesh
from tests.wrinkles.meshes import turned
from wrinkles.ridges import RADII, RidgeCoherence

LENGTH, HEIGHT = 0.03, 0.002  # of a wave [m]


@pytest.fixture(scope="module")
def sheet() -> ClothMesh:
    """A square of 0.3 m with vertices 5 mm apart."""
    side = np.linspace(0.0, 0.3, 61)
    x, y = (part.ravel() for part in np.meshgrid(side, side))
    corner = (np.arange(60)[:, None] * 61 + np.arange(60)).ravel()
    below, above = (np.stack([corner, corner + a, corner + b], axis=1) for a, b in ((1, 62), (62, 61)))
    return ClothMesh.from_surface(np.stack([x, y, np.zeros_like(x)], axis=1), np.concatenate([below, above]))


def waved(sheet: ClothMesh, *directions: float) -> np.ndarray:
    """The sheet with waves along each direction [deg], in one frame."""
    vertices = np.array(sheet.vertices)
    for angle in np.radians(directions):
        along = vertices[:, 0] * np.cos(angle) + vertices[:, 1] * np.sin(angle)
        vertices[:, 2] += HEIGHT * np.sin(2.0 * np.pi * along / LENGTH)
    return vertices[None]


@pytest.mark.parametrize("direction", [0.0, 30.0, 45.0, 90.0])
def test_waves_of_any_direction_are_coherent(sheet: ClothMesh, direction: float) -> None:
    found = RidgeCoherence(sheet)(waved(sheet, direction))
    assert found.shape == (len(RADII),) and found.min() > 0.97


def test_bumps_are_not(sheet: ClothMesh) -> None:
    ridges, bumps = RidgeCoherence(sheet), waved(sheet, 20.0, 110.0)
    assert ridges(bumps).max() < 0.3
    assert ridges(turned(bumps, 70.0, axis=1)) == pytest.approx(ridges(bumps), rel=1e-6)
    mixed = np.concatenate([bumps, waved(sheet, 20.0)])
    assert ridges(bumps).max() < ridges(mixed).min() < 0.9
