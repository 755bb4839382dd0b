"""Measured fronts: full detail first and free of error, less detail cheaper; and plans made from them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from precompute import front as measuring
from precompute.pipeline import Precomputed
from precompute.planning import front_of
from runtime import command
from runtime.front import Front, front_path
from tests.runtime.fronts import made_front


@pytest.fixture(scope="module")
def small() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measuring, "EVERY", (1, 2))
        patch.setattr(measuring, "SUBSTEPS", (1.0, 0.5))
        patch.setattr(measuring, "TEMPOS", (3.0, 4.5))
        yield


@pytest.fixture(scope="module")
def measured(learned: Precomputed, small: None) -> Front:
    return front_of(learned.database, learned.path)


def test_the_front_has_the_full_detail_first_and_all_others_once(measured: Front) -> None:
    details = [setting.detail for setting in measured.settings]
    assert len(set(details)) == len(details) >= 24
    assert measured.settings[0].error_m == (0.0,) * len(measured.speeds)
    assert details[0].every == 1 and measured.settings[0].cost_ms == measured.settings[0].peak_ms
    assert all(setting.detail.substeps <= 2 * details[0].substeps for setting in measured.settings)


def test_less_detail_costs_less_and_shows_more(measured: Front) -> None:
    by_detail = {setting.detail: setting for setting in measured.settings}
    full = measured.settings[0].detail
    bare, half = replace(full, atoms=0, sweeps=0, passes=0), replace(full, substeps=full.substeps // 2)
    seldom = replace(full, every=2, substeps=2 * full.substeps)
    for detail in (bare, half, seldom):
        assert by_detail[detail].cost_ms < by_detail[full].cost_ms
        assert min(by_detail[detail].error_m) > 1e-4
    assert by_detail[seldom].peak_ms > by_detail[full].peak_ms
    errors = np.array([setting.error_m for setting in measured.settings])
    assert np.all(np.diff(errors, axis=1) >= 0.0)


def test_a_front_is_kept_and_measured_again_for_another_database(
    learned: Precomputed, measured: Front, small: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert front_of(learned.database, learned.path) == measured
    monkeypatch.setattr("precompute.planning.measure_front", lambda *_: made_front())
    kept = front_path(learned.path).read_bytes()
    assert front_of(replace(learned.database, created="1999-12-31"), learned.path) == made_front()
    front_path(learned.path).write_bytes(kept)


def test_plan_prints_a_choice_and_why(
    learned: Precomputed, measured: Front, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "plan.json"
    words = ["plan", str(learned.path), "--distance", "20", "--fov", "40", "--garments", "3", "--json", str(out)]
    assert command.main([*words, "--budget-ms", "1000", "-o", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    content = json.loads(out.read_text(encoding="utf-8"))
    figures = content["figures"]
    assert figures["choice"] in printed and "3 x " in printed
    assert figures["screen_error_px"] <= 1.0 and figures["regret_percent"] == 0.0
    assert figures["cost_ratio_2m_20m"] > 1.0 and figures["cost_ms"] > 0.0
    assert len(content["rows"]) == figures["settings"] == len(measured.settings)


def test_plan_takes_the_camera_of_the_scene(learned: Precomputed, measured: Front, tmp_path: Path) -> None:
    out = tmp_path / "plan.json"
    words = ["plan", str(learned.path), "--target", "accepted", "--budget-ms", "1000"]
    assert command.main([*words, "--json", str(out)]) == 0
    figures = json.loads(out.read_text(encoding="utf-8"))["figures"]
    assert 2.5 < figures["distance_m"] < 3.5
    assert figures["screen_error_px"] <= 10.0


@pytest.mark.parametrize(
    ("words", "expected"),
    [(["--garments", "0"], "at least 1"), (["--fov", "180"], "below 180"), (["--budget-ms", "-1"], "above 0")],
)
def test_bad_plans_end_with_a_message(
    learned: Precomputed, measured: Front, words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        status = command.main(["plan", str(learned.path), *words])
    except SystemExit as ended:
        status = ended.code
    assert status == 2
    assert expected in capsys.readouterr().err
