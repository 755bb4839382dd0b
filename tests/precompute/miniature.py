"""A precompute of the built-in skirt that takes seconds: little motion, coarse substeps, few tries."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

from assets.io.scene import Scene, parse_scene
from precompute.learning import calibration, evaluation, in_time, pipeline, recording
from precompute.wrinkle_comparison import ablation_experiment, wrinkle_baselines, wrinkle_comparison
from runtime.simulation import poses_of

__all__ = ["SCENE", "miniature", "scene"]

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

[[training.held_out]]
file = "builtin:mannequin"
clip = "walk"

[solver]
substep = 0.00416667

[wrinkles]
atoms = 6
hidden_width = 8
seed = 4
"""
HELD_OUT_SECONDS = 1.5


def scene(text: str = SCENE) -> Scene:
    return parse_scene(text, "miniature.toml")


@contextmanager
def miniature() -> Iterator[None]:
    """Constants of the pipeline made small."""
    short = lambda motion, dt: poses_of(motion, dt, 2.0 if "exploration" in motion.name else HELD_OUT_SECONDS)  # noqa: E731
    with ExitStack() as stack:
        for module, name, value in (
            (pipeline, "EPOCHS", 6),
            (pipeline, "MOST_EPOCHS", 6),
            (pipeline, "CALIBRATION_SECONDS", 1.0),
            (pipeline, "GAINS", (1.0, 1.25)),  # so little is learned that more only raises noise
            (calibration, "SETTLE", 0.3),
            (calibration, "SQUEEZE", (1.0,)),
            (calibration, "SHEAR", (1.0, 0.1)),
            (calibration, "BEND", (1.0, 30.0)),
            (evaluation, "SETTLE", 0.9),
            (evaluation, "poses_of", short),
            (recording, "CHUNK_SECONDS", 0.5),
            (ablation_experiment, "EPOCHS", 2),
            (wrinkle_comparison, "RADII", (0.25,)),
            (in_time, "STILL", 0.2),
            (in_time, "PIECE", 0.1),
            (wrinkle_baselines, "WIDE", (12, 8)),
            (wrinkle_baselines, "MODES", 32),
        ):
            stack.enter_context(patch.object(module, name, value))
        yield
