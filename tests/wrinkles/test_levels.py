from __future__ import annotations

import pickle

import numpy as np
import pytest

from pbd import InputError
from pbd.distance import BodyDistance
from tests.pbd.meshes import grid
from tests.refusals import refuses
from tests.runtime.players import skirt_stage
from tests.wrinkles.meshes import flat_sheet, icosphere, tube
from wrinkles.charts import fine_places
from wrinkles.levels import Levels, build_levels

NOBODY = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
EDGE = 0.05


@pytest.fixture(scope="module")
def sheet() -> Levels:
    """A free flat sheet in the x-y plane of regular faces."""
    return build_levels(*grid(40, 40, EDGE, "equilateral"), np.array([], int), *NOBODY, 2)


def wave(levels: Levels, wavelength: float, axis: int) -> np.ndarray:
    """A fold across the sheet: its shape at the fine vertices, shape (N,)."""
    return np.sin(2 * np.pi / wavelength * levels.fine.vertices[:, axis] + 0.3)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    ("waves", "tolerance"), [(1 / 3, 0.0), (0.5, 0.0), (2 / 3, 0.06), (1.0, 0.05), (1.5, 0.025), (3.0, 0.01)]
)
def test_the_filter_halves_folds_of_the_cutoff_wavelength(
    sheet: Levels, waves: float, tolerance: float, axis: int
) -> None:
    assert sheet.cutoff == pytest.approx(3 * EDGE, rel=0.01)
    shape = wave(sheet, waves * sheet.cutoff, axis)
    fine = sheet.fine.vertices.copy()
    fine[:, 2] += 0.003 * shape
    height = sheet.subdivision.upsample(sheet.filter_down(fine[None])[0])[:, 2]
    centre = sheet.fine.vertices[:, :2] - sheet.fine.vertices[:, :2].mean(axis=0)
    middle = np.exp(-((centre / 0.25) ** 2).sum(axis=1))  # away from the rim
    response = (middle * height * shape).sum() / (middle * shape**2).sum() / 0.003
    law = 1 / (1 + waves**-4.0)
    if waves * sheet.cutoff < 2 * EDGE:  # the coarse mesh cannot hold such folds
        assert -1e-3 < response < law
    else:
        assert response == pytest.approx(law, abs=tolerance)


def test_the_filter_is_linear_over_frames_and_moves_along(sheet: Levels) -> None:
    rng = np.random.default_rng(0)
    fine = sheet.fine.vertices + 0.01 * rng.standard_normal((2, len(sheet.fine.vertices), 3))
    both = sheet.filter_down(fine)
    assert both.shape == (2, len(sheet.coarse.vertices), 3)
    np.testing.assert_allclose(both[1], sheet.filter_down(fine[1:])[0], atol=1e-12)
    np.testing.assert_allclose(sheet.filter_down(fine + [1.0, -2.0, 0.5]), both + [1.0, -2.0, 0.5], atol=1e-10)
    np.testing.assert_allclose(sheet.filter_down(3.0 * fine), 3.0 * both, atol=1e-10)


def test_held_vertices_keep_their_places_in_the_filter() -> None:
    vertices, faces = grid(16, 16, EDGE, "equilateral")
    held = np.arange(17)
    free = build_levels(vertices, faces, held[:0], *NOBODY, 2)
    levels = build_levels(vertices, faces, held, *NOBODY, 2)
    fine = levels.fine.vertices.copy()
    fine[:, 2] += 0.01 * wave(levels, levels.cutoff, 1)
    off = lambda which: np.abs(which.filter_down(fine[None])[0] - fine[: len(vertices)])[held].max()  # noqa: E731
    assert off(levels) < 2e-4 and off(free) > 3e-3


def test_the_filter_leaves_a_tube_as_it_is() -> None:
    levels = build_levels(*tube(18), np.array([], int), *NOBODY, 2)
    down, height = levels.filter_down(levels.fine.vertices[None])[0], levels.coarse.vertices[:, 1]
    inner = (height > 0.25) & (height < height.max() - 0.25)  # its rims are zigzags, which are smoothed away
    assert inner.sum() > 200
    assert np.linalg.norm(down - levels.coarse.vertices, axis=1)[inner].max() < 1.5e-3


@pytest.mark.parametrize("subdivisions", [1, 2, 3])
def test_fine_vertices_are_held_between_held_coarse_ones_only(subdivisions: int) -> None:
    vertices, faces = flat_sheet(6, 1.0, jitter=0.3)
    face = faces[len(faces) // 2]
    held = np.union1d(np.flatnonzero(vertices[:, 0] < 1e-9), face)  # one side, and one face inside
    levels = build_levels(vertices, faces, held[::-1], *NOBODY, subdivisions)
    assert np.array_equal(levels.coarse_held, held)
    place, weights = fine_places(levels.subdivision)
    share = (weights * np.isin(faces[place], held)).sum(axis=1)
    assert np.array_equal(levels.fine_held, np.flatnonzero(share > 1 - 1e-12))
    pieces = 2**subdivisions
    inside_face = (pieces + 1) * (pieces + 2) // 2
    assert len(levels.fine_held) >= 5 * pieces + 1 + inside_face
    assert not np.isin(levels.fine_held, np.flatnonzero(share < 0.99)).any()


def test_attached_vertices_start_outside_the_body_and_ride_on_it() -> None:
    stage = skirt_stage()
    levels, body = stage.levels, stage.body
    distance = BodyDistance(body.faces)
    assert len(levels.coarse_held) > 10 and len(levels.fine_held) == 2 * len(levels.coarse_held)
    for mesh, held, attachment in (
        (levels.coarse, levels.coarse_held, levels.coarse_attachment),
        (levels.fine, levels.fine_held, levels.fine_attachment),
    ):
        assert distance.signed_distance(mesh.vertices[held], body.vertices).min() >= 0.002
        assert distance.signed_distance(mesh.vertices, body.vertices).min() > 0.0
        np.testing.assert_allclose(attachment.targets(body.vertices), mesh.vertices[held], atol=1e-12)
        moved = attachment.targets(body.vertices + [0.3, -0.1, 0.2])
        np.testing.assert_allclose(moved, mesh.vertices[held] + [0.3, -0.1, 0.2], atol=1e-9)


def test_a_garment_that_starts_inside_the_body_is_pushed_out() -> None:
    body_vertices, body_faces = icosphere(3, 0.2)
    vertices, faces = icosphere(3, 0.195)
    above = faces[(vertices[faces, 1] > -0.05).all(axis=1)]
    used, faces = np.unique(above, return_inverse=True)
    vertices, faces = vertices[used], faces.reshape(-1, 3).astype(np.int32)
    levels = build_levels(vertices, faces, np.array([0]), body_vertices, body_faces, 1)
    distance = BodyDistance(body_faces)
    for mesh in (levels.coarse, levels.fine):
        depth = distance.signed_distance(mesh.vertices, body_vertices)
        assert depth.min() >= 0.002 and depth.max() < 0.01
    assert levels.coarse.face_areas.sum() == pytest.approx(levels.fine.face_areas.sum(), rel=0.005)


@pytest.mark.parametrize("subdivisions", [-1, 0, 5])
def test_bad_numbers_of_subdivisions_are_refused(subdivisions: int) -> None:
    with pytest.raises(InputError, match=rf"subdivisions.*received {subdivisions}.*1\.\.4"):
        build_levels(*flat_sheet(4, 1.0), np.array([], int), *NOBODY, subdivisions)


def test_meshes_too_coarse_for_their_shape_are_refused() -> None:
    refuses(r"differ in area.*0\.8", build_levels, *icosphere(0), np.array([], int), *NOBODY, 2)


def test_levels_go_to_another_process_without_their_factors(sheet: Levels) -> None:
    fine = sheet.fine.vertices[None].astype(np.float32)
    before = sheet.filter_down(fine)  # makes the factors, which cannot be pickled
    other = pickle.loads(pickle.dumps(sheet))  # noqa: S301
    assert "_filter" not in vars(other) and other.cutoff == sheet.cutoff
    assert np.array_equal(other.filter_down(fine), before)


def test_the_cutoff_follows_the_mesh() -> None:
    levels = [build_levels(*grid(8, 8, edge, "equilateral"), np.array([], int), *NOBODY, 1) for edge in (0.01, 0.04)]
    assert levels[0].cutoff == pytest.approx(0.25 * levels[1].cutoff) == pytest.approx(0.03, rel=0.01)
