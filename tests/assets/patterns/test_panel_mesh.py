"""Panels are cut into even triangles that keep the outline, and both sides of a seam match."""

from __future__ import annotations

import numpy as np
import pytest

from assets.garment import boundary_loops
from assets.patterns.curves import signed_area
from assets.patterns.panel_mesh import CutPattern, cut
from assets.patterns.pattern import Band, EdgeName, Pattern, edge_length
from pbd.mesh import edges_of
from tests.assets.patterns.shapes import darted, pattern, polygon, tube
from tests.refusals import refuses

PATTERNS = {
    "tube": tube(),
    "dart": darted(),
    "narrow dart": darted(0.28, 0.002),
    "slanting dart": pattern(
        polygon("one", [(0.0, 0.0), (0.4, 0.0), (0.4, 0.3), (0.2, 0.3), (0.05, 0.02), (0.19, 0.3), (0.0, 0.3)])
    ),
    "strip": pattern(polygon("strip", [(0.0, 0.0), (0.6, 0.0), (0.6, 0.011), (0.0, 0.011)])),
    "patch": pattern(polygon("patch", [(0.0, 0.0), (0.012, 0.0), (0.007, 0.009)])),
}


def angles(cut_pattern: CutPattern) -> np.ndarray:
    """Of every corner [deg], shape (m, 3)."""
    corners = cut_pattern.flat[cut_pattern.faces]
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = (ahead * back).sum(axis=2) / np.linalg.norm(ahead, axis=2) / np.linalg.norm(back, axis=2)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def areas(cut_pattern: CutPattern, corners: np.ndarray | None = None) -> np.ndarray:
    corners = cut_pattern.flat[cut_pattern.faces] if corners is None else corners
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2.0


@pytest.mark.parametrize("length", [0.05, 0.02, 0.009])
@pytest.mark.parametrize("case", PATTERNS)
def test_each_panel_is_one_sheet_within_its_outline(case: str, length: float) -> None:
    whole: Pattern = PATTERNS[case]
    mesh = cut(whole, length)
    assert areas(mesh).min() > 0.0
    loops = boundary_loops(mesh.faces)
    assert len(loops) == len(whole.panels)
    for number, panel in enumerate(whole.panels):
        faces = mesh.faces[mesh.panel_of_face == number]
        own = np.flatnonzero(mesh.panel_of_vertex == number)
        assert (np.unique(faces) == own).all()
        assert len(own) - len(edges_of(faces)[0]) + len(faces) == 1  # Euler: a disc
        around = np.concatenate([mesh.edge_vertices[EdgeName(panel.name, k)][:-1] for k in range(len(panel.edges))])
        loop = next(loop for loop in loops if loop[0] in own)
        turn = int(np.flatnonzero(loop == around[0])[0])
        assert (np.roll(loop, -turn) == around).all()


@pytest.mark.parametrize("length", [0.03, 0.02, 0.01, 0.005])
def test_triangles_are_even(length: float) -> None:
    for whole in (tube(), darted()):
        mesh = cut(whole, length)
        assert angles(mesh).min() > 25.0
        sides = np.linalg.norm(np.diff(mesh.flat[edges_of(mesh.faces)[0]], axis=1), axis=2)
        low, middle, high = np.percentile(sides, [1, 50, 99])
        assert low > 0.6 * length and 0.85 * length < middle < 1.15 * length and high < 1.5 * length


def test_points_of_an_edge_lie_on_its_curve_at_equal_shares_and_keep_its_corners() -> None:
    whole = tube()
    for length in (0.05, 0.011):
        mesh = cut(whole, length)
        for name, vertices in mesh.edge_vertices.items():
            curve, points = whole.edge(name), mesh.flat[vertices]
            np.testing.assert_allclose(points[[0, -1]], curve[[0, -1]], atol=1e-12)
            along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
            shares = np.linspace(0.0, 1.0, len(points)) * edge_length(curve)
            expected = np.stack([np.interp(shares, along, curve[:, axis]) for axis in (0, 1)], axis=1)
            np.testing.assert_allclose(points, expected, atol=1e-12)


def test_both_sides_of_a_seam_meet_point_by_point() -> None:
    whole = tube()
    mesh = cut(whole, 0.02)
    for number, seam in enumerate(whole.seams):
        pairs = mesh.stitches[mesh.seam_of_stitch == number]
        assert len(pairs) == 1 + 22  # (0.40 + 0.48) / 2 / 0.02 segments
        assert pairs[:, 0].tolist() == mesh.edge_vertices[seam.first].tolist()
        assert pairs[:, 1].tolist() == mesh.edge_vertices[seam.second][::-1].tolist()


def test_the_tip_of_a_dart_is_not_sewn_to_itself() -> None:
    mesh = cut(darted(), 0.02)
    assert (mesh.stitches[:, 0] != mesh.stitches[:, 1]).all()
    ahead, back = (mesh.edge_vertices[EdgeName("skirt", k)] for k in (3, 4))
    assert mesh.stitches.tolist() == np.stack([ahead, back[::-1]], axis=1)[:-1].tolist()


@pytest.mark.parametrize("length", [0.04, 0.01])
def test_a_band_is_as_heavy_and_as_short_at_every_edge_length(length: float) -> None:
    elastic = Band(EdgeName("patch", 2), 0.03, layers=3.0, length_ratio=0.7)
    rectangle = polygon("patch", [(0.0, 0.0), (0.4, 0.0), (0.4, 0.2), (0.0, 0.2)])
    mesh = cut(pattern(rectangle, bands=(elastic,)), length)
    flat = areas(mesh)
    assert ((mesh.layers - 1.0) * flat).sum() == pytest.approx(2.0 * 0.4 * 0.03, rel=0.05)
    assert areas(mesh, mesh.rest).sum() == pytest.approx(0.4 * 0.2 - 0.3 * 0.4 * 0.03, rel=0.01)
    shape = mesh.rest - mesh.rest.mean(axis=1, keepdims=True)
    before = mesh.flat[mesh.faces] - mesh.flat[mesh.faces].mean(axis=1, keepdims=True)
    np.testing.assert_allclose(shape[..., 1], before[..., 1], atol=1e-12)  # only along the edge
    far = mesh.flat[mesh.faces][..., 1].max(axis=1) < 0.16
    assert (mesh.layers[far] == 1.0).all() and (mesh.rest[far] == mesh.flat[mesh.faces][far]).all()


def test_the_same_pattern_gives_the_same_triangles() -> None:
    one, two = cut(tube(), 0.02), cut(tube(), 0.02)
    assert (one.flat == two.flat).all() and (one.faces == two.faces).all()


@pytest.mark.parametrize("length", [0.0, -0.01, float("nan"), 1e-5])
def test_a_bad_edge_length_is_refused(length: float) -> None:
    refuses("bad edge length.*above .* m for this pattern", cut, tube(), length)


def test_an_outline_that_crosses_itself_is_refused_by_name() -> None:
    bow = polygon("bow", [(0.0, 0.0), (0.4, 0.3), (0.4, 0.0), (0.0, 0.2)])
    refuses("panel 'bow'.*crosses itself", cut, pattern(bow), 0.02)


def test_random_outlines_with_sharp_corners_and_notches() -> None:
    rng = np.random.default_rng(0)
    for _ in range(60):
        count = int(rng.integers(3, 14))
        angle, radius = np.sort(rng.random(count)) * 2.0 * np.pi, rng.uniform(0.05, 0.5, count)
        corners = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        if np.max(np.diff(np.append(angle, angle[0] + 2.0 * np.pi))) > 0.9 * np.pi:
            continue  # may cross itself
        mesh = cut(pattern(polygon("star", [tuple(corner) for corner in corners])), 0.03)
        assert areas(mesh).min() > 0.0
        assert areas(mesh).sum() == pytest.approx(signed_area(corners))
        assert len(mesh.flat) - len(edges_of(mesh.faces)[0]) + len(mesh.faces) == 1


def test_straight_sides_in_any_direction_leave_no_face_without_area() -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        angle, (width, height) = rng.random() * 2.0 * np.pi, rng.uniform(0.1, 0.5, 2)
        across, up = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        corners = [rng.normal(size=2)]
        corners += [corners[0] + width * across, corners[0] + width * across + height * up, corners[0] + height * up]
        mesh = cut(pattern(polygon("rectangle", [tuple(corner) for corner in corners])), 0.03)
        assert angles(mesh).min() > 20.0
