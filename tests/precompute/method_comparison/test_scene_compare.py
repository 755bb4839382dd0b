"""Comparison of methods on scenes: what a scene is, how runs are judged, what is left out, what is written."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pbd import InputError
from precompute.experiment.engines import ENGINES
from precompute.experiment.error_classes import ErrorClass
from precompute.method_comparison import scene_compare, scene_judging
from precompute.method_comparison.compare_scenes import SCENES, Sheet, scene_of
from precompute.method_comparison.scene_compare import METHODS, SceneComparison, chosen_settings, compare_scenes
from precompute.method_comparison.scene_judging import Judge, reference_settings
from precompute.method_comparison.scene_page import COLORS, comparison_figures, comparison_text, write_comparison
from precompute.method_comparison.scene_runs import (
    MethodSetting,
    SceneRun,
    parse_setting,
    read_run,
    run_path,
    run_setting,
    write_run,
)

SHORT = 0.7  # [s]


def few_references(scene: scene_judging.CompareScene) -> list[MethodSetting]:
    """References that take no time."""
    if scene.unique:
        return [MethodSetting("default", 12, 32), MethodSetting("default", 16, 48)]
    return [MethodSetting("default", 12, 16, seed=seed) for seed in (1, 2, 3)] + [
        MethodSetting("default", 16, 24, seed=1)
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("compare")


@pytest.fixture(scope="module")
def found(folder: Path) -> list[SceneComparison]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_compare, "reference_settings", few_references)
        methods = ["default@8x2", "default@8x16", "projective-dynamics@8x2x4"]
        return compare_scenes(["swing", "drape"], folder, methods=methods, seconds=SHORT, workers=1)


def test_a_spline_through_a_sheet_is_exact_for_cubics() -> None:
    coarse, fine = Sheet.of(1.0, 0.5, 6), Sheet.of(1.0, 0.5, 14)

    def bent(flat: np.ndarray) -> np.ndarray:
        x, y = flat.T
        return np.stack([x, y**2 - x * y, x**3 - 0.3 * x**2 * y], axis=1)

    sampled = coarse.sampled(bent(coarse.flat)[None], fine)
    assert np.abs(sampled[0] - bent(fine.flat)).max() < 1e-12


@pytest.mark.parametrize("name", SCENES)
def test_scenes_start_without_strain(name: str) -> None:
    scene = scene_of(name)
    mesh = scene.mesh(48)
    edges, lengths = mesh.edge_lengths()
    now = np.linalg.norm(mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]], axis=1)
    assert np.abs(now / lengths - 1.0).max() < (0.02 if name == "curtain" else 1e-9)  # chords of pleats
    moved = scene.mesh(48, seed=1).vertices - mesh.vertices
    held = scene.held(scene.sheet(48).flat)
    assert not moved[held].any()
    assert np.sqrt((moved[~held] ** 2).sum(axis=1).mean()) == pytest.approx(1e-4, rel=0.1)
    depth = np.concatenate([row.centre - mesh.vertices for row in scene.colliders()] or [np.ones((1, 3))])  # type: ignore
    assert np.linalg.norm(depth, axis=1).min() > 0.25


def test_the_default_comparison_has_enough_methods_and_points() -> None:
    settings = [setting for scene in SCENES.values() for setting in chosen_settings(scene, [])]
    assert len(SCENES) == 4 and len(METHODS) >= 8 and len(settings) >= 60


def test_a_setting_reads_back(found: list[SceneComparison]) -> None:
    for point in (point for one in found for point in one.points):
        text = point.command.split("--methods ")[1].split()[0]
        name, numbers = parse_setting(text)
        assert MethodSetting(name, *numbers) == point.run.setting  # type: ignore[arg-type]
    assert parse_setting("xpbd@16x0x3") == ("xpbd", (16, None, 3))


@pytest.mark.parametrize("text", ["nothing", "xpbd@", "xpbd@axb", "xpbd@1x2", "xpbd@8x1x1x1", "xpbd@8x-2"])
def test_bad_settings_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="--methods"):
        parse_setting(text)


def test_an_unknown_scene_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"SCENE.*waltz"):
        compare_scenes(["waltz"], tmp_path)


def test_more_substeps_are_nearer_to_the_reference(found: list[SceneComparison]) -> None:
    few, many = (point.judgement.error for point in found[0].points[:2])
    assert many < 0.5 * few
    assert found[0].judge.floor < many


def test_a_reference_judged_by_itself_has_no_error(found: list[SceneComparison]) -> None:
    judge = found[0].judge
    judgement = judge.judge(judge.reference)
    assert judgement.error == 0.0 and judgement.worst is ErrorClass.IMPERCEPTIBLE


def test_perturbed_references_lie_within_the_floor(found: list[SceneComparison]) -> None:
    judge = found[1].judge
    assert not judge.scene.unique
    assert all(judge.judge(run).error <= judge.floor for run in judge.references[:3])


def test_a_run_that_ended_is_catastrophic_and_off_the_front(found: list[SceneComparison]) -> None:
    one = found[0]
    broken = replace(one.points[0].run, problem="after 0.20 s: not finite")
    judgement = one.judge.judge(broken)
    assert judgement.worst is ErrorClass.CATASTROPHIC and judgement.error == np.inf
    worse = replace(one, points=(*one.points, replace(one.points[0], run=broken, judgement=judgement)))
    assert all(np.isfinite(point.judgement.error) for point in worse.pareto_front())


def test_folds_that_are_not_there_are_told(found: list[SceneComparison]) -> None:
    judge = found[1].judge
    position = judge.reference.position.copy()
    position[..., 1] += 0.05 * np.sin(40.0 * position[..., 0])
    assert judge.judge(replace(judge.reference, position=position)).error > 2.0 * judge.floor


def test_a_run_reads_back(tmp_path: Path, found: list[SceneComparison]) -> None:
    run = found[0].points[0].run
    write_run(tmp_path / "run.npz", run)
    again = read_run(tmp_path / "run.npz")
    assert again is not None and again.setting == run.setting and again.substeps == run.substeps
    assert np.array_equal(again.position, run.position)
    (tmp_path / "run.npz").write_bytes(b"half a file")
    assert read_run(tmp_path / "run.npz") is None


def test_nothing_is_run_twice_and_budget_drops_the_dearest(
    found: list[SceneComparison], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_compare, "reference_settings", few_references)
    monkeypatch.setattr(scene_compare._Job, "run", lambda _: pytest.fail("run again"))
    methods = ["default@8x2", "xpbd@8x40x40"]
    (one,) = compare_scenes(["swing"], folder, methods=methods, seconds=SHORT, workers=1, budget_s=10.0)
    assert [point.run.setting.method for point in one.points] == ["default"]
    ((setting, why),) = one.dropped
    assert setting.method == "xpbd" and "budget" in why


def test_a_run_that_takes_too_long_is_given_up() -> None:
    run: SceneRun = run_setting(scene_of("swing", 0.5), MethodSetting("default", 8, 2), limit_s=0.0)
    assert run.gave_up and len(run.position) == 1 and "given up" in run.problem


def test_a_key_tells_settings_and_scenes_apart(tmp_path: Path) -> None:
    scene, setting = scene_of("swing"), MethodSetting("default", 8, 2)
    paths = {
        run_path(tmp_path, scene, setting),
        run_path(tmp_path, scene_of("swing", 0.3), setting),
        run_path(tmp_path, scene_of("drape"), setting),
        run_path(tmp_path, scene, replace(setting, seed=2)),
    }
    assert len(paths) == 4


def test_references_of_unique_scenes_are_refined_twice() -> None:
    for scene in SCENES.values():
        *proxy, finest = reference_settings(scene)
        assert all(finest.edges > one.edges for one in proxy)
        assert len(proxy) == (1 if scene.unique else 3)


def test_everything_is_written(found: list[SceneComparison], tmp_path: Path) -> None:
    write_comparison(tmp_path, found)
    page = (tmp_path / "compare.html").read_text(encoding="utf-8")
    assert 'src="http' not in page and len(re.findall(r'<g id="chart\d+-p\d"><title>', page)) == 6
    for point in found[0].points:
        color = COLORS[point.judgement.worst]
        title = f"<title>{point.run.setting.method}, {point.run.setting.numbers}: [^<]*</title>"
        assert re.search(f"{title}(?:(?!fill: ).)*fill: {color}", page, re.DOTALL)
    for one in found:
        assert all(point.command in page for point in one.points)
        assert (tmp_path / f"{one.scene.name}.png").stat().st_size > 10_000
        assert one.scene.title in comparison_text(one)
    rows = json.loads((tmp_path / "compare.json").read_text(encoding="utf-8"))["rows"]
    lines = (tmp_path / "compare.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 6 and len(lines) == 7
    assert {"frame_ms_p50", "frame_ms_p99", "setup_s", "memory_mb", "error", "error_class"} <= set(rows[0])
    assert all(row["memory_mb"] > 0.1 and row["frame_ms_p99"] >= row["frame_ms_p50"] > 0.0 for row in rows)
    assert comparison_figures(found)["points"] == 6.0
    assert (tmp_path / "compare.png").stat().st_size > 10_000


def test_a_judge_of_one_reference_has_no_floor() -> None:
    scene = scene_of("swing", SHORT)
    run = run_setting(scene, MethodSetting("default", 8, 4))
    judge = Judge(scene, [run, run])
    assert judge.floor == 0.0


def test_every_engine_has_settings_of_its_own() -> None:
    assert set(scene_compare.BASELINES) == set(ENGINES)
