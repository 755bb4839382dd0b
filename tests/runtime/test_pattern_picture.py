"""The flat picture of a pattern shows its cloth, its seams in pairs and its bands."""

from __future__ import annotations

import numpy as np
import pytest

from assets.patterns.pattern import Band, EdgeName
from runtime.draw.pattern_picture import draw_pattern
from tests.assets.patterns.shapes import pattern, tube

BLUE, ORANGE = (31, 119, 180), (255, 127, 14)  # of the first two seams
CLOTH, STRIP = (239, 233, 220), (209, 199, 174)


def pixels(picture: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Row and column of each pixel of a color, shape (k, 2)."""
    return np.argwhere(np.abs(picture.astype(int) - color).max(axis=2) < 6)


def test_both_sides_of_a_seam_have_one_color() -> None:
    sewn = tube()
    picture, bare = draw_pattern(sewn), draw_pattern(pattern(*sewn.panels))
    assert picture.dtype == np.uint8 and picture.shape[1:] == (1800, 3)
    for color in (BLUE, ORANGE):
        assert len(pixels(bare, color)) == 0
        assert np.ptp(pixels(picture, color), axis=0).max() > 0.5 * min(picture.shape[:2])  # on both panels


def test_a_band_is_a_strip_to_scale() -> None:
    sewn = tube()
    area = 0.5 * 0.4 + 0.5 * 0.48 + np.pi * 0.25 * 0.1 / 2.0
    per_area = len(pixels(draw_pattern(pattern(*sewn.panels)), CLOTH)) / area
    banded = draw_pattern(pattern(*sewn.panels, bands=(Band(EdgeName("front", 2), 0.1),)))
    assert len(pixels(banded, STRIP)) / per_area == pytest.approx(0.5 * 0.1, rel=0.05)
