"""The validation table: what is asked for, what is run, what is written."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pbd import InputError
from pbd.models import StepError
from precompute.experiment.sheets import level
from precompute.validation.bending_rows import critical_gamma, hinge_poisson
from precompute.validation.laboratory import tension_curve
from precompute.validation.strip_references import tall_column, upright_gamma
from precompute.validation.trial import FABRIC, Curve, Trial, TrialResult, TrialSetting, disc, strip
from precompute.validation.validation import ROWS, chosen_rows, result_row, validate, validation_text
from precompute.validation.validation_pictures import draw_results
from precompute.validation.validation_row import Parameter, Row
from runtime.cli import command

TABLE = (
    "cantilever bending_direction upright_buckling lateral_buckling stick_slip tension hanging_strip catenary swing "
    "damping momentum incline capstan hencky disc_folds kawabata cusick drape_cipc tension_measured "
    "hysteresis creases dry_damping"
).split()


def falling(setting: TrialSetting, power: float) -> TrialResult:
    """A test whose error falls with substeps and edges."""
    error = (12.0 / setting.substeps) ** power * (20.0 / setting.edges) ** 2
    curve = Curve("x", "y", (np.zeros(2), np.ones(2)), (np.zeros(3), np.ones(3)))
    return TrialResult(1.0, 1.0 + error, error, 0.1 * setting.substeps, curve)


FAKE = Row("fake", "made up", falling, 0.01, 0.3, {"power": Parameter("order", 1.0, 0.0, 4.0)}, ({},), ("default",))


def test_the_table_has_every_test() -> None:
    assert sorted(ROWS) == sorted(TABLE)
    for row in ROWS.values():
        assert row.gate_best <= row.gate_realtime
        for case in row.cases:
            assert set(case) <= set(row.parameters)


@pytest.mark.parametrize(
    ("names", "params", "solver", "words"),
    [
        (["cantilevr"], [], None, "unknown test"),
        (["cantilever"], ["gama=3"], None, "no such parameter"),
        (["cantilever"], ["gamma=-3"], None, "out of range"),
        (["cantilever"], ["gamma=soft"], None, "out of range"),
        (["cantilever"], ["gamma"], None, "key=value"),
        (["kawabata"], ["direction=up"], None, "warp or bias or weft"),
        ([], ["gamma=3"], None, "NAME"),
        ([], [], "magic", "unknown solver"),
    ],
)
def test_what_cannot_be_run_is_one_clear_message(
    names: list[str], params: list[str], solver: str | None, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        chosen_rows(names, params, solver)


def test_all_that_is_wrong_is_said_at_once() -> None:
    with pytest.raises(InputError, match="(?s)2 problems.*no such parameter.*out of range"):
        chosen_rows(["cantilever"], ["gama=3", "gamma=-3"], None)


def test_a_parameter_takes_the_place_of_the_cases() -> None:
    ((row, cases),) = chosen_rows(["tension"], ["angle_deg=30"], None)
    assert row.name == "tension" and cases == [{"angle_deg": 30.0, "strain": 0.002}]
    assert len(chosen_rows([], [], None)) == len(ROWS)
    ((_, cases),) = chosen_rows(["tension"], ["strain=0.01"], None)
    assert [case["angle_deg"] for case in cases] == [0.0, 22.5, 45.0, 67.5, 90.0]


def test_the_cheapest_setting_that_passes_is_found() -> None:
    result = validate(FAKE, {"power": 1.0})
    assert result.default.error == 1.0 and not result.passed_default
    assert result.realtime_setting == TrialSetting(substeps=48) and result.realtime is not None
    assert result.passed_best and result.best_setting == TrialSetting(substeps=48 * 32)
    figures = result_row(result)
    assert figures["passed_best"] and figures["passed_realtime"] and not figures["passed_default"]
    assert figures["realtime_cost_ms"] == pytest.approx(4.8)


@pytest.mark.parametrize(("lucky", "edges"), [(False, 10), (True, 20)])
def test_a_coarser_mesh_is_taken_for_its_speed_unless_it_passes_by_chance(lucky: bool, edges: int) -> None:
    def slower_if_fine(setting: TrialSetting, power: float) -> TrialResult:
        found = falling(replace(setting, edges=20), power)
        lost = lucky and setting.edges < 20 and setting.substeps != 48
        return replace(found, error=1.0 if lost else found.error, cost_ms=found.cost_ms * setting.edges / 20)

    result = validate(replace(FAKE, measure=slower_if_fine), {"power": 1.0})
    assert result.realtime_setting == TrialSetting(substeps=48, edges=edges)
    assert f"{edges} edges, 48 substeps" in validation_text([result])


def test_what_never_passes_is_lost_with_its_reason() -> None:
    result = validate(replace(FAKE, gate_realtime=0.2), {"power": 0.0})
    assert not result.passed_best and result.realtime is None
    assert result.best_setting.edges == 40
    assert "change nothing" in result.reason and result.reason in validation_text([result])
    lost = validate(replace(FAKE, measure=lambda setting, power: TrialResult(1.0, math.nan, math.nan, 1.0)), {})
    assert not lost.passed_best and lost.realtime is None
    assert "FAILED" in validation_text([lost]) and "never" in validation_text([lost])


def test_a_step_that_fails_is_a_lost_run_and_takes_nothing_from_the_others() -> None:
    def breaking(setting: TrialSetting, power: float) -> TrialResult:
        if setting.substeps > 50:
            raise StepError("thrown", "solver")
        return falling(setting, power)

    result = validate(replace(FAKE, measure=breaking), {"power": 1.0})
    assert not result.passed_best and result.best_setting == TrialSetting(substeps=48)
    assert result.realtime_setting == TrialSetting(substeps=48) and "thrown" in result.reason


def test_what_cannot_be_measured_is_lost_at_once_and_says_why() -> None:
    nothing = replace(
        FAKE, measure=lambda setting, power: TrialResult(1.0, math.nan, math.nan, 1.0, missing="no such law")
    )
    result = validate(nothing, {"power": 1.0})
    assert not result.passed_best and result.realtime is None and result.reason == "no such law"
    assert result.best_setting == TrialSetting()  # nothing else was tried


def test_an_equilibrium_that_is_lost_is_not_sought_on_a_finer_mesh() -> None:
    tried: list[TrialSetting] = []

    def lost(setting: TrialSetting, power: float) -> TrialResult:
        tried.append(setting)
        raise StepError("no end", setting.solver)

    quasi = "fem-stvk/quasi-static"
    result = validate(replace(FAKE, measure=lost, best_solvers=(quasi, "fem-stvk/verlet")), {"power": 1.0})
    assert [(setting.solver, setting.edges) for setting in tried] == [(quasi, 20), ("fem-stvk/verlet", 20)]
    assert not result.passed_best and "no end" in result.reason


def test_a_chosen_resolution_is_the_only_one() -> None:
    result = validate(FAKE, {"power": 0.0}, "default", resolution=30)
    assert result.best_setting.edges == 30


def test_curves_are_drawn(tmp_path: Path) -> None:
    (file,) = draw_results(tmp_path, [validate(FAKE, {"power": 4.0})])
    assert file.read_bytes().startswith(b"\x89PNG")


def test_strips_and_discs_are_whole() -> None:
    specimen = strip(0.2, 0.05, 20, angle=0.3)
    corners = specimen.flat[specimen.faces]
    side_1, side_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * (side_1[:, 0] * side_2[:, 1] - side_1[:, 1] * side_2[:, 0])
    assert area.min() > 0.05 * specimen.edge**2 and area.sum() == pytest.approx(0.21 * 0.05)
    round_one = disc(0.1, 0.03, 10)
    assert np.linalg.norm(round_one.flat, axis=1).max() == pytest.approx(0.1)
    assert np.sum(np.abs(np.linalg.norm(round_one.flat, axis=1) - 0.03) < 1e-12) > 10


def test_a_load_cell_reads_the_pull_of_stretched_cloth() -> None:
    """Stretched evenly by 1 %, as the clamps hold it."""
    specimen = strip(0.2, 0.1, 8, clamp=0)
    x = specimen.flat[:, 0]
    fabric = replace(FABRIC, poisson=0.0, bend_warp=0.0, bend_weft=0.0)
    ends = (x < 1e-9) | (x > 0.2 - 1e-9)
    start = level(specimen.flat) * [1.01, 1.0, 1.0]
    trial_ = Trial(specimen, start, fabric, ends, TrialSetting(), (0.0, 0.0, 0.0))
    force, moment = trial_.pull(np.flatnonzero(x > 0.2 - 1e-9))
    assert force == pytest.approx([-0.01 * fabric.stretch_warp * 0.1, 0.0, 0.0], rel=1e-3, abs=1e-3)
    assert moment == pytest.approx(np.zeros(3), abs=1e-3)


def test_southwell_finds_the_critical_load() -> None:
    found, points = critical_gamma(lambda gamma: tall_column(gamma, 1e-4) if gamma < 7.8 else 1.0, 2.0)
    assert found == pytest.approx(upright_gamma(), rel=3e-3) and len(points) >= 3
    assert math.isnan(critical_gamma(lambda gamma: 1.0, 2.0)[0])


def test_hinges_bend_with_a_ratio_of_minus_a_third() -> None:
    assert hinge_poisson() == pytest.approx(-1.0 / 3.0, abs=0.02)


@pytest.mark.parametrize(
    ("name", "case"),
    [
        ("momentum", {"quantity": "fall"}),
        ("momentum", {"quantity": "linear"}),
        ("incline", {"quantity": "angle"}),
        ("swing", {}),
        ("hanging_strip", {"edges": 20.0}),
        ("catenary", {"span": 0.8}),
        ("kawabata", {"instrument": "friction"}),
        ("cusick", {"gravity_length_cm": 2.0}),
    ],
)
def test_what_the_default_solver_passes_at_its_default_setting(name: str, case: dict) -> None:
    found = ROWS[name].run(TrialSetting(), case)
    error = found.error if found.realtime_error is None else found.realtime_error
    assert error <= ROWS[name].gate_realtime


def test_a_belt_lies_on_a_cylinder_of_triangles() -> None:
    """With the cylinder inside out it lay in it, crumpled, and the ratio of its legs was anything."""
    found = ROWS["capstan"].run(
        replace(TrialSetting(), substeps=384), {"mu": 0.4, "wrap_deg": 90.0, "collider": "mesh"}
    )
    assert found.error < 0.02


def test_swings_lose_what_implicit_euler_loses_or_less() -> None:
    """Patches pull along the substep's start, which loses nothing: without them it is the law of implicit Euler."""
    fewest, twice = (ROWS["damping"].run(replace(TrialSetting(), substeps=count), {}) for count in (12, 24))
    assert fewest.reference < fewest.measured < 1.0
    assert twice.error <= ROWS["damping"].gate_best


def test_soft_cloth_gives_its_stiffness_back_at_the_bias() -> None:
    soft = replace(FABRIC, stretch_warp=20.0, stretch_weft=10.0, shear=4.0)
    curve = tension_curve(TrialSetting(substeps=96), soft, math.radians(45.0), (0.01,))
    assert curve.load[0] / curve.deformation[0] == pytest.approx(4 / (1 / 20 + 1 / 10 + 1 / 4 - 0.4 / 20), rel=0.02)


def test_the_command_prints_and_writes_the_table(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    arguments = ["validate", "momentum", "--param", "quantity=linear", "--json", str(tmp_path / "v.json")]
    assert command.main([*arguments, "-o", str(tmp_path)]) == 0
    assert "momentum linear" in capsys.readouterr().out
    (row,) = json.loads((tmp_path / "v.json").read_text())["rows"]
    wanted = "test solver default_solver params reference measured error gate_best gate_realtime passed_best"
    assert {*wanted.split(), "passed_realtime"} <= set(row)
    assert row["passed_best"] is True and row["params"] == {"quantity": "linear", "spin": 1.0}


def test_the_command_says_what_is_unknown(capsys: pytest.CaptureFixture) -> None:
    assert command.main(["validate", "nothing"]) == 2
    assert "unknown test" in capsys.readouterr().err


@pytest.mark.parametrize("gamma", [0.1, 1.0, 30.0])
def test_the_default_solver_holds_stiff_cantilevers_at_its_default_setting(gamma: float) -> None:
    result = validate(ROWS["cantilever"], {"gamma": gamma}, "default", resolution=20)
    assert result.passed_default, result.default.error


@pytest.mark.proof
@pytest.mark.parametrize(
    ("name", "case"),
    [
        ("cantilever", {"gamma": 10.0}),
        ("tension", {"angle_deg": 22.5, "strain": 0.002}),
        ("hanging_strip", {"edges": 50.0}),
        ("hencky", {"poisson": 0.3}),
        ("catenary", {"span": 0.8}),
    ],
)
def test_equilibria_hold_the_gate_of_the_best(name: str, case: dict) -> None:
    result = validate(ROWS[name], case, "fem-stvk/quasi-static", resolution=20)
    assert result.passed_best, result.reason
