"""A pattern that cannot be sewn is refused, all its faults at once, with panels and edges named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.patterns.pattern import Band, EdgeName, Panel, Seam
from assets.patterns.pattern_checks import check_pattern
from pbd.errors import InputError
from tests.assets.patterns.shapes import darted, pattern, polygon, tube
from tests.refusals import refuses

FRONT = polygon("front", [(0.0, 0.0), (0.5, 0.0), (0.5, 0.4), (0.0, 0.4)])
BESIDE = polygon("back", [(0.6, 0.0), (1.1, 0.0), (1.1, 0.4), (0.6, 0.4)])


def moved(panel: Panel, by: tuple[float, float]) -> Panel:
    return replace(panel, edges=tuple(edge + by for edge in panel.edges))


def scaled(panel: Panel, by: float) -> Panel:
    return replace(panel, edges=tuple(edge * by for edge in panel.edges))


def seam(first: tuple[str, int], second: tuple[str, int]) -> Seam:
    return Seam(EdgeName(*first), EdgeName(*second))


def test_patterns_that_can_be_sewn_pass() -> None:
    check_pattern(tube())
    check_pattern(darted())
    check_pattern(pattern(FRONT, BESIDE), on_one_sheet=True)
    check_pattern(pattern(FRONT, moved(BESIDE, (-0.6, 0.0))))  # each in coordinates of its own


def open_panel() -> Panel:
    edges = list(FRONT.edges)
    edges[1] = np.array([(0.5, 0.0), (0.5, 0.39)])
    return replace(FRONT, edges=tuple(edges))


def not_finite() -> Panel:
    return replace(FRONT, edges=(*FRONT.edges[:3], np.array([(0.0, 0.4), (0.0, np.nan), (0.0, 0.0)])))


@pytest.mark.parametrize(
    ("panel", "message"),
    [
        (open_panel(), "panel 'front', between edges 1 and 2: an open outline .*a gap of 10 mm"),
        (not_finite(), "panel 'front': a coordinate that is not finite"),
        (scaled(FRONT, -1.0), None),  # turned by 180 degrees
        (replace(FRONT, edges=tuple(edge * [-1.0, 1.0] for edge in FRONT.edges)), "panel 'front': a clockwise outline"),
        (polygon("bow", [(0, 0), (0.4, 0.3), (0.4, 0), (0, 0.2)]), "'bow', edges 0 and 2: an outline that crosses"),
        (polygon("tiny", [(0, 0), (0.4, 0), (0.4, 0.3), (0.3995, 0.3)]), "'tiny', edge 2: an edge that is too short"),
        (scaled(FRONT, 100.0), "panel 'front': a size that no garment has .*50 m.* is the unit right"),
        (scaled(FRONT, 0.01), "panel 'front': a size that no garment has .*0.005 m"),
        (replace(FRONT, grain=np.array([0.0, 2.0])), "panel 'front': a grain that is no unit vector"),
        (replace(FRONT, edges=FRONT.edges[:1]), "panel 'front': an outline of one edge"),
    ],
)
def test_an_outline_that_cannot_be_cut(panel: Panel, message: str | None) -> None:
    if message is None:
        check_pattern(pattern(panel))
        return
    refuses(message, check_pattern, pattern(panel))


@pytest.mark.parametrize("panel", [moved(scaled(BESIDE, 0.9), shift) for shift in ((-0.4, 0.1), (-0.55, 0.05))])
def test_panels_that_overlap_on_their_sheet(panel: Panel) -> None:
    overlapping = "panels 'front' and 'back': panels that overlap"
    refuses(overlapping, check_pattern, pattern(FRONT, panel), on_one_sheet=True)
    inside = replace(moved(scaled(FRONT, 0.2), (0.1, 0.1)), name="small")
    refuses("panels that overlap", check_pattern, pattern(FRONT, inside), on_one_sheet=True)


def test_edges_of_very_different_length_are_named_with_their_ratio() -> None:
    short = polygon("cuff", [(0.0, 0.0), (0.15, 0.0), (0.15, 0.1), (0.0, 0.1)])
    with pytest.raises(InputError, match=r"seam 0: .*differ 3.33 times .*front 0 of 50.0 cm and cuff 2 of 15.0 cm"):
        check_pattern(pattern(FRONT, short, seams=(seam(("front", 0), ("cuff", 2)),)))
    check_pattern(pattern(FRONT, scaled(short, 1.2), seams=(seam(("front", 0), ("cuff", 2)),)))  # gathers 2.8 times


def test_all_faults_of_seams_and_bands_are_reported_at_once() -> None:
    seams = (
        seam(("front", 1), ("back", 3)),
        seam(("frnt", 1), ("back", 1)),
        seam(("front", 9), ("back", 2)),
        seam(("front", 0), ("front", 0)),
        seam(("front", 1), ("back", 1)),
    )
    bands = (Band(EdgeName("front", 4), 0.02), Band(EdgeName("back", 0), -0.02, layers=0.5, length_ratio=0.0))
    text = refuses("", check_pattern, pattern(FRONT, BESIDE, seams=seams, bands=bands))
    for words in (
        "8 problems",
        "seam 1: no such panel (received 'frnt', expected one of 'front', 'back'; did you mean 'front'?)",
        "seam 2: no such edge of panel 'front' (received 9, expected 0 to 3)",
        "seam 3: an edge that is sewn to itself (received 'front 0')",
        "seam 4: an edge in two seams (received 'front 1, also in seam 0')",
        "band 0: no such edge of panel 'front' (received 4, expected 0 to 3)",
        "band 1, width: bad value (received -0.02, expected above 0, below 5 m)",
        "band 1, layers: bad value (received 0.5, expected 1 to 20)",
        "band 1, length_ratio: bad value (received 0.0, expected 0.2 to 2)",
    ):
        assert words in text


def test_names_must_differ_and_there_must_be_panels() -> None:
    refuses("panel 'front': the same name twice", check_pattern, pattern(FRONT, moved(FRONT, (1.0, 0.0))))
    refuses("a pattern without panels", check_pattern, pattern())
