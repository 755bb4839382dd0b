"""Comparison of methods: a small tube of cloth on the built-in mannequin."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.procedural.builtin import builtin_garment
from pbd import InputError, SolverOptions
from precompute.learning.evaluation import Truth, fine_run, levels_from, play_freely, truth_of
from precompute.wrinkle_comparison import compare as comparing
from precompute.wrinkle_comparison.baselines import ClothTurn, fine_cloth, plain_cloths, take_turns
from precompute.wrinkle_comparison.blind import PAIRS, blind_figures, write_blind
from precompute.wrinkle_comparison.compare import (
    ERRORS,
    Comparison,
    Method,
    compare,
    compare_file,
    plain_methods,
    write_choice,
)
from precompute.wrinkle_comparison.comparison_page import verdict, write_comparison
from runtime.info import better_choice, info_text
from runtime.plain_player import PlainCloth, PlainPlayer, middle_levels
from runtime.simulation import Simulation, body_source
from tests.runtime.players import skirt_database, skirt_stage
from tests.wrinkles.databases import placed
from wrinkles.database import WrinkleDatabase, read_database, write_database
from wrinkles.levels import build_levels
from wrinkles.rest_shape import RestShapeCorrection


def tube() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A short wide skirt of few vertices: vertices, faces and its upper ring."""
    skirt = builtin_garment("skirt").vertices
    top, around, rows = skirt[skirt[:, 1] > skirt[:, 1].max() - 0.01], 16, 4
    centre, radius = top.mean(axis=0), np.linalg.norm((top - top.mean(axis=0))[:, [0, 2]], axis=1).max()
    row, column = np.divmod(np.arange(rows * around), around)
    angle = 2.0 * np.pi * column / around
    wide = radius + 0.03 + 0.05 * row
    vertices = centre + np.stack([wide * np.sin(angle), -0.09 * row, wide * np.cos(angle)], axis=1)
    a = np.arange((rows - 1) * around)
    b = a - a % around + (a + 1) % around
    faces = np.concatenate([np.stack([a, a + around, b], axis=1), np.stack([b, a + around, b + around], axis=1)])
    return vertices, faces.astype(np.int32), np.arange(around)


@pytest.fixture(scope="module")
def database() -> WrinkleDatabase:
    vertices, faces, held = tube()
    body = skirt_stage().body
    levels = build_levels(vertices, faces, held, body.vertices, body.faces, 2)
    plain = skirt_database(subdivisions=2)
    bias = np.zeros((len(vertices), plain.mapping.place_bias.shape[1]))
    return replace(
        plain,
        coarse_vertices=levels.coarse.vertices,
        coarse_faces=faces,
        sewn=None,
        rest_shape=RestShapeCorrection.none(faces),
        held=levels.coarse_held.astype(np.int32),
        subdivisions=2,
        cutoff=levels.cutoff,
        atoms=replace(plain.atoms, vertex_mean=np.zeros((levels.subdivision.fine_count, 3), np.float32)),
        mapping=placed(plain.mapping, bias),
        solver=SolverOptions(substep=1.0 / 240.0),
        frame_rate=30.0,
    )


@pytest.fixture(scope="module")
def truth(database: WrinkleDatabase, tmp_path_factory: pytest.TempPathFactory) -> Truth:
    stage = skirt_stage()
    levels = levels_from(database, stage.body)
    run = fine_run(levels, stage.body, stage.motion(), database, substep=1.0 / 480.0)
    return truth_of(replace(run, poses=run.poses[:84]), tmp_path_factory.mktemp("cache"), 1)


@pytest.fixture(scope="module")
def comparison(database: WrinkleDatabase, truth: Truth) -> Comparison:
    with pytest.MonkeyPatch.context() as patch:  # short: what is measured is not what is tested
        patch.setattr(comparing, "SUBSTEPS", (2, 12))
        return compare(database, truth)


def some(prefix: str, frame_ms: float, error: float | None, mesh: str = "") -> Method:
    """A method with one error for all, or one that broke."""
    figures = {} if error is None else dict.fromkeys(ERRORS.values(), error)
    settings = {"simulated vertices": 9.0, "substeps a frame": 3.0}
    return Method(prefix, prefix, frame_ms, figures, settings, mesh=mesh, broke_at=0.5 if error is None else None)


def rigged(truth: Truth, ours: float, *plain: tuple[float, float | None], floor: float = 0.1) -> Comparison:
    """Ours of 4 ms and plain cloth of some times and errors."""
    cloths = [some(f"plain_{k}_", ms, error, "fine") for k, (ms, error) in enumerate(plain)]
    return Comparison("x", "y", truth, (some("", 4.0, ours), *cloths, some("floor_", float("nan"), floor)))


def test_the_middle_mesh_leads_to_the_same_fine_mesh(database: WrinkleDatabase, truth: Truth) -> None:
    middle, levels = middle_levels(database, body_source(truth.run.body)), truth.levels
    assert middle is not None
    assert np.array_equal(middle.subdivision.faces, levels.fine.faces)
    assert np.array_equal(middle.fine_held, levels.fine_held)
    assert len(middle.coarse.faces) == 4 * len(levels.coarse.faces)
    size = np.ptp(levels.fine.vertices, axis=0).max()
    assert np.abs(middle.fine.vertices - levels.fine.vertices).max() < 0.02 * size
    assert middle.coarse.face_areas.sum() == pytest.approx(levels.fine.face_areas.sum(), rel=0.01)
    assert middle_levels(replace(database, subdivisions=1), body_source(truth.run.body)) is None


def test_every_mesh_of_the_chain_is_a_plain_cloth(database: WrinkleDatabase, truth: Truth) -> None:
    cloths = plain_cloths(database, truth.run)
    assert list(cloths) == ["coarse", "middle", "fine"]
    counts = [cloth.model.vertex_count for cloth in cloths.values()]
    assert counts[0] == len(database.coarse_vertices) and counts[-1] == len(truth.levels.fine.vertices)
    assert counts == sorted(counts)


@pytest.mark.parametrize(
    ("ours", "plain", "ratio", "at_least"),
    [
        (0.3, [(8.0, 0.3), (20.0, 0.2), (2.0, 0.5)], 2.0, False),
        (0.3, [(1.0, 0.29), (20.0, 0.2)], 0.25, False),
        (0.3, [(8.0, 0.4), (20.0, 0.35)], 5.0, True),
        (0.05, [(8.0, 0.1), (20.0, 0.2)], 2.0, False),  # within the floor nothing is better
        (0.3, [(8.0, None), (12.0, 0.2), (90.0, None)], 3.0, False),  # a cloth that breaks is not good
        (0.3, [(8.0, 0.4), (90.0, None)], 2.0, True),
    ],
)
def test_the_advantage_is_that_over_the_cheapest_plain_cloth_as_good(
    truth: Truth, ours: float, plain: list[tuple[float, float | None]], ratio: float, at_least: bool
) -> None:
    comparison = rigged(truth, ours, *plain)
    found = comparison.advantage("band")
    assert found is not None and (found.ratio, found.at_least) == (ratio, at_least)
    figures = comparison.figures
    assert figures["cost_advantage"] == figures["cost_advantage_realism"] == ratio
    assert figures["cost_advantage_is_at_least"] == at_least
    assert ("at least" in verdict(comparison).split("\n\n")[0]) == at_least


def test_the_least_of_both_advantages_counts(truth: Truth) -> None:
    comparison = rigged(truth, 0.3, (8.0, 0.25), (20.0, 0.2))
    methods = list(comparison.methods)
    methods[0] = replace(methods[0], figures={**methods[0].figures, "realism": 0.22})
    figures = replace(comparison, methods=tuple(methods)).figures
    assert figures["cost_advantage_band"] == figures["cost_advantage"] == 2.0
    assert figures["cost_advantage_realism"] == 5.0 == figures["cost_advantage_both"]


def test_what_is_played_is_as_good_by_both_measures(truth: Truth) -> None:
    comparison = rigged(truth, 0.3, (2.0, 0.25), (8.0, 0.2))
    methods = list(comparison.methods)
    methods[1] = replace(methods[1], figures={**methods[1].figures, "realism": 0.9})  # cheap, good by bands alone
    comparison = replace(comparison, methods=tuple(methods))
    assert comparison.figures["cost_advantage"] == 0.5 and comparison.choice["cost_advantage_both"] == 2.0
    assert comparison.choice["plain_frame_ms"] == 8.0
    assert "ours is played" in verdict(comparison)


def test_a_database_says_which_is_the_better_choice(tmp_path: Path, database: WrinkleDatabase, truth: Truth) -> None:
    path = tmp_path / "curtain.h5"
    assert better_choice(database.quality).startswith("unknown")
    for cloths, words in (
        ([(1.0, 0.29), (20.0, 0.2)], "plain cloth of 9 vertices, 3 substeps, 1.00 ms a frame; the wrinkles, 4.00 ms"),
        ([(8.0, 0.3)], "the wrinkles, 4.00 ms a frame; plain cloth that is as good takes 9 vertices"),
        ([(8.0, 0.4)], "the wrinkles, 4.00 ms a frame; no plain cloth that was tried is as good"),
    ):
        write_choice(path, database, rigged(truth, 0.3, *cloths))
        written = read_database(path)
        assert better_choice(written.quality).startswith(words)
        assert database.quality.items() <= written.quality.items()
        assert words in info_text(path)[0]


@pytest.mark.parametrize(("cuts", "passes"), [(0, 0), (1, 0), (2, 0), (0, 2), (1, 1)])
def test_what_is_played_is_what_was_compared(cuts: int, passes: int, database: WrinkleDatabase, truth: Truth) -> None:
    run, keep = truth.run, np.array([2, 4, 8])
    cloth = list(plain_cloths(database, run).values())[cuts].with_substeps(6)
    compared = replace(cloth, passes=passes).play(keep, 8).frames
    player = PlainPlayer(database, run.body, PlainCloth(cuts, 6, passes), run.poses[0], run.primitives)
    for number in range(1, 9):
        player.update(run.poses[number], run.dt, run.wind)
        if number in keep:
            shown = (player.vertices + player.origin).astype(np.float32)
            np.testing.assert_array_equal(shown, compared[keep.tolist().index(number)])


def test_methods_take_turns() -> None:
    played: list[tuple[str, int]] = []

    class One:
        def __init__(self, name: str) -> None:
            self.name = name

        def advance(self, count: int) -> None:
            played.append((self.name, count))

    take_turns([One("a"), One("b")], 20)
    assert played == [("a", 8), ("b", 8), ("a", 8), ("b", 8), ("a", 4), ("b", 4)]


@pytest.mark.parametrize(("array", "value"), [("velocity", np.inf), ("position", 40.0)])
def test_a_cloth_that_breaks_says_when(array: str, value: float, truth: Truth, monkeypatch: pytest.MonkeyPatch) -> None:
    step, frames = Simulation.step, []

    def breaking(simulation: Simulation, *arguments: object) -> None:
        step(simulation, *arguments)
        frames.append(1)
        if len(frames) == 6:
            getattr(simulation.state, array)[0] = value

    monkeypatch.setattr(Simulation, "step", breaking)
    played = fine_cloth(truth.run).with_substeps(2).play(np.array([2, 4, 8]))
    assert played.broke_at == pytest.approx(6 / 30)
    assert len(played.frames) == 2


def test_frames_kept_in_a_file_go_to_another_process_by_its_name(tmp_path: Path, truth: Truth) -> None:
    cloth, keep = fine_cloth(truth.run).with_substeps(2), np.array([2, 4, 8])
    turn = ClothTurn(cloth, keep, tmp_path)
    turn.advance(8)
    frames = turn.played.frames
    assert np.array_equal(frames, cloth.play(keep, 8).frames)
    sent = pickle.dumps(Method("", "ours", 1.0, {}, {}, frames))
    assert len(sent) < frames.nbytes
    received = pickle.loads(sent)  # noqa: S301
    assert np.array_equal(received.frames, frames)


def test_more_substeps_are_nearer_to_the_truth_and_smooth_is_too_smooth(comparison: Comparison) -> None:
    figures, truth = comparison.figures, comparison.truth
    assert figures["floor_low_frequency_ratio_to_floor"] == pytest.approx(1.0)
    assert figures["plain_fine_12_low_frequency_ratio_to_floor"] < figures["plain_fine_2_low_frequency_ratio_to_floor"]
    assert figures["smooth_bending_energy_ratio"] < 1.0
    assert figures["smooth_frame_ms_p50"] < figures["frame_ms_p50"]
    assert figures["plain_middle_2_frame_ms_p50"] < figures["truth_frame_ms_p50"]
    assert "floor_frame_ms_p50" not in figures
    for method in comparison.methods:
        assert method.frames is not None and method.frames.shape == truth.frames.shape
    assert 0.5 <= figures["floor_realism"] < figures["smooth_realism"] <= 1.0
    assert {"cost_advantage_band", "cost_advantage_realism", "ours_half_substeps_cost_advantage"} < figures.keys()


def test_free_runs_are_those_of_the_player(database: WrinkleDatabase, comparison: Comparison) -> None:
    truth = comparison.truth
    free = play_freely(database, truth.run.body, truth.run)
    np.testing.assert_array_equal(comparison.method("").frames, free.frames)


def test_few_plain_cloths_are_as_in_the_whole_comparison(
    database: WrinkleDatabase, comparison: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(comparing, "BRIEF", (2,))
    found = plain_methods(database, comparison.truth)
    assert [method.prefix for method in found] == [
        f"plain_{mesh}_2_{rest}" for mesh in ("coarse", "middle") for rest in ("", "at_rest_")
    ]
    for method in found:
        assert dict(method.figures) == dict(comparison.method(method.prefix).figures)


def test_the_page_has_front_places_and_pictures(comparison: Comparison, tmp_path: Path) -> None:
    write_comparison(tmp_path / "compare.html", comparison)
    page = (tmp_path / "compare.html").read_text(encoding="utf-8")
    assert page.count('<svg class="plot"') == len(ERRORS)
    assert "Cost advantage" in page and "Realism by place" in page and "data:image/jpeg" in page


def test_blind_pairs_hide_the_names_and_answers_are_counted(comparison: Comparison, tmp_path: Path) -> None:
    ours = comparison.method("").frames
    assert ours is not None
    *pictures, file = write_blind(tmp_path, comparison.truth, ours)
    key = json.loads(file.read_text(encoding="utf-8"))
    assert list(key) == [picture.name for picture in pictures] and len(key) == PAIRS
    assert file.parent != pictures[0].parent and set(key.values()) <= {"A", "B"}
    answers = tmp_path / "answers.txt"
    answers.write_text("\n".join(key.values()).lower() + "\n", encoding="utf-8")
    assert blind_figures(tmp_path, answers) == {
        "blind_right_percent": 100.0,
        "blind_chance_percent": pytest.approx(100.0 * 0.5**PAIRS),
    }
    wrong = ["B" if letter == "A" else "A" for letter in key.values()]
    answers.write_text("\n".join(wrong), encoding="utf-8")
    assert blind_figures(tmp_path, answers) == {"blind_right_percent": 0.0, "blind_chance_percent": 100.0}
    for text, message in (("A\n", "12 lines"), ("\n".join(["A"] * (PAIRS - 1) + ["C"]), "line 12")):
        answers.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=message):
            blind_figures(tmp_path, answers)
    with pytest.raises(InputError, match="no blind pairs"):
        blind_figures(tmp_path / "nowhere", answers)


def test_a_method_that_broke_is_on_the_page(comparison: Comparison, tmp_path: Path) -> None:
    methods = [
        replace(m, figures={}, frames=None, broke_at=0.5, realism=None) if m.prefix == "plain_fine_2_" else m
        for m in comparison.methods
    ]
    write_comparison(tmp_path / "compare.html", replace(comparison, methods=tuple(methods)))
    page = (tmp_path / "compare.html").read_text(encoding="utf-8")
    assert "broke: after 0.50 s" in page


@pytest.fixture
def path(database: WrinkleDatabase, tmp_path: Path) -> Path:
    write_database(tmp_path / "skirt.h5", database)
    return tmp_path / "skirt.h5"


def test_a_clip_that_was_learned_from_is_refused_and_so_is_its_part(database: WrinkleDatabase, path: Path) -> None:
    with pytest.raises(InputError, match="has learned from this clip.*sway.*expected walk"):
        compare_file(path, path.parent, clip="sway")
    scene = database.scene.replace('clip = "sway", start = 0.0', 'clip = "sway", start = 1.0')
    assert scene != database.scene
    write_database(path, replace(database, scene=scene, trained_on=("sway 1- s",)))
    with pytest.raises(InputError, match="has learned from this clip.*sway"):
        compare_file(path, path.parent, clip="sway")


@pytest.fixture
def at_once(truth: Truth, monkeypatch: pytest.MonkeyPatch) -> None:
    """A comparison takes no time, and finds an advantage of 2."""
    monkeypatch.setattr(comparing, "truth_of", lambda *_: truth)
    monkeypatch.setattr(comparing, "compare", lambda *_, **__: rigged(truth, 0.3, (8.0, 0.3)))


def test_only_the_whole_held_out_motion_decides(database: WrinkleDatabase, path: Path, at_once: None) -> None:
    compare_file(path, path.parent, seconds=2.0)
    compare_file(path, path.parent, clip=database.held_out[0])
    assert "cost_advantage_both" not in read_database(path).quality
    compare_file(path, path.parent)
    assert read_database(path).quality["cost_advantage_both"] == 2.0


def test_a_database_that_cannot_be_written_costs_no_comparison(
    path: Path, at_once: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    lines: list[str] = []
    monkeypatch.setattr(comparing, "write_database", refuse)
    assert compare_file(path, path.parent, report=lines.append).cost_advantage() is not None
    assert any("cannot be written (Permission denied)" in line for line in lines)
