"""A precompute of the built-in skirt that takes seconds: little motion, coarse substeps, few tries."""

from __future__ import annotations

from assets.io.scene import Scene, parse_scene
from precompute.learning.options import LearningOptions

__all__ = ["OPTIONS", "SCENE", "scene"]

SCENE = """
[[garment]]
name = "skirt"
mesh = "builtin:skirt"
attach = "top"
subdivisions = 1

[character]
file = "builtin:mannequin"
clip = "walk"

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
    compression_scales=(1.0,),
    shear_scales=(1.0, 0.1),
    bend_scales=(1.0, 30.0),
    calibration_s=1.0,
    settle_s=0.3,
    still_s=0.2,
    piece_s=0.1,
)


def scene(text: str = SCENE) -> Scene:
    return parse_scene(text, "miniature.toml")
