"""Panels drawn as SVG or DXF, sewn by the side file."""

from __future__ import annotations

from pathlib import Path

import ezdxf
import numpy as np
import pytest
from ezdxf.enums import InsertUnits

from assets.patterns.curves import signed_area
from assets.patterns.load import load_pattern
from assets.patterns.pattern import Band, EdgeName, Pattern, Seam, edge_length
from tests.refusals import refuses

SHAPES = """
<g transform="translate(100,100)">
  <path id="front" d="M 0 0 L 150 0 Q 250 100 350 0 L 500 0 L 500 300 A 600 600 0 0 1 0 300 Z"/>
  <line id="front.grain" x1="200" y1="300" x2="200" y2="100"/>
</g>
<polygon id="back" points="700,100 1200,100 1200,400 950,440 700,400"/>
"""
SEAMS = 'seams = [["front", 2, "back", 0]]\n'


def svg(folder: Path, shapes: str = SHAPES, seams: str | None = SEAMS, size: str = "1500mm") -> Pattern:
    header = f'<svg xmlns="http://www.w3.org/2000/svg" width="{size}" height="{size}" viewBox="0 0 1500 1500">'
    (folder / "top.svg").write_text(f"{header}{shapes}</svg>", encoding="utf-8")
    if seams is not None:
        (folder / "top.seams.toml").write_text(seams, encoding="utf-8")
    return load_pattern(folder / "top.svg")


def test_an_svg_path_has_an_edge_from_node_to_node_counted_counter_clockwise(tmp_path: Path) -> None:
    front = svg(tmp_path).panel("front")
    assert signed_area(front.outline) > 0.0
    ends = [np.round(edge[-1] - front.edges[0][0], 9).tolist() for edge in front.edges]
    assert ends == [[0.0, -0.3], [0.5, -0.3], [0.5, 0.0], [0.35, 0.0], [0.15, 0.0], [0.0, 0.0]]
    hem, neck = front.edges[1], front.edges[4]
    assert edge_length(hem) == pytest.approx(2.0 * 0.6 * np.arcsin(0.25 / 0.6), rel=1e-3)
    assert hem[:, 1].min() < -0.4 - 0.05 and neck[:, 1].min() == pytest.approx(-0.1 - 0.05, abs=1e-4)
    assert front.grain.tolist() == [0.0, 1.0]


def test_a_polygon_has_an_edge_from_corner_to_corner(tmp_path: Path) -> None:
    back = svg(tmp_path).panel("back")
    assert [len(edge) for edge in back.edges] == [2, 3, 2, 2]  # 18 degrees are no corner


@pytest.mark.parametrize(("size", "unit"), [("150cm", 1e-3), ("1500", 0.0254 / 96.0), ("60in", 60 * 0.0254 / 1500.0)])
def test_units_of_the_drawing(tmp_path: Path, size: str, unit: float) -> None:
    back = svg(tmp_path, size=size).panel("back")
    assert np.ptp(back.outline[:, 0]) == pytest.approx(500 * unit)


def test_the_side_file_sews_places_and_finishes(tmp_path: Path) -> None:
    more = """
[[panel]]
name = "back"
faces = "back"
position = [0.0, 1.2, -0.2]
mirrored = true

[[band]]
edge = ["front", 1]
width = 0.02
length_ratio = 0.9
"""
    drawn, pattern = svg(tmp_path), svg(tmp_path, seams=SEAMS + more)
    assert pattern.seams == (Seam(EdgeName("front", 2), EdgeName("back", 0)),)
    assert pattern.bands == (Band(EdgeName("front", 1), 0.02, 2.0, 0.9),)
    back, before = pattern.panel("back"), drawn.panel("back")
    assert signed_area(back.outline) == pytest.approx(signed_area(before.outline))
    np.testing.assert_allclose(back.edges[0], (before.edges[-1] * [-1.0, 1.0])[::-1])
    assert back.placement is not None and pattern.panel("front").placement is None
    where = back.placement.apply(back.outline)
    np.testing.assert_allclose((where.min(axis=0) + where.max(axis=0)) / 2.0, [0.0, 1.2, -0.2], atol=1e-12)
    np.testing.assert_allclose(back.placement.rotation[:, 2], [0.0, 0.0, -1.0], atol=1e-12)


def test_bad_side_files(tmp_path: Path) -> None:
    refuses("top.seams.toml: a drawing without its file of seams", svg, tmp_path, seams=None)
    bad = """
seams = [["front", 2, "back"], ["front", "2", "back", 0], ["front", 2, "bakc", 0]]
stitches = []
[[panel]]
name = "hood"
[[panel]]
name = "back"
faces = "up"
[[panel]]
name = "front"
faces = "left"
"""
    text = refuses("", svg, tmp_path, seams=bad)
    for words in (
        "seams[0]: no seam (received ['front', 2, 'back'], expected [panel, number, panel, number])",
        "seams[1]: bad value (received ['front', '2']",
        "stitches: unknown key",
        "panel[1].faces: bad value (received 'up', expected one of 'front', 'left', 'back', 'right')",
    ):
        assert words in text
    refuses("seam 0: no such panel .*did you mean 'back'", svg, tmp_path, seams='seams = [["front", 2, "bakc", 0]]')
    places = '[[panel]]\nname = "hood"\n[[panel]]\nname = "front"\nfaces = "left"\n'
    refuses(r"(?s)panel\[0\].name: no such panel.*panel\[1\]: half a place", svg, tmp_path, seams=SEAMS + places)


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        ('<path id="a" d="M 0 0 L 300 0 L 300 200 L 0 200"/>', "panel 'a': an open outline .*200 mm from the start"),
        ('<path id="a" d="M 0 0 L 300 200 L 300 0 L 0 250 Z"/>', "panel 'a', edges .*crosses or touches itself"),
        ('<path id="a" d="M 0 0 H 300 V 200 Z M 50 10 H 90 V 20 Z"/>', "panel 'a': a panel of several outlines"),
        (
            SHAPES + '<rect id="cuff" x="1100" y="300" width="200" height="50"/>',
            "'back' and 'cuff': panels that overlap",
        ),
        ("<text>no panel</text>", "a drawing without panels"),
        ("<path", "cannot be read"),
    ],
)
def test_bad_drawings(tmp_path: Path, shapes: str, message: str) -> None:
    assert "top.svg" in refuses(message, svg, tmp_path, shapes)


def test_a_drawing_in_the_wrong_unit(tmp_path: Path) -> None:
    refuses("a size that no garment has .*50 m", svg, tmp_path, size="15000cm")
    refuses("width: bad size .*'15furlong'", svg, tmp_path, size="15furlong")


def dxf(folder: Path, document: ezdxf.document.Drawing, seams: str = SEAMS) -> Pattern:
    document.saveas(folder / "top.dxf")
    (folder / "top.seams.toml").write_text(seams, encoding="utf-8")
    return load_pattern(folder / "top.dxf")


def plain(unit: InsertUnits = InsertUnits.Centimeters) -> ezdxf.document.Drawing:
    """A front as a polyline with a bulge, and a back of lines and an arc in any order and direction."""
    document = ezdxf.new()
    document.units = unit
    space = document.modelspace()
    front, back = {"layer": "front"}, {"layer": "back"}
    outline = [(0, 0), (50, 0), (50, 30, 0, 0, -0.3), (0, 30)]
    space.add_lwpolyline(outline, close=True, dxfattribs=front)
    space.add_line((60, 0), (100, 0), dxfattribs=back)
    space.add_arc((80, 30), 20, 0, 180, dxfattribs=back)
    space.add_line((60, 0), (60, 30), dxfattribs=back)
    space.add_line((100, 30), (100, 0), dxfattribs=back)
    return document


def test_a_plain_dxf_has_a_panel_on_each_layer(tmp_path: Path) -> None:
    pattern = dxf(tmp_path, plain())
    front, back = pattern.panel("front"), pattern.panel("back")
    assert [len(edge) > 2 for edge in front.edges] == [False, False, True, False]
    assert front.edges[2][:, 1].min() == pytest.approx(0.3 - 0.3 * 0.25, abs=1e-4)  # sagitta: bulge times half chord
    assert [round(edge_length(edge), 3) for edge in back.edges] == [0.4, 0.3, 0.628, 0.3]
    assert all(signed_area(panel.outline) > 0.0 for panel in pattern.panels)


def test_blocks_of_a_pattern_system_have_cut_line_turn_points_and_grain(tmp_path: Path) -> None:
    document = ezdxf.new()
    document.header["$INSUNITS"] = 0
    space = document.modelspace()
    space.add_text("UNITS: METRIC")
    for name, x in (("front", 0.0), ("back", 600.0)):
        block = document.blocks.new(name)
        outline = [(0, 0), (500, 0), (500, 300), (400, 330), (250, 340), (0, 300)]
        block.add_polyline2d(outline, close=True, dxfattribs={"layer": "1"})
        block.add_line((100, 100), (100, 200), dxfattribs={"layer": "8"})  # drawn on the piece, not cut
        block.add_line((100, 100), (200, 100), dxfattribs={"layer": "7"})
        for k in (0, 1, 2, 4, 5):
            block.add_point(outline[k], dxfattribs={"layer": "2"})
        space.add_blockref(name, (x, 0.0))
    front, back = dxf(tmp_path, document).panels
    assert (front.name, back.name) == ("front", "back")
    assert [len(edge) for edge in front.edges] == [2, 2, 3, 2, 2]
    assert front.grain.tolist() == [1.0, 0.0]
    np.testing.assert_allclose(back.outline, front.outline + [0.6, 0.0], atol=1e-12)
    assert np.ptp(front.outline[:, 0]) == pytest.approx(0.5)


def test_bad_dxf_drawings(tmp_path: Path) -> None:
    refuses(r"\$INSUNITS: a drawing without unit", dxf, tmp_path, plain(InsertUnits.Unitless))
    refuses("a size that no garment has .*50 m", dxf, tmp_path, plain(InsertUnits.Meters))
    gap = plain()
    gap.modelspace().add_line((0, 50), (10, 50), dxfattribs={"layer": "back"})
    refuses("panel 'back': an open outline", dxf, tmp_path, gap)
    (tmp_path / "no.dxf").write_text("no drawing", encoding="utf-8")
    refuses("no.dxf: cannot be read", load_pattern, tmp_path / "no.dxf")
