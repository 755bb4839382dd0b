"""Pages of the site that are made from the code and from files that commands wrote, as Markdown."""

from __future__ import annotations

import argparse
import csv
import inspect
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

import gube
from assets.io import body_settings, collider_settings
from assets.io import scene as scene_module
from assets.io.scene import Scene
from assets.io.view_settings import ViewSettings
from pbd import Fabric, SolverOptions
from precompute.failures.stress import QUOTED
from runtime.cli.command import COMMANDS, parser
from wrinkles.schema import ENTRIES, FORMAT, SCHEMA_VERSION

__all__ = ["FILMS", "GENERATED", "ROOT"]

ROOT = Path(__file__).resolve().parent.parent.parent
VALIDATION = ROOT / "out" / "validate.json"
FILMS = ROOT / "out" / "gallery" / "gallery.json"
# Tables of a scene file by their heading there, and the class that declares each.
TABLES = {
    "[[garment]]": scene_module.GarmentSettings,
    "[garment.fabric]": Fabric,
    "[character]": body_settings.CharacterSettings,
    "[training]": scene_module.TrainingSettings,
    "[[training.clips]], [[training.held_out]] and [character.motion]": body_settings.MotionSettings,
    '[[collider]] of type "plane"': collider_settings.PlaneSettings,
    '[[collider]] of type "sphere"': collider_settings.SphereSettings,
    '[[collider]] of type "capsule"': collider_settings.CapsuleSettings,
    '[[collider]] of type "field"': collider_settings.FieldSettings,
    "[wind]": scene_module.WindSettings,
    "[solver]": scene_module.SolverSettings,
    "[wrinkles]": scene_module.WrinkleSettings,
    "[camera]": scene_module.CameraSettings,
    "[view]": ViewSettings,
}


def scene_keys() -> str:
    """Every key of a scene file, from the classes that declare them."""
    lines = [
        "# Every key of a scene file",
        "",
        "Made from the declarations that read it. See [scene files](scenes.md).",
    ]
    known = {key for one in fields(Scene) for key in (one.metadata.get("key") or one.name,)}
    assert known == {re.split(r"[.\]]", heading.strip("["))[0] for heading in TABLES}, "a table of the scene is missing"
    for heading, kind in TABLES.items():
        summary = (inspect.getdoc(kind) or "").split("\n\n")[0].replace("``", "`")
        lines += ["", f"## {heading}", "", summary, "", "| key | accepted | default | meaning |", "|---|---|---|---|"]
        meanings = attribute_texts(kind)
        if kind is scene_module.SolverSettings:  # which has the options of the solver under the same names
            meanings = attribute_texts(SolverOptions) | meanings
        for one in fields(kind):
            check = one.metadata.get("check")
            unit = f" [{check.unit}]" if check and check.unit else ""
            cells = (
                f"`{one.metadata.get('key') or one.name}`",
                (check.expected if check else "a number") + unit,
                _default(one.default),
                _without_roles(meanings.get(one.name, "")),
            )
            lines.append("| " + " | ".join(_cell(cell) for cell in cells) + " |")
    lines += ["", "Presets of fabrics are on [a page of their own](fabrics.md)."]
    return "\n".join(lines) + "\n"


def attribute_texts(kind: type) -> dict[str, str]:
    """What the section "Attributes" of a class's docstring says of each; nothing for a class without one.

    Args:
        kind: a class with a docstring in Google's style.
    """
    text = inspect.getdoc(kind) or ""
    _, found, section = text.partition("Attributes:\n")
    if not found:
        return {}
    texts: dict[str, str] = {}
    for entry in re.split(r"\n(?=    \S)", "\n" + section.split("\n\n")[0]):
        names, _, words = entry.strip().partition(": ")
        texts |= {name.strip(): " ".join(words.split()) for name in names.split(",")}
    return {name: words for name, words in texts.items() if name}


def options_page() -> str:
    """Every option of every command, from the parser."""
    lines = ["# Every option of every command", "", "Made from the parser. [Commands](commands.md) has examples."]
    for name, one in zip(COMMANDS, _parsers(parser()), strict=True):
        lines += [
            "",
            f"## gube {name}",
            "",
            one.description or "",
            "",
            "```text",
            one.format_usage().strip(),
            "```",
            "",
        ]
        lines += ["| argument | meaning |", "|---|---|"]
        formatter = one._get_formatter()
        for action in one._actions:
            shown = ", ".join(action.option_strings) or str(action.metavar or action.dest)
            if action.option_strings and action.nargs != 0:
                shown += f" {action.metavar or action.dest.upper()}"
            lines.append(f"| {_cell(f'`{shown}`')} | {_cell(formatter._expand_help(action) if action.help else '')} |")
    return "\n".join(lines) + "\n"


def _parsers(one: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    groups = [action for action in one._actions if isinstance(action, argparse._SubParsersAction)]
    for group in groups:
        for below in group.choices.values():
            yield from _parsers(below)
    if not groups:
        yield one


def python_page() -> str:
    """Docstrings of the public names, and the examples."""
    lines = ["# Python", "", "Docstrings of all [public names](api.md); `import gube` has them.", "", "## Names"]
    for name in sorted(gube.SOURCES, key=str.lower):
        lines += ["", f"::: {gube.SOURCES[name].replace(':', '.')}", "    options:"]
        lines += [f"      heading: {name}", f"      toc_label: {name}"]
    lines += ["", "## Examples"]
    for path in sorted((ROOT / "examples").glob("*.py")):
        lines += ["", f"### {path.name}", "", "```python", path.read_text(encoding="utf-8").strip(), "```"]
    return "\n".join(lines) + "\n"


def database_page() -> str:
    """Every value of the database file, from its schema."""
    lines = [
        "# The database file",
        "",
        f'An HDF5 file; its attribute `format` is "{FORMAT}", `schema_version` is {SCHEMA_VERSION}. Units are SI.',
        "A letter in a shape stands for the same size in all values. `gube check` holds a file against this table.",
        "",
        "| name | kept in | type | shape | unit |",
        "|---|---|---|---|---|",
    ]
    for entry in ENTRIES:
        shape = " x ".join(map(str, entry.shape)) or "one"
        place = "attribute" if entry.in_header else "data set"
        lines.append(f"| `{entry.name}` | {place} | {entry.dtype} | {shape} | {entry.unit} |")
    return "\n".join(lines) + "\n"


def validation_page() -> str:
    """The table that `gube validate --json out/validate.json` wrote, if there is one."""
    lines = ["# Validation", "", "`gube validate` holds solvers against formulas, exact solutions and measurements."]
    lines.append("The difficulties that were found are in the [lab notes](lab-notes/validation.md).")
    if not VALIDATION.is_file():
        lines += ["", "No table was written beside this site. `gube validate --json out/validate.json` writes it, and"]
        return "\n".join([*lines, "`make docs` then shows it here."]) + "\n"
    report = json.loads(VALIDATION.read_text(encoding="utf-8"))
    rows = [
        row | {"params": " ".join(f"{key}={value}" for key, value in row["params"].items())} for row in report["rows"]
    ]
    best, realtime = (sum(row[name] for row in rows) for name in ("passed_best", "passed_realtime"))
    lines += [
        "",
        f"Written by gube {report['version']} on {report['machine']['cpu']}, {report['machine']['date'][:10]}: of "
        f"{len(rows)} rows the best setting holds {best}, a setting that plays in real time {realtime}.",
        "",
    ]
    lines = ["---", "hide: [toc]", "---", *lines]  # the table is wide
    return "\n".join([*lines, *_table(rows, VALIDATION_COLUMNS)]) + "\n"


VALIDATION_COLUMNS = (
    "test", "params", "solver", "reference", "measured", "error", "gate_best", "passed_best", "default_error",
    "gate_realtime", "passed_realtime",
)  # fmt: skip
GARMENT_COLUMNS = (
    "method", "frame_ms", "worst octave", "normals [deg]", "bias", "spread", "stretch [%]", "in body [%]",
    "crossed [%]", "ours as good", "its ms", "its share", "rival ahead by", "ended",
)  # fmt: skip
SOLVER_COLUMNS = ("side", "method", "substeps", "frame_ms", "mean_stretch", "worst_stretch", "amplitude_ratio")


def other_engines_page() -> str:
    """Tables of other engines, from the files that commands wrote, under the text that people wrote."""
    text = (ROOT / "docs" / "other-engines.md").read_text(encoding="utf-8")
    with open(ROOT / "docs" / "bench-solver.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    passed = sorted((row for row in rows if row["passed"] == "True"), key=lambda row: float(row["frame_ms"]))
    cheapest = {(int(row["side"]), row["method"]): row for row in reversed(passed)}
    solver = [cheapest[key] for key in sorted(cheapest)]
    machine = f"Written on {rows[0]['cpu']}, {rows[0]['date'][:10]}."
    stress = [
        {"engine": name, "ended well": ok, "over 20 % stretched": far, "exploded": burst}
        for name, (ok, far, burst) in QUOTED.items()
    ]
    tables = {
        "BENCH SOLVER": [*_table(solver, SOLVER_COLUMNS), "", machine],
        "BENCH GARMENT": _garments(ROOT / "docs" / "bench-garment"),
        "BENCH STRESS": _table(stress, tuple(stress[0])),
    }
    for name, lines in tables.items():
        assert f"<!-- {name} -->" in text, f"docs/other-engines.md has no place for {name}"
        text = text.replace(f"<!-- {name} -->", "\n".join(lines))
    return text


def _garments(folder: Path) -> list[str]:
    """The tables that `gube bench garment` wrote, its charts and pictures."""
    lines = []
    for chart in sorted(folder.glob("*_chart.png")):
        stem = chart.name.removesuffix("_chart.png")
        with open(folder / f"{stem}.csv", encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        lines += ["", f"### {rows[0]['garment']}", ""]
        lines += [f"![{what} of {stem}]({folder.name}/{stem}_{what}.png)\n" for what in ("chart", "strip")]
        lines += [*_table(rows, GARMENT_COLUMNS), "", f"Written on {rows[0]['cpu']}, {rows[0]['date'][:10]}."]
        with open(folder / f"{stem}_within.csv", encoding="utf-8", newline="") as file:
            lines += ["", *_table(list(csv.DictReader(file)), ("within [ms]", "engine", *GARMENT_COLUMNS))]
    return lines


def gallery_page() -> str:
    """Pictures and films that `make gallery` made, and the pictures that the repository keeps."""
    text = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    notes = json.loads(FILMS.read_text(encoding="utf-8")) if FILMS.is_file() else []
    lines = []
    for note in notes:
        lines += ["", f"## {note['title']}", "", f"![{note['title']}](gallery/{note['file']})", "", note["words"]]
    if not lines:
        lines = ["", "Films are made by `make gallery`, which takes 15 minutes; `make docs` then shows them here."]
    return text.rstrip("\n") + "\n" + "\n".join(lines) + "\n"


def _table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> list[str]:
    used = [column for column in columns if any(column in row for row in rows)]
    lines = ["| " + " | ".join(used) + " |", "|---" * len(used) + "|"]
    return lines + ["| " + " | ".join(_cell(_short(row.get(column, ""))) for column in used) + " |" for row in rows]


def _short(value: Any) -> str:
    try:
        return f"{float(value):.3g}" if not isinstance(value, (bool, int)) else str(value)
    except (TypeError, ValueError):
        return str(value)


def _cell(text: str) -> str:
    """A text in a cell of a Markdown table."""
    return str(text).replace("|", "\\|").replace("\n", " ")


def _without_roles(text: str) -> str:
    """A docstring's text with plain names instead of cross-references."""
    return re.sub(r":\w+:`~?([^`]*)`", r"`\1`", text)


def _default(value: Any) -> str:
    if value is MISSING:
        return "required"
    if value is None:
        return "none"
    return "the values below" if is_dataclass(value) else f"`{_toml(value)}`"


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value) if isinstance(value, str) else f"{value:g}"


GENERATED: Mapping[str, Callable[[], str]] = {
    "scene-keys.md": scene_keys,
    "options.md": options_page,
    "python.md": python_page,
    "database-file.md": database_page,
    "validation.md": validation_page,
    "other-engines.md": other_engines_page,
    "gallery.md": gallery_page,
}
"""Pages by name, and the function that makes each."""
