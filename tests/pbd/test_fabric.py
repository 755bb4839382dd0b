"""Fabrics: elasticity, and every bad value refused."""

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pbd import Fabric, InputError
from pbd.fabric import MAX_STIFFENING_STRAIN, stiffening_stress
from tests.refusals import refuses

stiffness = st.floats(1e-2, 1e5)
MAY_BE_ZERO = (
    "compression", "poisson", "friction", "air_drag", "bend_warp", "bend_weft", "bend_hysteresis_warp",
    "bend_hysteresis_weft", "shear_hysteresis",
)  # fmt: skip


@given(stiffness, stiffness, stiffness, st.floats(0.0, 0.95))
def test_elasticity_is_symmetric_and_positive_definite(warp: float, weft: float, shear: float, share: float) -> None:
    poisson = share * math.sqrt(warp / weft)
    matrix = Fabric(stretch_warp=warp, stretch_weft=weft, shear=shear, poisson=poisson).membrane_stiffness()
    assert np.array_equal(matrix, matrix.T)
    assert matrix.diagonal().min() > 0 and matrix[0, 0] * matrix[1, 1] > matrix[0, 1] ** 2
    # Tension along the warp alone: strain 1/E1 along it, -nu12/E1 across; the other way with nu21 = nu12 E2/E1.
    compliance = np.linalg.inv(matrix)
    assert compliance[0, 0] == pytest.approx(1 / warp) and compliance[1, 1] == pytest.approx(1 / weft)
    # Numbers too small for full precision are below the absolute bound.
    assert compliance[1, 0] == pytest.approx(-poisson / warp, rel=1e-12, abs=1e-300)
    assert compliance[2, 2] == pytest.approx(1 / shear)


@pytest.mark.parametrize("name", [field.name for field in fields(Fabric)])
@pytest.mark.parametrize("value", [-1e-9, math.nan, math.inf, "2", None, True, 1j])
def test_a_bad_value_is_refused(name: str, value: Any) -> None:
    refuses(f"fabric.{name}", Fabric, **{name: value})


@pytest.mark.parametrize("name", [field.name for field in fields(Fabric)])
def test_zero_is_refused_where_nothing_would_be_left(name: str) -> None:
    if name in MAY_BE_ZERO:
        Fabric(**{name: 0.0})
    else:
        refuses(f"fabric.{name}", Fabric, **{name: 0.0})


def test_all_bad_values_are_named_at_once() -> None:
    said = refuses("", Fabric, areal_density=0.0, shear=math.nan, friction=-1.0)
    text = said
    assert all(name in text for name in ("areal_density", "shear", "friction")) and "thickness" not in text


def test_an_elasticity_that_gives_energy_is_refused() -> None:
    Fabric(stretch_warp=100.0, stretch_weft=400.0, poisson=0.49)
    refuses(r"poisson.*sqrt\(E1/E2\) = 0.5", Fabric, stretch_warp=100.0, stretch_weft=400.0, poisson=0.51)


def test_gravity_length() -> None:
    fabric = Fabric(areal_density=0.2, bend_warp=4e-5, bend_weft=1e-5)
    assert fabric.gravity_length == pytest.approx((2e-5 / (0.2 * 9.81)) ** (1 / 3))


KNIT = Fabric(stiffening_warp_10=3.0, stiffening_warp_20=6.0, stiffening_weft_10=2.0, stiffening_weft_20=2.5)


def test_a_fabric_does_not_stiffen_unless_told() -> None:
    assert not Fabric().stiffening().any()


def test_tension_at_10_and_20_percent_is_what_the_fabric_says() -> None:
    strain = np.array([0.1, 0.2])
    for law, ratios in zip(KNIT.stiffening(), ([3.0, 6.0], [2.0, 2.5]), strict=True):
        assert 1.0 + stiffening_stress(strain, law)[1] / strain == pytest.approx(ratios)


@pytest.mark.parametrize(
    "law", [*KNIT.stiffening(), Fabric(stiffening_warp_10=1.2, stiffening_warp_20=1.1).stiffening()[0]]
)
def test_tension_is_the_slope_of_its_energy_and_has_a_smooth_slope_itself(law: np.ndarray) -> None:
    strain = np.linspace(-0.1, 0.6, 1401)
    energy, stress, tangent = stiffening_stress(strain, law)
    step = strain[1] - strain[0]
    np.testing.assert_allclose(np.gradient(energy, step)[1:-1], stress[1:-1], atol=2e-4 * np.abs(stress).max())
    np.testing.assert_allclose(np.gradient(stress, step)[1:-1], tangent[1:-1], atol=5e-3 * np.abs(tangent).max())
    assert not energy[strain <= 0.0].any() and not tangent[strain <= 0.0].any()
    assert (np.diff(strain + stress) > 0.0).all()  # monotone
    assert np.ptp(tangent[strain > MAX_STIFFENING_STRAIN]) == 0.0


@pytest.mark.parametrize(("ten", "twenty"), [(2.0, 1.6), (0.2, 1.0), (1.0, 0.5)])
def test_tension_that_falls_with_strain_is_refused(ten: float, twenty: float) -> None:
    with pytest.raises(InputError, match=r"fabric.stiffening_weft_10, _20.*tension that rises"):
        Fabric(stiffening_weft_10=ten, stiffening_weft_20=twenty)
