from __future__ import annotations

import numpy as np
import pytest

from assets.procedural.builtin import builtin_garment
from pbd.mesh import edges_of
from tests.pbd.meshes import grid
from tests.wrinkles.meshes import flat_sheet, icosphere, tube
from wrinkles.surface import Subdivision, loop_step


def rim_of(faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """Whether each vertex lies on the rim."""
    edges, side_edge = edges_of(faces)
    rim = np.bincount(side_edge.ravel(), minlength=len(edges)) == 1
    mark = np.zeros(vertex_count, bool)
    mark[edges[rim].ravel()] = True
    return mark


def test_rows_of_the_loop_matrix_are_weights() -> None:
    for vertices, faces in (flat_sheet(6, 1.0, jitter=0.3), icosphere(1), tube(12)):
        matrix, _ = loop_step(faces, len(vertices))
        assert matrix.data.min() > 0.0
        np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-14)


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_each_level_cuts_a_face_in_four(levels: int) -> None:
    vertices, faces = flat_sheet(5, 1.0, jitter=0.3)
    subdivision = Subdivision.of(faces, len(vertices), levels)
    assert len(subdivision.faces) == len(faces) * 4**levels
    edges, side_edge = edges_of(subdivision.faces)
    assert subdivision.fine_count == subdivision.faces.max() + 1 == len(np.unique(subdivision.faces))
    assert subdivision.fine_count - len(edges) + len(subdivision.faces) == 1  # still a disc
    assert np.bincount(side_edge.ravel()).max() == 2


def test_faces_keep_their_side() -> None:
    vertices, faces = flat_sheet(5, 1.0, jitter=0.3)
    subdivision = Subdivision.of(faces, len(vertices), 2)
    corner = subdivision.upsample(vertices)[subdivision.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert (normal[:, 1] > 0).all() and np.abs(normal[:, [0, 2]]).max() < 1e-15


def test_an_affine_function_is_reproduced_inside_a_regular_mesh() -> None:
    vertices, faces = grid(9, 9, 0.1, "equilateral")
    values = vertices @ np.array([[1.0, 2.0, 0.3], [-0.5, 0.7, 1.1], [0, 0, 0]]) + [0.2, -0.3, 0.9]
    matrix, _ = loop_step(faces, len(vertices))
    edges, _ = edges_of(faces)
    rim = rim_of(faces, len(vertices))
    expected = np.concatenate([values, values[edges].mean(axis=1)])
    inside = np.concatenate([~rim, ~rim[edges].any(axis=1)])
    np.testing.assert_allclose((matrix @ values)[inside], expected[inside], atol=1e-13)


def test_the_rim_is_a_curve_of_its_own() -> None:
    vertices, faces = flat_sheet(7, 1.0, jitter=0.3)
    subdivision = Subdivision.of(faces, len(vertices), 2)
    coarse_rim, fine_rim = rim_of(faces, len(vertices)), rim_of(subdivision.faces, subdivision.fine_count)
    assert fine_rim.sum() == 4 * coarse_rim.sum()
    # The fine rim depends on the coarse rim alone, so what happens inside leaves it where it was.
    moved = vertices.copy()
    moved[~coarse_rim] += np.random.default_rng(0).standard_normal((int((~coarse_rim).sum()), 3))
    assert np.array_equal(subdivision.upsample(vertices)[fine_rim], subdivision.upsample(moved)[fine_rim])
    assert np.abs(subdivision.upsample(vertices)[~fine_rim] - subdivision.upsample(moved)[~fine_rim]).max() > 0.1


def test_the_rim_of_a_straight_edged_sheet_stays_on_its_sides() -> None:
    vertices, faces = flat_sheet(7, 1.0)
    subdivision = Subdivision.of(faces, len(vertices), 2)
    fine = subdivision.upsample(vertices)[rim_of(subdivision.faces, subdivision.fine_count)]
    off = np.minimum(np.abs(fine[:, [0, 2]]), np.abs(fine[:, [0, 2]] - 1.0)).min(axis=1)
    middle = np.abs(fine[:, [0, 2]] - 0.5).min(axis=1) < 0.25  # corners are rounded over one coarse edge
    assert off[middle].max() < 1e-14 and off.max() < 0.05


def test_a_plane_stays_a_plane() -> None:
    vertices, faces = flat_sheet(7, 1.0, jitter=0.3)
    normal = np.array([0.2, 0.9, -0.4])
    vertices[:, 1] = -(vertices[:, 0] * normal[0] + vertices[:, 2] * normal[2]) / normal[1] + 0.7
    subdivision = Subdivision.of(faces, len(vertices), 3)
    assert np.abs(subdivision.upsample(vertices) @ normal - 0.7 * normal[1]).max() < 1e-14


def test_frames_are_upsampled_like_one() -> None:
    vertices, faces = icosphere(1)
    subdivision = Subdivision.of(faces, len(vertices), 2)
    frames = np.stack([vertices, 2.0 * vertices + 1.0])
    both = subdivision.upsample(frames)
    assert both.shape == (2, subdivision.fine_count, 3)
    np.testing.assert_allclose(both, [subdivision.upsample(f) for f in frames], atol=1e-15)
    np.testing.assert_allclose(both[1], 2.0 * both[0] + 1.0, atol=1e-13)


def plain_loop(subdivision: Subdivision, vertices: np.ndarray) -> np.ndarray:
    """Loop subdivision without the correction."""
    for step in subdivision.steps:
        vertices = step @ vertices
    return vertices


def test_a_sphere_keeps_its_radius_where_plain_loop_shrinks() -> None:
    errors, plain_errors = [], []
    for level in (1, 2, 3):
        vertices, faces = icosphere(level)
        subdivision = Subdivision.of(faces, len(vertices), 2)
        errors.append(np.abs(np.linalg.norm(subdivision.upsample(vertices), axis=1) - 1.0).max())
        plain_errors.append(1.0 - np.linalg.norm(plain_loop(subdivision, vertices), axis=1).max())
    for proxy, finer in zip(errors, errors[1:], strict=False):
        assert proxy > 2.5 * finer  # with the square of the edges, apart from the twelve irregular vertices
    assert all(e < 0.2 * p for e, p in zip(errors, plain_errors, strict=True)) and plain_errors[0] > 0.05


def test_a_cylinder_keeps_its_radius_where_plain_loop_shrinks() -> None:
    errors, plain_errors = [], []
    for around in (12, 24):
        vertices, faces = tube(around, 0.3)
        subdivision = Subdivision.of(faces, len(vertices), 2)
        # Coarse vertices away from the rim.
        inside = np.flatnonzero(np.abs(vertices[:, 1] - vertices[:, 1].mean()) < 0.2 * np.ptp(vertices[:, 1]))
        off = lambda fine: np.abs(np.hypot(fine[:, 0], fine[:, 2]) - 0.3).max()  # noqa: E731
        errors.append(off(subdivision.upsample(vertices)[inside]))
        plain_errors.append(off(plain_loop(subdivision, vertices)[inside]))
    # Half the edge length: a quarter of the error, and on this regular mesh a sixteenth with the correction.
    assert plain_errors[0] / plain_errors[1] == pytest.approx(4.0, rel=0.05)
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)
    assert errors[0] < 0.1 * plain_errors[0]


def test_fit_takes_upsampling_back() -> None:
    for vertices, faces in (flat_sheet(6, 1.0, jitter=0.3), icosphere(1)):
        subdivision = Subdivision.of(faces, len(vertices), 2)
        coarse = vertices + 0.1 * np.random.default_rng(0).standard_normal(vertices.shape)
        np.testing.assert_allclose(subdivision.fit(subdivision.upsample(coarse)), coarse, atol=1e-10)


def test_fit_is_the_nearest_smooth_surface() -> None:
    vertices, faces = flat_sheet(6, 1.0, jitter=0.3)
    subdivision = Subdivision.of(faces, len(vertices), 2)
    rng = np.random.default_rng(0)
    fine = subdivision.upsample(vertices) + 0.01 * rng.standard_normal((subdivision.fine_count, 3))
    rest = fine - subdivision.upsample(subdivision.fit(fine))
    assert np.abs(subdivision.matrix.T @ rest).max() < 1e-12 and np.abs(rest).max() > 1e-3


@pytest.fixture(scope="module")
def skirt() -> tuple[Subdivision, np.ndarray]:
    garment = builtin_garment("skirt")
    return Subdivision.of(garment.faces, len(garment.vertices), 2), garment.vertices


def test_coarse_and_fine_have_the_same_area(skirt: tuple[Subdivision, np.ndarray]) -> None:
    around, faces = tube(12)
    for subdivision, vertices in (skirt, (Subdivision.of(faces, len(around), 2), around)):
        coarse, fine = subdivision.meshes(vertices)
        assert coarse.face_areas.sum() == pytest.approx(fine.face_areas.sum(), rel=0.005)
        assert np.array_equal(coarse.vertices, vertices)
        np.testing.assert_allclose(fine.vertices, subdivision.upsample(vertices), atol=1e-15)
        # Rest lengths of the fine mesh are those of the smooth surface itself.
        edges, lengths = fine.edge_lengths()
        side = fine.vertices[edges[:, 1]] - fine.vertices[edges[:, 0]]
        np.testing.assert_allclose(lengths, np.linalg.norm(side, axis=1), rtol=1e-9)


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_a_coarse_edge_is_as_long_as_the_fine_edges_along_it(levels: int) -> None:
    vertices, faces = icosphere(1, 0.3)
    subdivision = Subdivision.of(faces, len(vertices), levels)
    coarse, fine = subdivision.meshes(vertices)
    edges, rest = coarse.edge_lengths()
    fine_edges, fine_rest = fine.edge_lengths()
    length_of = {tuple(edge): length for edge, length in zip(fine_edges.tolist(), fine_rest, strict=True)}
    paths = subdivision._edge_paths(edges)
    assert len(paths) == 2**levels
    for e, edge in enumerate(edges.tolist()):
        path = [p[e] for p in paths]
        assert path[0][0] == edge[0] and path[-1][1] == edge[1]
        assert all(a[1] == b[0] for a, b in zip(path, path[1:], strict=False))
        along = sum(length_of[tuple(sorted(piece.tolist()))] for piece in path)  # KeyError: not a fine edge
        assert rest[e] == pytest.approx(along, rel=1e-9)
    chord = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    assert (rest > 1.005 * chord).all()


def test_the_warp_of_both_meshes_is_the_direction_asked_for(skirt: tuple[Subdivision, np.ndarray]) -> None:
    subdivision, vertices = skirt
    for mesh in subdivision.meshes(vertices, (0.0, 1.0, 0.0)):
        # Side lengths may have changed; the first side keeps its angle against the warp.
        side = mesh.vertices[mesh.faces[:, 1]] - mesh.vertices[mesh.faces[:, 0]]
        other = mesh.vertices[mesh.faces[:, 2]] - mesh.vertices[mesh.faces[:, 0]]
        normal = np.cross(side, other)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        warp = np.array([0.0, 1.0, 0.0]) - normal * normal[:, 1:2]
        warp /= np.linalg.norm(warp, axis=1, keepdims=True)
        cosine = np.einsum("ij,ij->i", side, warp) / np.linalg.norm(side, axis=1)
        flat = mesh.flat[:, :, 0]
        np.testing.assert_allclose(flat[:, 0] / np.linalg.norm(flat, axis=1), cosine, atol=1e-9)


def test_the_pattern_is_cut_with_the_faces() -> None:
    """Each corner of a fine face has the place in the pattern that its point of the coarse face has, also at a seam."""
    garment = builtin_garment("skirt")
    assert garment.pattern is not None
    subdivision = Subdivision.of(garment.faces, len(garment.vertices), 2)
    flat = subdivision.flat_corners(garment.pattern)
    assert flat is not None and flat.shape == (len(subdivision.faces), 3, 2)
    areas = [0.5 * np.linalg.det(f[:, 1:] - f[:, :1]) for f in (garment.pattern, flat)]
    np.testing.assert_allclose(areas[1].reshape(-1, 16), np.repeat(areas[0][:, None] / 16.0, 16, axis=1), rtol=1e-6)
    # Fine edges are as long as the pattern says, up to Loop's rule: where vertices have more or fewer than six
    # neighbours, as along seams, it moves them within the surface.
    sides = [
        np.linalg.norm(np.roll(f, -1, axis=1) - f, axis=2)
        for f in (flat, subdivision.upsample(garment.vertices)[subdivision.faces])
    ]
    low, middle, high = np.percentile(sides[1] / sides[0], (5, 50, 95))
    assert low > 0.89 and middle == pytest.approx(1.0, abs=0.005) and high < 1.09
    assert subdivision.flat_corners(None) is None
