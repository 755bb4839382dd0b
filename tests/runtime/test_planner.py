"""The planner: no dearer than what looking at every setting finds, within its budget, and calm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

from assets.io.scene import CameraSettings
from pbd import InputError
from precompute.experiment.error_classes import LIMITS
from runtime.detail.cost_table import CostTable, Setting, read_cost_table, write_cost_table
from runtime.detail.planner import HOLD, TARGETS, Planner, ViewSize, sight_of
from runtime.play.level_of_detail import LevelOfDetail
from tests.refusals import refuses
from tests.runtime.cost_tables import made_front, seen
from wrinkles.mesh_measures import PIXELS_PER_METRE

ENDLESS = 1e9


def exhaustive(cost_tables: list[CostTable], views: list[ViewSize], target_px: float) -> float:
    """Cost of the cheapest settings whose errors meet the target, found by trying all of them [ms]."""
    total = 0.0
    for cost_table, view in zip(cost_tables, views, strict=True):
        rows = zip(cost_table.settings, view.errors(cost_table), strict=True)
        total += min(row.cost_ms for row, error in rows if error <= target_px)
    return total


def test_targets_are_those_of_the_error_classes() -> None:
    assert (TARGETS["imperceptible"], TARGETS["accepted"]) == LIMITS["position_px"][:2]


def test_the_standard_camera_shows_as_many_pixels_as_the_metrics_count() -> None:
    assert seen(3.0).pixels_per_metre == pytest.approx(PIXELS_PER_METRE)
    assert seen(6.0).size_px == pytest.approx(0.8 * PIXELS_PER_METRE / 2.0)
    assert seen(0.01).size_px == 1080.0


def test_what_no_camera_shows_is_not_seen() -> None:
    camera = CameraSettings(position=(0.0, 1.0, 0.0), target=(0.0, 1.0, -5.0))
    assert sight_of([camera], (0.0, 1.0, 5.0), 0.8, 1.0) == ViewSize(0.0, 0.0, 1.0)
    assert sight_of([camera], (20.0, 1.0, -5.0), 0.8, 1.0).size_px == 0.0
    both = [camera, replace(camera, target=(0.0, 1.0, 5.0))]
    assert sight_of(both, (0.0, 1.0, 5.0), 0.8, 1.0).size_px > 0.0
    planner = Planner([made_front()], 1.0, ENDLESS)
    (choice,) = planner.plan([sight_of([camera], (0.0, 1.0, 5.0), 0.8, 1.0)])
    assert choice.cost_ms == made_front().costs.min() and "no camera sees it" in choice.why


def test_errors_follow_the_speed_and_are_bounded_by_the_size() -> None:
    cost_table = made_front()
    slow, middle, fast = (cost_table.errors(speed)[1:] for speed in (0.1, 1.25, 4.0))
    assert slow == pytest.approx(cost_table.errors(0.5)[1:])
    assert middle / slow == pytest.approx(1.25)
    assert fast / slow == pytest.approx(3.0)
    assert ViewSize(1e6, 30.0, 1.0).errors(cost_table).max() == 30.0


@pytest.mark.parametrize("seed", range(20))
def test_a_random_scene_costs_no_more_than_the_cheapest_that_meets_the_target(seed: int) -> None:
    """Random cameras, distances, speeds and counts; the number to reach is 10 %."""
    rng = np.random.default_rng(seed)
    cost_tables = [made_front(seed=int(rng.integers(3))) for _ in range(rng.integers(1, 9))]
    assert all(
        len(cost_table.settings) >= 24 and np.ptp(np.log10(cost_table.costs)) > 1.0 for cost_table in cost_tables
    )
    cameras = [
        CameraSettings(position=tuple(rng.uniform(-20.0, 20.0, 3)), field_of_view_deg=rng.uniform(20.0, 90.0))
        for _ in range(rng.integers(1, 4))
    ]
    places, speeds = rng.uniform(-15.0, 15.0, (len(cost_tables), 3)), rng.uniform(0.1, 4.0, len(cost_tables))
    views = [sight_of(cameras, place, 0.8, speed) for place, speed in zip(places, speeds, strict=True)]
    for target in TARGETS.values():
        planner = Planner(cost_tables, target, ENDLESS)
        for elapsed in (np.inf, 0.1, 1.0):  # choices of a scene at rest stay as they are
            choices = planner.plan(views, elapsed)
            assert sum(choice.cost_ms for choice in choices) <= 1.1 * exhaustive(cost_tables, views, target)
            assert max(choice.error_px for choice in choices) <= target


def test_a_choice_that_moved_with_the_scene_is_at_most_a_tenth_dearer_once_it_rests() -> None:
    cost_table, rng = made_front(), np.random.default_rng(1)
    planner = Planner([cost_table], 1.0, ENDLESS)
    for distance in np.exp(rng.uniform(0.0, 4.0, 50)):
        for _ in range(2):
            (choice,) = planner.plan([seen(distance)], HOLD)
            assert choice.error_px <= 1.0
        # RELIEF: what is taken up is the cheapest of a target that is a little stricter.
        assert choice.cost_ms <= exhaustive([cost_table], [seen(distance)], 0.9) / 0.9


def test_a_camera_that_trembles_changes_nothing() -> None:
    cost_table, rng = made_front(), np.random.default_rng(2)
    for distance in (2.0, 3.7, 8.0, 20.0):
        planner = Planner([cost_table], 1.0, ENDLESS)
        choices = [planner.plan([seen(distance * rng.uniform(0.99, 1.01))], 1 / 60)[0].index for _ in range(600)]
        assert len(set(choices[60:])) == 1


def test_more_distance_never_costs_more() -> None:
    cost_table = made_front()
    costs = [Planner([cost_table], 1.0, ENDLESS).plan([seen(d)])[0].cost_ms for d in np.geomspace(1.0, 100.0, 40)]
    assert np.all(np.diff(costs) <= 0.0) and costs[0] > 3.0 * costs[-1]


def test_a_budget_is_kept_and_what_is_seen_least_is_given_up_first() -> None:
    cost_table, distances = made_front(), (2.0, 3.0, 5.0, 8.0)
    views = [seen(distance) for distance in distances]
    free = Planner([cost_table] * 4, 1.0, ENDLESS).plan(views)
    whole = sum(choice.cost_ms for choice in free)
    for share in (0.95, 0.8, 0.6, 0.4):
        planner = Planner([cost_table] * 4, 1.0, share * whole)
        choices = planner.plan(views)
        assert planner.tick_ms(choices) <= share * whole
        given_up = [choice.error_px > 1.0 for choice in choices]
        assert given_up == sorted(given_up)  # from the farthest on
        assert any("budget" in choice.why for choice in choices)


@pytest.mark.parametrize("budget", [4.5, 4.0, 3.0, 2.5])
def test_a_crowd_loses_no_more_than_the_least_that_nine_tenths_of_its_budget_would_cost(budget: float) -> None:
    """What is lost is how many pixels are off by how much beyond the target; its least is that of a linear program in
    which garments may take any mixture of settings, and turns cost nothing."""
    cost_table, distances = made_front(), np.geomspace(2.0, 12.0, 16)
    views = [seen(distance) for distance in distances]
    planner = Planner([cost_table] * 16, 1.0, budget)
    choices = planner.plan(views)
    assert planner.tick_ms(choices) <= budget
    losses = np.array([np.maximum(view.errors(cost_table) - 1.0, 0.0) * view.size_px**2 for view in views])
    ours = sum(loss[choice.index] for loss, choice in zip(losses, choices, strict=True))
    count = len(cost_table.settings)
    least = linprog(
        losses.ravel(),
        A_ub=[np.tile(cost_table.costs, 16)],
        b_ub=[0.9 * budget],
        A_eq=np.kron(np.eye(16), np.ones(count)),
        b_eq=np.ones(16),
    )
    assert least.success and 0.0 < least.fun and ours <= least.fun


def test_ticks_are_alike_where_garments_leave_some_out() -> None:
    row = Setting(LevelOfDetail(4, 4, 0, 0), 0.26, 1.0, (0.0,))
    cost_table = CostTable("cloak", "made up", "none", 0.8, (1.0,), (row,))
    planner = Planner([cost_table] * 8, 1.0, ENDLESS)
    choices = planner.plan([seen(3.0)] * 8)
    assert sorted(choice.wait for choice in choices) == [0, 0, 1, 1, 2, 2, 3, 3]
    assert planner.tick_ms(choices) == pytest.approx(2.0 + 6 * 0.04 / 3)


def test_a_slower_machine_is_given_less() -> None:
    cost_table = made_front()
    planner = Planner([cost_table] * 4, 1.0, 2.0)
    views = [seen(2.5)] * 4
    before = planner.tick_ms(planner.plan(views))
    rng = np.random.default_rng(3)
    for _ in range(2000):
        planner.report(1.5 * rng.uniform(0.9, 1.1), 1.0)
    assert 1.5 < planner.load < 1.7
    assert planner.tick_ms(planner.plan(views)) * 1.5 <= 2.0 < before * 1.5


@pytest.mark.parametrize(("cost_tables", "target", "budget"), [(0, 1.0, 1.0), (1, 0.0, 1.0), (1, 1.0, np.nan)])
def test_bad_plans_are_refused(cost_tables: int, target: float, budget: float) -> None:
    refuses("bad plan", Planner, [made_front()] * cost_tables, target, budget)


def test_a_plan_for_other_garments_is_refused() -> None:
    refuses("one a garment", Planner([made_front()], 1.0, 1.0).plan, [])


def test_a_front_is_read_as_it_was_written(tmp_path: Path) -> None:
    write_cost_table(tmp_path / "a" / "cloak.cost_table.json", made_front())
    assert read_cost_table(tmp_path / "a" / "cloak.cost_table.json") == made_front()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"gube front"', '"front"'),
        ('"every": 1', '"every": 0'),
        ('"cost_ms": 1.0', '"cost_ms": -1.0'),
        ('"cost_ms": 1.0', '"cost_ms": "dear"'),
        ('"peak_ms"', '"price"'),
        ('"machine"', '"maschine"'),
        ("0.5,", "5.0,"),
        ("{", "["),
    ],
)
def test_a_damaged_front_is_refused(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "cloak.cost_table.json"
    write_cost_table(path, made_front(4))
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_cost_table(path)
    assert caught.value.file == path
