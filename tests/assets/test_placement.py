"""Units and axes that are guessed: every unit and either axis is found again, and what is not worn is told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.body_checks import UNITS
from assets.garment import highest_loop
from assets.loading import load_character, load_garment
from assets.placement import AS_STORED, FilePlacement, best_placement, body_placement, check_worn, fit_of
from pbd.errors import InputError
from tests.wrinkles.meshes import flat_sheet, icosphere

BODY = load_character("builtin:mannequin")
SHIRT = load_garment("builtin:tshirt")
Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # from Y up


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("axes", ["Y up", "Z up"])
def test_the_unit_and_the_axes_of_a_body_are_found_by_its_height(unit: str, axes: str) -> None:
    stored = BODY.vertices / UNITS[unit]
    assert body_placement(stored if axes == "Y up" else stored @ Z_UP.T) == FilePlacement(unit, axes)


def test_a_body_of_no_size_is_none() -> None:
    assert body_placement(BODY.vertices * 1e-4) is None
    assert body_placement(BODY.vertices * 1e5) is None


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("axes", ["Y up", "Z up"])
def test_the_unit_and_the_axes_of_a_garment_are_those_in_which_the_body_wears_it(unit: str, axes: str) -> None:
    stored = SHIRT.vertices / UNITS[unit]
    stored = stored if axes == "Y up" else stored @ Z_UP.T
    placement, fit = best_placement(stored, SHIRT.faces, BODY.vertices, BODY.faces)
    assert placement == FilePlacement(unit, axes)
    assert fit is not None and fit.is_worn
    np.testing.assert_allclose(stored @ placement.matrix.T, SHIRT.vertices, atol=1e-9)


def test_a_garment_elsewhere_is_left_as_it_is_stored() -> None:
    placement, fit = best_placement(SHIRT.vertices + [2.0, 0.0, 0.0], SHIRT.faces, BODY.vertices, BODY.faces)
    assert placement == AS_STORED
    assert fit is not None and not fit.is_around
    assert 1.0 < fit.gap < 2.0


def test_a_garment_that_is_too_small_starts_inside_the_body() -> None:
    middle = SHIRT.vertices.mean(axis=0)
    fit = fit_of(middle + 0.8 * (SHIRT.vertices - middle), SHIRT.faces, BODY.vertices, BODY.faces)
    assert fit.is_around and not fit.is_worn
    assert fit.deep_share > 0.01


NOTHING = np.zeros(0, np.int64)


@pytest.mark.parametrize(
    ("body", "garment", "whose"),
    [
        (
            0.01,
            1.0,
            "body of another unit .*a body 0.017 m tall', expected a body 100 times as large: then the garment is worn",
        ),
        (
            0.1,
            1.0,
            r"body of another unit .*received 'a garment of 0\.\d+ m and a body 0\.17 m tall', expected a body 10 ",
        ),
        (1.0, 10.0, r"garment of another unit .*expected a garment 0\.1 times as large: then the garment is worn"),
        (1.0, 0.1, "garment of another unit .*expected a garment 10 times as large"),
    ],
)
def test_a_unit_in_which_one_would_wear_the_other_is_refused(body: float, garment: float, whose: str) -> None:
    other = replace(SHIRT, vertices=garment * SHIRT.vertices)
    with pytest.raises(InputError, match=rf"garment\[0\]\.mesh: a {whose}"):
        check_worn(other, NOTHING, body * BODY.vertices, BODY.faces, "garment[0].mesh")


def test_what_a_body_carries_is_near_it() -> None:
    carried = highest_loop(SHIRT.vertices, SHIRT.faces).astype(np.int64)
    away = replace(SHIRT, vertices=SHIRT.vertices + [0.0, 0.0, 2.0])
    with pytest.raises(
        InputError, match=r"nowhere near the body that carries it \(received '1\.\d\d m from a body 1\.7 m"
    ):
        check_worn(away, carried, BODY.vertices, BODY.faces, "garment[0].mesh")
    check_worn(away, NOTHING, BODY.vertices, BODY.faces, "garment[0].mesh")  # cloth may fall on a body from afar
    check_worn(SHIRT, carried, BODY.vertices, BODY.faces, "garment[0].mesh")


def test_cloth_on_bodies_that_are_no_people_passes() -> None:
    vertices, faces = flat_sheet(12, 0.6)
    cloth = replace(SHIRT, vertices=vertices - [0.3, 0.0, 0.3], faces=faces)
    for radius in (0.02, 0.08, 0.17, 0.3, 2.0):
        ball, ball_faces = icosphere(2, radius)
        check_worn(cloth, NOTHING, ball - [0.0, radius + 0.01, 0.0], ball_faces, "garment[0].mesh")
    ball, ball_faces = icosphere(2, 0.08)
    post = ball * [1.0, 6.0, 1.0] - [0.0, 0.49, 0.0]
    check_worn(cloth, NOTHING, post, ball_faces, "garment[0].mesh")
