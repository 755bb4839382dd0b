"""References against published values, limits, and each other."""

import math

import numpy as np
import pytest

from precompute.validation.drape_model import cone_load, fold_count, least_energy_cone, n_fold_cone
from precompute.validation.plate_references import hencky_rise, lateral_gamma
from precompute.validation.strip_references import (
    cantilever,
    cantilever_gamma,
    capstan_ratio,
    cusick_estimate,
    elastic_catenary,
    first_slip,
    hanging_stretch,
    off_axis,
    pressed_strip,
    swing_period,
    tall_column,
    upright_gamma,
)


@pytest.mark.parametrize(
    ("gamma", "slope"),
    [(0.1, 0.0124996), (1, 0.1245618), (3, 0.3646208), (10, 1.0668023), (30, 2.5472139), (100, 5.8881046)],
)
def test_cantilever(gamma: float, slope: float) -> None:
    assert cantilever(gamma).height_over_width == pytest.approx(slope, abs=5e-8)


def test_cantilever_is_as_long_as_it_was_and_bends_little_under_little_weight() -> None:
    bent = cantilever(30.0)
    assert np.hypot(np.diff(bent.x), np.diff(bent.y)).sum() == pytest.approx(1.0, abs=1e-4)
    assert cantilever(1e-3).height_over_width == pytest.approx(1e-3 / 8, rel=1e-5)  # w L^4 / (8 B)
    assert cantilever(1000.0).height_over_width == pytest.approx(21.33544, abs=1e-4)


def test_gamma_from_the_slope_is_the_inverse() -> None:
    for gamma in (0.05, 7.0, 200.0):
        assert cantilever_gamma(cantilever(gamma).height_over_width) == pytest.approx(gamma, rel=1e-6)


def test_upright_strip_tips_over_where_a_small_side_load_throws_it() -> None:
    assert upright_gamma() == pytest.approx(7.837347, abs=5e-7)
    assert tall_column(1e-3, 1.0) == pytest.approx(1e-3 / 8, rel=1e-3)
    assert tall_column(7.8373, 1.0) > 1e3 * tall_column(4.0, 1.0)


@pytest.mark.parametrize(
    ("friction", "lowering", "tip_deg", "pressure"),
    [(0.05, 0.0123805, 15.94343, 20.284941), (0.35, 0.3239935, 88.938833, 22.562811)],
)
def test_first_slip(friction: float, lowering: float, tip_deg: float, pressure: float) -> None:
    found = first_slip(friction)
    assert found is not None
    assert found.lowering == pytest.approx(lowering, abs=1e-6)
    assert math.degrees(found.tip_angle) == pytest.approx(tip_deg, abs=1e-4)
    assert found.pressure == pytest.approx(pressure, abs=1e-4)


def test_a_pressed_strip_ends_under_its_clamp() -> None:
    shape = pressed_strip(math.radians(10.0))
    assert shape[-1] == pytest.approx([0.0, 0.0]) and shape[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert np.hypot(*np.diff(shape, axis=0).T).sum() == pytest.approx(1.0, abs=1e-4)


def test_strips_that_do_not_bend() -> None:
    assert swing_period() == pytest.approx(5.225481, abs=5e-7)
    assert capstan_ratio(0.2, math.pi) == pytest.approx(1.87446, abs=1e-5)
    assert hanging_stretch(1.5, 1500.0) == pytest.approx(5e-4)


def test_catenary() -> None:
    """Without stretch a span of 2 a sinh(1/(2 a)) sags by a (cosh(1/(2 a)) - 1) and so on, a = 0.3."""
    a = 0.3
    half = a * math.asinh(0.5 / a)
    sag, x, y = elastic_catenary(2.0 * half, 1.0)
    assert sag == pytest.approx(a * (math.cosh(half / a) - 1.0), rel=1e-9)
    assert x[-1] == pytest.approx(half) and y[-1] == pytest.approx(sag)
    # Taut: the pull stretches it to the span; sag w / (8 H), H = EA (span - 1).
    taut, _, _ = elastic_catenary(1.01, 1.0, 1e4)
    assert taut == pytest.approx(1.0 / (8.0 * 100.0), rel=0.02)


def test_off_axis_by_the_formula_at_45_degrees() -> None:
    e1, e2, g, nu = 20.0, 10.0, 4.0, 0.2
    assert off_axis(e1, e2, g, nu, 0.0) == pytest.approx((e1, nu))
    assert off_axis(e1, e2, g, nu, 0.5 * math.pi) == pytest.approx((e2, nu * e2 / e1))
    assert off_axis(e1, e2, g, nu, 0.25 * math.pi)[0] == pytest.approx(4.0 / (1 / e1 + 1 / e2 + 1 / g - 2 * nu / e1))


@pytest.mark.parametrize(("length_cm", "percent"), [(1.5, 16.8), (2.0, 30.9), (2.8, 60.5)])
def test_cusick_by_radial_strips(length_cm: float, percent: float) -> None:
    assert 100.0 * cusick_estimate(0.01 * length_cm) == pytest.approx(percent, abs=0.05)


@pytest.mark.parametrize(
    ("poisson", "width", "by_plate"), [(0.0, 0.1, 19.3547), (0.3, 0.2, 17.0030), (0.5, 0.5, 18.0163)]
)
def test_lateral_buckling(poisson: float, width: float, by_plate: float) -> None:
    """By D, as other Ritz sums gave it; those agree among themselves to 6e-4."""
    assert lateral_gamma(width, poisson) * (1.0 - poisson**2) == pytest.approx(by_plate, rel=2.5e-3)


def test_round_membrane() -> None:
    """0.653 for nu = 0.3 (Hencky 1915, corrected by Chien 1948)."""
    assert hencky_rise(0.3) == pytest.approx(0.6534, abs=2e-4)
    assert hencky_rise(0.2) > hencky_rise(0.4)


@pytest.mark.parametrize(
    ("load", "folds", "energy", "drop"),
    [(1.0, 2, -0.74909, 0.2283), (9.884, 3, -24.6113, 0.6354), (97.69, 5, -440.71581, 0.9143)],
)
def test_n_fold_cone(load: float, folds: int, energy: float, drop: float) -> None:
    cone = n_fold_cone(folds, load)
    assert cone.free
    assert cone.energy == pytest.approx(energy, rel=1e-3) and cone.drop == pytest.approx(drop, abs=2e-4)
    assert np.linalg.norm(cone.curve, axis=1) == pytest.approx(np.ones(len(cone.curve)), abs=1e-3)


def test_folds_of_least_energy() -> None:
    assert [least_energy_cone(load).folds for load in (3.953, 9.884)] == [2, 3]


def test_load_and_scaling_of_a_disc() -> None:
    assert cone_load(0.12, 0.024, 0.02) == pytest.approx(216.0 / (3.0 * math.log(5.0)))
    assert fold_count(16.0, math.e) == pytest.approx(8.0)
