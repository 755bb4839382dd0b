"""The validation table: every test against exact knowledge, by the default solver and by the best one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from pbd.errors import InputError
from pbd.models import SOLVERS, StepError
from precompute.validation import (
    bending_rows,
    contact_rows,
    drape_cipc,
    drape_rows,
    friction_rows,
    laboratory_rows,
    membrane_rows,
    motion_rows,
)
from precompute.validation.trial import TrialResult, TrialSetting
from precompute.validation.validation_row import Row
from precompute.workers import run_jobs

__all__ = [
    "ROWS",
    "ValidationResult",
    "case_words",
    "chosen_rows",
    "validate",
    "validate_all",
    "validation_text",
    "result_row",
]

ROW_MODULES = (
    bending_rows, membrane_rows, motion_rows, contact_rows, drape_rows, laboratory_rows, friction_rows, drape_cipc,
)  # fmt: skip
ROWS: Mapping[str, Row] = {row.name: row for module in ROW_MODULES for row in module.ROWS}
MAX_RUN_S = 20.0  # processor time of a run, on the way to the cheapest and to the best setting [s]
MAX_SUBSTEPS = 4096  # of a frame
FINER = 2  # times as many edges, where more substeps do not help
REALTIME_MS = 4.2  # a quarter of a frame at 60 Hz: where no setting is as fast, a coarser mesh is tried [ms]


@dataclass(frozen=True)
class ValidationResult:
    """One case of one test.

    Attributes:
        row, case: test and parameters.
        default: result of the default setting, or of the chosen solver.
        realtime_setting, realtime: the cheapest setting of the default solver that passes its gate; None if none does.
        best_setting, best: the setting with the least error of those tried, or the first within its gate.
        reason: why it was lost where a gate failed.
    """

    row: Row
    case: Mapping[str, Any]
    default: TrialResult
    realtime_setting: TrialSetting | None
    realtime: TrialResult | None
    best_setting: TrialSetting
    best: TrialResult
    reason: str

    @property
    def passed_best(self) -> bool:
        return _within(self.best.error, self.row.gate_best)

    @property
    def passed_default(self) -> bool:
        return _within(_realtime_error(self.default), self.row.gate_realtime)


def _within(error: float, gate: float) -> bool:
    return bool(error <= gate)  # not a number never is


def _realtime_error(measured: TrialResult) -> float:
    return measured.error if measured.realtime_error is None else measured.realtime_error


def chosen_rows(
    names: Sequence[str], params: Sequence[str], solver: str | None
) -> list[tuple[Row, list[dict[str, Any]]]]:
    """Tests and cases by the words of the command line.

    Args:
        names: of tests; none for all.
        params: "key=value"; each must be known to every test that is named.
        solver: name of a solver, None for those that the test names.

    Raises:
        InputError: an unknown name, a bad parameter or solver; all at once.
    """
    errors: list[InputError] = []
    texts: dict[str, str] = {}
    for param in params:
        key, sign, text = param.partition("=")
        if not sign or not key:
            errors.append(InputError("bad parameter", key="--param", received=param, expected="key=value"))
        texts[key] = text
    if solver is not None and solver not in SOLVERS:
        errors.append(InputError("unknown solver", key="--solver", received=solver, expected=", ".join(SOLVERS)))
    for name in names:
        if name not in ROWS:
            errors.append(InputError("unknown test", key="NAME", received=name, expected=" or ".join(ROWS)))
    if texts and not names:
        errors.append(InputError("parameters belong to named tests", key="--param", expected="NAME before --param"))
    found = []
    if not errors:
        for row in [ROWS[name] for name in dict.fromkeys(names)] or ROWS.values():
            try:
                found.append((row, row.chosen(texts)))
            except InputError as error:
                errors.append(error)
    if errors:
        raise InputError.join(errors)
    return found


def validate(
    row: Row,
    case: Mapping[str, Any],
    solver: str | None = None,
    *,
    resolution: int | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> ValidationResult:
    """Run one case from the default setting on, to the cheapest setting that passes and to the best.

    A step that fails is no error but a lost row.

    Args:
        row, case: test and parameters.
        solver: name of a solver; None tries those that the test names. With a solver or a resolution chosen nothing
            else is tried.
        resolution: edges along the length; None starts with 20.
        report: called with a line of progress.
    """
    search = _Search(row, case, report)
    for setting in _settings(search, [solver] if solver else row.best_solvers, resolution):
        search.attempt(setting)
    if (solver or "default") == "default" and "default" in row.best_solvers and not _keeps_mesh(row, resolution):
        search.try_coarser(TrialSetting(edges=TrialSetting.edges // FINER))
    default, best = search.default, search.best
    assert default is not None and best is not None
    passed = _within(best[1].error, row.gate_best) and search.realtime is not None
    realtime = search.realtime or (None, None)
    return ValidationResult(row, case, default, *realtime, *best, "" if passed else search.reason)


class _Search:
    """What the settings that were tried so far have come to.

    Attributes:
        result, seconds: of the last one: what it measured and the processor time that it took [s].
        default: what the first one measured.
        realtime: the first setting of the default solver within that gate, and what it measured.
        best: the setting with the least error, and what it measured.
        reason: why the last one that failed did not pass.
    """

    def __init__(self, row: Row, case: Mapping[str, Any], report: Callable[[str], None]) -> None:
        self.row, self._case, self._report = row, case, report
        self.result, self.seconds, self.reason = TrialResult.lost(), 0.0, ""
        self.default: TrialResult | None = None
        self.realtime: tuple[TrialSetting, TrialResult] | None = None
        self.best: tuple[TrialSetting, TrialResult] | None = None

    @property
    def passed(self) -> bool:
        """Whether the last setting is within the gate of the best column."""
        return _within(self.result.error, self.row.gate_best)

    @property
    def settled(self) -> bool:
        """Whether no other setting can help: one has passed, or there is nothing to measure."""
        return self.best is not None and (_within(self.best[1].error, self.row.gate_best) or bool(self.best[1].missing))

    def _run(self, setting: TrialSetting) -> tuple[TrialResult, str]:
        """What the case comes to at a setting, and why a step failed in it."""
        problem = ""
        try:
            result = self.row.run(setting, self._case)
        except StepError as error:
            result, problem = TrialResult.lost(), str(error)
        test = f"{self.row.name} {case_words(self._case)}".strip()
        self._report(f"{test}: {setting.solver}, {_setting_words(setting)}: error {_short(result.error)}")
        return result, problem

    def try_coarser(self, setting: TrialSetting) -> None:
        """Where no setting has passed in real time so far, take the first on a coarser mesh that does, if any.

        It counts if one with twice its substeps passes as well: an error that changes its sign passes once by chance.
        """
        if self.realtime is not None and self.realtime[1].cost_ms <= REALTIME_MS:
            return
        before: tuple[TrialSetting, TrialResult] | None = None
        while setting.substeps <= MAX_SUBSTEPS:
            result, _ = self._run(setting)
            if result.missing or (before is None and not result.cost_ms <= REALTIME_MS):
                return
            within = _within(_realtime_error(result), self.row.gate_realtime)
            if within and before is not None:
                self.realtime = before
                return
            before = (setting, result) if within else None
            setting = replace(setting, substeps=2 * setting.substeps)

    def attempt(self, setting: TrialSetting) -> None:
        """Run the case at a setting."""
        begin = time.process_time()
        result, problem = self._run(setting)
        self.result, self.seconds = result, time.process_time() - begin
        if self.default is None:
            self.default = result
        if setting.solver == "default" and self.realtime is None:
            if _within(_realtime_error(result), self.row.gate_realtime):
                self.realtime = (setting, result)
        if self.best is None or math.isnan(self.best[1].error) or result.error < self.best[1].error:
            self.best = (setting, result)
        if not self.passed:
            failed = f"{setting.solver}: {_short(result.error)} at {_setting_words(setting)}"
            self.reason = problem or result.missing or failed


def _keeps_mesh(row: Row, resolution: int | None) -> bool:
    """Whether the number of edges is given: by the user, as a parameter of the test, or since the test is made so."""
    return resolution is not None or "edges" in row.parameters or not row.refines


def _settings(search: _Search, solvers: Sequence[str], resolution: int | None) -> Iterator[TrialSetting]:
    """The settings to try, each after the one before has been.

    One solver after the other, at the default resolution and then at twice that. A mesh on which a solver without
    substeps is lost is not refined: that takes minutes.
    """
    first = TrialSetting(edges=resolution or TrialSetting.edges)
    refined = () if _keeps_mesh(search.row, resolution) else (FINER * first.edges,)
    for solver in solvers:
        for edges in (first.edges, *refined):
            setting = replace(first, solver=solver, edges=edges)
            # Half the edge needs four times the substeps; cheaper settings have failed on the first mesh already.
            if edges > first.edges and not setting.fixed:
                setting = replace(setting, substeps=8 * setting.substeps)
            yield from _with_more_substeps(search, setting, first.substeps)
            if search.settled:
                return
            if setting.fixed and math.isnan(search.result.error):
                break


def _with_more_substeps(search: _Search, setting: TrialSetting, least: int) -> Iterator[TrialSetting]:
    """A setting, then with twice the substeps, until it passes, more change nothing, or a run takes too long.

    Args:
        search: says what came of each.
        setting: to begin with.
        least: substeps of the very first run, whose time says little because it compiles.
    """
    last, alike = math.nan, 0
    while True:
        yield setting
        error = search.result.error
        if search.passed or setting.fixed or search.result.missing:
            return
        alike = alike + 1 if abs(error - last) < 0.1 * max(search.row.gate_best, 1e-12) else 0
        if alike == 2:  # once may be by chance, or because nothing moves yet
            search.reason = f"more substeps change nothing; {search.reason}"
            return
        if 2.0 * search.seconds > MAX_RUN_S and setting.substeps > least:
            search.reason = f"more would take over {MAX_RUN_S:g} s; {search.reason}"
            return
        if setting.substeps >= MAX_SUBSTEPS:
            return
        last, setting = error, replace(setting, substeps=2 * setting.substeps)


def validate_all(
    tests: Sequence[tuple[Row, Sequence[Mapping[str, Any]]]],
    solver: str | None,
    resolution: int | None,
    workers: int,
    report: Callable[[str], None],
) -> list[ValidationResult]:
    """Run the cases of several tests, in the order of the table.

    Args:
        tests: as :func:`chosen_rows` gives them.
        solver, resolution: as for :func:`validate`.
        workers: processes at a time; one case stays in this process.
        report: called with a line of progress.
    """
    cases = [(row, case) for row, cases in tests for case in cases]
    if len(cases) == 1:
        return [validate(*cases[0], solver, resolution=resolution, report=report)]

    def progress(count: int, found: ValidationResult) -> None:
        report(f"{count} of {len(cases)}: {found.row.name} {case_words(found.case)}: {_short(found.best.error)}")

    jobs = [partial(_validate_named, row.name, case, solver, resolution) for row, case in cases]
    return run_jobs(jobs, workers, done=progress)


def _validate_named(name: str, case: Mapping[str, Any], solver: str | None, resolution: int | None) -> ValidationResult:
    return validate(ROWS[name], case, solver, resolution=resolution)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def case_words(case: Mapping[str, Any]) -> str:
    """Parameters as the command line takes them."""
    return " ".join(f"{key}={_short(value)}" for key, value in case.items())


def _setting_words(setting: TrialSetting) -> str:
    return f"{setting.edges} edges" + ("" if setting.fixed else f", {setting.substeps} substeps")


def result_row(result: ValidationResult) -> dict[str, Any]:
    """The result as a row of figures."""
    row, best = result.row, result.best
    figures: dict[str, Any] = {
        "test": row.name,
        "solver": result.best_setting.solver,
        "default_solver": "default",
        "params": dict(result.case),
        "reference": best.reference,
        "measured": best.measured,
        "error": best.error,
        "gate_best": row.gate_best,
        "gate_realtime": row.gate_realtime,
        "passed_best": result.passed_best,
        "passed_realtime": result.realtime is not None,
        "setting": _setting_words(result.best_setting),
        "cost_ms": best.cost_ms,
        "default_measured": result.default.measured,
        "default_error": _realtime_error(result.default),
        "default_cost_ms": result.default.cost_ms,
        "passed_default": result.passed_default,
        "reason": result.reason,
    }
    if result.realtime is not None and result.realtime_setting is not None:
        figures |= {
            "realtime_setting": _setting_words(result.realtime_setting),
            "realtime_measured": result.realtime.measured,
            "realtime_error": _realtime_error(result.realtime),
            "realtime_cost_ms": result.realtime.cost_ms,
        }
    return figures | dict(best.figures)


def validation_text(results: Sequence[ValidationResult]) -> str:
    """The table as text, a line a case."""
    lines = [
        f"{'test':<34}{'reference':>11}{'best':>11}{'error':>10}{'gate':>8}  {'':<7}"
        f"{'default':>11}{'error':>10}{'gate':>8}  passes at"
    ]
    for result in results:
        row, best, default = result.row, result.best, result.default
        name = " ".join([row.name, *(_short(value) for value in result.case.values())])
        at = "never"
        if result.realtime is not None and result.realtime_setting is not None:
            at = "default"
            if not result.passed_default:
                at = f"{_setting_words(result.realtime_setting)}, {result.realtime.cost_ms:.2f} ms"
        lines.append(
            f"{name:<34}{best.reference:11.5g}{best.measured:11.5g}{best.error:10.2g}{row.gate_best:8.2g}  "
            f"{'passed' if result.passed_best else 'FAILED':<7}{default.measured:11.5g}"
            f"{_realtime_error(default):10.2g}{row.gate_realtime:8.2g}  {at}"
            + (f"  ({result.reason})" if result.reason else "")
        )
        lines += [f"    {name}: {_short(value)}" for name, value in best.figures.items()]
    return "\n".join(lines)
