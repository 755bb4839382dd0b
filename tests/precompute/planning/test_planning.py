"""What the cost table of the demo's skirt gives to choose from, and what distance saves with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from assets.io.scene import load_scene
from precompute.demo_run import FULL
from precompute.learning.pipeline import precompute
from precompute.planning.planning import cost_table_of, plan_figures, seen_from
from runtime.detail.cost_table import CostTable
from runtime.detail.planner import Planner
from wrinkles.database_file import read_database


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> CostTable:
    path: Path = tmp_path_factory.mktemp("demo") / "skirt.h5"
    precompute(load_scene(FULL.scene), path)
    return cost_table_of(read_database(path), path)


@pytest.mark.proof
def test_the_front_is_wide_enough_to_choose_from(table: CostTable) -> None:
    assert len(table.settings) >= 24 and table.costs.max() >= 9.0 * table.costs.min()


@pytest.mark.proof
def test_two_metres_cost_three_times_what_twenty_do(table: CostTable) -> None:
    choices = Planner([table], 1.0, 1e9).plan([seen_from(table, 3.0)])
    figures = plan_figures(table, choices, 1.0)
    assert float(figures["cost_ratio_2m_20m"]) >= 3.0
