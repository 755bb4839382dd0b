"""StabilitySweep maps: known limits, classes on a tiny map, replay, what is refused."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pbd import SolverOptions
from pbd.models import Options, make_solver
from precompute.experiment.error_classes import ErrorClass, classify
from precompute.stability.stability_cells import Frames, judge, lattice_of
from precompute.stability.stability_maps import MAPS, StabilityMap, chosen_cell
from precompute.stability.stability_page import stability_text, write_stability
from precompute.stability.stability_sweep import StabilitySweep, cell_command, sweep
from precompute.stability.stability_theory import explicit_limit, membrane_limit, theory_of
from runtime.cli import command

EXPLICIT = "springs-triangle/symplectic-euler"
SECONDS = 0.6


def map_of(name: str, x: tuple[float, ...], y: tuple[float, ...]) -> StabilityMap:
    whole = next(one for one in MAPS if one.name == name)
    return replace(whole, x=replace(whole.x, values=x), y=replace(whole.y, values=y))


@pytest.fixture(scope="module")
def tiny() -> StabilitySweep:
    maps = [map_of("stiffness", (1.0, 1000.0), (1 / 240, 1 / 30, 1 / 10)), map_of("mass", (1e2, 1e3), (1.0, 12.0))]
    return sweep(("default", EXPLICIT), maps=maps, seconds=SECONDS)


def test_the_default_maps_are_whole() -> None:
    ranges = {(one.name, axis): (a.values[0], a.values[-1]) for one in MAPS for axis, a in (("x", one.x), ("y", one.y))}
    for name in ("stiffness", "resolution", "bending", "collider"):
        assert ranges[name, "y"] == pytest.approx((1 / 240, 1 / 10), rel=1e-3)
    assert ranges["stiffness", "x"] == (1.0, 1e6)
    assert ranges["resolution", "x"] == (16.0, 128.0)
    assert ranges["bending", "x"] == ranges["compression", "y"] == (1e-7, 1e-3)
    assert ranges["mass", "x"] == (1.0, 1e4)
    assert ranges["collider", "x"] == (0.0, 50.0)
    assert ranges["compression", "x"] == (0.0, 90.0)
    for one in MAPS:
        for axis in (one.x, one.y):
            assert len(axis.values) >= 12 and np.all(np.diff(axis.values) > 0.0)


@pytest.mark.parametrize("lattice", ["triangles", "squares"])
def test_the_explicit_limit_is_that_of_theory(lattice: str) -> None:
    assert explicit_limit(lattice).error_percent < 5.0


def test_what_goes_on_a_tiny_map(tiny: StabilitySweep) -> None:
    stiffness, mass = tiny.maps
    explicit = {(cell.x, cell.y): cell for cell in tiny.of(stiffness, EXPLICIT)}
    limit = membrane_limit("triangles", 1 / 16, 1.0)
    for (x, y), cell in explicit.items():
        lost = x > 1.0 or y > limit
        assert (cell.error_class is ErrorClass.CATASTROPHIC) is lost, (x, y)
        if lost:
            assert cell.went == "not finite" and "unstable" in cell.message and 0.0 < cell.failed_s <= SECONDS + 0.1
    kept = tiny.of(stiffness, "default") + tiny.of(mass, "default")
    assert all(cell.error_class < ErrorClass.CATASTROPHIC and cell.frame_ms > 0.0 for cell in kept)
    assert tiny.figures["catastrophic_cells_default"] == 0
    assert tiny.figures[f"catastrophic_cells_stiffness_{EXPLICIT}"] == 5
    assert tiny.figures["explicit_limit_error_percent"] < 5.0


def test_borders_lie_at_the_explicit_limit(tiny: StabilitySweep) -> None:
    """Inside the map at E h = 1 N/m, where its weight stretches the cloth by 74 %; far below it at 1,000."""
    soft, stiff = (b for b in tiny.borders if b.map == "stiffness" and b.method == EXPLICIT)
    for border, near in ((soft, 0.25), (stiff, 0.1)):
        assert border.safe < border.catastrophic < 1.1 * border.safe
        assert border.safe == pytest.approx(membrane_limit("triangles", 1 / 16, border.x), rel=near)


def test_theory_is_drawn_where_it_is_known() -> None:
    by_name = {one.name: one for one in MAPS}
    (curve,) = theory_of(by_name["stiffness"], EXPLICIT)
    assert curve.y[0] / curve.y[-1] == pytest.approx(1e3)
    (law,) = theory_of(by_name["resolution"], "xpbd")
    assert law.x == pytest.approx(math.sqrt(2.0 * 10 * 0.1 / 9.81) / law.y)
    (law,) = theory_of(by_name["resolution"], "default")
    assert law.x.min() >= math.sqrt(0.2 / 9.81) / SolverOptions().substep * 0.999
    assert theory_of(by_name["collider"], "default") == []


def test_the_page_holds_every_command(tiny: StabilitySweep, tmp_path: Path) -> None:
    files = write_stability(tmp_path, tiny)
    assert {file.suffix for file in files} == {".html", ".csv", ".png"} and len(files) == 2 + 4
    page, table = files[0].read_text(encoding="utf-8"), files[1].read_text(encoding="utf-8")
    lost = [cell for cell in tiny.cells if cell.error_class is ErrorClass.CATASTROPHIC]
    assert lost
    for cell in lost:
        assert cell_command(cell) in page and cell_command(cell) in table
    assert "http:" not in page and "https:" not in page
    assert table.count("\n") == 1 + len(tiny.cells)
    assert "0 of 6 cells catastrophic" in stability_text(tiny)


def test_a_cell_is_run_again_by_its_command(
    tiny: StabilitySweep, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for cell in (tiny.of(tiny.maps[0], EXPLICIT)[-1], tiny.of(tiny.maps[1], "default")[0]):
        words = cell_command(cell).split()
        assert command.main([*words[1:], "--json", str(tmp_path / "cell.json")]) == 0
        (row,) = json.loads((tmp_path / "cell.json").read_text(encoding="utf-8"))["rows"]
        assert (row["class"], row["went"]) == (cell.error_class.name.lower(), cell.went)
        assert cell.went in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "key", "expected"),
    [
        (["--method", "magic"], "--method", "vertex-block-descent"),
        (["--cell", "weather:1:1"], "--cell", "stiffness, resolution"),
        (["--cell", "stiffness:soft:0.1"], "--cell", "X from 1 to 1e+06"),
        (["--cell", "stiffness:1"], "--cell", "stiffness:X:Y"),
        (["--cell", "stiffness:1:0"], "--cell", "Y above 0 to 0.1"),
        (["--cell", "compression:91:1e-5"], "--cell", "X from 0 to 90"),
        (["--cell", "mass:nan:1"], "--cell", "X from 1 to 10000"),
    ],
)
def test_wrong_input_is_refused(
    arguments: list[str], key: str, expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(["stability", *arguments, "-o", str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"gube stability: {key}: ") and expected in message and message.count("\n") == 1


def test_a_ring_that_leaves_the_post_is_tunnelling() -> None:
    one, x, y = chosen_cell("collider:10:0.0166667")
    scene = one.scene(x, y, "triangles")
    times = y * np.arange(61)
    still = np.repeat(scene.start[None], 61, axis=0)
    reference = Frames(times, still, np.zeros_like(still))
    moved = still.copy()
    moved[40:, scene.rings[-1], 0] += 2.0
    for position, kind in ((still, ErrorClass.IMPERCEPTIBLE), (moved, ErrorClass.CATASTROPHIC)):
        figures = judge(scene, Frames(times, position, np.zeros_like(still)), reference)
        assert classify(figures)["through_percent"] is kind
    assert figures["through_percent"] == pytest.approx(100.0 / len(scene.rings))


@pytest.mark.parametrize("one", MAPS, ids=lambda one: one.name)
def test_a_method_whose_springs_need_squares_gets_them(one: StabilityMap) -> None:
    method = "springs-square/symplectic-euler"
    make_solver(method, one.scene(one.x.values[0], one.y.values[0], lattice_of(method)).model, Options(1e-3))
