"""Pages: complete, offline, readable; and charts that put every point where it belongs."""

from __future__ import annotations

import itertools
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from pbd.errors import InputError
from precompute.reporting.cost_charts import _COLORS, draw_charts, pareto_front
from precompute.reporting.html_page import Chart, Heading, Picture, Point, Table, Text, render_page, write_page
from runtime.draw.pictures import save_png

VOID = {"meta", "img"}
HOSTILE = "<script>alert(\"x\")</script> & <b onclick='y'>"


class Page(HTMLParser):
    """Elements as (tag, attributes) and the text outside styles; complains about tags that do not nest."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text, self.words, self.open = "", [], []
        self.feed(path.read_text(encoding="utf-8"))
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text += data
            self.words.append(data.strip())

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


def grid_of_points(**settings: object) -> list[Point]:
    return [
        Point(x, y, method, f"{method} {x:g}", {"substeps": x, **settings})
        for method, shift in (("ours", 0.0), ("middle mesh", 1.0))
        for x, y in ((1.0, 10.0 + shift), (10.0, 5.0 + shift), (100.0, 2.0 + shift))
    ]


def chart(points: list[Point] | None = None, **kwargs) -> Chart:
    return Chart(grid_of_points() if points is None else points, "frame time [ms]", "normal error [deg]", **kwargs)


def written(path: Path, *sections) -> Page:
    write_page(path, "A title", sections)
    return Page(path)


def places(page: Page) -> list[tuple[float, float]]:
    """Where the points of the page's first chart are drawn, in its units, downwards."""
    found = []
    for k, (tag, attributes) in enumerate(page.elements):
        if tag == "g" and (attributes.get("id") or "").startswith("chart0-p"):
            mark = next(attributes for tag, attributes in page.elements[k:] if tag == "use")
            found.append((float(mark["x"] or 0), float(mark["y"] or 0)))
    return found


def test_a_page_holds_all_it_shows_and_asks_for_nothing(tmp_path):
    image = np.random.default_rng(0).integers(0, 255, (20, 30, 3)).astype(np.uint8)
    save_png(tmp_path / "b.png", image)
    page = written(
        tmp_path / "a.html",
        Heading("Pictures"),
        Text("One.\n\nTwo\nlines."),
        Picture(image, "drawn"),
        Picture(tmp_path / "b.png", "read"),
        Table(["name", "value"], [["rmse_mm", 2.4]]),
        chart(floor=1.5, x_lines={"60 Hz": 16.7}),
    )
    content = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|//cdn|@import|url\((?!#)", content)
    for _, attributes in page.elements:
        for name in ("src", "href", "srcset", "data", "action"):
            assert (attributes.get(name) or "data:").startswith("data:")
    assert [a["src"].split(",")[0] for a in page.all("img")] == ["data:image/jpeg;base64", "data:image/png;base64"]  # type: ignore[union-attr]
    assert len(page.all("p")) == 2 and "Two lines." in page.text
    assert not page.all("link") and not page.all("script")
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a.html", "b.png"]


def test_every_text_is_escaped(tmp_path):
    points = [Point(1.0, 2.0, HOSTILE, HOSTILE, {HOSTILE: HOSTILE}), Point(2.0, 1.0, HOSTILE, HOSTILE, quoted=True)]
    points += [Point(3.0, 1.0, "$x$", "$y$")]  # no formulas
    hostile_chart = Chart(points, HOSTILE, HOSTILE, floor=1.0, y_lines={HOSTILE: 2.0}, caption=HOSTILE)
    table = Table([HOSTILE], [[HOSTILE]], HOSTILE)
    image = Picture(np.zeros((4, 4, 3), np.uint8), HOSTILE)
    write_page(tmp_path / "a.html", HOSTILE, [Heading(HOSTILE), Text(HOSTILE), image, table, hostile_chart])
    page = Page(tmp_path / "a.html")
    assert not page.all("script") and not page.all("b") and {"$x$", "$y$"} <= set(page.words)
    assert all(not name.startswith("on") for _, attributes in page.elements for name in attributes)
    assert page.text.count(HOSTILE) >= 25


def test_what_is_written_is_what_is_rendered(tmp_path):
    written(tmp_path / "a.html", chart(), Heading("x"))
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == render_page("A title", [chart(), Heading("x")])


def test_every_point_is_drawn_listed_and_linked(tmp_path):
    points = [*grid_of_points(seed=3, fabric="gray-interlock"), Point(3.0, 4.0, "a paper", "table 2", quoted=True)]
    page = written(tmp_path / "a.html", chart(points), chart(points[:2]))
    titles = re.findall(r'<g id="(chart\d-p\d)"><title>([^<]+)<', (tmp_path / "a.html").read_text(encoding="utf-8"))
    assert [name for name, _ in titles] == [f"chart0-p{k}" for k in range(7)] + ["chart1-p0", "chart1-p1"]
    for (_, title), point in zip(titles, points, strict=False):
        assert f"{point.method}, {point.label}: frame time [ms] {point.x:g}, normal error [deg] {point.y:g}" in title
        assert title.endswith("(quoted)") == point.quoted
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(set(ids)) == len(ids)
    assert page.text.count("gray-interlock") == 6 + 2
    assert "table 2" in page.words and "hollow: quoted from elsewhere, not measured here" in page.words


def drawn(one: Chart):
    """The axes of a chart, laid out."""
    figure = draw_charts({"": one}, 8.0, 5.0)
    figure.draw_without_rendering()
    return figure.axes[0]


def test_methods_differ_in_marker_or_color_and_the_legend_says_which():
    points = [Point(float(k), 1.0, f"method {k}", quoted=k == 20) for k in range(1, 21)]
    axes = drawn(chart(points))
    looks = [(line.get_marker(), line.get_color(), line.get_markerfacecolor()) for line in axes.lines]
    assert len(set(looks[:20])) == 20 and looks[19][2] == "white"
    assert looks[20:40] == looks[:20]
    assert [text.get_text() for text in axes.figure.legends[0].get_texts()][:20] == [p.method for p in points]


def test_colors_of_points_leave_methods_to_their_markers():
    points = [Point(1.0, 1.0, "a", color="#00764f"), Point(2.0, 1.0, "a", color="#b81f3c"), Point(3.0, 1.0, "b")]
    lines = drawn(chart(points, colors={"#00764f": "good", "#b81f3c": "bad"})).lines
    assert [line.get_color() for line in lines[:2]] == ["#00764f", "#b81f3c"]
    assert lines[0].get_marker() == lines[1].get_marker() != lines[2].get_marker()
    keys = {line.get_label(): (line.get_marker(), line.get_color()) for line in lines[3:]}
    assert keys["a"] == (lines[0].get_marker(), keys["b"][1]) and keys["bad"][1] == "#b81f3c"


def test_cost_keeps_ratios_and_a_linear_error_starts_at_zero(tmp_path):
    spots = places(written(tmp_path / "a.html", chart()))
    x, y = np.array(spots[:3]).T
    assert x[1] - x[0] == pytest.approx(x[2] - x[1], abs=0.2) and x[1] > x[0]
    assert (y[1] - y[0]) / (y[2] - y[1]) == pytest.approx((10 - 5) / (5 - 2), abs=0.01) and y[1] > y[0]  # down is less
    assert drawn(chart()).get_ylim()[0] == 0.0


def test_a_point_without_an_error_stands_at_the_upper_border(tmp_path):
    points = [*grid_of_points(), Point(0.5, np.inf, "ours", "ended")]
    page = written(tmp_path / "a.html", chart(points, log_y=True))
    *_, (x, y) = spots = places(page)
    assert x == min(spots)[0] and y < min(y for _, y in spots[:-1]) - 5.0
    assert "none" in page.words and pareto_front(points) == pareto_front(points[:-1])


@pytest.mark.parametrize(
    ("log", "values"),
    [(False, [0.2, 7.0]), (False, [3e-5, 4e-5]), (True, [4e-3, 900.0]), (True, [3.0, 3.0]), (False, [0.0, 0.0])],
)
def test_an_axis_has_a_few_round_ticks(log, values):
    axes = drawn(chart([Point(1.0 + k, value, "m") for k, value in enumerate(values)], log_y=log))
    low, high = axes.get_ylim()
    ticks = [text.get_text() for text in axes.get_yticklabels() if low <= text.get_position()[1] <= high]
    assert 2 <= len(ticks) <= 10
    assert all(1 <= len(tick) <= 7 for tick in ticks)
    assert not any(text.get_text() for text in axes.get_yticklabels(minor=True))


@pytest.mark.parametrize("log", [False, True])
def test_a_floor_starts_at_zero_and_is_below_the_points(log):
    axes = drawn(chart(log_y=log, floor=1.5))
    (band,) = axes.patches
    box = band.get_window_extent()
    assert box.y0 <= axes.bbox.y0 and axes.bbox.y0 + 5.0 < box.y1
    points = [axes.transData.transform((p.x, p.y))[1] for p in grid_of_points()]
    assert box.y1 < min(points) and max(points) < axes.bbox.y1


def test_lines_stand_at_their_values():
    lines = {line.get_label(): line for line in drawn(chart(x_lines={"60 Hz": 16.7}, y_lines={"limit": 20.0})).lines}
    assert list(lines["60 Hz"].get_xdata()) == [16.7, 16.7] and list(lines["limit"].get_ydata()) == [20.0, 20.0]
    assert lines["limit"].axes.get_ylim()[1] > 20.0


def test_the_front_is_what_no_other_point_beats():
    rng = np.random.default_rng(2)
    for _ in range(50):
        points = [
            Point(float(x), float(y), "m", quoted=bool(q)) for x, y, q in rng.integers(0, 6, (12, 3)) // [1, 1, 4]
        ]
        measured = [p for p in points if not p.quoted]
        cost_table = [points[k] for k in pareto_front(points)]
        unbeaten = {
            (p.x, p.y)
            for p in measured
            if not any(o.x <= p.x and o.y <= p.y and (o.x, o.y) != (p.x, p.y) for o in measured)
        }
        assert {(p.x, p.y) for p in cost_table} == unbeaten and len(cost_table) == len(unbeaten)


def test_labels_hide_neither_each_other_nor_points(tmp_path):
    rng = np.random.default_rng(7)
    points = [Point(float(x), float(y), "m", f"a point {k}") for k, (x, y) in enumerate(rng.random((40, 2)))]
    page = written(tmp_path / "a.html", chart(points))
    content, boxes = (tmp_path / "a.html").read_text(encoding="utf-8"), []
    label = r'<text style="font-size: 8px[^"]*text-anchor: (\w+)" x="([\d.]+)" y="([\d.]+)"[^>]*>a point \d+<'
    for anchor, x, y in re.findall(label, content):
        width = 0.5 * 8.0 * len("a point 1")
        left = float(x) - {"start": 0, "middle": width / 2, "end": width}[anchor]
        boxes.append((left, float(y) - 5.5, left + width, float(y)))
    boxes += [(x - 3, y - 3, x + 3, y + 3) for x, y in places(page)]
    labels = len(boxes) - 40
    assert labels >= 15
    for k, other in itertools.combinations(range(len(boxes)), 2):
        if k < labels:
            a, b = boxes[k], boxes[other]
            assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]


def luminance(color: str) -> float:
    channels = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_colors_stand_out_in_light_and_dark(tmp_path):
    written(tmp_path / "a.html", Text("x"))
    content = (tmp_path / "a.html").read_text(encoding="utf-8")
    themes = [dict(re.findall(r"--(\w+): (#\w{6});", part)) for part in content.split("color-scheme")[1:]]
    dark = dict(re.findall(r"--(\w+): (#\w{6});", content.split("prefers-color-scheme: dark")[1].split("}")[0]))
    assert len(dark) == 4
    assert all(1.05 / (luminance(color) + 0.05) >= 4.5 for color in _COLORS)  # a chart is on white in every theme
    for theme in (themes[0], dark, themes[-1]):
        paper = luminance(theme["paper"])
        for name, color in theme.items():
            if name in ("ink", "soft"):
                high, low = sorted((luminance(color), paper), reverse=True)
                assert (high + 0.05) / (low + 0.05) >= 4.5, name


@pytest.mark.parametrize(
    ("section", "message"),
    [
        (Table(["a", "b"], [[1, 2], [1]]), r"rows\[1\].*1 cells"),
        (chart([]), "at least one point"),
        (chart([Point(0.0, 1.0, "ours", "x0")]), "x of 'x0'.*positive"),
        (chart([Point(1.0, 0.0, "ours", "y0")], log_y=True), "y of 'y0'.*positive"),
        (chart([Point(1.0, -1.0, "ours")]), "y of 'ours'.*not negative"),
        (chart([Point(1.0, float("nan"), "ours")]), "y of 'ours'.*nan"),
        (chart(x_lines={"budget": float("inf")}), "x of 'budget'.*inf"),
    ],
)
def test_bad_sections_are_refused_and_leave_the_old_page(tmp_path, section, message):
    path = tmp_path / "a.html"
    path.write_text("old")
    with pytest.raises(InputError, match=message):
        write_page(path, "t", [section])
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_a_file_that_is_no_picture_is_refused(tmp_path):
    (tmp_path / "x.png").write_bytes(b"GIF89a")
    with pytest.raises(InputError, match=r"x\.png.*PNG, JPEG or WebP"):
        write_page(tmp_path / "a.html", "t", [Picture(tmp_path / "x.png", "c")])


def test_figures_are_shown_plainly(tmp_path):
    rows = [["a", np.float32(1.23456789), True], ["b", None, False], ["c", float("nan"), False]]
    page = written(tmp_path / "a.html", Table(["name", "value", "holds"], rows))
    assert "1.2346" in page.words and page.words.count("–") == 2 and page.words.count("no") == 2
    assert [a.get("class") for a in page.all("th")] == [None, "number", None]


def test_a_page_is_the_same_every_time(tmp_path):
    for name in ("a", "b"):
        write_page(tmp_path / f"{name}.html", "t", [chart(), Text("x")])
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
