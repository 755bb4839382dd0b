"""Cost and error of each setting of a garment: the measured table that the planner reads."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from assets.text import read_text
from pbd.errors import InputError
from pbd.storage import replacing
from runtime.play.level_of_detail import LevelOfDetail

__all__ = ["CostTable", "Setting", "cost_table_path", "read_cost_table", "write_cost_table"]

FORMAT = "gube front"
VERSION = 4


@dataclass(frozen=True)
class Setting:
    """One row of the table.

    Attributes:
        detail: level of detail.
        cost_ms: mean processor time of a tick [ms].
        peak_ms: processor time of a tick with an update [ms].
        error_m: distance from the full detail, the 95th percentile over vertices that 99 % of the ticks stay below,
            at each of the table's speeds [m].
    """

    detail: LevelOfDetail
    cost_ms: float
    peak_ms: float
    error_m: tuple[float, ...]


@dataclass(frozen=True)
class CostTable:
    """Settings of one garment, measured on one machine.

    Attributes:
        garment: name of the garment.
        database: code version, time of creation and size of the database that was measured.
        machine: name of the processor.
        size: height of the garment [m].
        speeds: speeds at which errors were measured: root mean square of the cloth's speed [m/s], ascending.
        settings: the rows, full detail first.
    """

    garment: str
    database: str
    machine: str
    size: float
    speeds: tuple[float, ...]
    settings: tuple[Setting, ...]

    @cached_property
    def costs(self) -> np.ndarray:
        """Mean processor time of a tick [ms], shape (settings,)."""
        return np.array([setting.cost_ms for setting in self.settings])

    @cached_property
    def peaks(self) -> np.ndarray:
        """Processor time of a tick with an update [ms], shape (settings,)."""
        return np.array([setting.peak_ms for setting in self.settings])

    @cached_property
    def _table(self) -> np.ndarray:
        return np.array([setting.error_m for setting in self.settings])

    def errors(self, speed: float) -> np.ndarray:
        """Distance of each setting from full detail, interpolated between the measured speeds.

        Above the highest measured speed the distances grow in proportion to the speed.

        Args:
            speed: root mean square of the cloth's speed [m/s].

        Returns:
            distances [m], shape (settings,).
        """
        table = self._table
        inside = np.clip(speed, self.speeds[0], self.speeds[-1])
        place = np.clip(np.searchsorted(self.speeds, inside) - 1, 0, max(0, len(self.speeds) - 2))
        if len(self.speeds) == 1:
            errors = table[:, 0]
        else:
            low, high = self.speeds[place], self.speeds[place + 1]
            share = (inside - low) / (high - low)
            errors = (1.0 - share) * table[:, place] + share * table[:, place + 1]
        return errors * max(1.0, speed / self.speeds[-1])


def cost_table_path(database: Path) -> Path:
    """Path of the cost table of a database: a file beside the database."""
    return database.with_suffix(".cost_table.json")


def write_cost_table(path: Path, cost_table: CostTable) -> None:
    """Write a cost table as a JSON file, which appears whole."""
    content = {"format": FORMAT, "version": VERSION, **asdict(cost_table)}
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as beside:
        beside.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_cost_table(path: str | Path) -> CostTable:
    """Read a file of :func:`write_cost_table`.

    Raises:
        InputError: the file cannot be read, is no cost table, or has values that are not finite, are
            negative or out of order.
    """
    path, expected = Path(path), "a cost table of `gube plan`; remove it to measure anew"
    text = read_text(path, expected)
    try:
        content = json.loads(text)
        if (content.pop("format"), content.pop("version")) != (FORMAT, VERSION):
            raise ValueError("another format")
        settings = tuple(_setting(row) for row in content.pop("settings"))
        cost_table = CostTable(**content | {"speeds": tuple(content["speeds"]), "settings": settings})
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"cannot be read: {error}", file=path, expected=expected) from error
    numbers = np.array([[s.cost_ms, s.peak_ms, *s.error_m] for s in settings], float)
    shaped = numbers.ndim == 2 and numbers.shape[1] == 2 + len(cost_table.speeds) and len(cost_table.speeds) > 0
    if (
        not shaped
        or not np.isfinite(numbers).all()
        or (numbers < 0.0).any()
        or np.any(np.diff(cost_table.speeds) <= 0.0)
    ):
        raise InputError("bad values", file=path, key="settings", expected=expected)
    return cost_table


def _setting(row: Mapping[str, Any]) -> Setting:
    return Setting(LevelOfDetail(**row["detail"]), float(row["cost_ms"]), float(row["peak_ms"]), tuple(row["error_m"]))
