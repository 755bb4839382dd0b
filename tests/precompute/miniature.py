"""A precompute of the built-in skirt that takes seconds: little motion, coarse substeps, few tries."""

from __future__ import annotations

import numpy as np

from assets.io.scene import Scene, parse_scene
from precompute.learning.options import LearningOptions
from tests.runtime.players import WORN
from wrinkles.database import WrinkleDatabase

__all__ = ["OPTIONS", "SCENE", "same", "same_learned", "scene"]

TIMED = ("_ms", "us_per_fine_vertex", "speedup_over_fine")

SCENE = f"""{WORN}
[training]
procedural_seconds = 2.0
substep = 0.00416667

[[training.held_out]]
file = "builtin:mannequin"
clip = "walk"
end = 1.2

[solver]
substep = 0.00416667

[wrinkles]
atoms = 6
hidden_width = 8
seed = 4
"""
OPTIONS = LearningOptions(
    epochs=6,
    most_epochs=6,
    still_s=0.2,
    piece_s=0.1,
)


def scene(text: str = SCENE) -> Scene:
    return parse_scene(text, "miniature.toml")


def same_learned(found: WrinkleDatabase, expected: WrinkleDatabase) -> None:
    """All that was learned, bit by bit."""
    for part in ("mapping", "atoms", "novelty", "rest_shape"):
        for name, array in vars(getattr(expected, part)).items():
            assert np.array_equal(array, getattr(getattr(found, part), name)), f"{part}.{name}"
    assert found.options == expected.options and found.bend_factor == expected.bend_factor


def same(found: WrinkleDatabase, expected: WrinkleDatabase) -> None:
    """All that was learned and measured, but times."""
    same_learned(found, expected)
    assert set(found.quality) == set(expected.quality)
    for name, value in expected.quality.items():
        assert any(part in name for part in TIMED) or found.quality[name] == value, name
