"""The quadratic hinge and its calibration."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from pbd import Fabric, State, build_model
from pbd.bending import (
    _disc,
    _edge_graph,
    _flat_patch,
    _strip_stiffness,
    bends_of,
    hinge_calibration,
    hinge_friction,
    hinge_rows,
    hinge_stiffness,
    layer_stiffness,
)
from pbd.mesh import ClothMesh, edges_of
from tests.pbd.meshes import cloth, free_model, grid, icosphere, run, turn
from tests.refusals import refuses

DIRECTIONS = np.arange(4) * np.pi / 4


def two_faces(seed: int) -> np.ndarray:
    """Corners i, j, k, l of a random flat hinge: both faces are far from slivers."""
    rng = np.random.default_rng(seed)
    above, below = rng.uniform([0.1, 0.3], [0.9, 1.0]), rng.uniform([0.1, -1.0], [0.9, -0.3])
    corners = np.array([[0.0, 0.0], [1.0, 0.0], above, below]) * rng.uniform(0.01, 0.1)
    return np.concatenate([corners, np.zeros((4, 1))], axis=1)


FACES = np.array([[0, 1, 2], [1, 0, 3]], np.int32)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000))
def test_rows_annihilate_every_affine_map_of_the_flat_shape(seed: int) -> None:
    corners = two_faces(seed)
    hinges, rows, areas, _ = hinge_rows(cloth(corners, FACES))
    flat = corners[hinges[0]]
    affine = np.random.default_rng(seed).normal(size=(3, 3))
    image = flat @ affine.T + [1.0, -2.0, 0.5]
    assert abs(rows[0].sum()) < 1e-12
    assert rows[0] @ image == pytest.approx(np.zeros(3), abs=1e-12)
    assert areas[0] == pytest.approx(cloth(corners, FACES).face_areas.sum())


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.floats(-2.0, 2.0))
def test_a_small_fold_gives_the_edge_times_the_angle(seed: int, degrees: float) -> None:
    corners = two_faces(seed)
    hinges, rows, _, _ = hinge_rows(cloth(corners, FACES))
    folded = corners.copy()
    folded[3] = turn((1.0, 0.0, 0.0), degrees) @ corners[3]  # the edge lies on the x axis
    size = np.linalg.norm(rows[0] @ folded[hinges[0]])
    angle = abs(np.radians(degrees))
    assert size == pytest.approx(np.linalg.norm(corners[1] - corners[0]) * angle, rel=5e-2 * angle + 1e-6, abs=1e-12)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_cloth_that_rests_bent_rolls_up_as_far_and_to_its_side(side: float) -> None:
    """A flat strip whose hinges rest as those of a cylinder becomes that cylinder, and does not start to spin."""
    vertices, faces = grid(16, 4, 0.02)
    flat = cloth(vertices, faces)
    turned, radius = (vertices[:, 0] - vertices[:, 0].mean()) / 0.1, 0.1
    rolled = np.stack([radius * np.sin(turned), vertices[:, 1], side * radius * np.cos(turned)], axis=1)
    bends = bends_of(flat, rolled[None])[0]
    assert bends_of(flat, vertices[None])[0] == pytest.approx(0.0, abs=1e-12)
    mesh = replace(flat, rest_bends=bends)
    model = free_model(mesh, Fabric(bend_warp=1e-4, bend_weft=1e-4))
    state = State.at_rest(model)
    run(model, state, 240, gravity=0.0, keep=0.95)
    found = bends_of(flat, state.position[None, :, :3])[0]
    assert np.abs(bends).max() > 1e-3
    assert np.corrcoef(found, bends)[0, 1] > 0.99
    assert np.linalg.norm(found - bends) < 0.1 * np.linalg.norm(bends)
    spin = np.cross(state.position[:, :3] - state.position[:, :3].mean(axis=0), state.velocity[:, :3]).mean(axis=0)
    assert np.abs(spin).max() < 1e-6


def test_bends_at_rest_that_do_not_belong_to_the_mesh_are_refused() -> None:
    mesh = cloth(*grid(4, 3, 0.1))
    count = len(hinge_rows(mesh).vertices)
    for bends in (np.zeros(count - 1), np.full(count, np.nan)):
        refuses(f"rest_bends.*finite.*\\({count},\\)", replace, mesh, rest_bends=bends)


def test_a_curved_mesh_is_flat_at_rest_in_its_pattern() -> None:
    """Rows come from the rest metric, not from the mesh in space."""
    vertices, faces = grid(6, 6, 0.05)
    pattern = vertices[faces][:, :, :2]
    rolled = np.stack([0.1 * np.sin(vertices[:, 0] / 0.1), vertices[:, 1], 0.1 * np.cos(vertices[:, 0] / 0.1)], axis=1)
    flat_rows, rolled_rows = (hinge_rows(ClothMesh.from_pattern(v, faces, pattern))[1] for v in (vertices, rolled))
    assert np.array_equal(flat_rows, rolled_rows)


@pytest.mark.parametrize(("kind", "tolerance"), [("equilateral", 0.1), ("alternating", 0.1), ("diagonal", 0.15)])
def test_calibrated_strips_bend_with_the_stiffness_asked_for(kind: str, tolerance: float) -> None:
    mesh = cloth(*grid(40, 40, 0.02, kind))
    factor = hinge_calibration(mesh)
    graph, centre = _edge_graph(edges_of(mesh.faces)[0], len(mesh.vertices)), 20 * 41 + 20
    # Larger patches than those that were calibrated on, in the middle of the mesh.
    patch = _flat_patch(mesh, _disc(graph, centre, 14), centre)
    assert patch is not None
    ratios = factor * np.array([_strip_stiffness(*patch, angle) for angle in DIRECTIONS])
    assert ratios.mean() == pytest.approx(1.0, abs=tolerance)
    # Hinges prefer directions; what is known of it is held here (physics of hinges, not of this code).
    if kind == "diagonal":
        assert ratios.max() / ratios.min() > 2.5
    else:
        assert np.all(np.abs(ratios - 1.0) < 0.2)


def test_calibration_does_not_depend_on_size_pose_or_material_axes() -> None:
    vertices, faces = grid(24, 24, 0.03, "equilateral")
    factor = hinge_calibration(cloth(vertices, faces))
    turned = 10.0 * vertices @ turn((1.0, 1.0, 0.3), 50.0).T + [1.0, 2.0, 3.0]
    assert hinge_calibration(cloth(turned, faces, warp=(0.2, 1.0, 0.1))) == pytest.approx(factor, rel=0.02)


def test_calibration_of_an_irregular_mesh() -> None:
    rng = np.random.default_rng(0)
    flat = grid(30, 30, 0.02, "equilateral")[0][:, :2] + rng.uniform(-0.004, 0.004, (31 * 31, 2))
    faces = Delaunay(flat).simplices
    sides = flat[faces]
    area = np.cross(
        np.pad(sides[:, 1] - sides[:, 0], ((0, 0), (0, 1))), np.pad(sides[:, 2] - sides[:, 0], ((0, 0), (0, 1)))
    )
    faces = faces[area[:, 2] > 2e-5]
    assert 0.28 < hinge_calibration(cloth(np.pad(flat, ((0, 0), (0, 1))), faces)) < 0.45


def test_a_strip_is_calibrated_like_the_sheet_that_it_is_cut_from() -> None:
    sheet = hinge_calibration(cloth(*grid(40, 40, 0.02, "alternating")))
    strip = hinge_calibration(cloth(*grid(40, 9, 0.02, "alternating")))
    assert strip == pytest.approx(sheet, rel=0.1)


def test_warp_and_weft_bend_each_with_their_own_stiffness() -> None:
    mesh = cloth(*grid(4, 4, 0.05), warp=(1.0, 0.0, 0.0))
    model = free_model(mesh, Fabric(bend_warp=4e-5, bend_weft=1e-5))
    equal = free_model(mesh, Fabric(bend_warp=1e-5, bend_weft=1e-5))
    assert np.array_equal(model.hinges, equal.hinges)
    ratio = equal.hinge_data[:, 1, 1] / model.hinge_data[:, 1, 1]  # of stiffness: compliances the other way round
    edge = mesh.vertices[model.hinges[:, 1]] - mesh.vertices[model.hinges[:, 0]]
    across = np.abs(edge[:, 0]) < 1e-9  # the hinge's edge runs along the weft: it bends the warp
    along = np.abs(edge[:, 1]) < 1e-9
    # Those in between bend along with both, see hinge_stiffness: its mean is 0.375 (4 + 1) + 0.25 sqrt(4).
    assert across.any() and ratio[across] == pytest.approx(2.375 + 0.75 * 3.0 + 0.75)
    assert along.any() and ratio[along] == pytest.approx(2.375 - 0.75 * 3.0 + 0.75)
    assert ratio[~across & ~along] == pytest.approx(2.375 - 0.75)


def test_without_bending_stiffness_there_are_no_hinges() -> None:
    assert len(free_model(cloth(*grid(3, 3, 0.1)), Fabric(bend_warp=0.0, bend_weft=0.0)).hinges) == 0


def test_a_model_scales_its_hinges_by_the_factor_and_the_option() -> None:
    mesh = cloth(*grid(24, 24, 0.03))
    measured, half = build_model(mesh, Fabric()), free_model(mesh, Fabric(), bend_factor=0.5)
    assert measured.bend_factor == hinge_calibration(mesh)
    assert half.hinge_data[:, 1, 1] == pytest.approx(
        measured.hinge_data[:, 1, 1] * measured.bend_factor / 0.5, rel=1e-5
    )


def test_a_sphere_too_curved_for_patches_keeps_a_third() -> None:
    assert hinge_calibration(cloth(*icosphere(1, 0.1))) == pytest.approx(1 / 3)


def test_layers_weigh_and_stretch_as_many_and_bend_as_their_square() -> None:
    vertices, faces = grid(6, 4, 0.02)
    one, fabric = cloth(vertices, faces), Fabric()
    models = [
        build_model(replace(one, layers=layers), fabric, bend_factor=1 / 3) for layers in (None, np.full(48, 3.0))
    ]
    assert models[1].mass.sum() == pytest.approx(3.0 * models[0].mass.sum())
    softness = [model.hinge_data[:, 1, 1] for model in models]
    np.testing.assert_allclose(softness[0] / softness[1], 9.0, rtol=1e-5)
    unit = [model.triangle_data[7, :48] for model in models]
    compliance = [model.triangle_data[8, :48] / share for model, share in zip(models, unit, strict=True)]
    np.testing.assert_allclose(compliance[0] / compliance[1], 3.0, rtol=1e-4)


def test_a_hinge_between_one_layer_and_three_bends_like_their_mean() -> None:
    vertices, faces = grid(1, 1, 0.02)
    np.testing.assert_allclose(layer_stiffness(replace(cloth(vertices, faces), layers=np.array([1.0, 3.0]))), [5.0])
    refuses("layers", replace, cloth(vertices, faces), layers=np.array([1.0, 0.0]))


@pytest.mark.parametrize("weft", [1.0, 0.5, 0.2])
def test_hinges_of_all_directions_bend_as_the_fabric_does(weft: float) -> None:
    fabric = Fabric(0.2, bend_warp=1e-5, bend_weft=1e-5 * weft, bend_hysteresis_warp=1e-3, bend_hysteresis_weft=6e-4)
    edges = np.linspace(0.0, np.pi, 3600, endpoint=False)
    across = edges + 0.5 * np.pi  # the direction in which a hinge bends
    stiffness = 8.0 / 3.0 * hinge_stiffness(fabric, edges)
    along_warp, along_weft = np.cos(across) ** 2, np.sin(across) ** 2
    assert np.mean(stiffness * along_warp**2) == pytest.approx(fabric.bend_warp)
    assert np.mean(stiffness * along_weft**2) == pytest.approx(fabric.bend_weft)
    assert 3.0 * np.mean(stiffness * along_warp * along_weft) == pytest.approx(1e-5 * np.sqrt(weft))
    friction = 2.0 * hinge_friction(fabric, edges)
    assert np.mean(friction * along_warp) == pytest.approx(1e-3)
    assert np.mean(friction * along_weft) == pytest.approx(6e-4)


def test_hinges_never_push() -> None:
    fabric = Fabric(0.2, bend_warp=1e-5, bend_weft=1e-8, bend_hysteresis_warp=1e-3, bend_hysteresis_weft=0.0)
    edges = np.linspace(0.0, np.pi, 36)
    assert hinge_stiffness(fabric, edges).min() == 0.0 and hinge_friction(fabric, edges).min() == 0.0
