"""Temporal sharpening of a coarse garment: by closed forms on a flat sheet with a fold."""

import numpy as np
import pytest

from tests.pbd.meshes import grid
from wrinkles.levels import Levels, build_levels
from wrinkles.temporal_sharpening import LIMIT, SHARPNESS, TIME, TemporalSharpening

HEIGHT = 0.002  # of folds [m]
DT = 1.0 / 60.0
HELD = np.arange(40)


@pytest.fixture(scope="module")
def sheet() -> Levels:
    """A flat sheet in the x-y plane, held at its first row of vertices."""
    return build_levels(*grid(40, 40, 0.05, "equilateral"), HELD, np.zeros((0, 3)), np.zeros((0, 3), np.int32), 1)


@pytest.fixture
def sharpen(sheet: Levels) -> TemporalSharpening:
    return TemporalSharpening(sheet)


def state(levels: Levels, waves: float = 2.0, height: float = 0.0) -> np.ndarray:
    """The sheet with a fold of so many cut-offs: positions as in a state, and the fourth column not zero."""
    position = np.ones((levels.subdivision.coarse_count, 4), np.float32)
    position[:, :3] = levels.coarse.vertices
    position[:, 2] += height * np.sin(2.0 * np.pi / (waves * levels.cutoff) * levels.coarse.vertices[:, 0] + 0.3)
    return position


def raised(levels: Levels, shown: np.ndarray, position: np.ndarray, waves: float) -> float:
    """Height of what was added, over that of the fold, away from the rim."""
    place = levels.coarse.vertices
    fold = np.sin(2.0 * np.pi / (waves * levels.cutoff) * place[:, 0] + 0.3)
    middle = np.exp(-(((place - place.mean(axis=0)) / 0.25) ** 2).sum(axis=1))
    return float((middle * (shown - position)[:, 2] * fold).sum() / (middle * fold**2).sum() / HEIGHT)


@pytest.mark.parametrize("waves", [2.0, 3.0, 4.0])
def test_a_fold_that_comes_up_is_raised_by_the_square_of_the_cutoff_over_its_wavelength(
    sheet: Levels, sharpen: TemporalSharpening, waves: float
) -> None:
    sharpen.begin(state(sheet))
    folded = state(sheet, waves, HEIGHT)
    sharpen.follow(folded, DT)
    wanted = np.exp(-DT / TIME) * SHARPNESS * waves**-2.0
    assert raised(sheet, sharpen(folded), folded, waves) == pytest.approx(wanted, rel=0.1)
    sharpen.follow(folded, 3.0 * TIME)
    assert raised(sheet, sharpen(folded), folded, waves) == pytest.approx(np.exp(-3.0) * wanted, rel=0.1)


def test_two_short_steps_are_as_one_long_one(sheet: Levels) -> None:
    shown = []
    for steps in (1, 2):
        sharpen, folded = TemporalSharpening(sheet), state(sheet, 1.5, HEIGHT)
        sharpen.begin(state(sheet))
        for _ in range(steps):
            sharpen.follow(folded, DT / steps)
        shown.append(sharpen(folded).copy())
    np.testing.assert_allclose(shown[0], shown[1], atol=1e-7)


def test_a_fold_that_stays_or_moves_as_a_whole_is_shown_as_it_is(sheet: Levels, sharpen: TemporalSharpening) -> None:
    folded = state(sheet, 1.5, HEIGHT)
    sharpen.begin(folded)
    sharpen.follow(folded, DT)
    np.testing.assert_allclose(sharpen(folded), folded, atol=1e-7)
    turned = folded.copy()
    turned[:, :3] = folded[:, [1, 2, 0]] + np.float32([0.3, -0.2, 0.5])
    sharpen.follow(turned, DT)
    np.testing.assert_allclose(sharpen(turned), turned, atol=2e-6)


def test_held_vertices_stay_and_no_vertex_goes_far(sheet: Levels, sharpen: TemporalSharpening) -> None:
    sharpen.begin(state(sheet))
    wild = state(sheet)
    wild[:, :3] += np.random.default_rng(0).normal(0.0, 0.05, (len(wild), 3)).astype(np.float32)
    sharpen.follow(wild, DT)
    added = (sharpen(wild) - wild)[:, :3]
    assert np.array_equal(added[HELD], np.zeros((len(HELD), 3)))
    assert np.linalg.norm(added, axis=1).max() < 1.001 * SHARPNESS * LIMIT * sheet.cutoff
    assert np.linalg.norm(added, axis=1).max() > 0.5 * SHARPNESS * LIMIT * sheet.cutoff


def test_between_two_steps_it_is_interpolated_and_its_memory_brings_it_back(
    sheet: Levels, sharpen: TemporalSharpening
) -> None:
    flat, folded = state(sheet), state(sheet, 1.5, HEIGHT)
    sharpen.begin(flat)
    sharpen.follow(folded, DT)
    memory, whole = sharpen.memory, sharpen(folded) - folded
    assert np.abs(whole).max() > 1e-4
    np.testing.assert_allclose(sharpen(folded, 0.25) - folded, 0.25 * whole, atol=1e-7)
    assert np.array_equal(sharpen(flat, 0.0), flat)
    sharpen.follow(flat, DT)
    np.testing.assert_allclose(sharpen(folded, 0.0) - folded, whole, atol=1e-7)
    sharpen.memory = memory
    assert np.array_equal(sharpen(folded) - folded, whole)
