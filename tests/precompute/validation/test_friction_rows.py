"""Rows about internal friction: their references, and what the default solver passes."""

import math

import numpy as np
import pytest

from precompute.experiment.sheets import level
from precompute.validation.friction_rows import _folded, _mode, _most_curved, _peaks
from precompute.validation.trial import TrialSetting, strip
from precompute.validation.validation import ROWS

ROOT = 1.875104068711961


def test_the_first_mode_of_a_clamped_strip() -> None:
    """Its tip is 1, its clamp holds it level, its end is free of moment; numbers by Blevins (1979)."""
    s = np.linspace(0.0, 1.0, 20001)
    shape, slope = _mode(ROOT, 0)(s), _mode(ROOT, 1)(s)
    assert shape[0] == pytest.approx(0.0) and slope[0] == pytest.approx(0.0) and shape[-1] == pytest.approx(1.0)
    assert slope[-1] == pytest.approx(1.376506, abs=1e-6)
    assert np.gradient(shape, s)[1:-1] == pytest.approx(slope[1:-1], abs=1e-6)
    bend = np.gradient(slope, s, edge_order=2)
    assert bend[0] == pytest.approx(3.516015, abs=1e-4) and bend[-1] == pytest.approx(0.0, abs=1e-4)
    assert np.trapezoid(shape**2, s) == pytest.approx(0.25, abs=1e-6)


def test_peaks_of_a_swing_between_its_samples() -> None:
    time = np.arange(0.0, 4.2, 0.05)
    found = _peaks((1.0 - 0.1 * time) * np.cos(math.pi * time))
    assert len(found) == 5
    assert found == pytest.approx(1.0 - 0.1 * np.arange(5), abs=2e-3)


def test_a_folded_strip_keeps_its_length_and_is_most_curved_in_its_fold() -> None:
    specimen = strip(0.1, 0.02, 40, clamp=1)
    places = _folded(specimen, 0.025, 0.035, math.radians(40.0))
    flat = level(specimen.flat)
    edges = np.concatenate([specimen.faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    sizes = [np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) for x in (places, flat)]
    assert np.abs(sizes[0] / sizes[1] - 1.0).max() < 2e-3
    assert _most_curved(specimen, places) == pytest.approx(0.3, abs=0.01)
    assert _folded(specimen, 0.025, 0.035, 0.0) == pytest.approx(flat)


@pytest.mark.parametrize(
    ("name", "case"), [pytest.param("hysteresis", {"loop": "shear"}, marks=pytest.mark.proof), ("creases", {})]
)
def test_what_the_default_solver_passes_at_its_default_setting(name: str, case: dict) -> None:
    found = ROWS[name].run(TrialSetting(), case)
    assert found.error <= ROWS[name].gate_realtime


def test_a_swing_loses_the_same_length_each_time() -> None:
    """With so many substeps that the solver's own loss is small."""
    found = ROWS["dry_damping"].run(TrialSetting(substeps=1536), {})
    assert found.error < 0.1
    (share,) = found.figures.values()
    assert share == pytest.approx(1.0, abs=0.1)


def test_loops_cannot_be_measured_in_motion() -> None:
    found = ROWS["hysteresis"].run(TrialSetting("fem-stvk/midpoint"), {})
    assert math.isnan(found.error) and "without time" in found.missing
