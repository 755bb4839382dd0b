"""Edges of a pattern that are too short to be cut, joined to their neighbours.

Programs that compute patterns leave slivers: a waist whose halves differ by a millimetre gives each an edge of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from assets.patterns.pattern import Band, EdgeName, Panel, Pattern, Seam, edge_length

__all__ = ["MIN_EDGE", "join_edges", "joinable_edges"]

MIN_EDGE = 1e-3  # [m]
_LONGEST_PARTNER = 3.0 * MIN_EDGE  # [m] of the edge that a short one is sewn to


def joinable_edges(pattern: Pattern) -> dict[EdgeName, int]:
    """Edges below 1 mm that can be joined to another edge of their panel, each with the number of that edge.

    The seam of a short edge is left out, and the other edge of the seam is joined to a neighbour too, if other seams
    still hold both panels together there. Short edges that follow each other without seams are one edge if that is long
    enough. An edge is not joined if it has a band, is one of several short ones with seams, or if its panel would be
    left with a single edge. A pattern with coordinates that are not finite has none.
    """
    if not all(np.isfinite(edge).all() for panel in pattern.panels for edge in panel.edges):
        return {}
    lengths = {
        EdgeName(panel.name, k): edge_length(edge) for panel in pattern.panels for k, edge in enumerate(panel.edges)
    }
    partner = _partners(pattern, lengths)
    short = {name for name, length in lengths.items() if length < MIN_EDGE}
    short |= {partner[name] for name in short & partner.keys() if lengths[partner[name]] < _LONGEST_PARTNER}
    banded = {band.edge for band in pattern.bands}
    found: dict[EdgeName, int] = {}
    for panel in pattern.panels:
        joined: dict[EdgeName, int] = {}
        for run in _runs(panel, short):
            names = [EdgeName(panel.name, k) for k in run]
            if not banded.isdisjoint(names) or (len(run) > 1 and not partner.keys().isdisjoint(names)):
                continue
            alone = sum(lengths[name] for name in names) >= MIN_EDGE and names[0] not in partner
            joined |= dict.fromkeys(names, run[0] if alone else _neighbour(panel, run, partner))
        if len(panel.edges) - sum(name.edge != taker for name, taker in joined.items()) >= 2:
            found |= joined
    found = {name: taker for name, taker in found.items() if partner.get(name, name) in found}
    torn = _torn_seams(pattern, found, partner)
    return {name: taker for name, taker in found.items() if name not in torn}


def join_edges(pattern: Pattern, joined: Mapping[EdgeName, int]) -> Pattern:
    """The pattern with edges joined to others of their panel, without the seams of those that are gone.

    The outlines stay as they are. Edges are numbered anew, from the one that holds edge 0.

    Args:
        pattern: as it is drawn.
        joined: from :func:`joinable_edges` of it.
    """
    if not joined:
        return pattern
    gone = {name for name, taker in joined.items() if name.edge != taker}
    panels, number = [], {}
    for panel in pattern.panels:
        takers = [joined.get(EdgeName(panel.name, k), k) for k in range(len(panel.edges))]
        first = 0
        while takers[first - 1] == takers[0]:
            first -= 1
        edges = []
        for _, group in groupby(range(first, first + len(takers)), key=lambda k: takers[k]):
            members = list(group)
            number |= {EdgeName(panel.name, k % len(takers)): len(edges) for k in members}
            edges.append(_chained([panel.edges[k] for k in members]))
        panels.append(replace(panel, edges=tuple(edges)))

    def renamed(name: EdgeName) -> EdgeName:
        return EdgeName(name.panel, number[name])

    seams = tuple(
        Seam(renamed(seam.first), renamed(seam.second), seam.reversed)
        for seam in pattern.seams
        if gone.isdisjoint((seam.first, seam.second))
    )
    bands = tuple(Band(renamed(band.edge), *band[1:]) for band in pattern.bands)
    return replace(pattern, panels=tuple(panels), seams=seams, bands=bands)


def _partners(pattern: Pattern, lengths: Mapping[EdgeName, float]) -> dict[EdgeName, EdgeName]:
    """The edge that each edge is sewn to; without seams of edges that do not exist."""
    partner: dict[EdgeName, EdgeName] = {}
    for seam in pattern.seams:
        if seam.first in lengths and seam.second in lengths:
            partner |= {seam.first: seam.second, seam.second: seam.first}
    return partner


def _runs(panel: Panel, short: set[EdgeName]) -> list[list[int]]:
    """Numbers of short edges that follow each other around the outline; none if all edges are short."""
    count = len(panel.edges)
    kept = [k for k in range(count) if EdgeName(panel.name, k) not in short]
    if not kept:
        return []
    around = [(kept[0] + k) % count for k in range(count)]
    grouped = groupby(around, key=lambda k: EdgeName(panel.name, k) in short)
    return [list(group) for is_short, group in grouped if is_short]


def _neighbour(panel: Panel, run: list[int], partner: Mapping[EdgeName, EdgeName]) -> int:
    """Edge before or after a run of edges that takes it in: without a seam, or where the outline turns less."""
    count = len(panel.edges)
    choices = []
    for taker, one, two in ((run[0] - 1, run[0] - 1, run[0]), (run[-1] + 1, run[-1], run[-1] + 1)):
        ahead, after = np.diff(panel.edges[one % count], axis=0)[-1], np.diff(panel.edges[two % count], axis=0)[0]
        turn = abs(np.arctan2(ahead[0] * after[1] - ahead[1] * after[0], ahead @ after))
        choices.append((EdgeName(panel.name, taker % count) in partner, turn, taker % count))
    return min(choices)[-1]


def _torn_seams(
    pattern: Pattern, joined: Mapping[EdgeName, int], partner: Mapping[EdgeName, EdgeName]
) -> set[EdgeName]:
    """Edges whose seam may not be left out: no other seam holds their panels together at that place."""
    corner: dict[EdgeName, int] = {}
    for panel in pattern.panels:
        for k in range(len(panel.edges)):
            corner[EdgeName(panel.name, k)] = len(corner)

    def ends(name: EdgeName) -> tuple[int, int]:
        return corner[name], corner[EdgeName(name.panel, (name.edge + 1) % len(pattern.panel(name.panel).edges))]

    gone = {name for name, taker in joined.items() if name.edge != taker}
    same = [ends(name) for name in gone]  # both ends of a short edge are one place
    for seam in pattern.seams:
        if {seam.first, seam.second} <= partner.keys() - gone:
            second = ends(seam.second)
            same += zip(ends(seam.first), second[::-1] if seam.reversed else second, strict=True)
    one, two = np.array(same, int).reshape(-1, 2).T
    _, place = connected_components(csr_matrix((np.ones(len(same)), (one, two)), (len(corner),) * 2), directed=False)
    return {name for name in gone & partner.keys() if place[ends(name)[0]] != place[ends(partner[name])[0]]}


def _chained(edges: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Edges one after another as one polyline, shape (k, 2), without points twice."""
    points = np.concatenate([edges[0], *(edge[1:] for edge in edges[1:])])
    apart = np.append(True, (np.diff(points, axis=0) != 0.0).any(axis=1))
    return points[apart]
