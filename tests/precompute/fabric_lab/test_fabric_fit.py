"""A fabric fitted to measured curves."""

from pathlib import Path

import pytest

from pbd import InputError
from precompute.fabric_lab.fabric_fit import draw_fit, fit_fabric, read_curves
from precompute.validation.trial import FABRIC, TrialSetting

# Of a soft fabric: E h = 20 and 10 N/m, at the bias 4/(1/20 + 1/10 + 1/4 - 0.4/20).
CURVES = """instrument,direction,deformation,load
tension,warp,0.02,0.4
tension,warp,0.01,0.2
tension,weft,0.01,0.1
tension,bias,0.01,0.1052632
"""


def test_stiffness_comes_from_the_curves_and_the_solver_gives_them_back(tmp_path: Path) -> None:
    (tmp_path / "curves.csv").write_text(CURVES)
    curves = read_curves(tmp_path / "curves.csv")
    assert curves["tension", "warp"].deformation.tolist() == [0.01, 0.02]
    fabric, found = fit_fabric(curves, FABRIC, TrialSetting("fem-stvk/quasi-static", edges=10))
    assert (fabric.stretch_warp, fabric.stretch_weft) == pytest.approx((20.0, 10.0))
    assert fabric.shear == pytest.approx(4.0, rel=1e-4) and fabric.bend_warp == FABRIC.bend_warp
    assert [(f.instrument, f.direction) for f in found] == list(curves)
    assert max(f.error for f in found) < 0.05
    draw_fit(tmp_path / "fit.png", found)
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n1,2\n", "line 1: other columns"),
        (CURVES.replace("weft", "up"), "line 4: unknown word"),
        (CURVES.replace("0.4\n", "much\n"), "line 2: bad point"),
        (CURVES.splitlines()[0] + "\n", "no curve"),
    ],
)
def test_a_bad_file_is_one_clear_message(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "curves.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        read_curves(tmp_path / "curves.csv")
    with pytest.raises(InputError, match=r"no\.csv: cannot be read"):
        read_curves(tmp_path / "no.csv")


def test_a_far_curve_of_tension_gives_the_stiffening(tmp_path: Path) -> None:
    """E h = 40 N/m and three times the straight line at 10 %, five times at 20 %: 40 e (1 + 20 e)."""
    lines = [f"tension,weft,{e},{40.0 * e * (1.0 + 20.0 * e):.6f}" for e in (0.02, 0.05, 0.10, 0.17)]
    (tmp_path / "curves.csv").write_text("\n".join([CURVES.splitlines()[0], *lines]))
    setting = TrialSetting("fem-corotational/quasi-static", edges=10)
    fabric, found = fit_fabric(read_curves(tmp_path / "curves.csv"), FABRIC, setting)
    assert (fabric.stretch_weft, fabric.stiffening_weft_10, fabric.stiffening_weft_20) == pytest.approx(
        (40, 3, 5), 1e-4
    )
    assert fabric.stiffening_warp_10 == 1.0 and found[0].error < 0.05
    (tmp_path / "curves.csv").write_text("\n".join([CURVES.splitlines()[0], *lines]).replace("0.17,", "0.01,"))
    with pytest.raises(InputError, match=r"tension weft.*rising with strain"):
        fit_fabric(read_curves(tmp_path / "curves.csv"), FABRIC, setting)


def test_a_bias_stiffer_than_any_fabric(tmp_path: Path) -> None:
    (tmp_path / "curves.csv").write_text(CURVES.replace("0.1052632", "5"))
    with pytest.raises(InputError, match="tension bias"):
        fit_fabric(read_curves(tmp_path / "curves.csv"), FABRIC, TrialSetting())


def test_compression_gives_thickness_and_van_wyks_pressure(tmp_path: Path) -> None:
    """T = 2 mm (1 + P/1500)^(-1/3), to the digits of the file."""
    points = [(0.002 * (1.0 + pressure / 1500.0) ** (-1.0 / 3.0), pressure) for pressure in (50.0, 800.0, 5000.0)]
    lines = [f"compression,normal,{thickness:.9f},{pressure}" for thickness, pressure in points]
    (tmp_path / "curves.csv").write_text("\n".join([CURVES.splitlines()[0], *lines]))
    fabric, found = fit_fabric(read_curves(tmp_path / "curves.csv"), FABRIC, TrialSetting(edges=8))
    assert (fabric.thickness, fabric.compression) == pytest.approx((0.002, 1500.0), rel=1e-3)
    assert found[0].error < 0.01
