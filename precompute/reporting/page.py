"""Self-contained HTML pages: text, pictures, tables and charts in one file that needs no network.

A page reads well without its script, in light and dark, on a screen and on paper. The script only adds what a pointer
can ask of a chart: a tooltip, and the settings of the point that is selected.
"""

from __future__ import annotations

import base64
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from pbd.errors import InputError
from pbd.storage import replacing
from precompute.reporting.scatter import COLOR_COUNT, Band, Chart, Line, Point, pareto_front, show, svg, swatch
from runtime.pictures import encode_image

__all__ = ["Band", "Chart", "Heading", "Line", "Picture", "Point", "Section", "Table", "Text", "write_page"]


@dataclass(frozen=True)
class Heading:
    """A heading inside the page."""

    text: str


@dataclass(frozen=True)
class Text:
    """Paragraphs of plain text, parted by empty lines."""

    text: str


@dataclass(frozen=True)
class Picture:
    """A picture: uint8 (h, w, 3), stored as JPEG, or a PNG or JPEG file, stored as it is."""

    image: np.ndarray | str | os.PathLike[str]
    caption: str


@dataclass(frozen=True)
class Table:
    """Rows of figures. Numbers are set to the right; a float is shown to five digits."""

    header: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""


Section = Heading | Text | Picture | Table | Chart


def write_page(path: str | os.PathLike[str], title: str, sections: Sequence[Section]) -> None:
    """Write one HTML file that holds everything it shows; it is never half-written.

    Args:
        path: the file.
        title: of the window and of the page.
        sections: what stands on the page, in order. All text in them is plain text, never HTML.

    Raises:
        InputError: a table's row has another length than its header, a picture is neither PNG nor JPEG, or a chart
            cannot be drawn.
    """
    body = "\n".join(_section(section, index) for index, section in enumerate(sections))
    content = _PAGE.format(title=escape(title), style=_STYLE, body=body, script=_SCRIPT)
    with replacing(Path(path)) as beside:
        beside.write_text(content, encoding="utf-8")


def _section(section: Section, index: int) -> str:
    if isinstance(section, Heading):
        return f"<h2>{escape(section.text)}</h2>"
    if isinstance(section, Text):
        paragraphs = (" ".join(part.split()) for part in section.text.split("\n\n"))
        return "\n".join(f"<p>{escape(paragraph)}</p>" for paragraph in paragraphs if paragraph)
    if isinstance(section, Picture):
        caption = escape(section.caption)
        return f'<figure><img src="{_data_address(section.image)}" alt="{caption}">{_caption(section.caption)}</figure>'
    if isinstance(section, Table):
        return _table(section)
    return _chart(section, f"chart{index}")


def _caption(text: str) -> str:
    return f"<figcaption>{escape(text)}</figcaption>" if text else ""


def _data_address(image: np.ndarray | str | os.PathLike[str]) -> str:
    """A picture as a ``data:`` address."""
    content = encode_image(image, "jpeg") if isinstance(image, np.ndarray) else Path(image).read_bytes()
    kinds = {b"\x89PNG\r\n\x1a\n": "png", b"\xff\xd8\xff": "jpeg"}
    kind = next((kind for start, kind in kinds.items() if content.startswith(start)), None)
    if kind is None:
        raise InputError("not a picture that a page can hold", file=image, expected="a PNG or JPEG file")
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _table(table: Table) -> str:
    for number, row in enumerate(table.rows):
        if len(row) != len(table.header):
            raise InputError(
                "a table's row does not fit its header",
                key=f"rows[{number}]",
                received=f"{len(row)} cells",
                expected=f"{len(table.header)} cells",
            )
    numeric = [all(_is_number(row[k]) for row in table.rows) for k in range(len(table.header))]
    kinds = [' class="number"' if flag else "" for flag in numeric]
    head = "".join(f"<th{kind}>{escape(name)}</th>" for name, kind in zip(table.header, kinds, strict=True))
    rows = "\n".join(
        "<tr>"
        + "".join(f"<td{kind}>{escape(_cell(value))}</td>" for value, kind in zip(row, kinds, strict=True))
        + "</tr>"
        for row in table.rows
    )
    caption = f"<caption>{escape(table.caption)}</caption>" if table.caption else ""
    return f'<div class="wide"><table>{caption}<thead><tr>{head}</tr></thead><tbody>\n{rows}\n</tbody></table></div>'


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, (int, float, np.number)) and not isinstance(value, bool))


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, (float, np.floating)) and math.isnan(value)):
        return "–"
    return show(value.item() if isinstance(value, np.generic) else value)


def _chart(chart: Chart, name: str) -> str:
    drawing = svg(chart, name)
    plain = COLOR_COUNT - 1 if chart.colors else None  # where colours mean something else, methods have none
    keys = [
        f'<li class="method" data-method="{escape(method)}">'
        f"{swatch(k, all(p.quoted for p in chart.points if p.method == method), plain)}{escape(method)}</li>"
        for k, method in enumerate(chart.methods())
    ]
    keys += [f"<li>{swatch(0, color=color)}{escape(words)}</li>" for color, words in chart.colors.items()]
    keys.append(f"<li>{_FRONT_SWATCH}best of what was measured here</li>")
    if any(point.quoted for point in chart.points):
        keys.append("<li>hollow: quoted from elsewhere, not measured here</li>")
    front = set(pareto_front(chart.points))
    rows = "\n".join(_point_row(chart, k, f"{name}-p{k}", k in front) for k in range(len(chart.points)))
    head = "".join(f"<th>{escape(text)}</th>" for text in ("method", "point", chart.x_label, chart.y_label, "settings"))
    return f"""<figure class="chart">
<ul class="legend">{"".join(keys)}</ul>
<div class="stage">{drawing}<div class="tip" hidden></div></div>
<div class="panel" aria-live="polite" hidden>Select a point to see its settings.</div>
{_caption(chart.caption)}
<details><summary>All {len(chart.points)} points and their settings</summary>
<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>
{rows}
</tbody></table></div></details>
</figure>"""


def _point_row(chart: Chart, k: int, name: str, on_front: bool) -> str:
    point = chart.points[k]
    notes = [text for text, holds in (("quoted", point.quoted), ("on the front", on_front)) if holds]
    label = escape(point.label) + (f" <em>({', '.join(notes)})</em>" if notes else "")
    settings = "".join(
        f"<dt>{escape(str(key))}</dt><dd>{escape(_cell(value))}</dd>" for key, value in point.settings.items()
    )
    return (
        f'<tr id="{name}"><td>{escape(point.method)}</td><td>{label}</td><td class="number">{_cell(point.x)}</td>'
        f'<td class="number">{_cell(None if point.off_scale else point.y)}</td><td><dl>{settings}</dl></td></tr>'
    )


_FRONT_SWATCH = '<svg class="swatch" viewBox="-9 -9 18 18" aria-hidden="true"><path class="front" d="M-9 0H9"/></svg>'

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'; \
script-src 'unsafe-inline'">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main>
<h1>{title}</h1>
{body}
</main>
<script>{script}</script>
</body>
</html>
"""

_LIGHT = """
--paper: #ffffff; --ink: #1c1c20; --soft: #5c5c66; --rule: #dcdce2; --band: #d9d9e0; --raised: #f4f4f7;
--m0: #0067a8; --m1: #c24a00; --m2: #00764f; --m3: #a83e85; --m4: #7d5c00; --m5: #5847c0; --m6: #b81f3c; --m7: #4d5560;
"""
_DARK = """
--paper: #17171a; --ink: #ececf0; --soft: #a9a9b4; --rule: #34343c; --band: #35353f; --raised: #212126;
--m0: #5cb5ec; --m1: #ff8f45; --m2: #35c795; --m3: #e88fc6; --m4: #dcb02e; --m5: #a99cff; --m6: #ff7d8c; --m7: #b4bcc8;
"""
_STYLE = f"""
:root {{ color-scheme: light dark; {_LIGHT} }}
@media (prefers-color-scheme: dark) {{ :root {{ {_DARK} }} }}
""" + """
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.55 system-ui, sans-serif; }
main { max-width: 960px; margin: 0 auto; padding: 2rem 1.2rem 4rem; }
h1 { font-size: 1.8rem; line-height: 1.25; } h2 { font-size: 1.3rem; margin-top: 2.4rem; }
p { max-width: 44rem; }
figure { margin: 1.8rem 0; } img { display: block; max-width: 100%; height: auto; }
figcaption, caption { color: var(--soft); font-size: 0.9rem; text-align: left; padding: 0.5rem 0; max-width: 44rem; }
.wide { overflow-x: auto; margin: 1.2rem 0; }
table { border-collapse: collapse; font-size: 0.92rem; }
th, td { text-align: left; vertical-align: top; padding: 0.3rem 0.8rem 0.3rem 0; border-bottom: 1px solid var(--rule); }
th { color: var(--soft); font-weight: 600; } .number { text-align: right; font-variant-numeric: tabular-nums; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 0 0.8rem; margin: 0; }
dt { color: var(--soft); } dd { margin: 0; overflow-wrap: anywhere; }
summary { cursor: pointer; color: var(--soft); font-size: 0.9rem; }
.legend { display: flex; flex-wrap: wrap; gap: 0.2rem 1.3rem; margin: 0; padding: 0; font-size: 0.9rem; }
.legend li { display: flex; align-items: center; } .swatch { width: 18px; height: 18px; margin-right: 0.4rem; }
.stage { position: relative; } .plot { display: block; width: 100%; height: auto; font-size: 13px; }
text { fill: var(--ink); } .tick, .note { fill: var(--soft); font-size: 12px; } .label { font-size: 12px; }
.label, .note { paint-order: stroke; stroke: var(--paper); stroke-width: 3px; stroke-linejoin: round; }
.grid { stroke: var(--rule); } .axis { stroke: var(--soft); fill: none; } .band { fill: var(--band); opacity: 0.7; }
.front { fill: none; stroke: var(--ink); stroke-width: 1.5; stroke-dasharray: 5 3; opacity: 0.7; }
.mark { stroke: var(--soft); stroke-width: 1.5; stroke-dasharray: 2 3; }
.marker { fill: currentColor; stroke: var(--paper); stroke-width: 1; }
.marker.hollow { fill: var(--paper); stroke: currentColor; stroke-width: 2.2; }
.method[role] { cursor: pointer; } .method.chosen { font-weight: 700; } .point.dim { opacity: 0.12; }
.touch { fill: transparent; } .point { cursor: pointer; outline: none; }
.point:hover .touch, .point:focus .touch, .point.selected .touch { fill: currentColor; opacity: 0.18; }
.tip, .panel { background: var(--raised); border: 1px solid var(--rule); border-radius: 4px; font-size: 0.88rem; }
.tip { position: absolute; padding: 0.25rem 0.5rem; pointer-events: none; max-width: 20rem; }
.panel { padding: 0.7rem 0.9rem; margin: 0.6rem 0; } .panel strong { display: block; margin-bottom: 0.3rem; }
""" + "".join(f".m{k} {{ color: var(--m{k}); }}\n" for k in range(COLOR_COUNT)) + f"""
@media print {{
:root {{ color-scheme: light; {_LIGHT} }}
main {{ max-width: none; padding: 0; }} .tip, .panel {{ display: none; }}
h2 {{ break-after: avoid; }}
figure, table {{ break-inside: avoid; }} * {{ print-color-adjust: exact; -webkit-print-color-adjust: exact; }}
}}
"""  # fmt: skip

_SCRIPT = """
for (const chart of document.querySelectorAll("figure.chart")) {
  const stage = chart.querySelector(".stage"), tip = chart.querySelector(".tip"), panel = chart.querySelector(".panel");
  panel.hidden = false;
  const showTip = (point) => {
    tip.textContent = point.getAttribute("aria-label");
    tip.hidden = false;
    const around = stage.getBoundingClientRect(), at = point.querySelector(".marker").getBoundingClientRect();
    const left = at.left - around.left + at.width / 2 - tip.offsetWidth / 2;
    tip.style.left = Math.max(0, Math.min(left, around.width - tip.offsetWidth)) + "px";
    const above = at.top - around.top - tip.offsetHeight - 8;
    tip.style.top = (above >= 0 ? above : at.bottom - around.top + 8) + "px";
  };
  const select = (point) => {
    for (const other of chart.querySelectorAll(".point.selected")) other.classList.remove("selected");
    point.classList.add("selected");
    const title = document.createElement("strong");
    title.textContent = point.getAttribute("aria-label");
    panel.replaceChildren(title, document.getElementById(point.dataset.row).querySelector("dl").cloneNode(true));
  };
  for (const key of chart.querySelectorAll(".legend .method")) {
    key.setAttribute("role", "button");
    key.tabIndex = 0;
    const choose = () => {
      const off = key.classList.contains("chosen");
      for (const other of chart.querySelectorAll(".legend .method")) other.classList.remove("chosen");
      if (!off) key.classList.add("chosen");
      for (const point of chart.querySelectorAll(".point"))
        point.classList.toggle("dim", !off && point.dataset.method !== key.dataset.method);
    };
    key.addEventListener("click", choose);
    key.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); choose(); }
    });
  }
  for (const point of chart.querySelectorAll(".point")) {
    point.querySelector("title").remove();
    point.addEventListener("pointerenter", () => showTip(point));
    point.addEventListener("pointerleave", () => { tip.hidden = true; });
    point.addEventListener("focus", () => showTip(point));
    point.addEventListener("blur", () => { tip.hidden = true; });
    point.addEventListener("click", () => select(point));
    point.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); select(point); }
    });
  }
}
"""
