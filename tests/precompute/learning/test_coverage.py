from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from pbd import InputError
from precompute.learning.coverage import evenly, greedily
from precompute.learning.pipeline import training_motions
from precompute.learning.training import Layer, build_layer
from runtime.garment_setup import GarmentSetup
from tests.precompute.miniature import SCENE, scene

CLIPS = """
[[training.clips]]
file = "builtin:mannequin"
clip = "sway"

[[training.clips]]
file = "builtin:mannequin"
clip = "sway"
speed = 2.0

[[training.held_out]]
"""
OFFERED = SCENE.replace("procedural_seconds = 2.0", "procedural_seconds = 9.0\nchoose_s = 6.0").replace(
    "[[training.held_out]]\n", CLIPS
)


@pytest.fixture(scope="module")
def stage() -> GarmentSetup:
    return GarmentSetup.of(scene(OFFERED))


@pytest.fixture(scope="module")
def layer(stage: GarmentSetup) -> Layer:
    return build_layer(stage.levels)


def distances(asking: np.ndarray, parts: list[np.ndarray]) -> np.ndarray:
    return np.stack([np.abs(asking[:, None] - part).min(axis=1) for part in parts], axis=1)


def test_what_adds_most_for_its_cost_is_taken_first() -> None:
    asking = np.array([0.0, 0.1, 0.2, 10.0, 10.1, 30.0])
    parts = [np.array([0.1]), np.array([0.0, 0.2]), np.array([10.0]), np.array([30.0]), np.array([0.1, 10.0])]
    far, alone = distances(asking, parts), np.full(6, 20.0)
    one = np.ones(5)
    assert greedily(far, alone, one, 1.0).tolist() == [4]  # near five of six
    # 30 is far from all that was taken; what is near zero adds little beside the last part.
    assert greedily(far, alone, one, 2.0).tolist() == [3, 4]
    assert greedily(far, alone, np.array([1.0, 1.0, 1.0, 1.0, 4.0]), 1.0).tolist() == [1]
    assert greedily(far, alone, np.array([1.0, 1.0, 1.0, 9.0, 4.0]), 2.5).tolist() == [1, 2]  # never above the budget
    assert greedily(far, alone, one, 5.0).tolist() == [0, 1, 2, 3, 4]
    assert greedily(far, alone, one, 0.5).tolist() == []


def test_greed_comes_near_to_the_best_choice() -> None:
    """A facility location is submodular: greed has at least 1 - 1/e of the best gain (Nemhauser et al. 1978)."""
    rng = np.random.default_rng(0)
    for _ in range(10):
        asking = rng.standard_normal((60, 2))
        far = np.linalg.norm(asking[:, None] - rng.standard_normal((9, 2)), axis=2)
        alone = np.full(60, 3.0)
        gain = lambda some, far=far: np.maximum(3.0 - far[:, some].min(axis=1), 0.0).mean()  # noqa: E731
        best = max(gain(list(some)) for some in combinations(range(9), 3))
        assert gain(greedily(far, alone, np.ones(9), 3.0)) >= (1.0 - 1.0 / np.e) * best


def test_even_parts_are_spread_over_all_within_the_budget() -> None:
    assert evenly(np.ones(9), 3.0).tolist() == [1, 4, 7]
    assert evenly(np.ones(4), 9.0).tolist() == [0, 1, 2, 3]
    assert evenly(np.array([1.0, 9.0, 1.0]), 5.0).tolist() == [0, 2]
    assert evenly(np.array([9.0, 9.0]), 5.0).tolist() == []
    assert evenly(np.array([2.0, 1.0, 2.0, 1.0]), 2.5).tolist() == [1, 3]


def test_motions_are_cut_into_parts_with_a_blend_each(stage: GarmentSetup) -> None:
    parts = stage.training_parts(4.0)
    names = ["sway 0-4 s", "sway 4-8 s", "sway x 2", "exploration_4 0-4.5 s", "exploration_4 4.5-9 s"]
    assert [part.name for part in parts] == names
    assert [part.duration for part in parts] == pytest.approx([5.0, 5.0, 5.0, 4.5, 5.5], abs=0.02)
    whole = stage.training_motions()
    for part, motion, blend, start in (
        (parts[1], whole[0], 1.0, 5.0),
        (parts[2], whole[1], 1.0, 1.0),
        (parts[3], whole[2], 0.0, 0.0),
        (parts[4], whole[2], 1.0, 4.5),
    ):
        for t in (0.02, 1.3, 3.2):
            np.testing.assert_allclose(part.pose(blend + t), motion.pose(start + t), atol=2e-2)


def test_the_parts_that_add_most_are_learned_from(stage: GarmentSetup, layer: Layer, tmp_path: Path) -> None:
    told: list[str] = []
    motions, figures = training_motions(layer, stage, stage.scene, tmp_path, 1, told.append)
    again, _ = training_motions(layer, stage, stage.scene, tmp_path, 1)
    names = [part.name for part in stage.training_parts(4.0)]
    chosen = [motion.name for motion in motions]
    assert chosen == [motion.name for motion in again] == [name for name in names if name in chosen]
    assert 0 < len(chosen) < len(names) and "walk" not in chosen
    assert 0.0 < figures["chosen_s"] <= 6.0 and figures["chosen_s"] < figures["offered_s"]
    assert 0.3 < figures["coverage"] <= 1.0 and 0.3 < figures["coverage_even"] <= 1.0
    assert told[-1].startswith("choosing motion: ") and told[-1].endswith("s on offer")


@pytest.mark.parametrize("seconds", ["3.0", "200.0"])
def test_a_budget_that_leaves_no_choice_is_refused(
    stage: GarmentSetup, layer: Layer, tmp_path: Path, seconds: str
) -> None:
    changed = scene(OFFERED.replace("choose_s = 6.0", f"choose_s = {seconds}"))
    with pytest.raises(
        InputError, match=rf"training\.choose_s: nothing to choose.*received {seconds}.*at least 4\.5.*25"
    ):
        training_motions(layer, GarmentSetup.of(changed), changed, tmp_path, 1)
    assert not list(tmp_path.iterdir())
