"""Crossings of a cloth with itself: known cases, and the sorted search against every pair."""

import numpy as np
import pytest

from pbd.crossings import FaceGrid, crossings
from pbd.mesh import edges_of
from tests.pbd.meshes import grid, turn


def cross(start: np.ndarray, end: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether segment k goes through triangle k: bool, shape (k,)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    volume = lambda p, q, r, s: np.einsum("ki,ki->k", np.cross(q - p, r - p), s - p)  # noqa: E731
    sides = volume(a, b, c, start) * volume(a, b, c, end) < 0
    around = np.stack([volume(start, end, p, q) for p, q in ((a, b), (b, c), (c, a))])
    return sides & ((around > 0).all(axis=0) | (around < 0).all(axis=0))


TRIANGLE = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])


@pytest.mark.parametrize(
    ("start", "end", "through"),
    [
        ([0.2, 0.2, -1.0], [0.3, 0.2, 1.0], True),
        ([0.2, 0.2, 1.0], [0.3, 0.2, -1.0], True),
        ([0.2, 0.2, 0.1], [0.3, 0.2, 1.0], False),  # on one side
        ([0.8, 0.8, -1.0], [0.8, 0.8, 1.0], False),  # beside
        ([-0.1, 0.2, 0.0], [0.5, 0.2, 0.0], False),  # in the plane
        ([0.2, 0.2, 0.0], [0.2, 0.2, 1.0], False),  # ends on it
    ],
)
def test_a_segment_goes_through_a_triangle_or_not(start: list, end: list, through: bool) -> None:
    assert cross(np.array([start]), np.array([end]), TRIANGLE).tolist() == [through]
    aside = np.add(end, [3.0, 0.1, 0.2])  # the segment is a side of a face
    rows = crossings(np.concatenate([TRIANGLE[0], [start, end, aside]]), np.array([[0, 1, 2], [3, 4, 5]]))
    assert ([3, 4, 0] in rows.tolist()) == through


def brute_force(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    edges, _ = edges_of(faces)
    edge, face = (part.ravel() for part in np.meshgrid(np.arange(len(edges)), np.arange(len(faces)), indexing="ij"))
    apart = ~(edges[edge][:, :, None] == faces[face][:, None, :]).any(axis=(1, 2))
    edge, face = edge[apart], face[apart]
    ends = vertices[edges[edge]]
    through = cross(ends[:, 0], ends[:, 1], vertices[faces[face]])
    return np.concatenate([edges[edge[through]], face[through, None]], axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_the_search_finds_what_brute_force_finds(seed: int) -> None:
    random = np.random.default_rng(seed)
    vertices, faces = grid(7, 6, 0.1)
    crumpled = vertices @ turn((1.0, 2.0, 3.0), 40.0).T + random.normal(0.0, 0.1, vertices.shape)
    found = crossings(crumpled, faces)
    assert len(found) > 20
    assert np.array_equal(found, brute_force(crumpled, faces))
    edges, side_edge = edges_of(faces)
    number = {tuple(edge): n for n, edge in enumerate(edges.tolist())}
    through = [number[tuple(row)] for row in found[:, :2].tolist()]
    expected = set(found[:, 2]) | {face for face, sides in enumerate(side_edge) if set(sides) & set(through)}
    assert set(FaceGrid(faces).crossing_faces(found)) == expected


def test_a_flat_sheet_crosses_nothing_and_two_through_each_other_do() -> None:
    vertices, faces = grid(4, 4, 0.1)
    assert crossings(vertices, faces).shape == (0, 3)
    other = (vertices - [0.2, 0.2, 0.0]) @ turn((1.0, 0.1, 0.0), 80.0).T + [0.21, 0.17, 0.0]
    assert len(crossings(np.concatenate([vertices, other]), np.concatenate([faces, faces + len(vertices)]))) > 4
