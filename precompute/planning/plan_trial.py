"""Plans put to the test: a garment played under a planner for minutes, beside full detail of the same coarse states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from assets.io.scene import CameraSettings
from pbd import InputError
from pbd.wind import Air
from precompute.planning.planning import cost_table_of
from runtime.cost_table import CostTable
from runtime.garment_group import GarmentGroup
from runtime.planner import TARGETS, Planner, ViewSize, sight_of
from runtime.play import PlaybackInputs, playback_inputs
from runtime.player import Player
from runtime.simulation import Motion
from wrinkles.database import WrinkleDatabase, read_database

__all__ = ["SCENES", "PlanTrial", "sight", "there_and_back", "trial_rows", "trial_text", "try_plan"]

TARGET_PX = TARGETS["imperceptible"]

COMPARED_EVERY = 13  # ticks; no multiple of the ticks between updates


def _flight(t: float) -> tuple[CameraSettings, ...]:
    """A camera that comes near and goes far, from 1.5 to 40 m, every twenty seconds."""
    distance = 1.5 * (40.0 / 1.5) ** (0.5 - 0.5 * np.cos(2.0 * np.pi * t / 20.0))
    return (CameraSettings(position=(0.0, 0.0, float(distance)), target=(0.0, 0.0, 0.0)),)


def _cuts(t: float) -> tuple[CameraSettings, ...]:
    """Cuts between a close picture, a long one, a zoom and one that shows something else, three seconds each."""
    position, angle = (
        ((0.0, 0.0, 2.0), 40.0),
        ((20.0, 5.0, 0.0), 40.0),
        ((0.0, 0.0, -30.0), 8.0),
        ((0.0, 0.0, 5.0), 40.0),
    )[int(t / 3.0) % 4]
    away = (0.0, 0.0, 10.0) if int(t / 3.0) % 4 == 3 else (0.0, 0.0, 0.0)
    return (CameraSettings(position=position, target=away, field_of_view_deg=angle),)


def _pair(t: float) -> tuple[CameraSettings, ...]:
    """Two cameras at once, of which one trembles and the other goes round."""
    turn = 2.0 * np.pi * t / 30.0
    tremble = 6.0 + 0.05 * np.sin(40.0 * t)
    return (
        CameraSettings(position=(0.0, 0.5, float(tremble)), target=(0.0, 0.0, 0.0)),
        CameraSettings(
            position=(12.0 * float(np.sin(turn)), 1.0, 12.0 * float(np.cos(turn))),
            target=(0.0, 0.0, 0.0),
            field_of_view_deg=25.0,
        ),
    )


SCENES: dict[str, Callable[[float], tuple[CameraSettings, ...]]] = {"flight": _flight, "cuts": _cuts, "pair": _pair}
"""Cameras over time [s], about a garment at the origin."""


@dataclass(frozen=True)
class PlanTrial:
    """The result of a trial.

    Attributes:
        error_px: on screen, in the ticks that were compared, the 95th percentile over vertices, shape (f,).
        changes: of detail.
        cost_ms: by the table, on average [ms].
        catastrophic: ticks that were not finite or whose garment's box was over twice as large as at full detail.
    """

    error_px: np.ndarray
    changes: int
    cost_ms: float
    catastrophic: int


def try_plan(
    database: WrinkleDatabase,
    inputs: PlaybackInputs,
    motion: Motion,
    table: CostTable,
    cameras: Callable[[float], tuple[CameraSettings, ...]],
    seconds: float,
) -> PlanTrial:
    """Play one garment under a planner whose target is imperceptible and whose budget never binds.

    The shown cloth is compared with full detail of the same coarse state: in a tick with an update of that
    state, in others of the state that full detail steps to from the last update.

    Args:
        database, inputs, table: of the garment.
        motion: played forth and back for as long as it takes.
        cameras: about the garment, see :data:`SCENES`.
        seconds: to play [s].
    """
    dt = 1.0 / database.frame_rate
    times = there_and_back(motion.duration, dt, round(seconds / dt))
    player, shadow = (Player(database, inputs.body, motion.pose(0.0), inputs.primitives) for _ in range(2))
    group = GarmentGroup([player], Planner([table], TARGET_PX, 1e9))
    errors, changes, cost, catastrophic, idle, updated = [], 0, 0.0, 0, 0, times[0]
    for tick in range(1, len(times)):
        view = sight(player, cameras(tick * dt), table)
        before, hash_before = player.detail, player.simulation.state.position.copy()
        try:
            group.update([motion.pose(times[tick])], dt, [view], inputs.wind)
        except InputError:  # the state is not finite
            catastrophic += 1
            break
        changes += player.detail != before
        cost += group.choices[0].cost_ms
        worked = not np.array_equal(player.simulation.state.position, hash_before)
        idle, updated = (0, times[tick]) if worked else (idle + 1, updated)
        if tick % COMPARED_EVERY == 0 and tick * dt > 1.5:
            full = _truth(player, shadow, motion, times[tick - idle : tick + 1], dt, inputs.wind)
            away = np.linalg.norm(player.vertices + player.origin - full, axis=1)
            errors.append(min(view.pixels_per_metre * float(np.percentile(away, 95)), view.size_px))
            box = np.ptp(player.vertices, axis=0), np.ptp(full, axis=0)
            large = np.linalg.norm(box[0]) > 2.0 * np.linalg.norm(box[1])
            catastrophic += bool(large or not np.isfinite(player.vertices).all())
    return PlanTrial(np.array(errors), changes, cost / (len(times) - 1), catastrophic)


def trial_rows(
    path: Path, names: Sequence[str] = (), seconds: float = 300.0, report: Callable[[str], None] | None = None
) -> list[dict[str, Any]]:
    """Try plans for a database in the motion that ``gube play`` plays, a row for each scene of cameras.

    Args:
        path: the database; its cost table is read beside it, or measured and kept there.
        names: of the scenes, see :data:`SCENES`; all where none is named.
        seconds: to play in each [s].
        report: gets lines of progress.

    Returns:
        rows of ``scene``; ``error_px_p50`` and ``error_px_p99``, the median and the 99th percentile of the error on
        screen; ``within_target_percent``, the share of compared ticks whose error is at most that of "imperceptible";
        ``changes`` of detail; ``cost_ms`` and ``full_cost_ms``, the mean cost of a tick and that of full detail by the
        table; ``catastrophic`` ticks, see :class:`PlanTrial`.

    Raises:
        InputError: no such scene, not a database, or a time in which no tick is compared.
    """
    for name in names:
        if name not in SCENES:
            raise InputError("no such scene", key="NAME", received=name, expected=", ".join(SCENES))
    database = read_database(path)
    inputs = playback_inputs(database)
    table = cost_table_of(database, path, report)
    rows = []
    for name in names or SCENES:
        if report is not None:
            report(f"{name}: {seconds:g} s")
        trial = try_plan(database, inputs, inputs.motions[0], table, SCENES[name], seconds)
        if trial.error_px.size == 0 and trial.catastrophic == 0:
            raise InputError("no tick is compared", key="--seconds", received=seconds, expected="at least 2 [s]")
        errors = trial.error_px if trial.error_px.size else np.array([np.inf])
        rows.append(
            {
                "scene": name,
                "error_px_p50": float(np.median(errors)),
                "error_px_p99": float(np.percentile(errors, 99)),
                "within_target_percent": 100.0 * float((errors <= TARGET_PX).mean()),
                "changes": trial.changes,
                "cost_ms": trial.cost_ms,
                "full_cost_ms": table.settings[0].cost_ms,
                "catastrophic": trial.catastrophic,
            }
        )
    return rows


def trial_text(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as a table."""
    titles = (
        "scene",
        "p50 [px]",
        "p99 [px]",
        f"<= {TARGET_PX:g} px [%]",
        "changes",
        "cost [ms]",
        "full [ms]",
        "failed",
    )
    lines = ["".join(f"{title:>13}" for title in titles)]
    for row in rows:
        lines.append("".join(f"{value:>13}" if isinstance(value, str) else f"{value:>13.3g}" for value in row.values()))
    return "\n".join(lines)


def sight(player: Player, cameras: tuple[CameraSettings, ...], table: CostTable) -> ViewSize:
    """How a garment at the origin is seen, at the speed that it has now."""
    speed = float(np.sqrt(3.0 * np.mean(player.simulation.state.velocity.astype(float) ** 2)))
    return sight_of(cameras, (0.0, 0.0, 0.0), table.size, speed)


def _truth(player: Player, shadow: Player, motion: Motion, times: np.ndarray, dt: float, wind: Air) -> np.ndarray:
    """Full detail of the player's coarse state, some ticks on: world [m], shape (N, 3)."""
    if len(times) == 1:
        return player.decoded(player.full) + player.origin
    shadow.simulation.state = player.simulation.state.copy()
    shadow.simulation.place_body(motion.pose(times[0]))
    for t in times[1:]:
        shadow.update(motion.pose(t), dt, wind)
    return shadow.vertices + shadow.origin


def there_and_back(duration: float, dt: float, count: int) -> np.ndarray:
    """Times of a motion that turns round gently at both ends, shape (count + 1,)."""
    phase = np.arange(count + 1) * dt % (2.0 * duration)
    return np.minimum(phase, 2.0 * duration - phase)
