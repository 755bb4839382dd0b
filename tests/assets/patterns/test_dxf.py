"""Blocks of pattern systems (ASTM D6673): sew lines, half pieces, cutouts, and what else is on their layers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ezdxf.document import Drawing
from ezdxf.xclip import XClip

from assets.patterns.curves import signed_area
from assets.patterns.dxf import read_dxf
from assets.patterns.pattern import Panel
from tests.refusals import refuses

Points = list[tuple[float, float]]
CUT: Points = [(-10, -10), (510, -10), (510, 710), (-10, 710)]
SEW: Points = [(0, 0), (500, 0), (500, 700), (0, 700)]
HALF: Points = [(0, 0), (250, 0), (250, 600), (100, 700), (0, 650)]  # the fold is x = 0


def on(layer: str) -> dict[str, str]:
    return {"layer": layer}


def read(folder: Path, draw: Callable[[Any], object], more: Callable[[Drawing], object] | None = None) -> Panel:
    """The panel of a block that ``draw`` fills."""
    document = Drawing.new("R2010")
    document.header["$INSUNITS"] = 4
    draw(document.blocks.new("front"))
    document.modelspace().add_blockref("front", (0, 0))
    if more is not None:
        more(document)
    document.saveas(folder / "top.dxf")
    (panel,) = read_dxf(folder / "top.dxf")
    return panel


def refused(folder: Path, draw: Callable[[Any], object], more: Callable[[Drawing], object] | None = None) -> str:
    return refuses("", read, folder, draw, more)


def closed(block: Any, points: Points, layer: str) -> None:
    block.add_polyline2d(points, close=True, dxfattribs=on(layer))


def drawing(*items: tuple[str, Points]) -> Callable[[Any], None]:
    """Draws a line of every two points and a closed polyline of more, each on its layer."""

    def draw(block: Any) -> None:
        for layer, points in items:
            if len(points) == 2:
                block.add_line(*points, dxfattribs=on(layer))
            else:
                closed(block, points, layer)

    return draw


def dots(block: Any, points: Points) -> None:
    for point in points:
        block.add_point(point, dxfattribs=on("2"))


def millimetres(panel: Panel) -> list[list[float]]:
    return (np.round(1e3 * panel.outline, 6) + 0.0).tolist()


@pytest.mark.parametrize("turns", [[], CUT, SEW, CUT + SEW])
def test_the_sew_line_is_the_outline_where_there_is_one(tmp_path: Path, turns: Points) -> None:
    def draw(block: Any) -> None:
        drawing(("1", CUT), ("14", SEW))(block)
        dots(block, turns)

    panel = read(tmp_path, draw)
    assert millimetres(panel) == [list(point) for point in SEW]
    assert [len(edge) for edge in panel.edges] == [2, 2, 2, 2]


def beside(layer: str) -> tuple[tuple[str, Points], ...]:
    """A line and a small outline that change nothing."""
    return ("1", SEW), (layer, [(0, 350), (8, 350)]), (layer, [(100, 100), (200, 100), (200, 200)])


@pytest.mark.parametrize(
    ("items", "outline"),
    [
        ([("1", CUT)], CUT),  # the cut line without a sew line
        ([("14", SEW)], SEW),  # a sew line alone
        ([("1", SEW), ("6", [(250, 0), (250, 700)])], SEW),  # a mirror line through a whole piece
        *((beside(layer), SEW) for layer in ("3", "4", "5", "8", "9", "10", "13", "15", "80", "84", "87")),
    ],
)
def test_what_makes_an_outline_and_what_changes_none(
    tmp_path: Path, items: list[tuple[str, Points]], outline: Points
) -> None:
    assert millimetres(read(tmp_path, drawing(*items))) == [list(point) for point in outline]


POCKET: Points = [(100, 100), (250, 100), (250, 300), (100, 300)]
SLIT: Points = [(0, 0), (250, 0), (250, 700), (0, 700), (0, 500), (20, 400), (0, 300)]


@pytest.mark.parametrize(
    ("items", "message"),
    [
        ([("1", CUT), ("14", POCKET)], "panel 'front': a sew line that does not follow its cut line"),
        ([("1", CUT), ("14", POCKET)], "allowances of 110, 110, 260, 410 mm"),
        ([("1", CUT), ("14", [(0, 0), (500, 0)])], "panel 'front', sew line: an open outline"),
        ([("1", SEW), ("14", CUT)], "a sew line that does not follow its cut line"),
        ([("1", SEW), ("6", [(-50, 0), (-50, 700)])], "panel 'front': a half piece that cannot be unfolded"),
        (
            [("1", SEW), ("6", [(0, 0), (0, 700)]), ("6", [(0, 0), (500, 0)])],
            "panel 'front': several mirror lines (received 2",
        ),
        ([("1", SEW), ("6", [(0, 100), (0, 100.01)])], "panel 'front': a mirror line without length"),
        ([("1", SLIT), ("6", [(0, 0), (0, 700)])], "a half piece that cannot be unfolded"),
        ([("1", SEW), ("1", [(x + 600, y) for x, y in SEW])], "panel 'front': a panel of several outlines"),
    ],
)
def test_what_is_no_piece_is_refused(tmp_path: Path, items: list[tuple[str, Points]], message: str) -> None:
    assert message in refused(tmp_path, drawing(*items))


def mirrored(points: Points) -> list[list[float]]:
    return [[-x, y] for x, y in points]


def as_set(points: Any) -> set[tuple[float, ...]]:
    return {tuple(float(value) for value in point) for point in points}


@pytest.mark.parametrize("start", range(5))
@pytest.mark.parametrize("turned", [False, True])
def test_a_half_piece_is_unfolded_along_its_mirror_line(tmp_path: Path, start: int, turned: bool) -> None:
    points = HALF[start:] + HALF[:start]
    panel = read(tmp_path, drawing(("1", points[::-1] if turned else points), ("6", [(0, 0), (0, 650)])))
    # Neither end of the fold is a corner of the hem; at the neck the whole turns by 53 degrees.
    corners = as_set([*HALF[1:], *mirrored(HALF[1:4])])
    assert as_set(np.round(1e3 * np.array([edge[0] for edge in panel.edges]), 6)) == corners
    assert signed_area(panel.outline) == pytest.approx(2.0 * signed_area(1e-3 * np.array(HALF)))


def test_turn_points_on_the_fold_count_where_the_whole_has_a_corner(tmp_path: Path) -> None:
    def draw(block: Any) -> None:
        drawing(("1", HALF), ("6", [(0, -20), (0, 700)]))(block)
        dots(block, [(0, 0), (250, 0), (100, 700), (0, 650)])  # none at (250, 600)

    panel = read(tmp_path, draw)
    corners = as_set([(250, 0), (100, 700), (0, 650), (-250, 0), (-100, 700)])
    assert as_set(np.round(1e3 * np.array([edge[0] for edge in panel.edges]), 6)) == corners


def test_a_half_piece_of_lines_and_arcs_is_unfolded_and_its_fold_may_be_open(tmp_path: Path) -> None:
    def draw(block: Any) -> None:
        block.add_line((0, 0), (250, 0), dxfattribs=on("1"))
        block.add_arc((0, 0), 250, 0, 90, dxfattribs=on("1"))
        block.add_line((0, 0), (0, 250), dxfattribs=on("6"))

    panel = read(tmp_path, draw)
    assert len(panel.edges) == 4
    assert signed_area(panel.outline) == pytest.approx(0.5 * np.pi * 0.25**2, rel=1e-3)

    def open_polyline(block: Any) -> None:
        block.add_polyline2d(HALF, dxfattribs=on("1"))
        block.add_line((0, 0), (0, 650), dxfattribs=on("6"))

    assert signed_area(read(tmp_path, open_polyline).outline) == pytest.approx(2.0 * signed_area(1e-3 * np.array(HALF)))


def test_the_sew_line_of_a_half_piece_is_unfolded(tmp_path: Path) -> None:
    cut: Points = [(0, -10), (260, -10), (260, 710), (0, 710)]
    sew: Points = [(0, 0), (250, 0), (250, 700), (0, 700)]
    panel = read(tmp_path, drawing(("1", cut), ("14", sew), ("6", [(0, -10), (0, 710)])))
    np.testing.assert_allclose(np.ptp(panel.outline, axis=0), [0.5, 0.7])
    assert [len(edge) for edge in panel.edges] == [2, 3, 2, 3]  # the hem and the waist go on over the fold


def test_the_grain_is_the_longest_line_whatever_its_kind(tmp_path: Path) -> None:
    def draw(block: Any) -> None:
        drawing(("1", SEW), ("7", [(400, 100), (390, 110)]))(block)  # an arrow head
        block.add_polyline2d([(100, 100), (400, 100)], dxfattribs=on("7"))

    assert read(tmp_path, draw).grain.tolist() == [1.0, 0.0]


@pytest.mark.parametrize(
    ("layer", "message"),
    [
        ("7", "panel 'front': a grain line that ends where it starts"),
        ("11", "panel 'front': a cutout inside a piece (received 'curves on layer 11'"),
    ],
)
def test_a_ring_is_no_grain_and_a_cutout_is_refused(tmp_path: Path, layer: str, message: str) -> None:
    def draw(block: Any) -> None:
        closed(block, SEW, "1")
        block.add_circle((250, 350), 50, dxfattribs=on(layer))

    assert message in refused(tmp_path, draw)


def test_pieces_that_would_be_lost_are_refused(tmp_path: Path) -> None:
    def named_layer(document: Drawing) -> None:
        closed(document.blocks.new("back"), SEW, "CUT")
        document.modelspace().add_blockref("back", (600, 0))

    def outline_beside(document: Drawing) -> None:
        closed(document.modelspace(), [(x + 600, y) for x, y in SEW], "back")

    def nested(document: Drawing) -> None:
        closed(document.blocks.new("pair"), SEW, "1")
        document.blocks["pair"].add_blockref("front", (600, 0))
        document.modelspace().add_blockref("pair", (600, 0))

    def rows(document: Drawing) -> None:
        document.modelspace().add_blockref("front", (600, 0), {"column_count": 2, "column_spacing": 600})

    for more, message in (
        (named_layer, "panel 'back': a block without an outline (received ['CUT']"),
        (outline_beside, "outlines beside the blocks (received ['back']"),
        (nested, "block 'pair': a block inside a block (received 'front'"),
        (rows, "block 'front': a block in rows and columns"),
    ):
        assert message in refused(tmp_path, drawing(("1", SEW)), more)


@pytest.mark.parametrize("on", [True, False])
def test_a_clipped_block_is_refused_while_its_clip_is_on(tmp_path: Path, on: bool) -> None:
    def clip(document: Drawing) -> None:
        (insert,) = document.modelspace().query("INSERT")
        clipping = XClip(insert)
        clipping.set_block_clipping_path([(0, 0), (250, 350)])
        if not on:
            clipping.disable_clipping()

    def draw(block: Any) -> None:
        closed(block, SEW, "1")

    if on:
        assert "block 'front': a clipped block" in refused(tmp_path, draw, clip)
    else:
        assert len(read(tmp_path, draw, clip).outline) == 4


def test_text_and_marks_beside_pieces_are_no_panels(tmp_path: Path) -> None:
    def more(document: Drawing) -> None:
        document.blocks.new("style").add_text("STYLE NAME: A", dxfattribs=on("1"))
        document.modelspace().add_blockref("style", (0, 0))
        document.modelspace().add_line((0, 0), (9, 9), dxfattribs=on("15"))
        closed(document.blocks.new("notch"), [(0, 0), (3, 0), (3, 3)], "4")
        document.blocks["front"].add_blockref("notch", (0, 350), on("4"))

    assert millimetres(read(tmp_path, lambda block: closed(block, SEW, "1"), more)) == [list(point) for point in SEW]


@pytest.mark.parametrize("hide", ["off", "freeze"])
def test_layers_that_are_hidden_are_left_out(tmp_path: Path, hide: str) -> None:
    document = Drawing.new("R2010")
    document.header["$INSUNITS"] = 4
    space = document.modelspace()
    closed(space, SEW, "front")
    closed(space, [(-50, -50), (2000, -50), (2000, 900), (-50, 900)], "frame")
    getattr(document.layers.add("frame"), hide)()
    document.saveas(tmp_path / "top.dxf")
    (panel,) = read_dxf(tmp_path / "top.dxf")
    assert panel.name == "front"
