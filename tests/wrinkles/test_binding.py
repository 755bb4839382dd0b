from __future__ import annotations

import numpy as np
import pytest

from assets.garment import boundary_loops
from assets.seams import Seams
from pbd import ClothMesh
from tests.assets.panels import two_panels
from tests.pbd.meshes import grid
from tests.wrinkles.delivered import delivered_levels, delivered_panels
from wrinkles.binding import Binding
from wrinkles.charts import Charts, fine_places, leading_vertices
from wrinkles.coarsening import PLACE_STEP, bind
from wrinkles.decoder import Upsampler
from wrinkles.levels import Levels
from wrinkles.patches import Patches
from wrinkles.surface import Subdivision


@pytest.fixture(scope="module")
def bound() -> tuple[np.ndarray, np.ndarray, np.ndarray, Subdivision]:
    """Delivered vertices, their faces, coarse vertices, the subdivision between them."""
    return delivered_panels()


@pytest.fixture(scope="module")
def levels(bound) -> Levels:
    return delivered_levels(*bound[2:])


def test_the_bound_surface_is_the_delivered_one(bound) -> None:
    vertices, _, coarse, subdivision = bound
    assert 40 <= len(coarse) <= 60
    assert subdivision.fine_count == len(vertices)
    offset = np.linalg.norm(subdivision.upsample(coarse) - vertices, axis=1)
    assert np.sqrt((offset**2).mean()) < 0.0005 and offset.max() < 0.006  # at the corners
    assert len(boundary_loops(subdivision.coarse_faces)) == 1


def test_places_are_rounded_as_a_file_holds_them(bound) -> None:
    binding = bound[3].binding
    steps = binding.place / PLACE_STEP
    assert np.array_equal(steps, np.round(steps))
    assert np.array_equal(binding.place.sum(axis=1), np.ones(len(steps)))
    assert np.array_equal(binding.flat, binding.flat.astype(np.float32))


def test_the_pattern_is_the_rest_shape_of_both_meshes(bound, levels: Levels) -> None:
    assert levels.fine.face_areas.sum() == pytest.approx(0.48 * 0.24, rel=1e-3)  # flat, though the arch is longer
    assert levels.coarse.face_areas.sum() == pytest.approx(levels.fine.face_areas.sum(), rel=0.005)
    edges, rest = levels.coarse.edge_lengths()
    ends = levels.coarse.vertices[edges]
    ratio = rest / np.linalg.norm(ends[:, 1, :2] - ends[:, 0, :2], axis=1)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.02)
    assert 0.7 < ratio.min() < ratio.max() < 1.4  # Loop's surface over uneven triangles is no affine map
    # A pattern is laid out upright: its second axis is the warp.
    side = levels.fine.flat[:, :, 0]
    corner = bound[0][bound[1]]
    assert np.abs(side[:, 0]) == pytest.approx(np.abs(corner[:, 1, 1] - corner[:, 0, 1]), abs=1e-4)


def test_places_lie_in_the_coarse_faces_that_carry_them(bound) -> None:
    _, _, coarse, subdivision = bound
    face, place = fine_places(subdivision)
    assert place.min() >= 0.0
    assert place.sum(axis=1) == pytest.approx(np.ones(len(place)))
    point = np.einsum("pc,pci->pi", place, coarse[subdivision.coarse_faces[face]])
    assert np.linalg.norm(point - bound[0], axis=1).max() < 0.02
    leading = leading_vertices(subdivision)
    near = np.linalg.norm(coarse[leading] - bound[0][:, None], axis=2)
    assert (near[:, 0] < 0.06).all()


def test_each_coarse_vertex_has_a_fine_one_beside_it(bound) -> None:
    vertices, _, coarse, subdivision = bound
    away = np.linalg.norm(vertices[subdivision.at_coarse] - coarse, axis=1)
    assert away.max() < 0.02
    plain = Subdivision.of(subdivision.coarse_faces, len(coarse), 2)
    assert np.array_equal(plain.at_coarse, np.arange(len(coarse)))


def test_two_sparse_steps_make_the_same_surface(bound) -> None:
    _, _, coarse, subdivision = bound
    position = np.concatenate([coarse, np.ones((len(coarse), 1))], axis=1).astype(np.float32)
    fine = np.zeros((subdivision.fine_count, 3), np.float32)
    Upsampler(subdivision)(position, fine)
    assert fine == pytest.approx(subdivision.upsample(coarse), abs=1e-6)


def test_what_is_seen_has_no_seam(bound) -> None:
    vertices, faces, _, subdivision = bound
    assert len(boundary_loops(faces)) == 2 and len(boundary_loops(subdivision.faces)) == 1
    assert np.array_equal(np.unique(subdivision.stands_for), np.unique(subdivision.faces))


def test_places_that_jump_do_not_make_the_surface_rough(bound) -> None:
    vertices, faces, coarse, subdivision = bound
    binding = subdivision.binding
    assert np.asarray(binding.smoothing.sum(axis=1)).ravel() == pytest.approx(1.0)
    linear = vertices @ [[0.7], [-0.2], [0.0]]
    inner = np.setdiff1d(np.arange(len(vertices)), np.concatenate(boundary_loops(faces)))
    noise = 0.001 * np.random.default_rng(0).standard_normal((len(vertices), 1))
    left = binding.smoothing @ (linear + noise) - linear
    assert np.abs(left[inner]).std() < 0.4 * noise.std()
    rim = np.concatenate(boundary_loops(subdivision.faces))
    assert np.array_equal((binding.smoothing @ noise)[rim], noise[rim])  # the hem keeps its length


def test_places_that_jump_are_found(bound) -> None:
    vertices, faces, coarse, subdivision = bound
    binding = subdivision.binding
    inner = np.setdiff1d(np.arange(len(vertices)), np.concatenate(boundary_loops(faces)))
    assert binding.crowded(vertices).mean() < 0.1
    moved, jumps = vertices.copy(), inner[len(inner) // 2]
    moved[jumps, 0] += 0.05
    found = binding.crowded(moved) & ~binding.crowded(vertices)
    assert found[jumps]
    away = np.linalg.norm(binding.flat - binding.flat[jumps], axis=1)
    edge = np.median(np.linalg.norm(vertices[faces[:, 1]] - vertices[faces[:, 0]], axis=1))
    assert found[away < 2.0 * edge].all() and not found[away > 8.0 * edge].any()
    some = np.zeros(len(vertices), bool)
    some[jumps] = True
    change = binding.smoothing_where(some) @ np.eye(len(vertices))
    stays = ~some & (binding.sewn.one == np.arange(len(vertices)))
    assert np.array_equal(change[stays], np.eye(len(vertices))[stays]) and change[jumps, jumps] < 0.2


def test_the_levels_of_a_bound_mesh(bound, levels: Levels) -> None:
    vertices, faces, _, subdivision = bound
    assert np.array_equal(levels.fine.faces, faces)
    assert np.array_equal(levels.fine.stitches, subdivision.binding.stitches)
    assert len(levels.coarse.stitches) == 0
    held = levels.fine.vertices[levels.fine_held]
    assert len(held) and held[:, 0].max() < 0.03
    # The filter takes the surface that it is given back to its coarse vertices, but for folds.
    assert levels.filter_down(levels.fine.vertices[None])[0] == pytest.approx(levels.coarse.vertices, abs=0.01)


@pytest.mark.parametrize(("first", "second"), [(6, 6), (6, 4), (4, 6), (7, 5)])
def test_seams_bend_like_cloth(first: int, second: int) -> None:
    """The rows of their hinges give edge length times fold angle, and nothing for a sheet that is only tilted."""
    vertices, faces, seams = two_panels(3, first, second)
    nothing = np.zeros(len(vertices), np.int32), np.zeros((len(vertices), 3))
    mesh = Binding(*nothing, faces, vertices[:, :2], seams.vertices, seams.weights).mesh(vertices)
    assert mesh.seam_hinges is not None
    hinges, rows, areas, angle = mesh.seam_hinges
    ends = vertices[hinges[:, :2]]
    assert ends[:, :, 0] == pytest.approx(0.24)  # all on the seam, and the whole of it
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert lengths.sum() == pytest.approx(0.24)
    assert areas.min() > 0.0 and np.abs(np.sin(angle)) == pytest.approx(0.0, abs=1e-9)  # along the warp
    tilted = 0.3 * vertices[:, 0] - 0.7 * vertices[:, 1] + 0.1
    assert (rows * tilted[hinges]).sum(axis=1) == pytest.approx(0.0, abs=1e-9)
    folded = 0.01 * np.abs(vertices[:, 0] - 0.24)
    assert np.abs((rows * folded[hinges]).sum(axis=1)) == pytest.approx(0.02 * lengths, rel=1e-6)


def test_wrinkles_of_the_middle_mesh_reach_every_fine_vertex(levels: Levels) -> None:
    subdivision = levels.subdivision
    assert subdivision.from_middle.shape == (len(levels.fine.vertices), subdivision.middle.fine_count)
    assert np.asarray(subdivision.from_middle.sum(axis=1)).ravel() == pytest.approx(1.0)
    both = subdivision.from_middle @ (subdivision.to_middle @ levels.coarse.vertices)
    assert both == pytest.approx(subdivision.upsample(levels.coarse.vertices), abs=1e-9)
    for mesh in (subdivision, subdivision.middle):
        patches = Patches.of(mesh, Charts.of(levels.coarse))
        assert len(patches.corners) == mesh.fine_count and patches.blend.sum(axis=1) == pytest.approx(1.0)


def angle_defects(mesh: ClothMesh) -> np.ndarray:
    """What the angles around inner vertices lack to a full turn in the rest shape [rad]."""
    corner = np.concatenate([np.zeros((len(mesh.faces), 1, 2)), mesh.flat.transpose(0, 2, 1)], axis=1)
    one, other = np.roll(corner, -1, axis=1) - corner, np.roll(corner, 1, axis=1) - corner
    cross = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    total = np.bincount(mesh.faces.ravel(), np.arctan2(cross, (one * other).sum(axis=2)).ravel())
    inner = np.setdiff1d(np.arange(len(total)), np.concatenate(boundary_loops(mesh.faces)))
    return 2.0 * np.pi - total[inner]


def test_the_coarse_rest_shape_is_as_flat_as_the_pattern(levels: Levels) -> None:
    assert np.degrees(np.abs(angle_defects(levels.coarse))).max() < 15.0
    assert np.median(np.abs(angle_defects(levels.coarse))) < 1e-9  # only where the seam is does it give


def test_a_panel_that_is_sewn_to_itself_closes_to_a_tube() -> None:
    """Its ends lie far apart in the pattern, and side by side on the body."""
    around, along, radius = 48, 24, 0.1
    flat, faces = grid(around, along, 1.0)
    flat = flat[:, :2] * [2.0 * np.pi * radius / around, 0.3 / along]
    turn = flat[:, 0] / radius
    vertices = np.stack([radius * np.sin(turn), flat[:, 1], radius * np.cos(turn)], axis=1)
    first = np.arange(along + 1)
    last = around * (along + 1) + first
    side = np.where(first < along, first + 1, first - 1)
    seams = Seams(np.stack([last, first, side], axis=1).astype(np.int32), np.zeros(along + 1))
    coarse, subdivision = bind(vertices, faces, flat, seams, 120, 2)
    assert len(boundary_loops(subdivision.coarse_faces)) == 2
    mesh, fine = subdivision.meshes(coarse)
    edges, rest = mesh.edge_lengths()
    chord = np.linalg.norm(coarse[edges[:, 0]] - coarse[edges[:, 1]], axis=1)
    assert 0.8 < (rest / chord).min() < (rest / chord).max() < 1.25
    assert mesh.face_areas.sum() == pytest.approx(fine.face_areas.sum(), rel=0.03)
    assert np.degrees(np.abs(angle_defects(mesh))).max() < 12.0
