from __future__ import annotations

import numpy as np
import pytest

from pbd import ClothMesh
from tests.pbd.meshes import grid
from wrinkles.gathers import LEAST, gathered, gathers_of, no_gathers


@pytest.fixture
def sheet() -> ClothMesh:
    vertices, faces = grid(6, 5, 0.1)
    return ClothMesh.from_surface(vertices, faces, (1.0, 0.0, 0.0))


def lengths(mesh: ClothMesh) -> np.ndarray:
    """Of the sides of each flat face [m], shape (m, 3)."""
    one, two = mesh.flat[:, :, 0], mesh.flat[:, :, 1]
    return np.stack([np.linalg.norm(side, axis=1) for side in (one, two - one, two)], axis=1)


def sides(mesh: ClothMesh, positions: np.ndarray) -> np.ndarray:
    a, b, c = (positions[:, mesh.faces[:, corner]] for corner in range(3))
    return np.stack([np.linalg.norm(p - q, axis=2).mean(axis=0) for p, q in ((b, a), (c, b), (c, a))], axis=1)


def test_faces_become_as_narrow_as_they_are_on_average(sheet: ClothMesh) -> None:
    along = np.array([1.0, 1.0, 1.0])
    along[np.ptp(sheet.vertices, axis=0).argmax()] = 0.6  # gathered along one axis, by half of what is gathered
    positions = np.stack([sheet.vertices * along, sheet.vertices])
    gathers = gathers_of(sheet, positions)
    assert gathers.dtype == np.float32 and gathers.shape == (len(sheet.faces), 3)
    assert lengths(gathered(sheet, gathers)) == pytest.approx(sides(sheet, positions), rel=1e-5)
    # The sheet's warp stays the warp: what is left of a side that lies along an axis is told by that axis alone.
    assert gathers[:, 1] == pytest.approx(0.0, abs=0.05)
    assert sorted({round(float(v), 2) for v in gathers[:, [0, 2]].ravel()}) == [0.8, 1.0]


def test_stretched_cloth_keeps_its_rest_shape_and_crushed_cloth_some_of_it(sheet: ClothMesh) -> None:
    assert gathers_of(sheet, 1.3 * sheet.vertices[None]) == pytest.approx(no_gathers(len(sheet.faces)), abs=1e-6)
    crushed = gathered(sheet, gathers_of(sheet, 0.01 * sheet.vertices[None]))
    assert lengths(crushed) == pytest.approx(LEAST * lengths(sheet), rel=1e-5)


def test_without_gathers_nothing_changes(sheet: ClothMesh) -> None:
    assert np.array_equal(gathered(sheet, no_gathers(len(sheet.faces))).flat, sheet.flat)
