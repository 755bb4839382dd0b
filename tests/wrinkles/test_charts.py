from __future__ import annotations

import numpy as np
import pytest

from assets.procedural.builtin import builtin_garment
from pbd import ClothMesh
from pbd.mesh import edges_of
from tests.wrinkles.meshes import flat_sheet, icosphere, tube
from wrinkles.charts import Charts, fine_places, leading_vertices
from wrinkles.surface import Subdivision

WARP, WEFT = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])  # of the flat sheet, whose normals point up


@pytest.fixture(scope="module")
def sheet() -> Charts:
    return Charts.of(ClothMesh.from_surface(*flat_sheet(9, 1.0, jitter=0.35), tuple(WARP)))


@pytest.fixture(scope="module")
def prism() -> Charts:
    return Charts.of(ClothMesh.from_surface(*tube(16), (0.0, 1.0, 0.0)))


def point(charts: Charts, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Points on the mesh in space [m], shape (p, 3)."""
    return np.einsum("pc,pci->pi", weights, charts.mesh.vertices[charts.mesh.faces[face]])


def laid_out(offset: np.ndarray) -> np.ndarray:
    """Chart offsets on the flat sheet as vectors in space."""
    return offset[:, :1] * WARP + offset[:, 1:] * WEFT


def test_a_walk_on_a_flat_sheet_arrives_where_it_is_sent(sheet: Charts) -> None:
    rng = np.random.default_rng(0)
    vertex = rng.integers(0, len(sheet.mesh.vertices), 2000)
    target = np.stack([rng.uniform(0.01, 0.99, 2000), np.zeros(2000), rng.uniform(0.01, 0.99, 2000)], axis=1)
    way = target - sheet.mesh.vertices[vertex]
    face, weights, arrived = sheet.trace(vertex, np.stack([way @ WARP, way @ WEFT], axis=1))
    assert arrived.all() and weights.min() >= 0.0
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(point(sheet, face, weights), target, atol=1e-12)


def test_a_walk_may_go_along_edges_and_through_vertices() -> None:
    """On regular squares every stencil offset runs along edges and through vertices, where a walk may lose its way."""
    charts = Charts.of(ClothMesh.from_surface(*flat_sheet(9, 1.0), tuple(WARP)))
    steps = 0.125 * np.array([(a, b) for a in range(-2, 3) for b in range(-2, 3)])
    middle = np.flatnonzero((np.abs(charts.mesh.vertices[:, [0, 2]] - 0.5) < 0.26).all(axis=1))
    vertex, offset = np.repeat(middle, 25), np.tile(steps, (len(middle), 1))
    face, weights, arrived = charts.trace(vertex, offset)
    assert arrived.all()
    np.testing.assert_allclose(point(charts, face, weights), charts.mesh.vertices[vertex] + laid_out(offset), atol=1e-9)


def test_a_walk_stops_at_the_rim_and_says_so(sheet: Charts) -> None:
    rng = np.random.default_rng(1)
    vertices = sheet.mesh.vertices
    inner = np.flatnonzero((np.abs(vertices[:, [0, 2]] - 0.5) < 0.499).all(axis=1))
    vertex, offset = rng.choice(inner, 500), rng.uniform(-0.7, 0.7, (500, 2))
    start, end = vertices[vertex], vertices[vertex] + laid_out(offset)
    inside = ((end[:, [0, 2]] > 0) & (end[:, [0, 2]] < 1)).all(axis=1)
    assert 100 < inside.sum() < 400
    face, weights, arrived = sheet.trace(vertex, offset)
    assert np.array_equal(arrived, inside)
    # Where the straight line leaves the square.
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(end > start, (1.0 - start) / (end - start), -start / (end - start))
    share = np.minimum(1.0, limit[:, [0, 2]].min(axis=1))
    np.testing.assert_allclose(point(sheet, face, weights), start + share[:, None] * (end - start), atol=1e-9)


def test_a_walk_off_the_cloth_goes_along_the_rim_as_far_as_it_leads_there(sheet: Charts) -> None:
    corner = int(np.argmin(np.linalg.norm(sheet.mesh.vertices, axis=1)))  # the weft points out of the sheet here
    offset = np.array([[-0.1, 0.05], [0.2, 0.1], [-0.1, -0.3], [0.2, -0.1], [0.2, 0.0], [0.0, -0.1]])
    face, weights, arrived = sheet.trace(np.full(6, corner), offset)
    assert arrived.tolist() == [False, False, False, True, True, True]
    expected = [[0.0, 0.0], [0.2, 0.0], [0.0, 0.3], [0.2, 0.1], [0.2, 0.0], [0.0, 0.1]]
    np.testing.assert_allclose(point(sheet, face, weights)[:, [0, 2]], expected, atol=1e-9)


@pytest.mark.parametrize("name", ["skirt", "tshirt", "flag", "tablecloth"])
def test_every_vertex_of_a_garment_sees_two_directions(name: str) -> None:
    """Also where the rim curves away from the directions of warp and weft."""
    garment = builtin_garment(name)
    charts = Charts.of(ClothMesh.from_surface(garment.vertices, garment.faces, (0.0, 1.0, 0.05)))
    count, step = len(garment.vertices), float(charts.mesh.edge_lengths()[1].mean())
    ends = []
    for offset in ([step, 0.0], [-step, 0.0], [0.0, step], [0.0, -step]):
        face, weights, _ = charts.trace(np.arange(count), np.tile(offset, (count, 1)))
        ends.append(point(charts, face, weights))
    warp, weft = ends[0] - ends[1], ends[2] - ends[3]
    size = np.linalg.norm(warp, axis=1) * np.linalg.norm(weft, axis=1)
    assert size.min() > 0.2 * step**2
    assert (np.linalg.norm(np.cross(warp, weft), axis=1) / size).min() > 0.3


def test_a_walk_round_a_prism_is_straight_when_it_is_unrolled(prism: Charts) -> None:
    around, radius = 16, 0.3
    chord = 2 * radius * np.sin(np.pi / around)
    rng = np.random.default_rng(2)
    vertices = prism.mesh.vertices
    middle = np.flatnonzero(np.abs(vertices[:, 1] - vertices[:, 1].mean()) < 0.2)
    vertex = rng.choice(middle, 500)
    offset = np.stack([rng.uniform(-0.3, 0.3, 500), rng.uniform(-1.5, 1.5, 500)], axis=1)  # up to 0.8 of the way round
    face, weights, arrived = prism.trace(vertex, offset)
    assert arrived.all()
    # Unrolled: each face lies between two columns of vertices; the weft runs against the angle.
    column = (np.arange(len(vertices)) // (around + 1)).astype(float)
    corner = column[prism.mesh.faces[face]]
    last = (corner.max(axis=1) == around - 1) & (corner.min(axis=1) == 0)
    corner[last[:, None] & (corner == 0)] = around
    end = chord * (weights * corner).sum(axis=1)
    wrong = (end - (chord * column[vertex] - offset[:, 1])) / (around * chord)
    np.testing.assert_allclose(wrong, np.round(wrong), atol=1e-9)
    np.testing.assert_allclose(point(prism, face, weights)[:, 1], vertices[vertex, 1] + offset[:, 0], atol=1e-9)


def meshes() -> list[Charts]:
    garment = builtin_garment("skirt")
    all_of = [flat_sheet(9, 1.0, jitter=0.35), icosphere(2), tube(12), (garment.vertices, garment.faces)]
    return [Charts.of(ClothMesh.from_surface(*mesh)) for mesh in all_of]


@pytest.mark.parametrize("which", range(4))
def test_a_walk_by_the_coordinates_of_a_point_leads_to_it(which: int) -> None:
    charts = meshes()[which]
    rng = np.random.default_rng(3)
    face = rng.integers(0, len(charts.mesh.faces), 300)
    weights = rng.dirichlet([1.0, 1.0, 1.0], 300)
    seen = charts.locate(face, weights)
    there = point(charts, face, weights)
    for corner in range(3):
        vertex = charts.mesh.faces[face, corner]
        to, share, arrived = charts.trace(vertex, seen[:, corner])
        assert arrived.all()
        np.testing.assert_allclose(point(charts, to, share), there, atol=1e-9)
        distance = np.linalg.norm(there - charts.mesh.vertices[vertex], axis=1)
        np.testing.assert_allclose(np.linalg.norm(seen[:, corner], axis=1), distance, atol=1e-12)


def test_angles_round_an_inner_vertex_make_a_full_turn() -> None:
    vertices, faces = icosphere(1)
    charts = Charts.of(ClothMesh.from_surface(vertices, faces))
    around = np.bincount(faces.ravel(), weights=charts.opening.ravel())
    np.testing.assert_allclose(around, 2 * np.pi, atol=1e-12)
    assert (charts.scale > 1.01).all()  # less than a full turn on a sphere


def test_charts_of_a_sheet_follow_the_warp() -> None:
    vertices, faces = flat_sheet(7, 1.0, jitter=0.3)
    angle = np.radians(33.0)
    charts = Charts.of(ClothMesh.from_surface(vertices, faces, (np.cos(angle), 0.0, -np.sin(angle))))
    middle = np.flatnonzero((np.abs(vertices[:, [0, 2]] - 0.5) < 0.3).all(axis=1))
    face, weights, _ = charts.trace(middle, np.tile([0.15, 0.0], (len(middle), 1)))
    way = point(charts, face, weights) - vertices[middle]
    np.testing.assert_allclose(
        way, np.tile([0.15 * np.cos(angle), 0.0, -0.15 * np.sin(angle)], (len(way), 1)), atol=1e-9
    )


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_fine_places_are_the_places_of_midpoint_subdivision(levels: int) -> None:
    vertices, faces = icosphere(1)
    subdivision = Subdivision.of(faces, len(vertices), levels)
    middle, current = vertices, faces
    for level in range(levels):
        edges, _ = edges_of(current)
        middle = np.concatenate([middle, middle[edges].mean(axis=1)])
        current = Subdivision.of(faces, len(vertices), level + 1).faces
    face, weights = fine_places(subdivision)
    assert weights.min() >= 0.0
    np.testing.assert_allclose(np.einsum("pc,pci->pi", weights, vertices[faces[face]]), middle, atol=1e-14)


def test_the_heaviest_coarse_vertex_comes_first() -> None:
    vertices, faces = flat_sheet(5, 1.0, jitter=0.2)
    subdivision = Subdivision.of(faces, len(vertices), 2)
    leading = leading_vertices(subdivision)
    assert np.array_equal(leading[: len(vertices), 0], np.arange(len(vertices)))
    face, place = fine_places(subdivision)
    weights = np.zeros((len(face), len(vertices)))
    weights[np.arange(len(face))[:, None], faces[face]] = place
    sorted_weights = np.take_along_axis(weights, leading.astype(int), axis=1)
    assert (np.diff(sorted_weights, axis=1) <= 0.0).all() and np.allclose(sorted_weights.sum(axis=1), 1.0)
