"""SVG drawings of other programs: sizes, hidden layers, clones, styles and names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from assets.patterns.pattern import Panel
from assets.patterns.pattern_checks import check_pattern
from assets.patterns.svg import read_svg
from pbd.errors import InputError
from tests.assets.patterns.shapes import pattern
from tests.refusals import refuses

FRONT = '<path id="front" d="M 20 20 H 520 V 720 H 20 Z"/>'
BACK = '<path id="back" d="M 600 20 H 1100 V 720 H 600 Z"/>'
PAGE = 'width="1200mm" height="800mm" viewBox="0 0 1200 800"'
XLINK = 'xmlns:xlink="http://www.w3.org/1999/xlink"'


def read(folder: Path, shapes: str, page: str = PAGE) -> tuple[Panel, ...]:
    file = folder / "dress.svg"
    file.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {XLINK} {page}>{shapes}</svg>', encoding="utf-8")
    return read_svg(file)


def names(folder: Path, shapes: str) -> list[str]:
    return sorted(panel.name for panel in read(folder, shapes))


@pytest.mark.parametrize(
    ("page", "width"),
    [
        ('width="1200MM" height="800MM" viewBox="0 0 1200 800"', 0.5),
        ('width="4800Q" height="3200q" viewBox="0 0 1200 800"', 0.5),
        ('width="120Cm" viewBox="0 0 1200 800"', 0.5),
        ('height="72IN" viewBox="0 0 1200 800"', 500 * 72 * 0.0254 / 800),
        ('width="100pc" viewBox="0 0 1200 800"', 500 * 100 * 0.0254 / 6 / 1200),
        ('style="width: 1200mm; height: 800mm" viewBox="0 0 1200 800"', 0.5),
        ('width="100%" height="100%" style="width:1200mm" viewBox="0 0 1200 800"', 0.5),
        ('width="1200mm" height="800mm" style="width:100%" viewBox="0 0 1200 800"', 0.5),
        ('width="1200mm" height="100%" viewBox="0 0 1200 800"', 0.5),
        ('width="1200mm" height="800mm"', 500 * 0.0254 / 96),
        ('width="1200mm" height="400mm" viewBox="0 0 1200 800"', 0.25),
        ('width="1200mm" height="400mm" viewBox="0 0 1200 800" preserveAspectRatio="xMidYMid slice"', 0.5),
    ],
)
def test_a_size_in_a_known_unit(tmp_path: Path, page: str, width: float) -> None:
    (front,) = read(tmp_path, FRONT, page)
    np.testing.assert_allclose(np.ptp(front.outline, axis=0), [width, 1.4 * width])


@pytest.mark.parametrize(
    "size", ['width="100%" height="100%"', "", 'width="auto"', 'style="width:100%"', 'width="50%"']
)
@pytest.mark.parametrize("box", ['viewBox="0 0 1200 800"', ""])
def test_a_drawing_without_unit_is_refused(tmp_path: Path, size: str, box: str) -> None:
    with pytest.raises(InputError, match=r"dress\.svg: width: a drawing without unit .*in mm, cm, Q, in, pt, pc or px"):
        read(tmp_path, FRONT, f"{size} {box}")


LINE = '<line id="front.grain" x1="50" y1="50" x2="50" y2="90"/>'


@pytest.mark.parametrize(
    ("drawn", "page", "message"),
    [
        ("", 'width="40em" viewBox="0 0 1200 800"', "width: bad size .*'40em'"),
        ("", 'width="-3mm" viewBox="0 0 1200 800"', "width: bad size .*'-3mm'"),
        ("", 'width="1200mm" viewBox="0 0 1200"', "viewBox: bad viewBox .*four numbers"),
        (
            "",
            'width="1200mm" height="400mm" viewBox="0 0 1200 800" preserveAspectRatio="none"',
            "preserveAspectRatio: a stretched drawing",
        ),
        (LINE.replace("front", "frnt"), PAGE, "'frnt.grain': a grain line without its panel"),
        (2 * LINE, PAGE, "'front.grain': the same name twice"),
        (LINE.replace('"90"', '"50"'), PAGE, "'front.grain': .* ends where it starts"),
        ('<use id="back" xlink:href="#front" x="580"/>', PAGE, "use 'back': a clone, which is not read .*'#front'"),
        ('<use href="other.svg#back"/>', PAGE, "use: a clone, which is not read"),
        (f'<a href="x">{BACK}</a>', PAGE, "path 'back': a shape that is not read .*'in a'"),
        (f"<switch><g>{BACK}</g></switch>", PAGE, "path 'back': a shape that is not read .*'in switch'"),
        (f'<svg x="5">{BACK}</svg>', PAGE, "path 'back': a shape that is not read .*'in svg'"),
        (f'<g style="transform:scale(2)">{BACK}</g>', PAGE, r"g: a style that changes an outline .*scale\(2\)"),
        (
            BACK.replace("/>", ' transform="rotate(9)" transform-origin="center"/>'),
            PAGE,
            "'back': a style that changes",
        ),
        (f"<style>path{{d:path('M0 0')}}</style>{BACK}", PAGE, "path 'back': a style that changes an outline"),
        (f"<style>g > .a {{display:none}}</style>{BACK}", PAGE, "style 'g > .a': a rule that is not read"),
        (f"<style>@media print {{.a {{display:none}}}}</style>{BACK}", PAGE, "a rule that is not read"),
        (f'<g clip-path="url(#x)">{BACK}</g>', PAGE, r"g: a clip that may cut outlines off .*url\(#x\)"),
        (f"<style>.c {{clip-path: url('#c')}}</style><g class='c'>{BACK}</g>", PAGE, "a clip that may cut"),
        (BACK.replace("/>", ' style="mask:url(#m)"/>'), PAGE, "path 'back': a clip that may cut"),
        (BACK.replace("/>", ' transform="rotate(9"/>'), PAGE, "cannot be read: Invalid SVG transform"),
    ],
)
def test_what_is_drawn_and_not_read_is_refused(tmp_path: Path, drawn: str, page: str, message: str) -> None:
    refuses(message, read, tmp_path, FRONT + drawn, page)


def test_two_shapes_of_one_name_are_both_there_and_refused(tmp_path: Path) -> None:
    panels = read(tmp_path, FRONT + BACK.replace("back", "front"))
    assert [panel.name for panel in panels] == ["front", "front"]
    refuses("panel 'front': the same name twice", check_pattern, pattern(*panels))


@pytest.mark.parametrize(
    "hidden",
    [
        f'<g style="display:none"><g>{BACK}</g></g>',
        f'<g display="none">{BACK}</g>',
        f'<g style="fill:none; DISPLAY : None !important">{BACK}</g>',
        f'<g visibility="hidden">{BACK}</g>',
        BACK.replace("/>", ' style="visibility:collapse"/>'),
        f'<style>/* a */ .st0{{display:none;}} .st1{{fill:#fff}}</style><g class="st1 st0">{BACK}</g>',
        f"<style>#back, .x {{ visibility: hidden }}</style>{BACK}",
        f"<defs>{BACK}</defs>",
        f'<symbol id="s">{BACK}</symbol>',
        f'<clipPath id="c">{BACK}</clipPath>',
        f'<g style="display:none">{BACK}<use xlink:href="#back"/></g>',
        f'<g style="display:none"><a>{BACK}</a></g>',
    ],
)
def test_what_is_hidden_is_left_out(tmp_path: Path, hidden: str) -> None:
    assert names(tmp_path, FRONT + hidden) == ["front"]


@pytest.mark.parametrize(
    "shown",
    [
        f'<g display="none" style="display:inline">{BACK}</g>',
        f'<g visibility="hidden">{BACK.replace("/>", " visibility=" + chr(34) + "visible" + chr(34) + "/>")}</g>',
        f'<style>.st0{{display:none}} @media print {{ p {{ color: red }} }}</style><g class="st00">{BACK}</g>',
        f'{BACK}<defs><text id="t">notch</text></defs><use href="#t"/>',
        f'<clipPath id="Page"><rect width="3000" height="3000"/></clipPath><g clip-path="url(#Page)">{BACK}</g>',
        f'<g clip-path="none" style="mask: none">{BACK}</g>',
        f'<g clip-path="url(#x)"><text>notch</text></g>{BACK}',
    ],
)
def test_what_is_shown_is_read(tmp_path: Path, shown: str) -> None:
    assert names(tmp_path, FRONT + shown) == ["back", "front"]


def test_a_closed_curve_of_one_piece_is_part_of_the_outline(tmp_path: Path) -> None:
    """A teardrop: it starts and ends in one point, and is no point."""
    (drop,) = read(tmp_path, '<path id="drop" d="M 300 600 C 0 100 600 100 300 600"/>')
    np.testing.assert_allclose(drop.outline[:, 1].max() - drop.outline[:, 1].min(), 0.375, rtol=1e-3)
