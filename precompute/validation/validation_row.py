"""One row of the validation table: a test, its parameters and its gates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pbd.errors import InputError
from precompute.validation.trial import TrialResult, TrialSetting

__all__ = ["ParameterChoice", "Parameter", "Row"]


@dataclass(frozen=True)
class Parameter:
    """A number that the user may set.

    Attributes:
        words: its meaning, with its unit.
        default: where neither the user nor the case says.
        low, high: smallest and largest value allowed.
    """

    words: str
    default: float
    low: float
    high: float

    def read(self, text: str, key: str) -> float:
        """The value in a text; raises :class:`InputError`."""
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not self.low <= value <= self.high:
            expected = f"{self.words}, {self.low:g} to {self.high:g}"
            raise InputError("value out of range", key=key, received=text, expected=expected)
        return value


@dataclass(frozen=True)
class ParameterChoice:
    """One of several words that the user may set."""

    words: str
    default: str
    allowed: tuple[str, ...]

    def read(self, text: str, key: str) -> str:
        """The value in a text; raises :class:`InputError`."""
        if text not in self.allowed:
            raise InputError("unknown value", key=key, received=text, expected=" or ".join(self.allowed))
        return text


@dataclass(frozen=True)
class Row:
    """A test.

    Attributes:
        name: as on the command line.
        words: set-up and measured quantity.
        measure: one run at a setting, with the parameters by name.
        gate_best: largest error of the best solver.
        gate_realtime: of the default solver.
        parameters: the ones that the user may set.
        cases: values that the table has; one empty case for a test without any.
        best_solvers: tried in this order for the best column.
        refines: whether the specimen has a finer mesh for more edges; not if its mesh is given.
    """

    name: str
    words: str
    measure: Callable[..., TrialResult]
    gate_best: float
    gate_realtime: float
    parameters: Mapping[str, Parameter | ParameterChoice] = field(default_factory=dict)
    cases: Sequence[Mapping[str, Any]] = ({},)
    best_solvers: Sequence[str] = ("default", "fem-stvk/quasi-static")
    refines: bool = True

    def run(self, setting: TrialSetting, case: Mapping[str, Any]) -> TrialResult:
        """Measure one case; parameters that it does not name are at their defaults."""
        return self.measure(setting, **self.complete(case))

    def complete(self, case: Mapping[str, Any]) -> dict[str, Any]:
        """All parameters of a case."""
        return {name: case.get(name, parameter.default) for name, parameter in self.parameters.items()}

    def chosen(self, texts: Mapping[str, str]) -> list[dict[str, Any]]:
        """The cases with what the user has set, each once.

        Raises:
            InputError: a parameter that this test does not have, or a bad value; all at once.
        """
        errors, values = [], {}
        for name, text in texts.items():
            if name not in self.parameters:
                has = ", ".join(self.parameters) or "no parameters"
                errors.append(
                    InputError(f"{self.name} has no such parameter", key="--param", received=name, expected=has)
                )
                continue
            try:
                values[name] = self.parameters[name].read(text, f"--param {name}")
            except InputError as error:
                errors.append(error)
        if errors:
            raise InputError.join(errors)
        cases: list[dict[str, Any]] = []
        for case in self.cases:
            whole = self.complete({**case, **values})
            if whole not in cases:
                cases.append(whole)
        return cases
