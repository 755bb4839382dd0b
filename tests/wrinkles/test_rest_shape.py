from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbd import ClothMesh, Fabric, InputError
from pbd.bending import bends_of
from pbd.mesh import hinges_of
from pbd.model import build_model
from tests.pbd.meshes import grid
from tests.refusals import refuses
from wrinkles.rest_shape import MAX_BEND_ANGLE, MIN_SIDE_RATIO, RestShapeCorrection


@pytest.fixture
def sheet() -> ClothMesh:
    vertices, faces = grid(6, 5, 0.1)
    return ClothMesh.from_surface(vertices, faces, (1.0, 0.0, 0.0))


def lengths(mesh: ClothMesh) -> np.ndarray:
    """Of the sides of each flat face [m], shape (m, 3)."""
    one, two = mesh.flat[:, :, 0], mesh.flat[:, :, 1]
    return np.stack([np.linalg.norm(side, axis=1) for side in (one, two - one, two)], axis=1)


def sides(mesh: ClothMesh, positions: np.ndarray) -> np.ndarray:
    a, b, c = (positions[:, mesh.faces[:, corner]] for corner in range(3))
    return np.stack([np.linalg.norm(p - q, axis=2).mean(axis=0) for p, q in ((b, a), (c, b), (c, a))], axis=1)


def test_faces_become_as_narrow_as_they_are_on_average(sheet: ClothMesh) -> None:
    along = np.array([1.0, 1.0, 1.0])
    along[np.ptp(sheet.vertices, axis=0).argmax()] = 0.6  # gathered along one axis, by half of what is gathered
    positions = np.stack([sheet.vertices * along, sheet.vertices])
    rest_shape = RestShapeCorrection.of(sheet, positions)
    stretch = rest_shape.stretch
    assert stretch.dtype == rest_shape.bends.dtype == np.float32 and stretch.shape == (len(sheet.faces), 3)
    assert lengths(rest_shape.applied(sheet)) == pytest.approx(sides(sheet, positions), rel=1e-5)
    # The sheet's warp stays the warp: what is left of a side that lies along an axis is told by that axis alone.
    assert stretch[:, 1] == pytest.approx(0.0, abs=0.05)
    assert sorted({round(float(v), 2) for v in stretch[:, [0, 2]].ravel()}) == [0.8, 1.0]


def test_stretched_cloth_keeps_its_rest_shape_and_crushed_cloth_some_of_it(sheet: ClothMesh) -> None:
    stretched = RestShapeCorrection.of(sheet, 1.3 * sheet.vertices[None])
    assert stretched.stretch == pytest.approx(RestShapeCorrection.none(sheet.faces).stretch, abs=1e-6)
    crushed = RestShapeCorrection.of(sheet, 0.01 * sheet.vertices[None]).applied(sheet)
    assert lengths(crushed) == pytest.approx(MIN_SIDE_RATIO * lengths(sheet), rel=1e-5)


def test_hinges_rest_as_bent_as_they_are_on_average_but_not_sharply(sheet: ClothMesh) -> None:
    """A wave that is there half of the time, in the rest shape that its own gathers leave."""
    x = sheet.vertices[:, 0]
    waving, sharp = sheet.vertices.copy(), sheet.vertices.copy()
    waving[:, 2] += 0.01 * np.sin(x / 0.1)
    sharp[:, 2] += 1.0 * np.cos(x / 0.1 * np.pi)  # a fold at each row
    rest_shape = RestShapeCorrection.of(sheet, np.stack([waving, sheet.vertices]))
    wanted = bends_of(rest_shape.applied(sheet), np.stack([waving, sheet.vertices])).mean(axis=0)
    assert rest_shape.bends == pytest.approx(wanted, abs=1e-6)
    assert np.abs(rest_shape.bends).max() > 1e-3
    ends = sheet.vertices[hinges_of(sheet.faces)[:, :2]]
    most = MAX_BEND_ANGLE * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    bends = np.abs(RestShapeCorrection.of(sheet, sharp[None]).bends)
    assert (bends <= 1.001 * most).all() and (bends > 0.99 * most).any()


def test_gathered_cloth_weighs_what_it_did_and_pulls_as_hard(sheet: ClothMesh) -> None:
    """Half as wide across the warp: all of it still hangs along the warp."""
    narrow = sheet.vertices * [1.0, 0.5, 1.0]
    mesh = RestShapeCorrection.of(sheet, narrow[None]).applied(sheet)
    assert mesh.face_areas == pytest.approx(0.5 * sheet.face_areas, rel=1e-5)
    one, other = (build_model(m, Fabric(), bend_factor=1.0) for m in (sheet, mesh))
    assert other.mass == pytest.approx(one.mass)
    softness = [m.triangle_data[8, : len(m.triangles)] / m.triangle_data[7, : len(m.triangles)] for m in (one, other)]
    assert np.sort(softness[1]) == pytest.approx(np.sort(softness[0]), rel=1e-5)


def test_areas_of_cloth_that_do_not_belong_to_the_mesh_are_refused(sheet: ClothMesh) -> None:
    with pytest.raises(InputError, match=f"cloth_areas: bad areas.*\\({len(sheet.faces)},\\)"):
        replace(sheet, cloth_areas=np.ones(len(sheet.faces) - 1))
    refuses("cloth_areas: bad areas.*above 0", replace, sheet, cloth_areas=np.zeros(len(sheet.faces)))


def test_without_gathers_nothing_changes(sheet: ClothMesh) -> None:
    mesh = RestShapeCorrection.none(sheet.faces).applied(sheet)
    assert np.array_equal(mesh.flat, sheet.flat)
    assert not np.any(mesh.rest_bends)
    assert RestShapeCorrection.none(sheet.faces).figures(sheet.vertices, sheet.faces) == (1.0, 0.0)


def test_figures_tell_how_narrow_and_how_bent_it_rests(sheet: ClothMesh) -> None:
    hinges = hinges_of(sheet.faces)
    lengths = np.linalg.norm(np.diff(sheet.vertices[hinges[:, :2]], axis=1)[:, 0], axis=1)
    rest_shape = RestShapeCorrection(np.tile([0.9, 0.1, 0.5], (len(sheet.faces), 1)), np.radians(20.0) * lengths)
    assert rest_shape.figures(sheet.vertices, sheet.faces) == pytest.approx((0.44, 20.0))
