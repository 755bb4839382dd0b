"""What each setting of a garment costs and how far it is off: the table that the planner reads."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pbd.errors import InputError
from pbd.storage import replacing
from runtime.detail import Detail

__all__ = ["FOLD", "Front", "Setting", "front_path", "read_front", "write_front"]

FORMAT = "gube front"
VERSION = 2
FOLD = 6.0  # shortest fold under gravity over l_g [-] ...
FOLD_EDGES = 3.0  # ... and over the edges of the coarsest mesh that carries it, as in wrinkles.levels [-]


@dataclass(frozen=True)
class Setting:
    """One row of the table.

    Attributes:
        detail: what is modelled.
        cost_ms: processor time of a tick on average [ms].
        peak_ms: of a tick with an update [ms].
        error_m: distance from the full detail, the 95th percentile over vertices that 99 % of the ticks stay below,
            at each of the front's speeds [m].
    """

    detail: Detail
    cost_ms: float
    peak_ms: float
    error_m: tuple[float, ...]


@dataclass(frozen=True)
class Front:
    """What was measured of one garment on one machine.

    Attributes:
        garment: name.
        database: the code version and the creation of the database that it was measured on, and its size.
        machine: processor.
        size: height of the garment [m].
        edges: mean edge of the mesh that is simulated, at each level that its settings name [m].
        gravity_length: of its fabric, l_g [m].
        speeds: at which errors were measured: root mean square of the cloth's speed [m/s], ascending.
        settings: full detail first.
    """

    garment: str
    database: str
    machine: str
    size: float
    edges: tuple[float, ...]
    gravity_length: float
    speeds: tuple[float, ...]
    settings: tuple[Setting, ...]

    @cached_property
    def too_fine(self) -> np.ndarray:
        """Settings that simulate a finer mesh than the fabric has folds for: bool, shape (settings,).

        Folds that gravity makes are :data:`FOLD` times l_g long or longer, and a mesh carries a fold of
        :data:`FOLD_EDGES` edges: a mesh is finer than that is worth if the next coarser one would do.
        """
        useful = [edge <= FOLD * self.gravity_length / FOLD_EDGES for edge in self.edges]
        enough = max((level for level, fits in enumerate(useful) if fits), default=0)
        return np.array([setting.detail.level < enough for setting in self.settings])

    @cached_property
    def costs(self) -> np.ndarray:
        """Of a tick on average [ms], shape (settings,)."""
        return np.array([setting.cost_ms for setting in self.settings])

    @cached_property
    def peaks(self) -> np.ndarray:
        """Of a tick with an update [ms], shape (settings,)."""
        return np.array([setting.peak_ms for setting in self.settings])

    @cached_property
    def _table(self) -> np.ndarray:
        return np.array([setting.error_m for setting in self.settings])

    def errors(self, speed: float) -> np.ndarray:
        """Distances from the full detail at a speed of the cloth [m/s]: [m], shape (settings,).

        Faster than measured they grow as the speed does.
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


def front_path(database: Path) -> Path:
    """The file that a database's front is kept in, beside it."""
    return database.with_suffix(".front.json")


def write_front(path: Path, front: Front) -> None:
    """Write a front as JSON."""
    content = {"format": FORMAT, "version": VERSION, **asdict(front)}
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as beside:
        beside.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_front(path: str | Path) -> Front:
    """Read the table that ``gube plan`` measured and :func:`write_front` wrote.

    Raises:
        InputError: a file that cannot be read or is no front, or one with values that cannot be.
    """
    path, expected = Path(path), "a front of `gube plan`; remove it to measure anew"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if (content.pop("format"), content.pop("version")) != (FORMAT, VERSION):
            raise ValueError("another format")
        settings = tuple(_setting(row) for row in content.pop("settings"))
        tuples = {"speeds": tuple(content["speeds"]), "edges": tuple(content["edges"]), "settings": settings}
        front = Front(**content | tuples)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"cannot be read: {error}", file=path, expected=expected) from error
    numbers = np.array([[s.cost_ms, s.peak_ms, *s.error_m] for s in settings], float)
    levels = {setting.detail.level for setting in settings}
    known = len(front.edges) > max(levels, default=0) and min(front.edges) > 0.0
    shaped = known and numbers.ndim == 2 and numbers.shape[1] == 2 + len(front.speeds) and len(front.speeds) > 0
    if not shaped or not np.isfinite(numbers).all() or (numbers < 0.0).any() or np.any(np.diff(front.speeds) <= 0.0):
        raise InputError("bad values", file=path, key="settings", expected=expected)
    return front


def _setting(row: Mapping[str, Any]) -> Setting:
    return Setting(Detail(**row["detail"]), float(row["cost_ms"]), float(row["peak_ms"]), tuple(row["error_m"]))
