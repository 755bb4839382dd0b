"""Edges of the middle mesh keep their lengths."""

from __future__ import annotations

import numpy as np
import pytest

from tests.pbd.meshes import grid
from tests.wrinkles.delivered import delivered_levels, delivered_panels
from wrinkles.charts import Charts
from wrinkles.edge_lengths import PASSES, EdgeLengthProjection, middle_edges
from wrinkles.fine_surface import FineSurface
from wrinkles.levels import Levels, build_levels
from wrinkles.patches import Patches

NOBODY = np.zeros((0, 3)), np.zeros((0, 3), np.int32)


def sheet(held: tuple = (), subdivisions: int = 2) -> Levels:
    vertices, faces = grid(9, 9, 0.04, "equilateral")
    return build_levels(vertices, faces, np.array(held, int), *NOBODY, subdivisions)


def shares(levels: Levels, middle: np.ndarray) -> np.ndarray:
    """Lengths of the middle mesh's edges over their rest lengths."""
    edges, lengths = middle_edges(levels)
    return np.linalg.norm(middle[edges[:, 1]] - middle[edges[:, 0]], axis=1) / lengths


def keep_lengths(levels: Levels, middle: np.ndarray, passes: int = PASSES) -> np.ndarray:
    """Correct middle vertices in place, without wrinkles; the fine ones that follow [m], shape (N, 3)."""
    subdivision = levels.subdivision
    patches = Patches.of(subdivision, Charts.of(levels.coarse))
    fine = np.zeros((subdivision.fine_count, 3), np.float32)
    surface = FineSurface(subdivision, patches, np.zeros_like(fine), EdgeLengthProjection(levels))
    frames = np.zeros((subdivision.coarse_count, 9), np.float32)
    surface(np.insert(middle, 3, 0.0, axis=1), None, frames, fine, passes)
    if subdivision.binding is None:
        middle[:] = surface.middle[:, :3]
    return fine


def relaxed(levels: Levels) -> np.ndarray:
    """Middle vertices of the garment at rest, after so many passes that nothing moves any more."""
    middle = levels.fine.vertices[: levels.subdivision.middle.fine_count].astype(np.float32)
    keep_lengths(levels, middle, 500)
    return middle


def test_rest_lengths_are_those_along_the_fine_surface() -> None:
    levels = sheet()
    edges, lengths = middle_edges(levels)
    first, count = levels.fine.vertices, levels.subdivision.middle.fine_count
    between = first[count : count + len(edges)]  # fine vertices are numbered by the edges that they halve
    ways = sum(np.linalg.norm(first[edges[:, end]] - between, axis=1) for end in (0, 1))
    share = lengths / ways
    assert np.median(np.abs(share - 1.0)) < 1e-3 and np.abs(share - 1.0).max() < 0.02


@pytest.mark.parametrize("subdivisions", [1, 3])
def test_other_numbers_of_subdivisions_have_a_middle_mesh_too(subdivisions: int) -> None:
    levels = sheet(subdivisions=subdivisions)
    assert len(middle_edges(levels)[1]) == len(middle_edges(sheet())[1])
    assert np.abs(shares(levels, relaxed(levels)) - 1.0).max() < 0.01


def test_what_is_as_long_as_it_should_be_stays() -> None:
    levels = sheet()
    middle = relaxed(levels)
    moved = middle.copy()
    keep_lengths(levels, moved)
    assert np.abs(moved - middle).max() < 2e-5


def test_faint_folds_of_pushed_cloth_grow_and_its_length_comes_back() -> None:
    levels = sheet()
    middle = relaxed(levels)
    across = middle[:, 0] - middle[:, 0].min()
    height = 0.002 * np.sin(2.0 * np.pi * across / 0.12)
    middle[:, 0] *= 0.98
    middle[:, 2] += height.astype(np.float32)
    grown = middle.copy()
    keep_lengths(levels, grown, 30)
    before, after = (shares(levels, m).mean() for m in (middle, grown))
    assert before < 0.995 and 1.0 - after < 0.7 * (1.0 - before)
    fold = lambda m: (m[:, 2] * height).sum() / (height**2).sum()  # noqa: E731
    assert fold(middle) == pytest.approx(1.0, abs=1e-3) and fold(grown) > 1.2


def test_held_vertices_stay_and_stretched_cloth_comes_back() -> None:
    held = tuple(range(9))
    levels = sheet(held)
    start = levels.fine.vertices[: levels.subdivision.middle.fine_count].astype(np.float32)
    middle = start * np.float32(1.05)
    moved = middle.copy()
    keep_lengths(levels, moved)
    assert np.array_equal(moved[list(held)], middle[list(held)])
    assert np.median(np.abs(shares(levels, moved) - 1.0)) < 0.7 * 0.05


def test_more_passes_come_nearer() -> None:
    levels = sheet()
    rng = np.random.default_rng(0)
    middle = levels.fine.vertices[: levels.subdivision.middle.fine_count]
    middle = (middle + 0.002 * rng.standard_normal(middle.shape)).astype(np.float32)
    errors = []
    for passes in (0, 2, 8):
        moved = middle.copy()
        keep_lengths(levels, moved, passes)
        errors.append(np.abs(shares(levels, moved) - 1.0).mean())
    assert errors[0] > 2.0 * errors[1] and errors[1] > 2.0 * errors[2]


def test_the_fine_mesh_follows_by_the_rule_of_subdivision() -> None:
    levels = sheet()
    rng = np.random.default_rng(1)
    before = levels.fine.vertices[: levels.subdivision.middle.fine_count].astype(np.float32)
    before += (0.002 * rng.standard_normal(before.shape)).astype(np.float32)
    middle = before.copy()
    fine = keep_lengths(levels, middle)
    assert np.abs(middle - before).max() > 1e-4
    np.testing.assert_allclose(fine, levels.subdivision.from_middle @ middle, atol=2e-7)


def test_lengths_of_a_delivered_mesh_are_left_as_they_are() -> None:
    levels = delivered_levels(*delivered_panels()[2:])
    middle = 1.1 * (levels.subdivision.to_middle @ levels.coarse.vertices).astype(np.float32)
    np.testing.assert_allclose(keep_lengths(levels, middle), levels.subdivision.from_middle @ middle, atol=2e-7)
