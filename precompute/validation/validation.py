"""The validation table: every test against what can be known exactly, by the default solver and by the best one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from pbd.errors import InputError
from pbd.models import SOLVERS, StepError
from precompute.validation import bending_rows, contact_rows, drape_rows, laboratory_rows, membrane_rows, motion_rows
from precompute.validation.trial import Measured, Setting
from precompute.validation.validation_row import Row
from precompute.workers import run_jobs

__all__ = ["ROWS", "Verdict", "case_words", "chosen_rows", "validate", "validate_all", "validation_text", "verdict_row"]

ROWS: Mapping[str, Row] = {
    row.name: row
    for module in (bending_rows, membrane_rows, motion_rows, contact_rows, drape_rows, laboratory_rows)
    for row in module.ROWS
}
LONGEST = 20.0  # processor time of a run, on the way to the cheapest and to the best setting [s]
MOST = 4096  # substeps of a frame that are tried
FINER = 2  # times as many edges, where more substeps do not help


@dataclass(frozen=True)
class Verdict:
    """One case of one test.

    Attributes:
        row, case: what was tested.
        default: what the default setting gave; None where a solver was chosen instead.
        realtime_setting, realtime: the cheapest setting of the default solver that passes its gate; None if none does.
        best_setting, best: the setting with the least error of those tried, or the first within its gate.
        reason: why it was lost where a gate failed.
    """

    row: Row
    case: Mapping[str, Any]
    default: Measured
    realtime_setting: Setting | None
    realtime: Measured | None
    best_setting: Setting
    best: Measured
    reason: str

    @property
    def passed_best(self) -> bool:
        return _within(self.best.error, self.row.gate_best)

    @property
    def passed_default(self) -> bool:
        return _within(_realtime_error(self.default), self.row.gate_realtime)


def _within(error: float, gate: float) -> bool:
    return bool(error <= gate)  # not a number never is


def _realtime_error(measured: Measured) -> float:
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
    resolution: int | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> Verdict:
    """Run one case from the default setting on, to the cheapest setting that passes and to the best.

    Substeps are doubled, at the default resolution and then at twice that, until the gate of the best column holds,
    more substeps change nothing, or a run takes too long; then the next solver's turn comes. What is lost on the first
    mesh, and knows no substeps, is not tried on a finer one. With a solver or a resolution chosen nothing else is
    tried. A step that fails is no error but a lost row.

    Args:
        row, case: what to test.
        solver: name of a solver; None tries those that the test names.
        resolution: edges along the length; None starts with 20.
        report: called with a line of progress.
    """
    words = f"{row.name} {case_words(case)}".strip()
    first = Setting(edges=resolution or Setting.edges)
    default: Measured | None = None
    realtime: tuple[Setting, Measured] | None = None
    best: tuple[Setting, Measured] | None = None
    reason = ""
    for name in [solver] if solver else row.best_solvers:
        for edges in (first.edges,) if resolution or "edges" in row.parameters else (first.edges, FINER * first.edges):
            setting = replace(first, solver=name, edges=edges)
            # What was cheap enough is not tried again: four times the substeps are needed.
            if edges > first.edges and not setting.fixed:
                setting = replace(setting, substeps=8 * setting.substeps)
            last, alike = math.nan, 0
            while True:
                begin, lost = time.process_time(), ""
                try:
                    found = row.run(setting, case)
                except StepError as error:
                    lost = str(error)
                    found = Measured(math.nan, math.nan, math.nan, math.nan)
                took = time.process_time() - begin
                report(f"{words}: {name}, {_setting_words(setting)}: error {_short(found.error)}")
                if default is None:
                    default = found
                if name == "default" and realtime is None:
                    if _within(_realtime_error(found), row.gate_realtime):
                        realtime = (setting, found)
                if best is None or math.isnan(best[1].error) or found.error < best[1].error:
                    best = (setting, found)
                if _within(found.error, row.gate_best):
                    break
                reason = lost or found.missing or f"{name}: {_short(found.error)} at {_setting_words(setting)}"
                if setting.fixed or found.missing:
                    break
                alike = alike + 1 if abs(found.error - last) < 0.1 * max(row.gate_best, 1e-12) else 0
                if alike == 2 or found.error == last:  # once may be by chance
                    reason = f"more substeps change nothing; {reason}"
                    break
                if 2.0 * took > LONGEST and setting.substeps > first.substeps:  # the first one compiles
                    reason = f"more would take over {LONGEST:g} s; {reason}"
                    break
                if setting.substeps >= MOST:
                    break
                last = found.error
                setting = replace(setting, substeps=2 * setting.substeps)
            if _within(best[1].error, row.gate_best) or best[1].missing:
                break
            if setting.fixed and math.isnan(found.error):  # lost on this mesh after long; a finer one takes minutes
                break
        if best is not None and (_within(best[1].error, row.gate_best) or best[1].missing):
            break
    assert default is not None and best is not None
    passed = _within(best[1].error, row.gate_best) and realtime is not None
    return Verdict(row, case, default, *(realtime or (None, None)), *best, "" if passed else reason)


def validate_all(
    tests: Sequence[tuple[Row, Sequence[Mapping[str, Any]]]],
    solver: str | None,
    resolution: int | None,
    workers: int,
    report: Callable[[str], None],
) -> list[Verdict]:
    """Run the cases of several tests, in the order of the table.

    Args:
        tests: as :func:`chosen_rows` gives them.
        solver, resolution: as for :func:`validate`.
        workers: processes at a time; one case stays in this process.
        report: called with a line of progress.
    """
    cases = [(row, case) for row, cases in tests for case in cases]
    if len(cases) == 1:
        return [validate(*cases[0], solver, resolution, report)]

    def tell(count: int, found: Verdict) -> None:
        report(f"{count} of {len(cases)}: {found.row.name} {case_words(found.case)}: {_short(found.best.error)}")

    jobs = [partial(_validate_named, row.name, case, solver, resolution) for row, case in cases]
    return run_jobs(jobs, workers, done=tell)


def _validate_named(name: str, case: Mapping[str, Any], solver: str | None, resolution: int | None) -> Verdict:
    return validate(ROWS[name], case, solver, resolution)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def case_words(case: Mapping[str, Any]) -> str:
    """Parameters as the command line takes them."""
    return " ".join(f"{key}={_short(value)}" for key, value in case.items())


def _setting_words(setting: Setting) -> str:
    return f"{setting.edges} edges" + ("" if setting.fixed else f", {setting.substeps} substeps")


def verdict_row(verdict: Verdict) -> dict[str, Any]:
    """The verdict as a row of figures."""
    row, best = verdict.row, verdict.best
    figures: dict[str, Any] = {
        "test": row.name,
        "solver": verdict.best_setting.solver,
        "default_solver": "default",
        "params": dict(verdict.case),
        "reference": best.reference,
        "measured": best.measured,
        "error": best.error,
        "gate_best": row.gate_best,
        "gate_realtime": row.gate_realtime,
        "passed_best": verdict.passed_best,
        "passed_realtime": verdict.realtime is not None,
        "setting": _setting_words(verdict.best_setting),
        "cost_ms": best.cost_ms,
        "default_measured": verdict.default.measured,
        "default_error": _realtime_error(verdict.default),
        "default_cost_ms": verdict.default.cost_ms,
        "passed_default": verdict.passed_default,
        "reason": verdict.reason,
    }
    if verdict.realtime is not None and verdict.realtime_setting is not None:
        figures |= {
            "realtime_setting": _setting_words(verdict.realtime_setting),
            "realtime_measured": verdict.realtime.measured,
            "realtime_error": _realtime_error(verdict.realtime),
            "realtime_cost_ms": verdict.realtime.cost_ms,
        }
    return figures


def validation_text(verdicts: Sequence[Verdict]) -> str:
    """The table as text, a line a case."""
    lines = [
        f"{'test':<34}{'reference':>11}{'best':>11}{'error':>10}{'gate':>8}  {'':<7}"
        f"{'default':>11}{'error':>10}{'gate':>8}  passes at"
    ]
    for verdict in verdicts:
        row, best, default = verdict.row, verdict.best, verdict.default
        name = " ".join([row.name, *(_short(value) for value in verdict.case.values())])
        at = "never"
        if verdict.realtime is not None and verdict.realtime_setting is not None:
            at = "default"
            if not verdict.passed_default:
                at = f"{verdict.realtime_setting.substeps} substeps, {verdict.realtime.cost_ms:.2f} ms"
        lines.append(
            f"{name:<34}{best.reference:11.5g}{best.measured:11.5g}{best.error:10.2g}{row.gate_best:8.2g}  "
            f"{'passed' if verdict.passed_best else 'FAILED':<7}{default.measured:11.5g}"
            f"{_realtime_error(default):10.2g}{row.gate_realtime:8.2g}  {at}"
            + (f"  ({verdict.reason})" if verdict.reason else "")
        )
    return "\n".join(lines)
