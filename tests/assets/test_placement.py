"""Units and axes that are guessed: every unit and either axis is found again, and what is not worn is told apart."""

from __future__ import annotations

import numpy as np
import pytest

from assets.character import load_character
from assets.garment import load_garment
from assets.placement import AS_STORED, UNITS, Placement, best_placement, body_placement, fit_of

BODY = load_character("builtin:mannequin")
SHIRT = load_garment("builtin:tshirt")
Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # from Y up


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("axes", ["Y up", "Z up"])
def test_the_unit_and_the_axes_of_a_body_are_found_by_its_height(unit: str, axes: str) -> None:
    stored = BODY.vertices / UNITS[unit]
    assert body_placement(stored if axes == "Y up" else stored @ Z_UP.T) == Placement(unit, axes)


def test_a_body_of_no_size_is_none() -> None:
    assert body_placement(BODY.vertices * 1e-4) is None
    assert body_placement(BODY.vertices * 1e5) is None


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("axes", ["Y up", "Z up"])
def test_the_unit_and_the_axes_of_a_garment_are_those_in_which_the_body_wears_it(unit: str, axes: str) -> None:
    stored = SHIRT.vertices / UNITS[unit]
    stored = stored if axes == "Y up" else stored @ Z_UP.T
    placement, fit = best_placement(stored, SHIRT.faces, BODY.vertices, BODY.faces)
    assert placement == Placement(unit, axes)
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
