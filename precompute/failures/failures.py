"""Where cloth engines are known to fail: the class in which each known failure ends, for any solver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pbd import InputError
from pbd.models import SOLVERS
from precompute.experiment.error_classes import ErrorClass
from precompute.failures.failure_comparisons import Case, comparisons
from precompute.failures.failure_play import FailureOutcome, play
from precompute.failures.failure_scenes import scenes
from precompute.reporting.tables import write_table
from precompute.workers import Workers, run_jobs

__all__ = ["CLASSIC", "all_failure_rows", "failure_rows", "failure_table", "write_failures"]

CLASSIC = (
    "pbd",
    "xpbd",
    "springs-triangle/symplectic-euler",
    "fem-stvk/implicit-euler",
    "baraff-witkin/implicit-euler",
    "vertex-block-descent",
    "projective-dynamics",
)


def failure_rows(
    solver: str = "default", *, report: Callable[[str], None] = lambda line: None, lines: Sequence[str] | None = None
) -> list[dict[str, Any]]:
    """A row of each scene.

    Columns are ``line``, ``scene``, ``solver``, ``class`` in which it ends, ``by`` which figure, its ``value``,
    ``recovered_s`` and ``frame_ms`` (see :class:`precompute.failures.failure_play.FailureOutcome`).

    Args:
        solver: a key of :data:`pbd.models.registry.SOLVERS`.
        report: called with a line of progress.
        lines: of the list; None takes all that the solver can take.

    Raises:
        InputError: no such solver.
    """
    _check(solver)
    rows = []
    for wanted in _lines() if lines is None else lines:
        for line, name, default_only, run in _cases():
            if line == wanted and (solver == "default" or not default_only):
                report(f"{solver}: {name}")
                rows.append(_row(line, name, solver, run(solver)))
    return rows


def _cases() -> list[Case]:
    return [*((one.line, one.name, one.default_only, partial(play, one)) for one in scenes()), *comparisons()]


def _lines() -> list[str]:
    """All lines of the list, in order."""
    return list(dict.fromkeys(line for line, *_ in _cases()))


def all_failure_rows(
    solvers: Sequence[str], workers: Workers | int, report: Callable[[str], None] = lambda line: None
) -> list[dict[str, Any]]:
    """The rows of several solvers, in order.

    Args:
        solvers: as for :func:`failure_rows`.
        workers: that run the scenes, or how many do.
        report: called with a line of progress.

    Raises:
        InputError: no such solver.
    """
    for name in solvers:
        _check(name)
    jobs = [partial(failure_rows, name, lines=[line]) for name in solvers for line in _lines()]
    found = run_jobs(jobs, workers, done=lambda count, rows: report(f"{count} of {len(jobs)} lines"))
    return [row for rows in found for row in rows]


def _check(solver: str) -> None:
    if solver not in SOLVERS:
        raise InputError("no such solver", key="solver", received=solver, expected=", ".join(SOLVERS))


def _row(line: str, name: str, solver: str, outcome: FailureOutcome) -> dict[str, Any]:
    error_class, by = outcome.worst
    return {
        "line": line,
        "scene": name,
        "solver": solver,
        "class": error_class.name.lower(),
        "by": outcome.note or by,
        "value": outcome.figures[by],
        "recovered_s": outcome.recovered_s,
        "frame_ms": outcome.frame_ms,
    }


def failure_table(rows: Sequence[dict[str, Any]]) -> str:
    """Classes of each line's worst scene, a column a solver."""
    order = [error.name.lower() for error in ErrorClass]
    solvers = list(dict.fromkeys(row["solver"] for row in rows))
    lines = list(dict.fromkeys(row["line"] for row in rows))
    text = [" | ".join(["line", *solvers])]
    for line in lines:
        cells = []
        for solver in solvers:
            found = [row["class"] for row in rows if row["line"] == line and row["solver"] == solver]
            cells.append(max(found, key=order.index) if found else "-")
        text.append(" | ".join([line, *cells]))
    return "\n".join(text)


def write_failures(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write rows as CSV with machine and date."""
    if not rows:
        raise InputError("nothing to write", key="rows", received=0, expected="at least one row")
    write_table(path, rows, digits=4, machine=True)
