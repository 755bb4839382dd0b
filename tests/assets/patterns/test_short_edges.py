"""Edges below a millimetre are joined to a neighbour, and their seams are left out where nothing comes apart."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assets.patterns.load import load_pattern
from assets.patterns.panel_mesh import cut
from assets.patterns.pattern import Band, EdgeName, Panel, Pattern, Seam
from assets.patterns.pattern_checks import check_pattern
from assets.patterns.short_edges import join_edges, joinable_edges
from assets.sewing.pieces import join, pieces_of
from pbd.errors import InputError
from tests.assets.patterns.shapes import pattern, polygon
from tests.refusals import refuses


def seam(first: tuple[str, int], second: tuple[str, int]) -> Seam:
    return Seam(EdgeName(*first), EdgeName(*second))


def mended(given: Pattern) -> Pattern:
    """The pattern as :func:`load_pattern` gives it."""
    joined = joinable_edges(given)
    check_pattern(given, joined=joined)
    return join_edges(given, joined)


def tube(step: list[tuple[float, float]]) -> Pattern:
    """Two panels that are sewn at both sides; corners ``step`` lie at the left end of their upper edge."""
    panels = [polygon(name, [(0.0, 0.0), (0.5, 0.0), (0.5, 0.6), *step]) for name in ("front", "back")]
    last = 2 + len(step)
    return pattern(*panels, seams=(seam(("front", 1), ("back", last)), seam(("front", last), ("back", 1))))


def waist(offset: float) -> Pattern:
    """Two upper and two lower panels with seams between all of them; the upper middle lies ``offset`` off the lower."""
    panels = (
        polygon("top_l", [(-0.3, 0.0), (0.0, 0.0), (offset, 0.0), (offset, 0.4), (-0.3, 0.4)]),
        polygon("top_r", [(offset, 0.0), (0.3, 0.0), (0.3, 0.4), (offset, 0.4)]),
        polygon("low_l", [(-0.3, -0.5), (0.0, -0.5), (0.0, 0.0), (-0.3, 0.0)]),
        polygon("low_r", [(0.0, -0.5), (0.3, -0.5), (0.3, 0.0), (offset, 0.0), (0.0, 0.0)]),
    )
    seams = (
        seam(("top_l", 0), ("low_l", 2)),
        seam(("top_l", 1), ("low_r", 3)),  # the sliver
        seam(("top_r", 0), ("low_r", 2)),
        seam(("top_l", 2), ("top_r", 3)),
        seam(("low_l", 1), ("low_r", 4)),
    )
    return pattern(*panels, seams=seams)


def outlines(given: Pattern) -> list[np.ndarray]:
    return [panel.outline for panel in given.panels]


def test_a_short_edge_is_joined_to_the_neighbour_without_a_seam() -> None:
    given = tube([(0.0009, 0.6), (0.0, 0.6002)])
    found = mended(given)
    for panel in found.panels:
        assert [len(edge) for edge in panel.edges] == [2, 2, 3, 2]
    np.testing.assert_array_equal(outlines(found), outlines(given))
    assert found.seams == (seam(("front", 1), ("back", 3)), seam(("front", 3), ("back", 1)))


def test_an_edge_of_a_millimetre_stays_and_edges_without_length_are_joined_too() -> None:
    given = tube([(0.0011, 0.6), (0.0, 0.6)])
    assert mended(given) is given
    found = mended(tube([(0.0, 0.6), (0.0, 0.6)]))
    assert [len(edge) for edge in found.panels[0].edges] == [2, 2, 2, 2]


def test_short_edges_in_a_row_are_one_edge() -> None:
    """A quarter of a circle in steps of 0.8 mm instead of a corner."""
    angle = np.linspace(0.0, np.pi / 2.0, 40)
    arc = np.stack([0.02 - 0.02 * np.sin(angle), 0.58 + 0.02 * np.cos(angle)], axis=1)
    found = mended(tube([(float(x), float(y)) for x, y in arc]))
    assert [len(edge) for edge in found.panels[0].edges] == [2, 2, 2, 40, 2]
    assert found.seams[0] == seam(("front", 1), ("back", 4))


def test_edges_are_numbered_from_the_one_that_holds_edge_0() -> None:
    """The last edge is short and goes on straight into edge 0, over the bottom; bands follow."""
    panel = polygon("front", [(0.0, 0.0), (0.5, 0.0), (0.5, 0.6), (-0.0005, 0.6), (-0.0005, 0.0)])
    given = pattern(panel, bands=(Band(EdgeName("front", 0), 0.02), Band(EdgeName("front", 2), 0.03)))
    found = mended(given)
    assert [len(edge) for edge in found.panels[0].edges] == [3, 2, 2, 2]
    assert found.panels[0].edges[0].tolist() == [[-0.0005, 0.0], [0.0, 0.0], [0.5, 0.0]]
    assert [band.edge.edge for band in found.bands] == [0, 2]


@pytest.mark.parametrize("offset", [0.0009, 0.0001])
def test_a_sliver_between_four_panels_goes_with_its_seam_and_nothing_comes_apart(offset: float) -> None:
    """As at the waist of GarmentCode's jumpsuit, whose upper halves are 0.9 mm wider than its lower ones."""
    found = mended(waist(offset))
    assert [len(panel.edges) for panel in found.panels] == [4, 4, 4, 4]
    assert len(found.seams) == 4
    surface = join(pieces_of(cut(found, 0.05)))
    sides = np.sort(np.stack([surface.faces, np.roll(surface.faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, times = np.unique(sides, axis=0, return_counts=True)
    rim = edges[times == 1]
    assert surface.count - len(edges) + len(surface.faces) == 1  # a disc: no crack, no second part
    assert len(np.unique(rim)) == len(rim)


def refused(given: Pattern) -> str:
    return refuses("", check_pattern, given, joined=joinable_edges(given))


def test_a_short_seam_that_alone_holds_two_panels_is_refused() -> None:
    step = [(0.3, 0.6), (0.2992, 0.6), (0.0, 0.6)]
    panels = [polygon(name, [(0.0, 0.0), (0.5, 0.0), (0.5, 0.6), *step]) for name in ("front", "back")]
    message = refused(pattern(*panels, seams=(seam(("front", 3), ("back", 3)),)))
    assert (
        "panel 'front', edge 3: an edge that is too short (received '0.8 mm', expected 1 mm: lengthen it, " in message
    )
    assert "panel 'back', edge 3: an edge that is too short" in message


def sewn_steps() -> Pattern:
    """A side seam of two edges of 0.8 mm that are sewn one by one."""
    steps = [(0.0, 0.0016), (0.0, 0.0008)]
    panels = [polygon(name, [(0.0, 0.0), (0.5, 0.0), (0.5, 0.6), *steps]) for name in ("front", "back")]
    return pattern(*panels, seams=(seam(("front", 3), ("back", 4)), seam(("front", 4), ("back", 3))))


def lens() -> Panel:
    """Half a disc, closed by an edge of 0.5 mm."""
    angle = np.linspace(0.0, 2.0 * np.pi - 0.0025, 80)
    round_edge = 0.2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Panel("lens", (round_edge, round_edge[[-1, 0]]), np.array([0.0, 1.0]))


SHORT = tube([(0.0009, 0.6), (0.0, 0.6)]).panels


@pytest.mark.parametrize(
    "given",
    [
        pytest.param(sewn_steps(), id="several in a row with seams"),
        pytest.param(pattern(lens()), id="a panel of one other edge"),
        pytest.param(pattern(*SHORT, bands=(Band(EdgeName("front", 3), 0.01),)), id="a band"),
        pytest.param(pattern(*SHORT, seams=(seam(("front", 3), ("back", 1)),)), id="a partner longer than 3 mm"),
    ],
)
def test_what_cannot_be_joined_is_refused(given: Pattern) -> None:
    assert ("panel 'front', edge 3: " if given.panels == SHORT else "") + "an edge that is too short" in refused(given)


def specification() -> dict[str, Any]:
    """Two panels in cm with a sliver of 0.9 mm at the left end of the waist."""
    vertices = [[-25, 0], [25, 0], [25, 60], [-24.91, 60], [-25, 60.02]]
    edges = [{"endpoints": [k, (k + 1) % 5]} for k in range(5)]
    panels = {name: {"vertices": vertices, "edges": edges} for name in ("front", "back")}
    stitches = [
        [{"panel": "front", "edge": 1}, {"panel": "back", "edge": 4}],
        [{"panel": "front", "edge": 4}, {"panel": "back", "edge": 1}],
    ]
    properties = {"units_in_meter": 100, "curvature_coords": "relative"}
    return {"pattern": {"panels": panels, "stitches": stitches}, "properties": properties}


def test_a_file_is_read_with_its_slivers_joined(tmp_path: Path) -> None:
    (tmp_path / "tube_specification.json").write_text(json.dumps(specification()), encoding="utf-8")
    found = load_pattern(tmp_path / "tube_specification.json")
    assert [len(edge) for edge in found.panel("front").edges] == [2, 2, 3, 2]
    assert [(one.first.edge, one.second.edge) for one in found.seams] == [(1, 3), (3, 1)]
    np.testing.assert_allclose(found.panel("front").edges[2], [[0.25, 0.6], [-0.2491, 0.6], [-0.25, 0.6002]])


def test_messages_number_edges_as_the_file_does(tmp_path: Path) -> None:
    document = specification()
    document["pattern"]["stitches"][0][0]["edge"] = 5
    (tmp_path / "tube_specification.json").write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(InputError, match=r"no such edge of panel 'front' \(received 5, expected 0 to 4\)"):
        load_pattern(tmp_path / "tube_specification.json")
