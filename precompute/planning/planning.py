"""`gube plan`: the cheapest detail of a scene's garment, and the time that it saves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from assets.io.scene import CameraSettings
from pbd import InputError
from precompute.planning.cost_measurement import cost_table_key, measure_cost_table
from precompute.wrinkle_comparison.compare_database import database_of
from runtime.detail.cost_table import CostTable, cost_table_path, read_cost_table, write_cost_table
from runtime.detail.planner import DetailChoice, Planner, ViewSize, sight_of
from runtime.output.report import machine_description
from runtime.setup.garment_setup import scene_of
from runtime.setup.playback_inputs import playback_inputs
from wrinkles.database import WrinkleDatabase
from wrinkles.database_file import read_database

__all__ = ["Planned", "cost_table_of", "plain_cloth", "plan_file", "plan_rows", "plan_text"]

NEAR_DISTANCE, FAR_DISTANCE = 2.0, 20.0  # from the camera, for the figure cost_ratio_2m_20m [m]
NO_BUDGET = 1e9  # a budget that bounds nothing [ms]


@dataclass(frozen=True)
class Planned:
    """A plan for some garments of one kind.

    Attributes:
        table: of the garment.
        view: how each is seen.
        choices: one for each.
        figures: of the plan, by name.
        plain: what plain cloth that is as good as full detail costs, in a line.
    """

    table: CostTable
    view: ViewSize
    choices: tuple[DetailChoice, ...]
    figures: dict[str, Any]
    plain: str


def cost_table_of(database: WrinkleDatabase, path: Path, report: Callable[[str], None] | None = None) -> CostTable:
    """The table kept beside a database, measured first where none was measured for it on this machine.

    Args:
        database: the database.
        path: its file.
        report: called with lines of progress.
    """
    kept = cost_table_path(path)
    if kept.exists():
        table = read_cost_table(kept)
        if (table.database, table.machine) == (cost_table_key(database), machine_description()["cpu"]):
            return table
    inputs = playback_inputs(database)
    table = measure_cost_table(database, inputs, inputs.motions[0], report)
    write_cost_table(kept, table)
    return table


def plan_file(
    path: Path,
    output: Path,
    *,
    target_px: float,
    budget_ms: float,
    distance: float | None = None,
    field_of_view_deg: float | None = None,
    garments: int = 1,
    report: Callable[[str], None] | None = None,
) -> Planned:
    """Plan for the camera of a scene.

    Args:
        path: a database, or a scene (``.toml``), whose database is made first where ``output`` does not have it yet.
        output: folder of that database.
        target_px: largest error on screen [px].
        budget_ms: for all garments in one tick [ms].
        distance: from the camera to the garment instead of the scene's own [m].
        field_of_view_deg: vertical, instead of the scene's own [deg].
        garments: how many of them share the budget.
        report: called with lines of progress.

    Raises:
        InputError: what cannot be read, or no garments.
    """
    if garments < 1:
        raise InputError("nothing to plan", key="--garments", received=garments, expected="at least 1")
    path = database_of(path, output, report)
    database = read_database(path)
    table = cost_table_of(database, path, report)
    camera = scene_of(database).camera
    centre = database.coarse_vertices.mean(axis=0)
    away = float(np.linalg.norm(np.subtract(centre, camera.position))) if distance is None else distance
    angle = camera.field_of_view_deg if field_of_view_deg is None else field_of_view_deg
    view = seen_from(table, away, angle)
    if distance is None and field_of_view_deg is None:
        view = sight_of([camera], centre.tolist(), table.size, table.speeds[0])
    planner = Planner([table] * garments, target_px, budget_ms)
    choices = planner.plan([view] * garments)
    figures = plan_figures(table, choices, target_px)
    figures |= {"distance_m": away, "frame_ms": planner.tick_ms(choices), "settings": float(len(table.settings))}
    plain, words = plain_cloth(database.quality, table, figures["cost_ms"] / garments)
    return Planned(table, view, tuple(choices), figures | plain, words)


def plain_cloth(quality: Mapping[str, float], table: CostTable, chosen_ms: float) -> tuple[dict[str, float], str]:
    """Plain cloth beside the settings of the table: it is as good as full detail, as `gube compare` measured.

    Args:
        quality: figures of the database.
        table: of its garment.
        chosen_ms: cost of the setting that was chosen [ms].

    Returns:
        ``plain_cost_ms``, that of the cheapest plain cloth that is as good as full detail [ms], if there is one that is
        known; and what follows from it, in a line.
    """
    ratio = quality.get("cost_advantage")
    if ratio is None:
        return {}, "plain cloth was not compared: `gube compare` with this database does it"
    if quality["cost_advantage_is_at_least"]:
        return {}, "no plain cloth that was tried is as good as full detail"
    cost = ratio * table.settings[0].cost_ms
    rest = ", brought to rest on the fine mesh," if quality["plain_passes"] else ""
    mesh = f"{quality['plain_vertex_count']:.0f} vertices with {quality['plain_substeps']:.0f} substeps{rest}"
    words = f"plain cloth of {mesh} is as good as full detail and costs {cost:.3g} ms"
    words += ": play that instead (gube play does)" if cost < chosen_ms else ": no better choice"
    return {"plain_cost_ms": cost}, words


def seen_from(table: CostTable, distance: float, field_of_view_deg: float = 40.0) -> ViewSize:
    """A garment in the middle of the picture, moving as it was measured."""
    camera = CameraSettings(position=(0.0, 0.0, distance), target=(0.0, 0.0, 0.0), field_of_view_deg=field_of_view_deg)
    return sight_of([camera], (0.0, 0.0, 0.0), table.size, table.speeds[0])


def plan_figures(table: CostTable, choices: Sequence[DetailChoice], target_px: float) -> dict[str, Any]:
    """Figures of a plan: the choice, its cost and error, and what distance saves."""
    cost = sum(choice.cost_ms for choice in choices)
    near, far = (
        Planner([table], target_px, NO_BUDGET).plan([seen_from(table, distance)])[0].cost_ms
        for distance in (NEAR_DISTANCE, FAR_DISTANCE)
    )
    return {
        "choice": str(table.settings[choices[0].index].detail),
        "cost_ms": cost,
        "screen_error_px": max(choice.error_px for choice in choices),
        "cost_ratio_2m_20m": near / far,
    }


def plan_text(planned: Planned) -> str:
    """The choice and why, a line for each of what is chosen alike."""
    table, figures = planned.table, planned.figures
    lines = [f"{table.garment}, {figures['distance_m']:.3g} m away"]
    for index in dict.fromkeys(choice.index for choice in planned.choices):
        alike = [choice for choice in planned.choices if choice.index == index]
        lines += [f"{len(alike)} x {table.settings[index].detail}", f"    {alike[0].why}"]
    return "\n".join(
        [
            *lines,
            f"cost {figures['cost_ms']:.3g} ms a tick, {figures['frame_ms']:.3g} in the dearest; "
            f"full detail {table.settings[0].cost_ms * len(planned.choices):.3g}",
            f"error on screen {figures['screen_error_px']:.2g} px",
            planned.plain,
            f"at 2 m {figures['cost_ratio_2m_20m']:.3g} times the cost at 20 m",
        ]
    )


def plan_rows(planned: Planned) -> list[dict[str, float]]:
    """The table as it is seen: a row a setting."""
    errors = planned.view.errors(planned.table)
    return [
        {**asdict(row.detail), "cost_ms": row.cost_ms, "peak_ms": row.peak_ms, "screen_error_px": float(error)}
        for row, error in zip(planned.table.settings, errors, strict=True)
    ]
