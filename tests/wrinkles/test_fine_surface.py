"""Fine vertices in one pass against products of matrices."""

from __future__ import annotations

import numpy as np
import pytest

from tests.pbd.meshes import grid
from tests.wrinkles.fine_surfaces import patch_sums
from wrinkles.charts import Charts
from wrinkles.fine_surface import FineSurface
from wrinkles.levels import Levels, build_levels
from wrinkles.patches import Patches
from wrinkles.vertex_mean import turned

NOBODY = np.zeros((0, 3)), np.zeros((0, 3), np.int32)


class Sheet:
    """A sheet with random patches and means."""

    def __init__(self, subdivisions: int) -> None:
        vertices, faces = grid(9, 9, 0.04, "equilateral")
        self.levels: Levels = build_levels(vertices, faces, np.arange(9), *NOBODY, subdivisions)
        self.subdivision = self.levels.subdivision
        self.patches = Patches.of(self.subdivision, Charts.of(self.levels.coarse))
        rng, count = np.random.default_rng(0), len(vertices)
        self.mean = (0.002 * rng.standard_normal((self.subdivision.fine_count, 3))).astype(np.float32)
        self.grids = (0.005 * rng.standard_normal((count, 3 * self.patches.grid.nodes))).astype(np.float32)
        self.frames = np.linalg.qr(rng.standard_normal((count, 3, 3)))[0].reshape(count, 9).astype(np.float32)
        smooth = self.subdivision.to_middle @ (vertices + 0.002 * rng.standard_normal(vertices.shape))
        self.smooth = np.insert(smooth, 3, 7.0, axis=1).astype(np.float32)  # nothing is to be read in the last column
        self.surface = FineSurface(self.subdivision, self.patches, self.mean)

    def make(self, grids: np.ndarray | None) -> np.ndarray:
        fine = np.full((self.subdivision.fine_count, 3), np.nan, np.float32)
        self.surface(self.smooth, grids, self.frames, fine)
        return fine


@pytest.mark.parametrize("subdivisions", [1, 2, 3])
def test_one_pass_is_the_sum_of_all_that_it_stands_for(subdivisions: int) -> None:
    """Smooth surface, patches and mean."""
    sheet = Sheet(subdivisions)
    fine = sheet.make(sheet.grids)
    smooth = sheet.smooth[:, :3].astype(float)
    added = patch_sums(sheet.patches, sheet.grids, sheet.frames)
    mean = turned(sheet.patches.turning, sheet.frames, sheet.mean)
    expected = sheet.subdivision.from_middle @ smooth + added + mean
    np.testing.assert_allclose(fine, expected, atol=5e-7)


def test_nothing_but_the_smooth_surface_where_nothing_is_drawn() -> None:
    sheet = Sheet(2)
    expected = sheet.subdivision.from_middle @ sheet.smooth[:, :3].astype(float)
    np.testing.assert_allclose(sheet.make(None), expected, atol=2e-7)
