"""Self-contained HTML pages: text, pictures, tables and charts in one file that needs no network.

A page reads well in light and dark, on a screen and on paper; its charts are dark on white in each. HTML and style
sheet are the Jinja2 templates in the folder ``templates``, which escape every text but the SVG of a chart.
"""

from __future__ import annotations

import base64
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from pbd.errors import InputError
from pbd.storage import replacing
from precompute.reporting.cost_charts import Chart, Point, chart_svg, pareto_front
from runtime.draw.pictures import encode_image

__all__ = [
    "Chart", "Heading", "Picture", "Point", "Section", "Table", "Text",
    "render_page", "write_page",
]  # fmt: skip


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
    """A picture: uint8 (h, w, 3), stored as JPEG, or a PNG, JPEG or WebP file, stored as it is."""

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
    """Write :func:`render_page` to a file, which is never half-written.

    Args:
        path: the file.
        title, sections: as for :func:`render_page`, which says what is raised.
    """
    content = render_page(title, sections)
    with replacing(Path(path)) as beside:
        beside.write_text(content, encoding="utf-8")


def render_page(title: str, sections: Sequence[Section]) -> str:
    """One HTML document that holds everything it shows.

    Args:
        title: of the window and of the page.
        sections: the page's content, in order. All text in them is plain text, never HTML.

    Raises:
        InputError: a table's row has another length than its header, a picture is neither PNG nor JPEG, or a
            chart cannot be drawn.
    """
    prepared = [_prepared(section, f"chart{index}") for index, section in enumerate(sections)]
    return _environment().get_template("page.html").render(title=title, sections=prepared)


@cache
def _environment() -> jinja2.Environment:
    """The templates; none of them takes text for HTML, and a name that a template misspells is an error."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader("precompute.reporting"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def _prepared(section: Section, name: str) -> dict[str, Any]:
    """A section as its template reads it; ``name`` is the start of the page-wide names of its elements."""
    if isinstance(section, Heading):
        return {"template": "heading.html", "text": section.text}
    if isinstance(section, Text):
        return {"template": "text.html", "paragraphs": _paragraphs(section.text)}
    if isinstance(section, Picture):
        return {"template": "picture.html", "address": _data_address(section.image), "caption": section.caption}
    return _prepared_table(section) if isinstance(section, Table) else _prepared_chart(section, name)


def _paragraphs(text: str) -> list[str]:
    paragraphs = (" ".join(part.split()) for part in text.split("\n\n"))
    return [paragraph for paragraph in paragraphs if paragraph]


def _data_address(image: np.ndarray | str | os.PathLike[str]) -> str:
    """A picture as a ``data:`` address."""
    content = encode_image(image, "jpeg") if isinstance(image, np.ndarray) else Path(image).read_bytes()
    kinds = {b"\x89PNG\r\n\x1a\n": "png", b"\xff\xd8\xff": "jpeg", b"RIFF": "webp"}
    kind = next((kind for start, kind in kinds.items() if content.startswith(start)), None)
    if kind is None:
        raise InputError("not a picture that a page can hold", file=image, expected="a PNG, JPEG or WebP file")
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _prepared_table(table: Table) -> dict[str, Any]:
    for number, row in enumerate(table.rows):
        if len(row) != len(table.header):
            raise InputError(
                "a table's row does not fit its header",
                key=f"rows[{number}]",
                received=f"{len(row)} cells",
                expected=f"{len(table.header)} cells",
            )
    numeric = [all(_is_number(row[k]) for row in table.rows) for k in range(len(table.header))]
    return {
        "template": "table.html",
        "caption": table.caption,
        "header": list(zip(table.header, numeric, strict=True)),
        "rows": [list(zip(map(_cell, row), numeric, strict=True)) for row in table.rows],
    }


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, (int, float, np.number)) and not isinstance(value, bool))


def _cell(value: Any) -> str:
    """A value as short text; a dash where there is none."""
    value = value.item() if isinstance(value, np.generic) else value
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _prepared_chart(chart: Chart, name: str) -> dict[str, Any]:
    front, rows, titles = set(pareto_front(chart.points)), [], []
    for k, point in enumerate(chart.points):
        notes = [text for text, holds in (("quoted", point.quoted), ("on the Pareto front", k in front)) if holds]
        x, y = _cell(point.x), "none" if math.isinf(point.y) else _cell(point.y)
        title = f"{point.method}, {point.label}" if point.label not in ("", point.method) else point.method
        about = f"{title}: {chart.x_label} {x}, {chart.y_label} {y}"
        titles.append(f"{about} ({notes[0]})" if notes else about)
        rows.append({
            "method": point.method,
            "label": point.label,
            "notes": ", ".join(notes),
            "x": x,
            "y": y,
            "settings": [(key, _cell(value)) for key, value in point.settings.items()],
        })  # fmt: skip
    return {"template": "chart.html", "chart": chart, "svg": chart_svg(chart, name, titles), "rows": rows}
