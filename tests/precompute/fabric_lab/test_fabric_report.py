"""What `gube fabric` writes: curves that the fit reads again, a picture, values as in a scene file."""

from dataclasses import asdict, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from pbd import Fabric
from pbd.models.newton import StepError
from precompute.fabric_lab.fabric_fit import read_curves
from precompute.fabric_lab.fabric_report import (
    PULLED,
    curves_text,
    draw_curves,
    fabric_text,
    measure_fabric,
    pull,
    write_curves,
)
from precompute.validation.laboratory import LoadCurve
from precompute.validation.trial import FABRIC, TrialSetting

CURVES = {
    ("tension", "warp"): LoadCurve(np.array([0.005, 0.01]), np.array([10.0, 20.0]), 1.0),
    ("compression", "normal"): LoadCurve(np.array([0.001, 0.002]), np.array([500.0, 50.0]), 1.0),
}


def test_curves_are_written_as_the_fit_reads_them(tmp_path: Path) -> None:
    write_curves(tmp_path / "curves.csv", CURVES)
    read = read_curves(tmp_path / "curves.csv")
    assert {key: curve.load.tolist() for key, curve in read.items()} == {
        key: curve.load.tolist() for key, curve in CURVES.items()
    }
    draw_curves(tmp_path / "curves.png", CURVES)
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert "2000 N/m" in curves_text(CURVES, {"friction": 0.4}) and "1 mm at 500 Pa" in curves_text(CURVES, {})


def test_values_read_back_as_a_fabric() -> None:
    fabric = replace(FABRIC, compression=1500.0)
    values = dict(line.split(" = ") for line in fabric_text(fabric).splitlines())
    assert asdict(Fabric(**{name: float(text) for name, text in values.items()})) == pytest.approx(asdict(fabric))


def test_a_pull_without_an_equilibrium_is_measured_by_small_steps() -> None:
    def measured(setting: TrialSetting, *_: object) -> LoadCurve:
        if setting.solver.endswith("quasi-static"):
            raise StepError("no equilibrium")
        assert setting == PULLED
        return CURVES["tension", "warp"]

    with patch("precompute.fabric_lab.fabric_report.tension_curve", measured):
        found = pull(TrialSetting(solver="fem-corotational/quasi-static"), FABRIC, 0.0, (0.01,))
    assert found is CURVES["tension", "warp"]


@pytest.mark.proof
def test_a_fabric_gives_its_own_values_back() -> None:
    curves, figures = measure_fabric(FABRIC, TrialSetting(solver="fem-stvk/quasi-static"))
    own = {"warp": FABRIC.stretch_warp, "weft": FABRIC.stretch_weft}
    for direction, stiffness in own.items():
        curve = curves["tension", direction]
        # St. Venant-Kirchhoff: (1 + e)(e + e^2/2) instead of the strain e.
        own_law = stiffness * (1.0 + curve.deformation) * (1.0 + 0.5 * curve.deformation)
        assert curve.load / curve.deformation == pytest.approx(own_law, rel=0.005)
    assert figures["friction"] == pytest.approx(FABRIC.friction, abs=0.01)
