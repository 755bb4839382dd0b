from __future__ import annotations

import numpy as np
import pytest

from pbd import ClothMesh
from pbd.mesh import edges_of
from tests.refusals import refuses
from tests.wrinkles.meshes import flat_sheet, icosphere, turned
from wrinkles import mesh_measures, metrics


def waves(vertices: np.ndarray, amplitude: float, wavelength: float, phase: float = 0.0) -> np.ndarray:
    """The sheet with a sine wave along x."""
    out = vertices.copy()
    out[:, 1] += amplitude * np.sin(2 * np.pi / wavelength * vertices[:, 0] + phase)
    return out


def test_normals_of_a_sphere_point_outwards() -> None:
    vertices, faces = icosphere(3, radius=0.2)
    normals = mesh_measures.vertex_normals(vertices, faces)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert np.einsum("ni,ni->n", normals, vertices / 0.2).min() > np.cos(np.radians(1.0))


def test_normals_of_many_frames_are_those_of_each() -> None:
    vertices, faces = icosphere(2)
    rng = np.random.default_rng(0)
    frames = vertices * rng.uniform(0.8, 1.2, (70, len(vertices), 1))
    each = np.stack([mesh_measures.vertex_normals(frame, faces) for frame in frames])
    assert np.array_equal(mesh_measures.vertex_normals(frames, faces), each)
    assert np.array_equal(mesh_measures.vertex_normals(frames.reshape(7, 10, -1, 3), faces).reshape(each.shape), each)


def test_normals_are_weighted_by_area() -> None:
    # Two right triangles at a right angle on one edge, one with twice the other's area.
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, -2.0], [0, 1.0, 0]])
    normal = mesh_measures.vertex_normals(vertices, np.array([[0, 1, 2], [0, 3, 1]]))[0]
    assert np.allclose(normal, np.array([0, 2, -1]) / 5**0.5)


@pytest.mark.parametrize("angle", [0.001, 7.0, 90.0, 150.0])
def test_normal_error_of_a_tilted_sheet_is_the_tilt(angle: float) -> None:
    vertices, faces = flat_sheet(6, 0.3, jitter=0.3)
    test = np.stack([vertices, turned(vertices, angle)])
    assert np.allclose(metrics.normal_error_deg(test, np.stack([vertices] * 2), faces), [0.0, angle], atol=1e-7)


def test_normal_error_of_a_turned_sphere() -> None:
    # A normal at the angle p from the axis turns by 2 asin(sin p sin(angle / 2)); its mean over the sphere.
    vertices, faces = icosphere(4)
    error = metrics.normal_error_deg(turned(vertices, 20.0), vertices, faces)
    polar = (np.arange(2000) + 0.5) * np.pi / 2000
    expected = np.average(2 * np.arcsin(np.sin(polar) * np.sin(np.radians(10.0))), weights=np.sin(polar))
    assert error == pytest.approx(np.degrees(expected), rel=2e-3)


def test_errors_of_patches_are_means_over_their_vertices() -> None:
    vertices, faces = flat_sheet(6, 0.3)
    test, truth = np.stack([vertices, turned(vertices, 30.0)]), np.stack([vertices, vertices])
    test[1, vertices[:, 0] > np.median(vertices[:, 0])] *= 1.5
    patches = np.random.default_rng(0).integers(5, size=len(vertices)) * 3
    errors = metrics.patch_normal_errors(test, truth, faces, patches)
    assert errors.shape == (2, 5) and np.allclose(errors[0], 0.0) and errors[1].min() > 10.0
    cosines = np.einsum("ni,ni->n", *(mesh_measures.vertex_normals(frames[1], faces) for frames in (test, truth)))
    angles = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    np.testing.assert_allclose(errors[1], [angles[patches == p].mean() for p in range(0, 15, 3)], atol=1e-5)


def test_collapsed_normals_count_ninety_degrees_and_loose_vertices_nothing() -> None:
    vertices, faces = flat_sheet(4, 0.3)
    vertices = np.concatenate([vertices, [[5.0, 5.0, 5.0]]])
    assert metrics.normal_error_deg(0.0 * vertices, vertices, faces) == pytest.approx(90.0)


def test_skill() -> None:
    assert metrics.skill(2.0, 8.0) == 0.75
    assert metrics.skill(8.0, 8.0) == 0.0
    assert np.isnan(metrics.skill(1.0, 0.0))


def test_normal_correlation_of_waves() -> None:
    smooth, faces = flat_sheet(81, 0.4)
    truth = waves(smooth, 0.001, 0.1)
    cases = {
        "truth": (truth, 1.0),
        "half the amplitude": (waves(smooth, 0.0005, 0.1), 1.0),
        "a quarter wave late": (waves(smooth, 0.001, 0.1, np.pi / 2), 0.0),
        "upside down": (waves(smooth, 0.001, 0.1, np.pi), -1.0),
        "smooth": (smooth, 0.0),
    }
    for name, (test, expected) in cases.items():
        value = metrics.normal_correlation(test, truth, smooth, faces)
        assert value == pytest.approx(expected, abs=0.02), name
    assert np.isnan(metrics.normal_correlation(truth, smooth, smooth, faces))


def test_rmse_of_a_shift() -> None:
    truth = np.random.default_rng(0).normal(size=(40, 9, 3))
    test = truth + np.array([0.003, 0.0, 0.004]) * np.arange(40)[:, None, None]
    assert np.allclose(metrics.rmse_mm(test, truth), 5.0 * np.arange(40))


def test_sted_is_blind_to_rigid_offsets_and_even_scale() -> None:
    vertices, faces = icosphere(1)
    truth = np.stack([turned(vertices, 3.0 * frame) for frame in range(12)])
    assert metrics.sted(truth + [0.1, 0.2, 0.3], truth, faces) == pytest.approx(0.0, abs=1e-7)
    assert metrics.sted(1.1 * truth[:1], truth[:1], faces) == pytest.approx(0.0, abs=1e-7)


def test_sted_of_one_triangle_by_hand() -> None:
    # A vertex with edges of lengths a, b and relative changes r, s deviates by sqrt(a b) |r - s| / (a + b).
    truth, faces = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]]), np.array([[0, 1, 2]])
    test = truth * [1.1, 1.0, 1.0]
    changes = {3.0: 0.1, 4.0: 0.0, 5.0: np.hypot(3.3, 4.0) / 5.0 - 1.0}
    pairs = [(3.0, 4.0), (3.0, 5.0), (4.0, 5.0)]
    expected = np.mean([np.sqrt(a * b) * abs(changes[a] - changes[b]) / (a + b) for a, b in pairs])
    assert metrics.sted(test, truth, faces) == pytest.approx(expected)


def test_sted_of_hops_in_time_by_hand() -> None:
    # The truth stands; the test hops rigidly in every other frame, so windows of five hold two or three changes r.
    triangle, faces = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]]), np.array([[0, 1, 2]])
    truth = np.stack([triangle] * 11)
    test = truth + np.repeat(np.arange(6), 2)[:11, None, None] * [0.0, 0.0, 0.1]
    change = np.hypot(0.1 / 5.0, 0.01) / 0.01 - 1.0  # diagonal 5
    assert metrics.sted(test, truth, faces) == pytest.approx(change * 6**0.5 / 5)


def test_worse_than_smooth_counts_patch_frames() -> None:
    sheet, one = flat_sheet(4, 0.3)
    truth = np.concatenate([sheet + [k, 0, 0] for k in range(4)])
    faces = np.concatenate([one + k * len(sheet) for k in range(4)])
    patches = np.repeat([0, 7, 2, 5], len(sheet))
    smooth = np.stack([turned(truth, 3.0)] * 2)
    test = np.stack([turned(truth, 2.0)] * 2)
    test[1, patches == 7] = turned(truth, 3.5)[patches == 7]
    truth = np.stack([truth] * 2)
    assert metrics.worse_than_smooth_percent(test, truth, smooth, faces, patches) == pytest.approx(100 / 8)
    assert metrics.worse_than_smooth_percent(smooth, truth, smooth, faces, patches) == 0.0
    refuses("patches", metrics.worse_than_smooth_percent, test, truth, smooth, faces, patches[:-1])


def test_figures_given_the_coarse_state_agree_with_the_single_ones() -> None:
    smooth, faces = flat_sheet(21, 0.2)
    rng = np.random.default_rng(0)
    smooth = np.stack([smooth] * 5)
    truth = smooth + rng.normal(scale=0.001, size=smooth.shape)
    test = 0.7 * truth + 0.3 * smooth
    patches = np.arange(smooth.shape[1]) // 20
    figures = metrics.given_coarse_figures(test, truth, smooth, faces, patches)
    assert figures["normal_error_deg"] == pytest.approx(metrics.normal_error_deg(test, truth, faces).mean())
    assert figures["normal_error_smooth_deg"] == pytest.approx(metrics.normal_error_deg(smooth, truth, faces).mean())
    assert figures["rmse_skill"] == pytest.approx(0.7)
    assert 0 < figures["normal_skill"] < 1
    assert 0.9 < figures["normal_correlation_p50"] <= figures["normal_correlation_p90"] <= 1
    assert figures["sted"] == metrics.sted(test, truth, faces)
    assert figures["worse_than_smooth_percent"] == 0.0
    nothing = metrics.given_coarse_figures(smooth, truth, smooth, faces, patches)
    assert nothing["normal_skill"] == nothing["rmse_skill"] == nothing["normal_correlation_p50"] == 0.0


def test_edge_stretch() -> None:
    vertices, faces = flat_sheet(31, 1.0, jitter=0.2)
    edges, _ = edges_of(faces)
    rest = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    assert mesh_measures.edge_stretch(1.02 * vertices, edges, rest) == pytest.approx((0.02, 0.02, 0.02))
    assert mesh_measures.edge_stretch(0.9 * vertices, edges, rest) == (0.0, 0.0, 0.0)
    rest[5] /= 1.5
    stretch = mesh_measures.edge_stretch(np.stack([vertices] * 40), edges, rest)
    assert stretch == pytest.approx((0.5 / len(edges), 0.0, 0.5), abs=1e-12)


def test_bending_energy_of_one_hinge() -> None:
    # Two equilateral triangles of side l at the angle t: |K x| = 2 l sin(t / 2), so E = 4 sin(t / 2)^2 / sqrt(3).
    height, angle = 0.1 * 3**0.5 / 2, np.radians(40.0)
    rest = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.05, 0, height], [0.05, 0, -height]])
    faces = np.array([[0, 2, 1], [0, 1, 3]])
    bent = rest.copy()
    bent[3, 1:] = height * np.sin(angle), -height * np.cos(angle)
    expected = 4 * np.sin(angle / 2) ** 2 / 3**0.5
    assert mesh_measures.bending_energy(np.stack([rest, bent]), ClothMesh.from_surface(rest, faces)) == pytest.approx(
        [0.0, expected]
    )


def test_bending_energy_of_a_sine_sheet() -> None:
    amplitude, wavelength, size = 0.002, 0.1, 0.4
    rest, faces = flat_sheet(81, size, jitter=0.2)
    sheet = waves(rest, amplitude, wavelength)
    energy = mesh_measures.bending_energy(sheet, ClothMesh.from_surface(rest, faces))[0]
    exact = 0.25 * amplitude**2 * (2 * np.pi / wavelength) ** 4 * size**2  # 1/2 int w''^2
    assert energy == pytest.approx(exact, rel=0.25)  # c = 1/3 hangs on the mesh
    moved = turned(turned(sheet, 30.0, axis=0), 50.0, axis=1) + [1.0, 2.0, 3.0]
    assert mesh_measures.bending_energy(moved, ClothMesh.from_surface(rest, faces))[0] == pytest.approx(energy)
    double = waves(rest, 2 * amplitude, wavelength)
    assert metrics.bending_energy_ratio(
        np.stack([double] * 3), sheet, ClothMesh.from_surface(rest, faces)
    ) == pytest.approx(4.0)


def test_bending_energy_of_a_part() -> None:
    rest, faces = flat_sheet(41, 0.4)
    sheet = waves(rest, 0.002, 0.1)[None].repeat(40, axis=0)
    left = np.repeat((rest[:, 0] < 0.2)[None], 40, axis=0)
    whole = mesh_measures.bending_energy(sheet, ClothMesh.from_surface(rest, faces))
    part = mesh_measures.bending_energy(sheet, ClothMesh.from_surface(rest, faces), where=left)
    assert part / whole == pytest.approx(np.full(40, 0.5), rel=0.05)
    assert np.array_equal(
        mesh_measures.bending_energy(sheet, ClothMesh.from_surface(rest, faces), where=np.ones_like(left)), whole
    )


@pytest.mark.parametrize("folds", [0, 3, 7, 12])
def test_fold_count_of_a_wavy_hem(folds: int) -> None:
    rng = np.random.default_rng(folds)
    angle = 2 * np.pi * np.sort((np.arange(240) + rng.uniform(-0.4, 0.4, 240)) / 240)
    radius = 0.3 + 0.03 * np.cos(folds * angle) * (folds > 0)
    hem = np.stack([radius * np.cos(angle), 0.02 * np.sin(3 * angle), radius * np.sin(angle)], axis=1)
    hem += rng.normal(scale=0.0003, size=hem.shape)
    for loop in (hem, hem[::-1], turned(hem, 70.0, axis=0) + [1.0, 0.0, 5.0]):
        assert mesh_measures.fold_count(loop) == [folds]


def test_folds_below_the_threshold_do_not_count() -> None:
    # 9 waves of 0.209 m; the swing of the tangent is 2 atan(2 pi a / w), less the part of 1/81 that the circle takes.
    angle = 2 * np.pi * np.arange(400) / 400
    for amplitude, folds in ((0.0040, 0), (0.0048, 9)):  # 13.6 and 16.3 deg
        radius = 0.3 + amplitude * np.cos(9 * angle)
        loop = np.stack([radius * np.cos(angle), 0 * angle, radius * np.sin(angle)], axis=1)
        assert mesh_measures.fold_count(loop, min_turn_deg=15.0, blur=0.004) == [folds]


def test_pixels_of_the_standard_camera() -> None:
    # 2.184 m fill the 1080 lines at 3 m distance.
    height = 2 * 3.0 * np.tan(np.radians(20.0))
    assert mesh_measures.pixel_distance(np.array([[0.0, height, 0.0]]), np.zeros((1, 3))) == pytest.approx(1080.0)


def test_jitter_is_the_length_of_a_hop() -> None:
    frames = np.zeros((30, 5, 3))
    frames[:, :, 0] = 0.01 * np.arange(30)[:, None]  # even motion adds nothing
    assert mesh_measures.jitter_px(frames) == pytest.approx(0.0, abs=1e-9)
    frames[::2, :, 1] += 0.002
    assert mesh_measures.jitter_px(frames) == pytest.approx(0.002 * mesh_measures.PIXELS_PER_METRE)
    refuses("at least 3", mesh_measures.jitter_px, frames[:2])


def test_sequences_must_match() -> None:
    vertices, faces = flat_sheet(3, 0.1)
    refuses("different shape", metrics.normal_error_deg, np.stack([vertices] * 2), np.stack([vertices] * 3), faces)
    refuses("not a sequence", metrics.rmse_mm, vertices[:, :2], vertices[:, :2])
