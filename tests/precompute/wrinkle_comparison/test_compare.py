"""Comparison of methods: a small tube of cloth on the built-in mannequin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from assets.procedural.builtin import builtin_garment
from pbd import InputError, SolverOptions
from precompute.learning.evaluation import Truth, fine_run, free_figures, levels_from, truth_of
from precompute.stability import stability
from precompute.stability.stability import MAX_SUBSTEP, MIN_SUBSTEP, largest_stable_step, real_substep
from precompute.wrinkle_comparison import baselines
from precompute.wrinkle_comparison.baselines import PROBE_FRAMES, Cloth, equal_cost_substeps, fine_cloth, middle_levels
from precompute.wrinkle_comparison.compare import Comparison, compare, compare_file, equal_cost_baselines, winners
from precompute.wrinkle_comparison.comparison_page import verdict, write_comparison
from runtime.simulation import Simulation
from tests.runtime.players import skirt_database, skirt_stage
from tests.wrinkles.databases import placed
from wrinkles.database import WrinkleDatabase, write_database
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
    plain = skirt_database()
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
    run = fine_run(levels_from(database, stage.body), stage.body, stage.motion(), database)
    return truth_of(replace(run, poses=run.poses[:58]), tmp_path_factory.mktemp("cache"), 1)


@pytest.fixture(scope="module")
def comparison(database: WrinkleDatabase, truth: Truth) -> Comparison:
    with pytest.MonkeyPatch.context() as patch:  # short: what is measured is not what is tested
        patch.setattr(baselines, "PROBE_FRAMES", 16)
        patch.setattr(stability, "MIN_SUBSTEP", 1.0 / 600.0)
        patch.setattr(stability, "BISECTIONS", 4)
        return compare(database, truth)


def rigged(comparison: Comparison, prefix: str) -> Comparison:
    """The comparison with one method that has found the truth."""
    truth = comparison.truth
    methods = [
        replace(m, figures={**m.figures, **free_figures(truth, truth.frames)}) if m.prefix == prefix else m
        for m in comparison.methods
    ]
    # Nothing lies within this floor but what is right.
    methods = [replace(m, figures=dict.fromkeys(m.figures, 1e-6)) if m.prefix == "floor_" else m for m in methods]
    return replace(comparison, methods=tuple(methods))


def test_the_middle_mesh_leads_to_the_same_fine_mesh(database: WrinkleDatabase, truth: Truth) -> None:
    middle, levels = middle_levels(database, truth.run), truth.levels
    assert middle is not None
    assert np.array_equal(middle.subdivision.faces, levels.fine.faces)
    assert np.array_equal(middle.fine_held, levels.fine_held)
    assert len(middle.coarse.faces) == 4 * len(levels.coarse.faces)
    size = np.ptp(levels.fine.vertices, axis=0).max()
    assert np.abs(middle.fine.vertices - levels.fine.vertices).max() < 0.02 * size
    assert middle.coarse.face_areas.sum() == pytest.approx(levels.fine.face_areas.sum(), rel=0.01)
    assert middle_levels(replace(database, subdivisions=1), truth.run) is None


@pytest.mark.parametrize(
    ("budget", "expected"), [(0.5, 1), (1.0, 1), (3.4, 4), (3.7, 5), (9.0, 15), (1e9, baselines.MAX_SUBSTEPS)]
)
def test_substeps_come_nearest_to_the_budget(budget: float, expected: int) -> None:
    assert equal_cost_substeps(lambda count: 1.4 + 0.5 * count, budget) == expected


@pytest.mark.parametrize("power", [0.8, 1.0, 1.2])
def test_substeps_are_found_by_few_trials(power: float) -> None:
    for wanted in (2, 7, 8, 21, 90):
        tried: list[int] = []

        def cost(count: int, tried: list[int] = tried) -> float:
            tried.append(count)
            return 1.0 + 0.3 * count**power

        assert equal_cost_substeps(cost, cost(wanted)) == wanted
        assert len(tried) <= 8


def test_what_lies_within_the_floor_has_won_alike() -> None:
    errors = {"ours": 0.3, "middle": 0.2, "fine": float("nan")}
    assert winners(errors, 0.1) == ("middle",)
    assert winners(errors, 0.25) == ("middle",)
    assert winners({"ours": 0.209, "middle": 0.2, "fine": 0.22}, 0.1) == ("ours", "middle")
    assert winners(errors, 0.35) == ("ours", "middle")
    assert winners({"fine": float("nan")}, 0.1) == ()


class Breaking:
    """A stand-in for a simulation that breaks, in one way, with substeps over a limit."""

    def __init__(self, options: SolverOptions, limit: float, way: str) -> None:
        vertices, faces, _ = tube()
        edges = np.sort(faces[:, :2], axis=1)
        lengths = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
        mesh = SimpleNamespace(vertices=vertices, edge_lengths=lambda: (edges, lengths))
        self.model = SimpleNamespace(mesh=mesh)
        self.source = SimpleNamespace(vertices=vertices, skin=lambda pose, origin, out: out.fill(0.0))
        self.breaks, self.way, self.frames = options.substep > limit, way, 0
        position = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1)
        self.state = SimpleNamespace(position=position, velocity=np.zeros_like(vertices))

    def step(self, pose: np.ndarray, dt: float, wind: tuple) -> None:
        self.frames += 1
        if self.breaks and self.frames == 8:
            if self.way == "strain":
                self.state.position[:, :3] *= 2.1
            elif self.way == "speed":
                self.state.velocity[3] = 40.0
            else:
                self.state.position[5, 0] = np.nan


@pytest.mark.parametrize("way", ["strain", "speed", "not finite"])
@pytest.mark.parametrize("limit", [1.0 / 1000.0, 1.0 / 170.0, 1.0 / 30.0])
def test_bisection_finds_the_largest_stable_substep(limit: float, way: str) -> None:
    poses = np.zeros((211, 1, 3, 4))
    found = largest_stable_step("x", lambda options: Breaking(options, limit, way), SolverOptions(), poses, 1.0 / 60.0)
    assert found.dt_max <= limit < found.unstable
    assert found.first_to_go == way
    # Neighbours: a whole number of substeps fills a frame, and longer ones are known to 5 %.
    assert found.unstable / found.dt_max < 1.05 or real_substep(0.99 * found.unstable) == found.dt_max


def test_the_ends_of_the_search_are_told_apart() -> None:
    poses = np.zeros((211, 1, 3, 4))
    always = largest_stable_step("x", lambda o: Breaking(o, 1.0, "speed"), SolverOptions(), poses, 1.0 / 60.0)
    assert (always.dt_max, always.first_to_go, always.unstable) == (MAX_SUBSTEP, "", float("inf"))
    never = largest_stable_step("x", lambda o: Breaking(o, 0.0, "speed"), SolverOptions(), poses, 1.0 / 60.0)
    assert (never.dt_max, never.first_to_go, never.unstable) == (0.0, "speed", MIN_SUBSTEP)


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


def test_converged_methods_are_right_and_smooth_is_not(comparison: Comparison) -> None:
    figures = comparison.figures
    truth = comparison.truth
    assert figures["floor_low_frequency_ratio_to_floor"] == pytest.approx(1.0)
    assert (
        figures["middle_mesh_converged_low_frequency_ratio_to_floor"]
        < figures["equal_cost_fine_low_frequency_ratio_to_floor"]
    )
    assert figures["smooth_bending_energy_ratio"] < 1.0
    assert figures["smooth_frame_ms_p50"] < figures["frame_ms_p50"]
    assert figures["middle_mesh_substeps_per_frame"] >= 1.0
    assert figures["middle_mesh_frame_ms_p50"] < figures["truth_frame_ms_p50"]
    assert "floor_frame_ms_p50" not in figures
    for method in comparison.methods:
        assert method.frames is not None and method.frames.shape == truth.frames.shape
    assert {"coarse_dt_max_s", "middle_mesh_dt_max_s", "fine_dt_max_s"} < figures.keys()
    assert 0.0 < figures["fine_dt_max_s"] <= figures["coarse_dt_max_s"]


def test_rivals_have_the_players_own_cost(
    database: WrinkleDatabase, truth: Truth, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Cloth, "cost", lambda cloth: 2.0 * cloth.substeps)
    ours_ms = np.concatenate([np.full(PROBE_FRAMES // 2, 50.0), np.full(PROBE_FRAMES // 2, 6.0), np.full(500, 90.0)])
    baselines = equal_cost_baselines(database, truth, ours_ms)
    assert [baseline.settings["substeps a frame"] for baseline in baselines] == [3] * len(baselines)


def test_the_page_says_that_the_middle_mesh_wins(comparison: Comparison, tmp_path: Path) -> None:
    write_comparison(tmp_path / "compare.html", rigged(comparison, "middle_mesh_"))
    page = (tmp_path / "compare.html").read_text(encoding="utf-8")
    for words in ("the spectrum of folds", "normals", "large folds"):
        assert any(words in part and "the middle mesh with" in part.split("at equal cost")[0] and " wins " in part
                   for part in page.split("<p>"))  # fmt: skip
    assert page.count('<svg class="plot"') == 3
    assert "Largest stable substep" in page and "data:image/jpeg" in page


@pytest.mark.parametrize(
    ("prefix", "name"), [("", "ours wins"), ("equal_cost_fine_", "the fine cloth with"), ("smooth_", "smooth wins")]
)
def test_whoever_wins_is_named(comparison: Comparison, prefix: str, name: str) -> None:
    sentence = next(part for part in verdict(rigged(comparison, prefix)).split("\n\n") if "spectrum" in part)
    assert name in sentence.split("at equal cost")[0]


def test_a_method_that_broke_is_on_the_page(comparison: Comparison, tmp_path: Path) -> None:
    methods = [
        replace(m, figures={}, frames=None, broke_at=0.5) if m.prefix == "equal_cost_fine_" else m
        for m in comparison.methods
    ]
    write_comparison(tmp_path / "compare.html", replace(comparison, methods=tuple(methods)))
    page = (tmp_path / "compare.html").read_text(encoding="utf-8")
    assert "broke: after 0.50 s" in page


def test_a_clip_that_was_learned_from_is_refused(database: WrinkleDatabase, tmp_path: Path) -> None:
    path = tmp_path / "skirt.h5"
    write_database(path, database)
    with pytest.raises(InputError, match="has learned from this clip.*sway.*expected walk"):
        compare_file(path, tmp_path, clip="sway")
