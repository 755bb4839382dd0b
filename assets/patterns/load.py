"""Patterns from files of every kind that the project reads."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from assets.patterns.dxf import read_dxf
from assets.patterns.garmentcode import read_garmentcode
from assets.patterns.pattern import Pattern
from assets.patterns.pattern_checks import check_pattern
from assets.patterns.sheet import with_side_file
from assets.patterns.short_edges import join_edges, joinable_edges
from assets.patterns.svg import read_svg
from pbd.errors import InputError

__all__ = ["load_pattern"]


def load_pattern(path: str | PathLike[str]) -> Pattern:
    """Read and check a sewing pattern; edges below 1 mm are joined to their neighbours.

    Args:
        path: a GarmentCode specification (.json), or a drawing (.svg, .dxf) with its seams in the file
            ``NAME.seams.toml`` beside it, see docs/patterns.md.

    Raises:
        InputError: the file cannot be read, or the pattern cannot be sewn (:func:`check_pattern`).
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind == ".json":
        pattern = read_garmentcode(path)
    elif kind in (".svg", ".dxf"):
        panels = read_svg(path) if kind == ".svg" else read_dxf(path)
        sheet = Pattern(path.stem, panels, (), (), str(path))
        check_pattern(sheet, joined=joinable_edges(sheet), on_one_sheet=True)
        pattern = with_side_file(path, panels)
    else:
        raise InputError("an unknown kind of pattern", file=path, received=kind, expected=".json, .svg or .dxf")
    joined = joinable_edges(pattern)
    check_pattern(pattern, joined=joined)
    return join_edges(pattern, joined)
