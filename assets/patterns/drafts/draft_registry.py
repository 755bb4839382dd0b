"""Drafts by name, and their parameters for the command line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any, NamedTuple

from assets.measures import BodyMeasures
from assets.patterns.drafts.aline_skirt import AlineSkirt, aline_skirt
from assets.patterns.drafts.circle_skirt import CircleSkirt, circle_skirt
from assets.patterns.drafts.shirt import Shirt, shirt
from assets.patterns.drafts.trousers import Trousers, trousers
from assets.patterns.drafts.tshirt import Tshirt, tshirt
from assets.patterns.pattern import Pattern
from pbd.errors import InputError

__all__ = ["DRAFTS", "DraftParameter", "draft", "draft_parameters"]


class _Draft(NamedTuple):
    parameters: type
    make: Callable[[BodyMeasures, Any], Pattern]


_DRAFTS: Mapping[str, _Draft] = {
    "tshirt": _Draft(Tshirt, tshirt),
    "shirt": _Draft(Shirt, shirt),
    "aline_skirt": _Draft(AlineSkirt, aline_skirt),
    "circle_skirt": _Draft(CircleSkirt, circle_skirt),
    "trousers": _Draft(Trousers, trousers),
}

DRAFTS = tuple(_DRAFTS)
"""Names of the drafts."""


class DraftParameter(NamedTuple):
    """A parameter of a draft.

    Attributes:
        name: as :func:`draft` takes it.
        default: None for a value that the draft derives from the body.
        unit: "m" or "-".
        meaning: in words.
    """

    name: str
    default: float | None
    unit: str
    meaning: str


def draft_parameters(name: str) -> list[DraftParameter]:
    """The parameters of a draft.

    Raises:
        InputError: there is no draft of that name.
    """
    return [
        DraftParameter(field.name, field.default, field.metadata["unit"], field.metadata["meaning"])  # type: ignore
        for field in fields(_find(name).parameters)
    ]


def draft(name: str, measures: BodyMeasures, **parameters: float | None) -> Pattern:
    """Draft a garment for a body.

    Args:
        name: one of DRAFTS.
        measures: of the body; see :func:`assets.anthropometry.measure`. The panels stand around it where it is.
        parameters: those of :func:`draft_parameters`; others keep their defaults.

    Raises:
        InputError: no such draft or parameter, a body that lacks a measure, or values that cannot be.
    """
    found = _find(name)
    known = [parameter.name for parameter in draft_parameters(name)]
    unknown = sorted(set(parameters) - set(known))
    if unknown:
        raise InputError(
            "no such parameter", key=f"draft {name}", received=unknown[0], expected="one of " + ", ".join(known)
        )
    pattern, frame = found.make(measures, found.parameters(**parameters)), measures.frame
    panels = [
        replace(panel, placement=panel.placement and panel.placement.moved(frame.rotation, frame.origin))
        for panel in pattern.panels
    ]
    return replace(pattern, panels=tuple(panels))


def _find(name: str) -> _Draft:
    if name not in _DRAFTS:
        raise InputError("no such draft", received=name, expected="one of " + ", ".join(DRAFTS))
    return _DRAFTS[name]
