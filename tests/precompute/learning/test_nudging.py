from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pbd import Fabric, ModelOptions, SolverOptions
from precompute.learning.nudging import Corrected, Nudging, learn_correction
from precompute.learning.recording import Recording, Run, poses_of, record_runs
from precompute.learning.training import Layer, build_layer
from precompute.workers import Workers
from tests.runtime.players import skirt_database, skirt_stage
from wrinkles.coarse_filter import CoarseFilter

DT, SECONDS = 1.0 / 60.0, 2.5
PRESSURE = 0.5  # from inside [Pa]


def skirt_run(pressure: float = 0.0) -> Run:
    stage = skirt_stage()
    poses = poses_of(stage.motion(), DT, SECONDS)
    options, solver = ModelOptions(pressure=pressure), SolverOptions(substep=1.0 / 240.0)
    return Run("walk", stage.levels, False, stage.body, poses, DT, Fabric(), options, solver, bend_factor=0.4)


@cache
def layer() -> Layer:
    return build_layer(skirt_stage().levels)


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """The coarse skirt, filtered, where air pushes it outwards besides."""
    (recording,) = record_runs([skirt_run(PRESSURE)], tmp_path_factory.mktemp("cache"), 1)
    matrix = CoarseFilter(layer().levels).matrix
    return replace(recording, coarse=np.stack([matrix @ one for one in recording.coarse]).astype(np.float32))


def learned(motion: Nudging, strength: float = 0.3, workers: int = 1, seed: int = 0) -> tuple[Corrected, list[str]]:
    lines: list[str] = []
    with Workers.of(workers) as pool:
        mapping = skirt_database().mapping
        return learn_correction(layer(), mapping, [motion], [strength], pool, seed, lines.append), lines


def test_what_pushes_the_fine_garment_outwards_is_learned(truth: Recording) -> None:
    motion = Nudging.of(skirt_run(), truth)
    found, lines = learned(motion)
    assert found.correction is not None and found.without_mm > 10.0
    assert found.with_mm < 0.6 * found.without_mm
    assert len(lines) == 1 and f"{found.with_mm:.1f} mm" in lines[0]
    assert 1.0 < found.correction.most < 30.0
    assert 0.1 < found.force_percent < 50.0 and 0.0 < abs(found.power_w_kg) < 5.0
    again, _ = learned(motion, workers=2)
    for name, value in vars(found.correction).items():
        assert np.array_equal(value, getattr(again.correction, name)), name


def test_a_garment_that_goes_right_is_left_alone(truth: Recording) -> None:
    motion = Nudging.of(skirt_run(PRESSURE), truth)
    found, _ = learned(motion)
    assert found.correction is None and found.with_mm == found.without_mm < 2.0
    assert found.force_percent == found.power_w_kg == 0.0


def test_targets_lie_between_recorded_frames() -> None:
    target = np.array([[[0.0, 0.0, 0.0]], [[1.0, 0.0, 2.0]], [[3.0, 0.0, 2.0]]], np.float32)
    motion = Nudging(skirt_run(PRESSURE), np.array([4, 6, 8]), target)
    assert motion.at(3) is None and motion.at(9) is None
    found = [motion.at(tick) for tick in range(4, 9)]
    np.testing.assert_allclose(np.array(found)[:, 0], [[0, 0, 0], [0.5, 0, 1], [1, 0, 2], [2, 0, 2], [3, 0, 2]])
