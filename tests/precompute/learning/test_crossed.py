"""How much recorded cloth goes through itself: known shares, what does not count, and the words that tell of it."""

from dataclasses import replace

import numpy as np
import pytest

from pbd.crossings import SelfCrossings
from precompute.learning.crossed import crossed_figures, crossed_jobs, crossed_words, joined_crossed
from tests.pbd.meshes import cloth, grid


def two_triangles(**more: np.ndarray) -> tuple[np.ndarray, SelfCrossings]:
    """A triangle, one that stands in it, and one far away."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -0.5], [0.2, 0.2, 0.5], [0.3, 0.25, 0.5]], float)
    vertices = np.concatenate([vertices, vertices[:3] + 5.0])
    faces = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    return vertices, SelfCrossings(replace(cloth(vertices, faces), **more))


def test_faces_that_cross_are_those_crossed_and_those_beside_the_edge() -> None:
    vertices, crossings = two_triangles()
    rows = crossings.find(vertices)
    assert {tuple(row) for row in rows} == {(3, 4, 0), (3, 5, 0)}
    assert crossings.faces_of(rows).tolist() == [0, 1]


def test_stitched_faces_and_short_edges_do_not_count() -> None:
    sewn = {"stitches": np.array([[3, 0, 1]], np.int32), "stitch_weights": np.array([0.2])}
    vertices, crossings = two_triangles(**sewn)
    assert not len(crossings.find(vertices))
    small = vertices * 1e-4  # all edges of the standing triangle are about 0.1 mm long
    _, crossings = two_triangles()
    mesh = cloth(small, np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]]))
    assert not len(SelfCrossings(mesh).find(small))


@pytest.mark.parametrize("outfit", [False, True])
def test_figures_of_frames(outfit: bool) -> None:
    flat, faces = grid(5, 5, 0.1)
    count = len(flat)
    other = flat[:, [0, 2, 1]] + [0.013, 0.21, -0.17]  # stands in the first
    mesh = cloth(np.concatenate([flat, flat + [0.0, 0.0, 1.0]]), np.concatenate([faces, faces + count]))
    layer = np.repeat([0, 1], count).astype(np.int32) if outfit else None
    frames = np.array([mesh.vertices] * 99 + [np.concatenate([flat, other])], np.float32)
    shares = joined_crossed([job() for job in crossed_jobs(mesh, layer, frames)])
    assert shares.shape == (100, 2) and (shares[:99] == 0.0).all() and shares[99, 0] > 10.0
    figures = crossed_figures(shares, outfit)
    assert figures["self_crossed_percent"] == pytest.approx(shares[99, 0] / 100)
    assert figures["self_crossed_worst_percent"] == shares[99, 0]
    assert ("crossed_layers_at_end_percent" in figures) == outfit
    if outfit:
        assert figures["crossed_layers_at_end_percent"] == shares[99, 1] > 5.0
    words = crossed_words("walk", np.arange(100) / 30.0, shares, 3.3).splitlines()
    assert "goes through itself in walk" in words[0] and "at 3.3 s" in words[0]
    assert words[1].startswith("1 of 100 frames of walk are left out") and len(words) == 2
    assert crossed_words("walk", np.arange(99) / 30.0, shares[:99], 98 / 30.0) == ""
    assert crossed_words("walk", np.arange(99) / 30.0, shares[:99], 5.0).startswith("walk ends at 3.3 of 5.0 s")
    assert crossed_words("walk", np.zeros(0), shares[:0], 5.0).startswith("walk ends at 0.0 of 5.0 s")
