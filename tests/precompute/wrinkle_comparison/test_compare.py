"""Comparison of methods: a small tube of cloth on the built-in mannequin."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from pbd import InputError, SolverOptions
from precompute.learning.evaluation import play_freely
from precompute.learning.run_recording import Run
from precompute.learning.truth import SETTLE, Truth, fine_run, truth_of
from precompute.scratch import Tally
from precompute.wrinkle_comparison import compare_database as comparing
from precompute.wrinkle_comparison import wrinkle_comparison
from precompute.wrinkle_comparison.baselines import ClothTurn, fine_cloth, plain_cloths, take_turns
from precompute.wrinkle_comparison.blind import blind_figures, write_blind
from precompute.wrinkle_comparison.compare_database import (
    RUNS,
    check_length,
    compare,
    compare_file,
    plain_methods,
    write_choice,
)
from precompute.wrinkle_comparison.comparison import ERRORS, Comparison, Method, MotionComparison
from precompute.wrinkle_comparison.comparison_page import verdict, write_comparison
from precompute.wrinkle_comparison.realism import FEWEST_FRAMES
from runtime.cli import command
from runtime.output.database_info import info_text
from runtime.output.verdict import cost_sentence
from runtime.play.plain_cloth import PlainCloth, middle_levels
from runtime.play.player import Player
from runtime.play.simulation import Simulation, body_source, poses_of
from tests.runtime.players import SCENE, skirt_database, skirt_stage, tube
from tests.wrinkles.databases import placed
from wrinkles.database import WrinkleDatabase
from wrinkles.database_file import read_database, write_database
from wrinkles.levels import build_levels
from wrinkles.rest_shape import RestShapeCorrection


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
        texture=None,
    )


@pytest.fixture(scope="module")
def truth(database: WrinkleDatabase, tmp_path_factory: pytest.TempPathFactory) -> Truth:
    stage = skirt_stage()
    source = body_source(stage.body)
    levels = database.levels(source.vertices, source.faces)
    run = fine_run(levels, stage.body, stage.motion(), database, substep=1.0 / 480.0)
    return truth_of(replace(run, poses=run.poses[:84]), tmp_path_factory.mktemp("cache"), 1, count=RUNS)


@pytest.fixture(scope="module")
def comparison(database: WrinkleDatabase, truth: Truth) -> Comparison:
    with pytest.MonkeyPatch.context() as patch:  # short: what is measured is not what is tested
        patch.setattr(comparing, "SUBSTEPS", (2, 12))
        return compare(database, [truth])


def some(prefix: str, frame_ms: float, errors: dict[str, float] | float | None, mesh: str = "") -> Method:
    """A method of four runs with one error for all, or errors by name; None broke, without errors it is too dear."""
    values = {} if errors is None else dict.fromkeys(ERRORS, errors) if isinstance(errors, float) else errors
    figures = {ERRORS[name]: float(np.exp(value)) if name == "spread" else value for name, value in values.items()}
    settings = {"simulated vertices": 9.0, "substeps a frame": 3.0}
    runs = (np.zeros((1, 1, 3)),) * 4 if values else ()
    broke_at = 0.5 if errors is None else None
    return Method(prefix, prefix, frame_ms, figures, settings, runs, mesh=mesh, broke_at=broke_at)


def rigged(
    truth: Truth,
    ours: dict[str, float] | float,
    *plain: tuple[float, dict[str, float] | float | None],
    floor: float = 0.1,
) -> Comparison:
    """Ours of 4 ms and plain cloth of some times and errors, on one motion."""
    cloths = [some(f"plain_{k}_", ms, errors, "fine") for k, (ms, errors) in enumerate(plain)]
    methods = (some("", 4.0, ours), *cloths, some("floor_", float("nan"), floor))
    return Comparison("x", (MotionComparison("y", truth, methods),))


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


def test_a_finer_mesh_that_is_too_dear_is_not_played_on(
    database: WrinkleDatabase, truth: Truth, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(comparing, "DEAR", 0.0)
    methods = comparing._played(database, truth, True, None, Tally(None))
    dear = [one for one in methods if one.mesh not in ("", "coarse")]
    assert dear and all(one.too_dear and one.frame_ms > 0.0 for one in dear)
    assert all(len(one.runs[0]) == len(truth.frames) for one in methods if one.mesh in ("", "coarse"))


@pytest.mark.parametrize(
    ("ours", "plain", "ratio", "at_least"),
    [
        (0.3, [(8.0, 0.3), (20.0, 0.2), (2.0, 0.5)], 2.0, False),
        (0.3, [(1.0, 0.29), (20.0, 0.2)], 0.25, False),
        (0.3, [(8.0, 0.4), (20.0, 0.35)], 5.0, True),
        (0.05, [(8.0, 0.1), (20.0, 0.2)], 2.0, False),  # within the floor nothing is better
        (0.3, [(8.0, None), (12.0, 0.2), (90.0, None)], 3.0, False),  # a cloth that breaks is not good
        (0.3, [(8.0, 0.4), (90.0, None)], 2.0, True),
        (0.3, [(8.0, 0.4), (90.0, {}), (70.0, {})], 17.5, True),  # too dear to be played: a bound
        (0.3, [(8.0, 0.2), (90.0, {})], 2.0, False),
    ],
)
def test_the_advantage_is_that_over_the_cheapest_plain_cloth_as_good(
    truth: Truth, ours: float, plain: list[tuple[float, float | None]], ratio: float, at_least: bool
) -> None:
    comparison = rigged(truth, ours, *plain)
    found = comparison.cost_advantage
    assert found is not None and (found.ratio, found.at_least) == (ratio, at_least)
    assert comparison.figures["cost_advantage"] == ratio
    assert comparison.figures["cost_advantage_is_at_least"] == at_least
    assert ("at least" in verdict(comparison).split("\n\n")[0]) == at_least


@pytest.mark.parametrize("name", list(ERRORS))
def test_plain_cloth_is_as_good_by_all_errors_at_once(truth: Truth, name: str) -> None:
    good = dict.fromkeys(ERRORS, 0.2)
    comparison = rigged(truth, 0.3, (2.0, good | {name: 0.4}), (8.0, good))
    assert comparison.cost_advantage is not None and comparison.cost_advantage.ratio == 2.0
    assert comparison.choice["plain_frame_ms"] == 8.0
    unknown = rigged(truth, 0.3, (2.0, {other: 0.2 for other in ERRORS if other != name}), (8.0, good))
    assert unknown.cost_advantage is not None and unknown.cost_advantage.ratio == 2.0


def test_plain_cloth_must_be_as_good_in_every_motion_and_its_time_is_the_mean(truth: Truth) -> None:
    first = rigged(truth, 0.3, (2.0, 0.2), (8.0, 0.2), (10.0, 0.2)).motions[0]
    second = rigged(truth, 0.3, (2.0, 0.4), (16.0, 0.2), (10.0, 0.2)).motions[0]
    found = Comparison("x", (first, second)).cost_advantage
    assert found is not None and found.cloth.prefix == "plain_2_" and found.frame_ms == 10.0 and found.ratio == 2.5


def test_a_difference_that_chance_makes_is_none(truth: Truth) -> None:
    def told(chance: float, **others: float) -> float:
        comparison = rigged(truth, 0.3, (2.0, dict.fromkeys(ERRORS, 0.3) | others), (8.0, 0.3))
        (motion,) = comparison.motions
        for prefix in ("", "plain_0_"):
            method = motion.method(prefix)
            moved = {f"chance_{figure}": chance for figure in ERRORS.values()}
            motion = motion.with_method(replace(method, figures={**method.figures, **moved}))
        found = replace(comparison, motions=(motion,)).cost_advantage
        assert found is not None
        return found.ratio

    # A mean of four runs is off by half as much as one, and a difference by the root of two of that.
    assert told(0.1, realism=0.3 + 0.14) == 0.5 and told(0.1, realism=0.3 + 0.15) == 2.0
    assert told(0.1, bias=0.3 + 0.28) == 0.5 and told(0.1, bias=0.3 + 0.29) == 2.0  # it knows its standard error


def test_what_may_be_as_good_is_run_again_the_cheapest_first(
    database: WrinkleDatabase, truth: Truth, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = ((9.0, 0.2), (2.0, 0.9), (5.0, 0.2), (12.0, 0.2))
    once = [some(f"plain_{k}_", ms, error, "fine") for k, (ms, error) in enumerate(told)]
    once = [replace(method, runs=method.runs[:1]) for method in once]
    methods = [some("", 4.0, 0.3), *once, some("floor_", float("nan"), 0.1)]
    asked: list[str] = []

    def again(_: object, __: object, method: Method, **___: object) -> Method:
        asked.append(method.prefix)
        figures = {**method.figures, "low_frequency_bias": 0.9 if method.prefix == "plain_2_" else 0.2}
        return replace(method, runs=method.runs * 4, figures=figures)

    monkeypatch.setattr(comparing, "_played", lambda *_: methods)
    monkeypatch.setattr(comparing, "_with_figures", lambda _, methods, *__: methods)
    monkeypatch.setattr(comparing, "run_again", again)
    found = compare(database, [truth])
    assert asked == ["plain_2_", "plain_0_"]  # two at a time
    assert found.cost_advantage is not None
    assert found.cost_advantage.cloth.prefix == "plain_0_" and found.cost_advantage.ratio == 2.25


def test_a_database_says_which_is_the_better_choice(tmp_path: Path, database: WrinkleDatabase, truth: Truth) -> None:
    path = tmp_path / "curtain.h5"
    assert "finds out whether cloth without learned folds would do" in cost_sentence(database.quality)
    for cloths, words in (
        ([(1.0, 0.29), (20.0, 0.2)], "(9 points in 3 steps) is as good and takes 1.0 ms: that cloth is played instead"),
        ([(8.0, 0.3)], "that is as good (9 points in 3 steps) takes 8.0 ms: the learned folds are played"),
        ([(8.0, 0.4)], "none is as good up to 8.0 ms (9 points in 3 steps): the learned folds are played"),
    ):
        written = write_choice(path, database, rigged(truth, 0.3, *cloths))
        sentence = cost_sentence(written.quality)
        assert sentence.startswith("A picture takes 4.0 ms of one processor core") and words in sentence
        assert read_database(path).quality == written.quality and database.quality.items() <= written.quality.items()
        assert sentence in info_text(path)[0]


@pytest.mark.parametrize(("cuts", "passes"), [(0, 0), (1, 0), (2, 0), (0, 2), (1, 1)])
def test_what_is_played_is_what_was_compared(cuts: int, passes: int, database: WrinkleDatabase, truth: Truth) -> None:
    run, keep = truth.run, np.array([2, 4, 8])
    cloth = list(plain_cloths(database, run).values())[cuts].with_substeps(6)
    compared = replace(cloth, passes=passes).play(keep, 8).frames
    player = Player(database, run.body, run.poses[0], run.primitives, cloth=PlainCloth(cuts, 6, passes))
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


@pytest.mark.parametrize(("array", "value"), [("velocity", np.inf), ("position", 1.0)])
def test_a_cloth_that_breaks_says_when(array: str, value: float, truth: Truth, monkeypatch: pytest.MonkeyPatch) -> None:
    step, frames = Simulation.step, []

    def breaking(simulation: Simulation, *arguments: object) -> None:
        step(simulation, *arguments)
        frames.append(1)
        if len(frames) == 6:
            getattr(simulation.state, array)[::9] = value

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
    sent = pickle.dumps(Method("", "ours", 1.0, {}, {}, (frames, frames)))
    assert len(sent) < frames.nbytes
    received = pickle.loads(sent)  # noqa: S301
    assert len(received.runs) == 2 and np.array_equal(received.frames, frames)


def test_more_substeps_are_nearer_to_the_truth_and_smooth_is_too_smooth(comparison: Comparison) -> None:
    figures, (motion,) = comparison.figures, comparison.motions
    assert figures["plain_fine_12_low_frequency_bias"] < figures["plain_fine_2_low_frequency_bias"]
    assert figures["smooth_bending_energy_ratio"] < 1.0
    assert figures["smooth_frame_ms_p50"] < figures["frame_ms_p50"]
    assert figures["plain_middle_2_frame_ms_p50"] < figures["truth_frame_ms_p50"]
    assert "floor_frame_ms_p50" not in figures
    for method in motion.methods:
        assert all(frames.shape == motion.truth.frames.shape for frames in method.runs)
    assert len(motion.method("").runs) == len(motion.method("floor_").runs) == RUNS
    assert 0.5 <= figures["floor_realism"] < figures["smooth_realism"] <= 1.0
    assert figures["low_frequency_spread"] > 0.0 and figures["chance_free_normal_error_deg"] > 0.0
    assert "smooth_low_frequency_spread" not in figures


def test_true_runs_from_other_starts_are_no_copies(truth: Truth) -> None:
    runs = [truth.frames, *truth.others, truth.floor]
    assert len(runs) == RUNS + 1
    apart = [np.abs(one - other).max() for k, one in enumerate(runs) for other in runs[:k]]
    assert min(apart) > 1e-5


def test_a_true_run_is_sent_without_its_filters(truth: Truth) -> None:
    assert truth.low_frequency.floor >= 0.0  # makes the filters
    sent = pickle.loads(pickle.dumps(truth))  # noqa: S301
    assert "low_pass" not in sent.__dict__ and np.array_equal(sent.floor, truth.floor)


def test_free_runs_are_those_of_the_player(database: WrinkleDatabase, comparison: Comparison) -> None:
    (motion,) = comparison.motions
    for start in (0, 2):
        free = play_freely(database, motion.truth.run.body, motion.truth.run, start)
        np.testing.assert_array_equal(motion.method("").runs[start], free.frames)


def test_few_plain_cloths_are_as_in_the_whole_comparison(
    database: WrinkleDatabase, comparison: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(comparing, "BRIEF", (2,))
    (motion,) = comparison.motions
    found = plain_methods(database, motion.truth)
    assert [method.prefix for method in found] == [
        f"plain_{mesh}_2_{rest}" for mesh in ("coarse", "middle") for rest in ("", "at_rest_")
    ]
    for method in found:
        whole = motion.method(method.prefix)
        if len(whole.runs) == 1:
            assert dict(method.figures) == dict(whole.figures)


def test_the_page_has_front_places_and_pictures(comparison: Comparison, tmp_path: Path) -> None:
    write_comparison(tmp_path / "compare.html", comparison)
    page = (tmp_path / "compare.html").read_text(encoding="utf-8")
    assert page.count('<svg class="plot"') == len(ERRORS) - 1  # spread is known of few methods
    assert "cost advantage" in page and "Realism by place" in page and "data:image/jpeg" in page


def test_blind_pairs_hide_the_names_and_answers_are_counted(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pairs = 3  # pictures take a third of a second for each moment, whatever their size
    monkeypatch.setattr("precompute.wrinkle_comparison.blind.PAIRS", pairs)
    (motion,) = comparison.motions
    ours = motion.method("").frames
    assert ours is not None
    *pictures, file = write_blind(tmp_path, motion.truth, ours)
    key = json.loads(file.read_text(encoding="utf-8"))
    assert list(key) == [picture.name for picture in pictures] and len(key) == pairs
    assert file.parent != pictures[0].parent and set(key.values()) <= {"A", "B"}
    answers = tmp_path / "answers.txt"
    answers.write_text("\n".join(key.values()).lower() + "\n", encoding="utf-8")
    assert blind_figures(tmp_path, answers) == {
        "blind_right_percent": 100.0,
        "blind_chance_percent": pytest.approx(100.0 * 0.5**pairs),
    }
    wrong = ["B" if letter == "A" else "A" for letter in key.values()]
    answers.write_text("\n".join(wrong), encoding="utf-8")
    assert blind_figures(tmp_path, answers) == {"blind_right_percent": 0.0, "blind_chance_percent": 100.0}
    for text, message in (("A\n", "3 lines"), ("\n".join(["A"] * (pairs - 1) + ["C"]), "line 3")):
        answers.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=message):
            blind_figures(tmp_path, answers)
    with pytest.raises(InputError, match="no blind pairs"):
        blind_figures(tmp_path / "nowhere", answers)


def test_a_method_that_broke_is_on_the_page(comparison: Comparison, tmp_path: Path) -> None:
    (motion,) = comparison.motions
    broken = replace(motion.method("plain_fine_2_"), figures={}, runs=(), broke_at=0.5, realism=None)
    write_comparison(tmp_path / "compare.html", replace(comparison, motions=(motion.with_method(broken),)))
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
    monkeypatch.setattr(comparing, "truth_of", lambda *_, **__: truth)
    monkeypatch.setattr(comparing, "compare", lambda *_, **__: rigged(truth, 0.3, (8.0, 0.3)))


def test_only_the_whole_held_out_motion_decides(database: WrinkleDatabase, path: Path, at_once: None) -> None:
    compare_file(path, path.parent, seconds=2.7)
    compare_file(path, path.parent, clip=database.held_out[0])
    assert "cost_advantage" not in read_database(path).quality
    compare_file(path, path.parent)
    assert read_database(path).quality["cost_advantage"] == 2.0


def test_a_database_that_cannot_be_written_costs_no_comparison(
    path: Path, at_once: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    lines: list[str] = []
    monkeypatch.setattr(comparing, "write_database", refuse)
    assert compare_file(path, path.parent, report=lines.append).cost_advantage is not None
    assert any("cannot be written (Permission denied)" in line for line in lines)


class Lasting:
    """A motion that lasts so long, led into for some of it."""

    name = "lasting"

    def __init__(self, duration: float, lead_in: float) -> None:
        self.duration, self.lead_in = duration, lead_in

    def pose(self, t: float) -> np.ndarray:
        return np.zeros((1, 3))


def held_out_for(seconds: float, folder: Path) -> Path:
    """A scene whose held-out clip lasts so long."""
    path = folder / "scene.toml"
    path.write_text(SCENE.rstrip() + f"\nend = {seconds}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("frame_rate", [30.0, 50.0, 60.0])
def test_a_motion_is_refused_exactly_where_too_few_frames_would_be_recorded(frame_rate: float) -> None:
    dt, outcomes = 1.0 / frame_rate, set()
    for blend, frames in product((0.0, 1.0), range(20, 130)):
        motion = Lasting(blend + frames * dt, blend)
        count = len(poses_of(motion, dt)) - 1
        recorded = np.arange(Run.every, count + 1, Run.every)
        enough = int((recorded * dt > SETTLE).sum()) >= FEWEST_FRAMES
        for cut in (None, motion.duration):
            try:
                check_length(motion, dt, cut)
            except InputError:
                assert not enough, (blend, frames)
            else:
                assert enough, (blend, frames)
        outcomes.add(enough)
    assert outcomes == {True, False}


def test_what_cannot_be_compared_on_is_refused_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def made(*_: object, **__: object) -> None:
        raise AssertionError("nothing may be simulated or learned")

    for name in ("precompute", "truth_of", "database_of"):
        monkeypatch.setattr(comparing, name, made)
    monkeypatch.setattr(wrinkle_comparison, "database_of", made)
    short, long = held_out_for(0.8, tmp_path), tmp_path / "long.toml"
    for refuse in (compare_file, wrinkle_comparison.compare_wrinkles_file):
        with pytest.raises(InputError, match=r"too short to compare on.*received '0.80 s', expected at least 1.03 s"):
            refuse(short, tmp_path)
    long.write_text(SCENE, encoding="utf-8")
    with pytest.raises(InputError, match=r"--seconds.*received 1.5, expected at least 2.03"):
        compare_file(long, tmp_path, seconds=1.5)
    with pytest.raises(InputError, match="no such clip"):
        compare_file(long, tmp_path, clip="flying")
    with pytest.raises(InputError, match="learned from this clip"):
        compare_file(long, tmp_path, clip="sway")
    long.write_text(SCENE.partition("[[training.held_out]]")[0], encoding="utf-8")
    with pytest.raises(InputError, match="nothing is held out"):
        wrinkle_comparison.compare_wrinkles_file(long, tmp_path)


def test_built_in_scenes_wait_until_the_database_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[object] = []
    monkeypatch.setattr(
        "precompute.method_comparison.scene_compare.compare_scenes", lambda *given, **_: ran.append(given)
    )
    assert command.main(["compare", "swing", str(held_out_for(0.8, tmp_path)), "-o", str(tmp_path)]) == 2
    assert "too short to compare on" in capsys.readouterr().err and not ran


def test_what_is_measured_is_counted(truth: Truth, comparison: Comparison, tmp_path: Path) -> None:
    told: list[str] = []
    tally = Tally(tmp_path / "figures")
    methods = [comparison.motions[0].method(prefix) for prefix in ("", "smooth_")]
    found = comparing._with_figures(truth, methods, 1, tally, lambda: told.append(""))
    assert [one.figures for one in found] == [one.figures for one in methods]
    assert tally.count == 2
