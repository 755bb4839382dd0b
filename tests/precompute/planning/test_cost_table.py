"""Measured tables: full detail first and free of error, less detail cheaper; and plans made from them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from precompute.learning.pipeline import Precomputed, default_cache, precompute
from precompute.planning import cost_measurement as measuring
from precompute.planning.planning import cost_table_of, plain_cloth
from runtime.cli import command
from runtime.detail.cost_table import CostTable, cost_table_path
from tests.precompute.miniature import OPTIONS, SCENE
from tests.runtime.cost_tables import made_front


@pytest.fixture(scope="module")
def small() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measuring, "EVERY", (1, 2))
        patch.setattr(measuring, "SUBSTEPS", (1.0, 0.5))
        patch.setattr(measuring, "TEMPOS", (3.0, 4.5))
        yield


@pytest.fixture(scope="module")
def measured(learned: Precomputed, small: None) -> CostTable:
    return cost_table_of(learned.database, learned.path)


def test_the_front_has_the_full_detail_first_and_all_others_once(measured: CostTable) -> None:
    details = [setting.detail for setting in measured.settings]
    assert len(set(details)) == len(details) >= 24
    assert measured.settings[0].error_m == (0.0,) * len(measured.speeds)
    assert details[0].every == 1 and measured.settings[0].cost_ms == measured.settings[0].peak_ms
    assert all(setting.detail.substeps <= 2 * details[0].substeps for setting in measured.settings)


def test_less_detail_costs_less_and_shows_more(measured: CostTable) -> None:
    by_detail = {setting.detail: setting for setting in measured.settings}
    full = measured.settings[0].detail
    below = [setting for setting in measured.settings if setting.detail.level]
    assert below and all(setting.detail.atoms == 0 < min(setting.error_m) for setting in below)
    bare, half = replace(full, atoms=0, passes=0), replace(full, substeps=full.substeps // 2)
    seldom = replace(full, every=2, substeps=2 * full.substeps)
    for detail in (bare, half, seldom):
        assert min(by_detail[detail].error_m) > 1e-4
    for detail in (bare, seldom):  # half the substeps save less here than a busy machine adds
        assert by_detail[detail].cost_ms < by_detail[full].cost_ms
    assert by_detail[seldom].peak_ms > by_detail[full].peak_ms
    errors = np.array([setting.error_m for setting in measured.settings])
    assert np.all(np.diff(errors, axis=1) >= 0.0)


def test_a_front_is_kept_and_measured_again_for_another_database(
    learned: Precomputed, measured: CostTable, small: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cost_table_of(learned.database, learned.path) == measured
    monkeypatch.setattr("precompute.planning.planning.measure_cost_table", lambda *_: made_front())
    kept = cost_table_path(learned.path).read_bytes()
    assert cost_table_of(replace(learned.database, created="1999-12-31"), learned.path) == made_front()
    cost_table_path(learned.path).write_bytes(kept)


def test_plan_prints_a_choice_and_why(
    learned: Precomputed, measured: CostTable, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "plan.json"
    words = ["plan", str(learned.path), "--distance", "20", "--fov", "40", "--garments", "3", "--json", str(out)]
    assert command.main([*words, "--budget-ms", "1000", "-o", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    content = json.loads(out.read_text(encoding="utf-8"))
    figures = content["figures"]
    assert figures["choice"] in printed and "3 x " in printed
    good = [row["cost_ms"] for row in content["rows"] if row["screen_error_px"] <= 1.0]
    assert figures["screen_error_px"] <= 1.0 and figures["cost_ms"] == pytest.approx(3.0 * min(good))
    assert figures["cost_ratio_2m_20m"] > 1.0 and figures["cost_ms"] > 0.0
    assert len(content["rows"]) == figures["settings"] == len(measured.settings)


def test_plan_takes_the_camera_of_the_scene(learned: Precomputed, measured: CostTable, tmp_path: Path) -> None:
    out = tmp_path / "plan.json"
    words = ["plan", str(learned.path), "--target", "accepted", "--budget-ms", "1000"]
    assert command.main([*words, "--json", str(out)]) == 0
    figures = json.loads(out.read_text(encoding="utf-8"))["figures"]
    assert 2.5 < figures["distance_m"] < 3.5
    assert figures["screen_error_px"] <= 10.0


@pytest.mark.proof
def test_plan_of_a_scene_makes_its_database_and_its_front_once(
    learned: Precomputed, small: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From a scene file to a plan; the recorded runs are found again, what is learned from them is made anew."""
    # How well it is measured is not tested here.
    for name, value in (("MAX_TICKS", 30), ("REFERENCE_RUNS", 2), ("RUNS_EACH", 1)):
        monkeypatch.setattr(measuring, name, value)
    scene, out = tmp_path / "little.toml", tmp_path / "out"
    scene.write_text(SCENE, encoding="utf-8")
    out.mkdir()
    (out / ".gube-cache").symlink_to(default_cache(learned.path), target_is_directory=True)
    words = ["plan", str(scene), "-o", str(out), "--distance", "20", "--budget-ms", "1000", "--json"]
    monkeypatch.setattr(
        "precompute.wrinkle_comparison.compare_database.precompute", partial(precompute, options=OPTIONS)
    )
    assert command.main([*words, str(tmp_path / "first.json")]) == 0
    made = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    assert set(made) == {"little.h5", "little.cost_table.json"}
    monkeypatch.setattr("precompute.wrinkle_comparison.compare_database.precompute", None)
    monkeypatch.setattr("precompute.planning.planning.measure_cost_table", None)
    assert command.main([*words, str(tmp_path / "second.json")]) == 0
    first, second = (
        json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8"))["figures"] for name in ("first", "second")
    )
    assert first == second and first["distance_m"] == 20.0 and first["settings"] >= 24
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == made


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "cannot be read"),
        ("[[garment]\n", "not TOML"),
        (SCENE.replace("builtin:skirt", "builtin:kilt"), "builtin:kilt"),
        (SCENE.replace("atoms = 6", "atom = 6"), "atom"),
        (SCENE.split("[character]")[0], "character"),
    ],
)
def test_scenes_that_cannot_be_planned_end_with_a_message(
    content: str | None, expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "wrong.toml"
    if content is not None:
        scene.write_text(content, encoding="utf-8")
    assert command.main(["plan", str(scene), "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert expected in message and "Traceback" not in message
    assert not list(tmp_path.rglob("*.h5"))


def test_a_front_that_is_none_is_refused(
    learned: Precomputed, measured: CostTable, capsys: pytest.CaptureFixture[str]
) -> None:
    path = cost_table_path(learned.path)
    kept = path.read_text(encoding="utf-8")
    try:
        for content in ("{", kept.replace('"version": 4', '"version": 3'), kept.replace('"level": 1', '"level": 2')):
            path.write_text(content, encoding="utf-8")
            assert command.main(["plan", str(learned.path)]) == 2
            assert "remove it to measure anew" in capsys.readouterr().err
    finally:
        path.write_text(kept, encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "expected"),
    [(["--garments", "0"], "at least 1"), (["--fov", "180"], "below 180"), (["--budget-ms", "-1"], "above 0")],
)
def test_bad_plans_end_with_a_message(
    learned: Precomputed, measured: CostTable, words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        status = command.main(["plan", str(learned.path), *words])
    except SystemExit as ended:
        status = ended.code
    assert status == 2
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(
    ("quality", "cost", "words"),
    [
        ({}, None, "plain cloth was not compared"),
        ({"cost_advantage": 2.0, "cost_advantage_is_at_least": 1.0}, None, "no plain cloth .* is as good"),
        ({"cost_advantage": 0.5, "cost_advantage_is_at_least": 0.0}, 0.5, "costs 0.5 ms: play that instead"),
        ({"cost_advantage": 0.9, "cost_advantage_is_at_least": 0.0}, 0.9, "costs 0.9 ms: no better choice"),
    ],
)
def test_plain_cloth_that_is_as_good_stands_beside_the_settings(
    quality: dict[str, float], cost: float | None, words: str
) -> None:
    mesh = {"plain_vertex_count": 900.0, "plain_substeps": 6.0, "plain_passes": 1.0, "plain_frame_ms": 4.0}
    figures, line = plain_cloth(quality | mesh, made_front(), 0.8)
    assert figures.get("plain_cost_ms") == cost and re.search(words, line)
