"""Surfaces from fields, and even triangles on them."""

import numpy as np
import pytest

from assets.implicit import (
    ellipsoid,
    field_gradient,
    project,
    smooth_max,
    smooth_min,
    surface_mesh,
    tapered_tube,
)
from assets.remesh import drop_vertices, even_mesh, flip_edges
from pbd.mesh import edges_of

CENTRE = np.array([0.02, -0.01, 0.03])
LOW, HIGH = np.full(3, -0.16), np.full(3, 0.2)


def sphere(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points - CENTRE, axis=1) - 0.1


def ring(points: np.ndarray) -> np.ndarray:
    return np.hypot(np.hypot(points[:, 0], points[:, 2]) - 0.09, points[:, 1]) - 0.03


def check_closed(faces: np.ndarray, count: int, handles: int) -> None:
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(np.unique(sides, axis=0)) == len(sides)
    assert np.array_equal(np.unique(sides, axis=0), np.unique(sides[:, ::-1], axis=0))
    assert count - len(sides) // 2 + len(faces) == 2 - 2 * handles


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)


def least_angles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    p = vertices[faces]
    u, v = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(u, v), axis=2), (u * v).sum(axis=2))).min(axis=1)


@pytest.mark.parametrize(("field", "handles", "exact"), [(sphere, 0, 4.18879e-3), (ring, 1, 1.59887e-3)])
def test_a_field_becomes_a_closed_mesh_that_looks_outwards(field, handles: int, exact: float) -> None:
    vertices, faces = surface_mesh(field, LOW, HIGH, 0.012)
    check_closed(faces, len(vertices), handles)
    assert np.abs(field(vertices)).max() < 1e-4
    assert volume(vertices, faces) == pytest.approx(exact, rel=0.03)


@pytest.mark.parametrize(("field", "handles"), [(sphere, 0), (ring, 1)])
def test_triangles_become_nearly_equilateral(field, handles: int) -> None:
    fine, fine_faces = surface_mesh(field, LOW, HIGH, 0.009)
    vertices, faces = even_mesh(field, fine, fine_faces, 400)
    check_closed(faces, len(vertices), handles)
    assert 340 <= len(vertices) <= 400
    assert np.abs(field(vertices)).max() < 1e-5
    angles = least_angles(vertices, faces)
    assert angles.min() > 25.0 and np.median(angles) > 45.0
    edges = edges_of(faces)[0]
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    assert lengths.max() < 1.6 * lengths.mean() and lengths.min() > 0.5 * lengths.mean()


def test_anchors_stay_and_are_all_of_the_boundary() -> None:
    fine, faces = surface_mesh(sphere, LOW, HIGH, 0.009)
    faces = faces[(fine[faces][:, :, 1] > 0.0).all(axis=1)]
    used = np.unique(faces)
    fine, faces = fine[used], np.searchsorted(used, faces).astype(np.int32)
    edges, face_edges = edges_of(faces)
    rim = edges[np.bincount(face_edges.ravel()) == 1]
    bearing = np.arctan2(*(fine[np.unique(rim)] - CENTRE)[:, [0, 2]].T)
    anchors = np.unique(rim)[np.argsort(bearing)][:: len(np.unique(rim)) // 24]
    vertices, even = even_mesh(sphere, fine, faces, 260, anchors)
    assert np.array_equal(vertices[: len(anchors)], fine[anchors])
    edges, face_edges = edges_of(even)
    assert np.array_equal(np.unique(edges[np.bincount(face_edges.ravel()) == 1]), np.arange(len(anchors)))
    assert len(vertices) - len(edges) + len(even) == 1  # a disc


def test_a_long_diagonal_is_flipped() -> None:
    i, j = (part.ravel() for part in np.meshgrid(np.arange(5), np.arange(5), indexing="ij"))
    lattice = np.stack([i + 0.5 * j, np.sqrt(0.75) * j, 0.0 * i], axis=1)  # equilateral, as even meshes are
    a = (5 * i + j)[(i < 4) & (j < 4)]
    even = np.concatenate([np.stack([a, a + 5, a + 1], axis=1), np.stack([a + 5, a + 6, a + 1], axis=1)])
    uneven = even.copy()
    uneven[5], uneven[16 + 5] = (6, 11, 12), (6, 12, 7)  # one rhombus cut the long way
    assert {tuple(np.roll(face, -face.argmin())) for face in flip_edges(lattice, uneven)} == {
        tuple(np.roll(face, -face.argmin())) for face in even
    }
    assert np.array_equal(flip_edges(lattice, even), even)


def test_a_diagonal_stays_where_its_ends_have_no_neighbour_to_lose() -> None:
    kite = np.array([[0.0, 0.0, 0.0], [1.0, -0.2, 0.0], [2.0, 0.0, 0.0], [1.0, 0.2, 0.0]])
    long = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    assert np.array_equal(flip_edges(kite, long), long)


def test_a_poor_vertex_is_dropped() -> None:
    outer = np.array([[np.cos(t), np.sin(t), 0.0] for t in np.linspace(0.0, 2.0 * np.pi, 5)[:-1]])
    fan = np.array([[4, 0, 1], [4, 1, 2], [4, 2, 3], [4, 3, 0]], dtype=np.int32)
    vertices, faces = drop_vertices(np.vstack([outer, [[0.1, 0.2, 0.0]]]), fan)
    assert len(vertices) == 4 and len(faces) == 2
    assert volume(vertices + [0.0, 0.0, 1.0], faces) == pytest.approx(2.0 / 3.0)  # the square, wound as before


def test_blends_and_shapes_are_near_distances() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.2, 0.2, (200, 3))
    a, b = points[:, 0], points[:, 1]
    joined = smooth_min(a, b, 0.05)
    assert (joined <= np.minimum(a, b)).all() and (joined >= np.minimum(a, b) - 0.05 / 4.0 - 1e-12).all()
    far = np.abs(a - b) > 0.05
    assert np.array_equal(joined[far], np.minimum(a, b)[far])
    assert smooth_max(a, b, 0.05) == pytest.approx(-smooth_min(-a, -b, 0.05))
    axes = np.array([0.1, 0.06, 0.08])
    for field in (
        lambda p: ellipsoid(p, CENTRE, axes),
        lambda p: tapered_tube(p, CENTRE, CENTRE + [0.1, 0.05, 0.0], [(0.0, 0.05), (0.4, 0.06), (1.0, 0.03)]),
    ):
        surface = project(field, CENTRE + 0.09 * (points / np.linalg.norm(points, axis=1, keepdims=True)), 8)
        assert np.abs(field(surface)).max() < 1e-6
        gradient = field_gradient(field, surface)
        assert field(surface + 0.002 * gradient) == pytest.approx(0.002 * (gradient**2).sum(axis=1), rel=0.1)
