"""All maps of a few methods: cells, borders by bisection, figures; columns of cells on several processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

from threadpoolctl import threadpool_limits

from pbd import InputError
from pbd.models import SOLVERS
from precompute.experiment.error_classes import ErrorClass
from precompute.stability.stability_cells import (
    SECONDS,
    Cell,
    Frames,
    breaks,
    lattice_of,
    reference_of,
    run_cell,
)
from precompute.stability.stability_maps import MAPS, StabilityMap
from precompute.stability.stability_theory import ExplicitLimit, explicit_limits
from precompute.workers import Workers, run_jobs

__all__ = ["METHODS", "Border", "StabilitySweep", "cell_command", "check_methods", "sweep"]

METHODS = ("default", "springs-triangle/symplectic-euler")
BISECTIONS = 6  # bisections of a border between two cells
APPROACH = 4.0  # factor by which a border below the map is approached
MIN_TIME_STEP = 1e-5  # time step down to which a border is looked for below the map [s]


@dataclass(frozen=True)
class Border:
    """Between catastrophic and not, in one column of a map.

    Attributes:
        map, x, method: where.
        safe, catastrophic: y on both sides of it.
    """

    map: str
    x: float
    method: str
    safe: float
    catastrophic: float


@dataclass(frozen=True)
class StabilitySweep:
    """Cells, borders and explicit limits of a sweep."""

    maps: tuple[StabilityMap, ...]
    methods: tuple[str, ...]
    cells: tuple[Cell, ...]
    borders: tuple[Border, ...]
    limits: tuple[ExplicitLimit, ...]

    def of(self, one: StabilityMap, method: str) -> list[Cell]:
        """The cells of a map by a method."""
        return [cell for cell in self.cells if (cell.map, cell.method) == (one.name, method)]

    @property
    def figures(self) -> dict[str, float]:
        """By name; ``catastrophic_cells_MAP_METHOD`` for each map too."""
        found: dict[str, float] = {"explicit_limit_error_percent": max(one.error_percent for one in self.limits)}
        for method in self.methods:
            counts = {one.name: sum(map(lost, self.of(one, method))) for one in self.maps}
            found[f"catastrophic_cells_{method}"] = sum(counts.values())
            found |= {f"catastrophic_cells_{name}_{method}": count for name, count in counts.items()}
        return found | {"cells": len(self.cells)}


def cell_command(cell: Cell) -> str:
    """The command that runs a cell again and prints its failure."""
    return f"gube stability --cell {cell.map}:{cell.x:g}:{cell.y:g} --method {cell.method}"


def check_methods(names: Sequence[str]) -> tuple[str, ...]:
    """The methods asked for, each once.

    Raises:
        InputError: no such method.
    """
    for name in names:
        if name not in SOLVERS:
            raise InputError("no such method", key="--method", received=name, expected=", ".join(SOLVERS))
    return tuple(dict.fromkeys(names))


def sweep(
    methods: Sequence[str] = METHODS,
    *,
    maps: Sequence[StabilityMap] = MAPS,
    workers: Workers | int = 1,
    seconds: float = SECONDS,
    report: Callable[[str], None] | None = None,
) -> StabilitySweep:
    """Run every cell of every map by every method.

    Args:
        methods: names of :data:`pbd.models.SOLVERS`.
        maps: which.
        workers: that run the cells, or how many do.
        seconds: of each run [s].
        report: called with lines of progress.

    Raises:
        InputError: no such method.
    """
    methods, progress = check_methods(methods), report or (lambda line: None)
    jobs = [(one, x, methods, seconds) for one in maps for x in one.x.values]
    jobs.sort(key=lambda job: (job[0].column, job[0].name != "resolution", -job[1]))  # the longest first
    found = run_jobs(
        [partial(_column, *job) for job in jobs],
        workers,
        done=lambda count, _: progress(f"stability: {count} of {len(jobs)} columns"),
    )
    cells = [cell for column, _ in found for cell in column]
    borders = [border for _, column in found for border in column]
    limits = explicit_limits()
    order = [one.name for one in maps]
    cells.sort(key=lambda cell: (methods.index(cell.method), order.index(cell.map), cell.x, cell.y))
    borders.sort(key=lambda border: (methods.index(border.method), order.index(border.map), border.x))
    return StabilitySweep(tuple(maps), methods, tuple(cells), tuple(borders), tuple(limits))


@threadpool_limits.wrap(limits=1, user_api="blas")
def _column(one: StabilityMap, x: float, methods: tuple[str, ...], seconds: float) -> tuple[list[Cell], list[Border]]:
    """Cells and borders of a column, which share what references they can."""
    references: dict[tuple[str, float], Frames] = {}

    def run(y: float, method: str) -> Cell:
        key = lattice_of(method), 0.0 if one.column else y
        if key not in references:
            references[key] = reference_of(one.scene(x, y, key[0]), seconds)
        return run_cell(one, x, y, method, references[key], seconds=seconds)

    cells, borders = [], []
    for method in methods:
        column = [run(y, method) for y in one.y.values]
        cells += column
        for one_side, other in pairwise(column):
            if lost(one_side) != lost(other):
                safe, bad = (one_side, other) if lost(other) else (other, one_side)
                gone = partial(lambda y, method: lost(run(y, method)), method=method)
                borders.append(_bisected(one, x, method, safe.y, bad.y, gone))
        if one.y.values[0] == column[0].dt and all(map(lost, column)):
            borders += _below(one, x, method)
    return cells, borders


def lost(cell: Cell) -> bool:
    """Whether it is catastrophic."""
    return cell.error_class is ErrorClass.CATASTROPHIC


def _below(one: StabilityMap, x: float, method: str) -> list[Border]:
    """The border of a column that is catastrophic at every time step of the map: where numbers break."""
    gone = lambda y: breaks(one.scene(x, y, lattice_of(method)), method)  # noqa: E731
    bad = one.y.values[0]
    if not gone(bad):  # it is lost in another way
        return []
    while bad > MIN_TIME_STEP and gone(bad / APPROACH):
        bad /= APPROACH
    return [_bisected(one, x, method, bad / APPROACH, bad, gone)] if bad > MIN_TIME_STEP else []


def _bisected(
    one: StabilityMap, x: float, method: str, safe: float, bad: float, gone: Callable[[float], bool]
) -> Border:
    for _ in range(BISECTIONS):
        middle = one.y.between(safe, bad)
        safe, bad = (safe, middle) if gone(middle) else (middle, bad)
    return Border(one.name, x, method, safe, bad)
