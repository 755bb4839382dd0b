from __future__ import annotations

import numpy as np
import pytest

from pbd.distance import BodyDistance, penetration_figures
from tests.data import data_path
from tests.refusals import refuses
from tests.wrinkles.meshes import icosphere

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
CUBE_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def segment_distance(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = np.clip(((points - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0.0, 1.0)
    return np.linalg.norm(points - a - along[..., None] * (b - a), axis=-1)


def brute_force(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance by all faces: over a face the height, elsewhere the nearest side. Sign by the winding number."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    p = points[:, None]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    inside = np.ones((len(points), len(faces)), bool)
    distance = np.full(inside.shape, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(normal, end - start) * (p - start)).sum(-1) >= 0
        distance = np.minimum(distance, segment_distance(p, start, end))
    distance = np.where(inside, np.abs(((p - a) * normal).sum(-1)), distance).min(axis=1)
    # Solid angles (van Oosterom and Strackee 1983).
    u, v, w = a - p, b - p, c - p
    lu, lv, lw = (np.linalg.norm(side, axis=-1) for side in (u, v, w))
    numerator = (u * np.cross(v, w)).sum(-1)
    denominator = lu * lv * lw + (u * v).sum(-1) * lw + (v * w).sum(-1) * lu + (w * u).sum(-1) * lv
    winding = np.arctan2(numerator, denominator).sum(axis=1) / (2 * np.pi)
    return np.where(np.abs(winding) > 0.5, -distance, distance)


def spiked(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A closed body with sharp spikes and dents, where the sign of a single face's normal misleads."""
    vertices, faces = icosphere(2)
    return vertices * np.random.default_rng(seed).uniform(0.25, 1.0, (len(vertices), 1)), faces


def test_equals_brute_force_on_a_spiked_body() -> None:
    vertices, faces = spiked(0)
    rng = np.random.default_rng(1)
    near = vertices[faces].mean(axis=1) + rng.normal(scale=0.02, size=(len(faces), 3))
    points = np.concatenate([rng.uniform(-1.2, 1.2, (500, 3)), near, 1.02 * vertices, 20 * rng.normal(size=(50, 3))])
    expected = brute_force(points, vertices, faces)
    assert (expected < 0).sum() > 100 and (expected > 0).sum() > 100
    assert np.allclose(BodyDistance(faces).signed_distance(points, vertices), expected, rtol=1e-12, atol=1e-14)


def test_follows_a_body_that_moves_far_from_where_its_tree_was_built() -> None:
    vertices, faces = spiked(0)
    body = BodyDistance(faces)
    points = np.random.default_rng(2).uniform(-1.5, 1.5, (400, 3))
    body.signed_distance(points, vertices)
    moved = spiked(7)[0][:, [1, 2, 0]] * [1.5, 0.8, 1.2]
    assert np.allclose(body.signed_distance(points, moved), brute_force(points, moved, faces), rtol=1e-12, atol=1e-14)
    # Where a point's search starts, at its last nearest face, has no part in the result.
    for others in (points[::-1], points[:50]):
        assert np.array_equal(body.signed_distance(others, moved), BodyDistance(faces).signed_distance(others, moved))


def test_sign_at_a_tip_does_not_hang_on_how_its_faces_are_cut() -> None:
    # A spike with one of its three sides cut into 30 slivers, which a plain mean of normals would follow.
    base = np.array([[1.0, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.8, 0]])
    cut = base[0] + np.linspace(0, 1, 31)[:, None] * (base[1] - base[0])
    vertices = np.concatenate([cut, base[2:], [[0.0, 0.0, 1.0]]])
    fan = np.stack([np.arange(30), np.arange(1, 31)], axis=1)
    sides = np.column_stack([fan, np.full(30, 32)])
    floor = np.column_stack([fan[:, ::-1], np.full(30, 31)])
    faces = np.concatenate([sides, floor, [[30, 31, 32], [31, 0, 32]]])
    points = vertices[32] + np.random.default_rng(0).uniform(-0.1, 0.1, (1000, 3))
    expected = brute_force(points, vertices, faces)
    assert np.allclose(BodyDistance(faces).signed_distance(points, vertices), expected, rtol=1e-12, atol=1e-14)


def test_every_side_of_a_single_triangle() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.3, 0.9, 0.2]])
    points = np.random.default_rng(0).uniform(-1, 2, (400, 3))
    for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):
        faces = np.array([order])
        distance = BodyDistance(faces).signed_distance(points, vertices)
        assert np.allclose(np.abs(distance), np.abs(brute_force(points, vertices, faces)), rtol=1e-12)


def test_cube_faces_edges_and_corners() -> None:
    points = np.array([[0.5, 0.997, 0.5], [0.4, 1.003, 0.3], [0.5, 1.3, 1.4], [-0.1, -0.2, -0.2], [0.5, 0.5, 0.5]])
    distance = BodyDistance(CUBE_FACES).signed_distance(points, CUBE)
    assert distance == pytest.approx([-0.003, 0.003, 0.5, 0.3, -0.5], abs=1e-14)


def test_points_on_the_surface_have_no_distance() -> None:
    points = np.concatenate([CUBE, [[0.5, 0.0, 0.0], [0.2, 0.3, 1.0]]])
    assert np.abs(BodyDistance(CUBE_FACES).signed_distance(points, CUBE)).max() < 1e-15


def test_known_depth_in_a_sphere() -> None:
    vertices, faces = icosphere(4, radius=0.1)
    directions = np.random.default_rng(0).normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # The body lies between the sphere and its own inscribed sphere.
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    gap = 0.1 - ((a * normal).sum(axis=1) / np.linalg.norm(normal, axis=1)).min()
    assert gap < 2e-4
    for depth in (-0.004, 0.003):
        distance = BodyDistance(faces).signed_distance((0.1 + depth) * directions, vertices)
        assert np.all((distance > depth - 1e-12) & (distance < depth + gap + 1e-12))


def test_slivers_and_doubled_corners_do_no_harm() -> None:
    # A cube's corner doubled: two faces without area.
    vertices = np.concatenate([CUBE, CUBE[:1]])
    faces = np.concatenate([CUBE_FACES, [[0, 8, 1], [8, 0, 4], [0, 8, 0]]])
    points = np.random.default_rng(0).uniform(-0.5, 1.5, (300, 3))
    expected = BodyDistance(CUBE_FACES).signed_distance(points, CUBE)
    assert np.allclose(np.abs(BodyDistance(faces).signed_distance(points, vertices)), np.abs(expected))


def test_penetration_figures() -> None:
    distances = np.array([[0.01, -0.002, -0.00004, 0.0], [0.01, 0.01, -0.005, -0.001]])
    room = np.array([[True, True, True, True], [True, True, False, True]])
    figures = penetration_figures(distances, room)
    assert figures == pytest.approx(
        {
            "inside_body_percent": 100 * 3 / 8,
            "deepest_mm": 5.0,
            "inside_body_with_room_percent": 100 * 2 / 8,
            "deepest_with_room_mm": 2.0,
        }
    )
    assert set(penetration_figures(np.full((2, 3), -0.00004), np.ones((2, 3), bool)).values()) == {0.0}


def test_between_two_walls_there_is_room_or_not() -> None:
    thickness = 0.003
    for gap, expected in ((0.02, True), (0.0065, True), (0.005, False), (0.001, False), (-0.004, False)):
        other = CUBE + [1.0 + gap, 0.0, 0.0]
        vertices, faces = np.concatenate([CUBE, other]), np.concatenate([CUBE_FACES, CUBE_FACES + 8])
        points = np.array([[0.999, 0.4, 0.6], [0.5, 0.998, 0.5], [0.5, 1.2, 0.5]])  # by the gap, by no gap, outside
        body = BodyDistance(faces)
        distances = body.signed_distance(points, vertices)
        assert list(distances < 0) == [True, True, False]
        assert list(body.leaves_room(points, distances, vertices, thickness)) == [expected, True, True]


def test_a_surface_winds_once_about_what_is_inside_and_twice_where_two_overlap() -> None:
    ball, faces = icosphere(3, 0.1)
    vertices = np.concatenate([ball, ball + [0.12, 0.0, 0.0]])
    both = BodyDistance(np.concatenate([faces, faces + len(ball)]))
    found = both.winding(np.array([[0.0, 0.0, 0.0], [0.06, 0.0, 0.0], [0.06, 0.2, 0.0]]), vertices)
    assert found == pytest.approx([1.0, 2.0, 0.0], abs=1e-6)
    assert len(both.winding(np.zeros((0, 3)), vertices)) == 0


def test_bad_input_is_refused() -> None:
    body = BodyDistance(CUBE_FACES)
    refuses(r"points\[1\]", body.signed_distance, np.array([[0.0, 0, 0], [np.nan, 0, 0]]), CUBE)
    refuses("body_vertices", body.signed_distance, np.zeros((1, 3)), CUBE[:7])
    refuses("faces", BodyDistance, np.zeros((0, 3), int))


@pytest.mark.parametrize(
    "garment, percent, depth", [("skirt_knee", 0.5, 1.5), ("skirt_long", 1.0, 2.1), ("tshirt_tight", 18.0, 9.5)]
)
def test_garments_that_start_inside_the_body(garment: str, percent: float, depth: float) -> None:
    """The published figures of these garments, measured by others."""

    def read(name: str) -> tuple[np.ndarray, np.ndarray]:
        lines = [line.split() for line in data_path(name).read_text().splitlines()]
        vertices = np.array([words[1:4] for words in lines if words[:1] == ["v"]], float)
        faces = [[int(word.split("/")[0]) - 1 for word in words[1:]] for words in lines if words[:1] == ["f"]]
        return vertices, np.array(faces)

    body_vertices, body_faces = read("characters/mh_female_body.obj")
    vertices, _ = read(f"garments/mh_female_{garment}.obj")
    distances = BodyDistance(body_faces).signed_distance(vertices, body_vertices)
    assert 100 * (distances < 0).mean() == pytest.approx(percent, abs=0.05 if percent < 10 else 0.5)
    assert penetration_figures(distances, np.ones(len(distances), bool))["deepest_mm"] == pytest.approx(depth, abs=0.05)
