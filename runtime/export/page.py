"""A page that plays a recorded garment in a browser, in a folder of its own; it needs no network and no server."""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pbd.errors import InputError
from runtime.output.figures import FIRST, figure_of, figure_table, value_texts
from runtime.output.verdict import verdict
from wrinkles.database import WrinkleDatabase

__all__ = ["check_page_folder", "page_text", "write_page"]

WEB = Path(__file__).parent / "web"
PROGRAM = ("index.html", "style.css", "reader.js", "page.js")
BUILT = ("three.js", "three.LICENSE")  # see the Makefile
RECORDING = "recording.js"
BEGINNING = "const gubeRecording = "
PAGE = (*PROGRAM, *BUILT, RECORDING)


def check_page_folder(folder: Path) -> None:
    """Refuse to write a page where something else would be lost, or without its parts.

    Raises:
        InputError: a file, a folder with other files than those of a page, or three.js is missing.
    """
    missing = [name for name in BUILT if not (WEB / "built" / name).is_file()]
    if missing:
        raise InputError(
            "this installation of gube has no three.js, which draws the page",
            file=WEB / "built",
            key=", ".join(missing),
            received="no such file",
            expected="`make runtime/export/web/built/three.js` in a checkout, with npm's registry, or its wheel",
        )
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise InputError("cannot be written", key="-o", received=str(folder), expected="a folder")
    found = {entry.name for entry in folder.iterdir()} if folder.exists() else set()
    others = sorted(found - set(PAGE) if _is_recording(folder / RECORDING) else found)
    if others:
        raise InputError(
            "the folder holds other files, which would be lost",
            key="-o",
            received=f"{folder} with {', '.join(others[:3])}",
            expected="a new or empty folder, or an earlier page",
        )


def _is_recording(file: Path) -> bool:
    if not file.is_file():
        return False
    with file.open("rb") as content:
        return content.read(len(BEGINNING)) == BEGINNING.encode()


def write_page(folder: Path, recording: bytes) -> int:
    """Write a page. It is made beside the folder and put in its place whole; an earlier page there is replaced.

    Args:
        folder: see :func:`check_page_folder`.
        recording: of :func:`runtime.export.recording.record`.

    Returns:
        size of all its files [bytes].

    Raises:
        InputError: as :func:`check_page_folder`.
    """
    check_page_folder(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    beside, old = (folder.with_name(f".{folder.name}.{os.getpid()}.{kind}") for kind in ("part", "old"))
    try:
        beside.mkdir()
        for name in PROGRAM:
            shutil.copyfile(WEB / name, beside / name)
        for name in BUILT:
            shutil.copyfile(WEB / "built" / name, beside / name)
        text = base64.b64encode(recording).decode("ascii")
        (beside / RECORDING).write_text(f'{BEGINNING}"{text}";\n', encoding="ascii")
        if folder.exists():
            os.rename(folder, old)
        try:
            os.rename(beside, folder)
        except OSError:
            if old.exists():
                os.rename(old, folder)
            raise
        shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return sum(file.stat().st_size for file in folder.iterdir())


def page_text(database: WrinkleDatabase, motion: str) -> dict[str, Any]:
    """What the page says in words and numbers: for the header of its recording.

    Args:
        database: that is played.
        motion: name of the motion.
    """
    facts = [
        ("motion", motion),
        ("fabric", database.fabric_name),
        ("vertices", f"{len(database.coarse_vertices)} coarse, {database.fine_vertex_count} fine"),
        ("dictionary", f"{len(database.atoms.shapes)} wrinkle shapes for the patch around each coarse vertex"),
        ("learned from", ", ".join(database.trained_on) or "nothing"),
        ("held out", ", ".join(database.held_out) or "nothing"),
        ("made", f"{database.created} by gube {database.code_version}"),
    ]
    figures = _figure_tables(database.quality)
    return {
        "garment": database.garment_name,
        "motion": motion,
        "verdict": verdict(database),
        "facts": facts,
        "figures": figures,
    }


def _figure_tables(quality: Mapping[str, float]) -> dict[str, Any]:
    """Columns of both tables; rows of the first one under their titles, and of the second one, which holds the rest."""
    columns, table = figure_table(quality)

    def row(name: str) -> dict[str, Any]:
        figure, values = figure_of(name), table[name]
        unit = "" if figure.unit in ("", "-") else f" [{figure.unit}]"
        texts = value_texts([values.get(column) for column in columns])
        return {"name": figure.label + unit, "values": texts, "meaning": figure.meaning}

    first = {title: [name for name in names if name in table] for title, names in FIRST.items()}
    shown = {name for names in first.values() for name in names}
    groups = [{"title": title, "rows": [row(name) for name in names]} for title, names in first.items() if names]
    return {"columns": columns, "first": groups, "rest": [row(name) for name in table if name not in shown]}
