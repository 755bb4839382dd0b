"""The filter of a freely running coarse garment."""

import numpy as np
import pytest

from assets.procedural.builtin import builtin_garment
from assets.procedural.mannequin import builtin_mannequin
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.levels import Levels, build_levels


@pytest.fixture(scope="module")
def levels() -> Levels:
    garment, body = builtin_garment("skirt"), builtin_mannequin()
    held = np.flatnonzero(garment.vertices[:, 1] > garment.vertices[:, 1].max() - 1e-6)
    return build_levels(garment.vertices, garment.faces, held, body.vertices, body.faces, 1)


def test_a_moved_garment_stays_as_it_is(levels: Levels) -> None:
    matrix = CoarseFilter(levels).matrix
    assert np.allclose(matrix @ np.ones(len(levels.coarse.vertices)), 1.0)


def test_held_vertices_keep_their_places(levels: Levels) -> None:
    matrix = CoarseFilter(levels).matrix
    moved = matrix @ levels.coarse.vertices
    assert np.array_equal(moved[levels.coarse_held], levels.coarse.vertices[levels.coarse_held])


def test_folds_at_the_mesh_limit_go_and_long_ones_stay(levels: Levels) -> None:
    matrix = CoarseFilter(levels).matrix
    noise = np.random.default_rng(0).standard_normal(len(levels.coarse.vertices))
    noise[levels.coarse_held] = 0.0
    inside = levels.coarse.vertices[:, 1] > levels.coarse.vertices[:, 1].min() + levels.cutoff / 2.0
    assert (matrix @ noise)[inside].std() < 0.6 * noise[inside].std()
    height = levels.coarse.vertices[:, 1]
    wave = np.sin(2.0 * np.pi * height / (3.0 * levels.cutoff))
    free = np.setdiff1d(np.arange(len(height)), levels.coarse_held)
    assert np.corrcoef((matrix @ wave)[free], wave[free])[0, 1] > 0.98


def test_the_kernel_agrees_with_the_matrix(levels: Levels) -> None:
    coarse_filter = CoarseFilter(levels)
    rng = np.random.default_rng(1)
    position = rng.standard_normal((len(levels.coarse.vertices), 4)).astype(np.float32)
    filtered = coarse_filter(position)
    assert np.allclose(filtered[:, :3], coarse_filter.matrix @ position[:, :3].astype(float), atol=1e-5)
    assert np.array_equal(filtered[:, 3], position[:, 3])
