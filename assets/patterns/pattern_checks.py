"""Checks of a pattern before it is cut: every fault at once, with the panels and edges named."""

from __future__ import annotations

from collections.abc import Collection
from difflib import get_close_matches

import numpy as np

from assets.patterns.curves import contains, crossings, signed_area
from assets.patterns.pattern import EdgeName, Panel, Pattern, edge_length
from assets.patterns.short_edges import MIN_EDGE
from pbd.errors import InputError

__all__ = ["MAX_GATHER", "check_pattern"]

MAX_GATHER = 3.0  # length of an edge over that of the edge it is sewn to [-]; a full ruffle has 2 to 3
_MAX_GAP = 1e-6  # [m] between the end of an edge and the start of the next one
_MAX_PANEL, _MIN_PANEL = 5.0, 0.03  # [m] of the longer side of a panel; the second of the largest panel


def check_pattern(pattern: Pattern, *, joined: Collection[EdgeName] = (), on_one_sheet: bool = False) -> None:
    """Refuse a pattern that cannot be sewn.

    Args:
        pattern: from a file or a draft.
        joined: edges that may be below 1 mm, since they are joined to others afterwards
            (:func:`assets.patterns.short_edges.joinable_edges`).
        on_one_sheet: whether the panels lie side by side in one drawing, so that they must not overlap.

    Raises:
        InputError: one or more of: no panels; a name twice; coordinates that are not finite; open, clockwise or
            self-crossing outlines; edges below 1 mm; panels above 5 m or all below 3 cm; panels that overlap on their
            sheet; seams and bands of panels or edges that do not exist; an edge in two seams or sewn to itself; edges
            whose lengths differ more than three times; bands without width, with less than a layer, or without length.
    """
    errors: list[InputError] = []
    names = [panel.name for panel in pattern.panels]
    if not names:
        errors.append(InputError("a pattern without panels", expected="closed outlines"))
    for name in sorted({name for name in names if names.count(name) > 1}):
        errors.append(InputError("the same name twice", key=f"panel {name!r}", expected="a name of its own"))
    sound = [panel for panel in pattern.panels if not (found := _panel_errors(panel, joined)) or errors.extend(found)]
    if len(sound) == len(names) and not errors:
        errors += _size_errors(pattern)
        errors += _overlaps(sound) if on_one_sheet else []
    errors += _seam_errors(pattern, {panel.name for panel in sound}, joined)
    errors += _band_errors(pattern)
    if errors:
        raise InputError.join([error.in_file(pattern.source) for error in errors])


def _panel_errors(panel: Panel, joined: Collection[EdgeName]) -> list[InputError]:
    """Faults of one outline, of which some edges may be short."""
    key = f"panel {panel.name!r}"
    numbers = [*panel.edges, panel.grain]
    if panel.placement is not None:
        numbers += [panel.placement.rotation, panel.placement.translation]
    if not all(np.isfinite(values).all() for values in numbers):
        return [InputError("a coordinate that is not finite", key=key)]
    if len(panel.edges) < 2:
        return [InputError("an outline of one edge", key=key, expected="at least 2 edges, that is 2 corners")]
    errors = []
    for k, edge in enumerate(panel.edges):
        following = (k + 1) % len(panel.edges)
        gap = float(np.linalg.norm(panel.edges[following][0] - edge[-1]))
        if gap > _MAX_GAP:
            place = f"{key}, between edges {k} and {following}"
            errors.append(InputError("an open outline", key=place, received=f"a gap of {1e3 * gap:.3g} mm"))
        if edge_length(edge) < MIN_EDGE and EdgeName(panel.name, k) not in joined:
            length, expected = (
                f"{1e3 * edge_length(edge):.3g} mm",
                "1 mm: lengthen it, or join it to the edge beside it",
            )
            problem = "an edge that is too short"
            errors.append(InputError(problem, key=f"{key}, edge {k}", received=length, expected=expected))
    if errors:
        return errors
    apart = (np.roll(panel.outline, -1, axis=0) != panel.outline).any(axis=1)  # an edge may have no length at all
    outline = panel.outline[apart]
    crossed = crossings(outline, outline)
    if len(crossed):
        owner = np.repeat(np.arange(len(panel.edges)), [len(edge) - 1 for edge in panel.edges])[apart]
        one, two = (int(owner[k]) for k in crossed[0])
        x, y = 1e2 * outline[crossed[0, 0]]
        place = f"{key}, edge {one}" if one == two else f"{key}, edges {one} and {two}"
        errors.append(
            InputError("an outline that crosses or touches itself", key=place, received=f"at {x:.1f}, {y:.1f} cm")
        )
    elif signed_area(outline) < 0.0:
        expected = "counter-clockwise, seen from the outer side"
        errors.append(InputError("a clockwise outline", key=key, expected=expected))
    if abs(np.linalg.norm(panel.grain) - 1.0) > 1e-6:
        errors.append(InputError("a grain that is no unit vector", key=key, received=panel.grain.tolist()))
    return errors


def _size_errors(pattern: Pattern) -> list[InputError]:
    """Sizes that no garment has: the unit of the file is another one."""
    sizes = [float(np.ptp(panel.outline, axis=0).max()) for panel in pattern.panels]
    largest = int(np.argmax(sizes))
    if _MIN_PANEL <= sizes[largest] <= _MAX_PANEL:
        return []
    key = f"panel {pattern.panels[largest].name!r}"
    expected = f"a largest panel of {_MIN_PANEL:g} to {_MAX_PANEL:g} m: is the unit right?"
    return [InputError("a size that no garment has", key=key, received=f"{sizes[largest]:.3g} m", expected=expected)]


def _overlaps(panels: list[Panel]) -> list[InputError]:
    """Pairs of panels that lie over each other."""
    errors = []
    outlines = [panel.outline for panel in panels]
    for i, one in enumerate(outlines):
        for j in range(i + 1, len(outlines)):
            two = outlines[j]
            if (one.min(axis=0) > two.max(axis=0)).any() or (two.min(axis=0) > one.max(axis=0)).any():
                continue
            if len(crossings(one, two)) or contains(one, two[:1])[0] or contains(two, one[:1])[0]:
                key = f"panels {panels[i].name!r} and {panels[j].name!r}"
                errors.append(InputError("panels that overlap", key=key, expected="panels side by side on the sheet"))
    return errors


def _edge_error(pattern: Pattern, name: EdgeName, key: str) -> InputError | None:
    """Why there is no such edge, if there is none."""
    edges = {panel.name: len(panel.edges) for panel in pattern.panels}
    if name.panel not in edges:
        near = get_close_matches(name.panel, list(edges), n=1)
        expected = "one of " + ", ".join(map(repr, edges)) + (f"; did you mean {near[0]!r}?" if near else "")
        return InputError("no such panel", key=key, received=name.panel, expected=expected)
    if not 0 <= name.edge < edges[name.panel]:
        expected = f"0 to {edges[name.panel] - 1}"
        return InputError(f"no such edge of panel {name.panel!r}", key=key, received=name.edge, expected=expected)
    return None


def _seam_errors(pattern: Pattern, sound: set[str], joined: Collection[EdgeName]) -> list[InputError]:
    """Faults of the seams; lengths are compared between panels without faults, where no short edge is joined."""
    errors: list[InputError] = []
    owner: dict[EdgeName, int] = {}
    for number, seam in enumerate(pattern.seams):
        key = f"seam {number}"
        wrong = [error for name in (seam.first, seam.second) if (error := _edge_error(pattern, name, key))]
        errors += wrong
        if wrong:
            continue
        if seam.first == seam.second:
            errors.append(InputError("an edge that is sewn to itself", key=key, received=_words(seam.first)))
            continue
        for name in (seam.first, seam.second):
            if name in owner:
                received = f"{_words(name)}, also in seam {owner[name]}"
                errors.append(InputError("an edge in two seams", key=key, received=received))
            owner[name] = number
        if not {seam.first.panel, seam.second.panel} <= sound or {seam.first, seam.second} & set(joined):
            continue
        lengths = [edge_length(pattern.edge(name)) for name in (seam.first, seam.second)]
        ratio = max(lengths) / min(lengths)
        if ratio > MAX_GATHER:
            pair = zip((seam.first, seam.second), lengths, strict=True)
            received = " and ".join(f"{_words(name)} of {1e2 * length:.1f} cm" for name, length in pair)
            expected = f"a ratio of at most {MAX_GATHER:g}"
            problem = f"edges whose lengths differ {ratio:.2f} times"
            errors.append(InputError(problem, key=key, received=received, expected=expected))
    return errors


def _band_errors(pattern: Pattern) -> list[InputError]:
    errors: list[InputError] = []
    for number, band in enumerate(pattern.bands):
        key = f"band {number}"
        wrong = _edge_error(pattern, band.edge, key)
        errors += [wrong] if wrong else []
        for name, value, holds, expected in (
            ("width", band.width, 0.0 < band.width < _MAX_PANEL, f"above 0, below {_MAX_PANEL:g} m"),
            ("layers", band.layers, 1.0 <= band.layers <= 20.0, "1 to 20"),
            ("length_ratio", band.length_ratio, 0.2 <= band.length_ratio <= 2.0, "0.2 to 2"),
        ):
            if not holds:
                errors.append(InputError("bad value", key=f"{key}, {name}", received=value, expected=expected))
    return errors


def _words(name: EdgeName) -> str:
    return f"{name.panel} {name.edge}"
