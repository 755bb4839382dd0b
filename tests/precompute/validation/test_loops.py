"""Loops of bending and shear: what is measured, what is read off, what is no loop."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pbd import InputError
from pbd.xpbd.constraints import FRICTION_STIFFNESS
from precompute.fabric_lab.fabric_fit import draw_fit, fit_fabric, read_curves
from precompute.fabric_lab.fabric_report import curve_rows, curves_text, draw_curves, loop_figures, write_curves
from precompute.validation.laboratory import LoadCurve
from precompute.validation.loops import LOOP_SOLVER, LOOPS, bending_loop, loop_area, read_loop, shear_loop
from precompute.validation.trial import FABRIC, TrialSetting

BEND, HYSTERESIS = 11.6e-6, 1.2e-3  # of cotton broadcloth, B [N m] and 2HB [N]
SHEAR, RUBBED = 40.0, 1.0  # G and 2HG [N/m]
RUBBING = replace(
    FABRIC, bend_warp=BEND, bend_weft=BEND, bend_hysteresis_warp=HYSTERESIS, bend_hysteresis_weft=HYSTERESIS,
    shear=SHEAR, shear_hysteresis=RUBBED,
)  # fmt: skip
COARSE = TrialSetting(LOOP_SOLVER, edges=8)
HEADER = "instrument,direction,deformation,load"


def drawn(path: np.ndarray, stiffness: float, width: float, stick: float = FRICTION_STIFFNESS) -> LoadCurve:
    """A loop of an elastic spring beside an element of dry friction, from the points that a sample is brought to."""
    slipped, loads = 0.0, []
    for x in path:
        pull = np.clip(stick * stiffness * (x - slipped), -0.5 * width, 0.5 * width)
        slipped = x - pull / (stick * stiffness)
        loads.append(stiffness * x + pull)
    return LoadCurve(np.array(path), np.array(loads), 1.0)


def rows(curve: LoadCurve, instrument: str = "bending_loop", direction: str = "warp") -> str:
    points = zip(curve.deformation, curve.load, strict=True)
    return "\n".join([HEADER, *(f"{instrument},{direction},{x:.6g},{y:.6g}" for x, y in points)]) + "\n"


def test_readings_of_a_loop_that_is_known() -> None:
    path = LOOPS["bending_loop"].path
    curve = drawn(path, BEND, HYSTERESIS)
    reading = read_loop(curve, "bending_loop", "warp")
    assert reading.stiffness == pytest.approx(BEND, rel=1e-9) and reading.widths == pytest.approx([HYSTERESIS])
    # A parallelogram: 2 x 2HB x (how far it goes - where it starts to slip), less the corners that its points cut off.
    own = 2.0 * HYSTERESIS * (250.0 - 0.5 * HYSTERESIS / (FRICTION_STIFFNESS * BEND))
    assert loop_area(curve, "bending_loop", "warp") == pytest.approx(own, rel=5e-3)
    # The instrument itself stops at 0, so that the first branch closes the loop; or it begins on the other side.
    stopped = drawn(np.append(path[: np.argmin(path) + 7], 0.0), BEND, HYSTERESIS)
    for other in (stopped, drawn(-path, BEND, HYSTERESIS)):
        again = read_loop(other, "bending_loop", "warp")
        assert (again.stiffness, *again.widths) == pytest.approx((BEND, HYSTERESIS), rel=1e-9)


def test_a_loop_of_shear_is_read_where_kawabata_reads_it() -> None:
    curve = drawn(LOOPS["shear_loop"].path, SHEAR, RUBBED)
    reading = read_loop(curve, "shear_loop", "warp")
    assert (reading.stiffness, *reading.widths) == pytest.approx((SHEAR, RUBBED, RUBBED))
    # Cloth that rubs more the further it is sheared: 2HG5 is not 2HG.
    wider = curve.load + 0.2 * np.sign(np.gradient(curve.deformation)) * np.abs(curve.deformation)
    more = read_loop(LoadCurve(curve.deformation, wider, 1.0), "shear_loop", "warp")
    assert more.widths[1] - more.widths[0] == pytest.approx(0.4 * np.radians(4.5), rel=1e-6)


def test_the_instruments_give_the_fabric_back() -> None:
    """8 edges a centimetre: B is 2 % low, and 0.3 % with 20."""
    bent = bending_loop(COARSE, RUBBING, 0.0, LOOPS["bending_loop"].path)
    reading = read_loop(bent, "bending_loop", "warp")
    assert reading.stiffness == pytest.approx(BEND, rel=0.03) and reading.widths[0] == pytest.approx(
        HYSTERESIS, rel=0.02
    )
    sheared = shear_loop(COARSE, RUBBING, 0.0, LOOPS["shear_loop"].path)
    reading = read_loop(sheared, "shear_loop", "warp")
    assert (reading.stiffness, *reading.widths) == pytest.approx((SHEAR, RUBBED, RUBBED), rel=0.01)
    figures = loop_figures({("bending_loop", "warp"): bent, ("shear_loop", "warp"): sheared})
    assert list(figures) == ["B_warp", "2HB_warp", "G", "2HG", "2HG5"]


def test_without_friction_there_is_no_width() -> None:
    smooth = replace(RUBBING, bend_hysteresis_warp=0.0, bend_hysteresis_weft=0.0, shear_hysteresis=0.0)
    path = LOOPS["bending_loop"].path
    curve = bending_loop(COARSE, smooth, 0.0, path)
    reading = read_loop(curve, "bending_loop", "warp")
    assert abs(reading.widths[0]) < 1e-5 * np.ptp(curve.load)
    assert reading.stiffness == pytest.approx(BEND, rel=0.03)
    assert curve_rows({("bending_loop", "warp"): curve}) == []


def test_loops_are_written_drawn_and_read_again(tmp_path: Path) -> None:
    curves = {
        ("bending_loop", "warp"): drawn(LOOPS["bending_loop"].path, BEND, HYSTERESIS),
        ("shear_loop", "warp"): drawn(LOOPS["shear_loop"].path, SHEAR, RUBBED),
    }
    write_curves(tmp_path / "curves.csv", curves)
    read = read_curves(tmp_path / "curves.csv")
    for key, curve in curves.items():
        assert read[key].deformation == pytest.approx(curve.deformation) and read[key].load == pytest.approx(curve.load)
    draw_curves(tmp_path / "curves.png", curves)
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert "2HB_warp" in curves_text(curves, loop_figures(curves)) and "0.0012" in curves_text(
        curves, loop_figures(curves)
    )


def test_hysteresis_comes_from_the_loops(tmp_path: Path) -> None:
    """Bent more finely than the virtual instrument bends, and 2HG5 wider than 2HG: their mean is the fabric's."""
    fine = np.concatenate([np.arange(0.0, 250.0, 5.0), np.arange(250.0, -250.0, -5.0), np.arange(-250.0, 251.0, 5.0)])
    sheared = drawn(LOOPS["shear_loop"].path, SHEAR, RUBBED)
    wider = sheared.load + 0.2 * np.sign(np.gradient(sheared.deformation)) * np.abs(sheared.deformation)
    text = rows(drawn(fine, BEND, HYSTERESIS), direction="weft")
    text += rows(LoadCurve(sheared.deformation, wider, 1.0), "shear_loop").split("\n", 1)[1]
    (tmp_path / "curves.csv").write_text(text)
    fitted, found = fit_fabric(read_curves(tmp_path / "curves.csv"), FABRIC, COARSE)
    assert fitted.bend_weft == pytest.approx(BEND, rel=1e-3)
    assert fitted.bend_hysteresis_weft == pytest.approx(HYSTERESIS, rel=1e-3)
    assert fitted.bend_warp == FABRIC.bend_warp and fitted.bend_hysteresis_warp == 0.0
    narrow, wide = RUBBED + 0.4 * np.radians(0.5), RUBBED + 0.4 * np.radians(5.0)
    assert fitted.shear_hysteresis == pytest.approx(0.5 * (narrow + wide), rel=1e-3)
    assert fitted.shear == pytest.approx(SHEAR, rel=0.01)
    assert [(f.instrument, f.direction) for f in found] == [("bending_loop", "weft"), ("shear_loop", "warp")]
    assert max(f.error for f in found) < 0.05
    draw_fit(tmp_path / "fit.png", found)
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")


LOOP = drawn(LOOPS["bending_loop"].path, BEND, HYSTERESIS)


def changed(deformation: np.ndarray, load: np.ndarray) -> str:
    return rows(LoadCurve(deformation, load, 1.0))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (changed(LOOP.deformation, -LOOP.load), "bending_loop warp: load falls as the deformation rises"),
        (changed(LOOP.deformation[::-1], LOOP.load[::-1]), "wrong way round.*received -0.0012"),
        (changed(LOOP.deformation, BEND * LOOP.deformation), "without width"),
        (changed(LOOP.deformation[:20], LOOP.load[:20]), "does not close.*received -225"),
        (changed(LOOP.deformation, LOOP.load + np.linspace(0.0, 1e-3, len(LOOP.load))), "does not close.*within 5 %"),
        (changed(LOOP.deformation[:9], LOOP.load[:9]), "no loop.*9 points from 0 to 250"),
        (changed(LOOP.deformation / 2.0, LOOP.load / 2.0), "no loop.*to 150 and to -150 or further"),
        (changed(np.sort(LOOP.deformation)[[0, 2, 1, *range(3, 30)]], LOOP.load), "no loop"),
        (rows(LOOP).replace("bending_loop,warp,250,", "bending_loop,warp,inf,"), "bad point.*two finite numbers"),
        (changed(LOOP.deformation, -1e300 * np.sign(LOOP.deformation)), "load falls as the deformation rises"),
        (rows(LOOP).replace("bending_loop", "bending loop"), "unknown word.*bending_loop or shear_loop"),
    ],
)  # fmt: skip
def test_what_is_no_loop_is_one_clear_message(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "curves.csv").write_text(text)
    with pytest.raises(InputError, match=f"(?s)curves.csv.*{words}"):
        read_curves(tmp_path / "curves.csv")
