"""The command `gube export`: the folder that it writes, and what it refuses."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path

import pytest

from runtime.cli import command
from runtime.export import page
from runtime.export.page import PAGE, WEB, check_page_folder, write_page
from runtime.export.recording_file import read_recording
from tests.refusals import refuses
from tests.runtime.players import skirt_database
from wrinkles.database_file import write_database


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("database") / "skirt.h5"
    write_database(path, skirt_database())
    return path


def recording_of(folder: Path) -> bytes:
    """The file of a page's folder, read as docs/recording-file.md says."""
    text = (folder / "recording.js").read_text(encoding="ascii")
    found = re.search(r'"([^"]*)"', text)
    assert found is not None
    return base64.b64decode(found.group(1))


def test_it_writes_a_page_with_its_recording(
    database: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, figures = tmp_path / "page", tmp_path / "figures.json"
    arguments = ["export", str(database), "-o", str(folder), "--seconds", "0.1", "--json", str(figures)]
    assert command.main(arguments) == 0
    printed = capsys.readouterr().out
    assert sorted(file.name for file in folder.iterdir()) == sorted(PAGE)
    assert [file.name for file in tmp_path.iterdir() if file.suffix in (".part", ".old")] == []
    about, arrays = read_recording(recording_of(folder))
    assert (about["garment"], about["motion"], about["frame_count"]) == ("skirt", "walk", 4)
    assert arrays["frames/fine"].steps.shape == (4, skirt_database().fine_vertex_count, 3)
    found = json.loads(figures.read_text(encoding="utf-8"))["figures"]
    assert found["page_mb"] == pytest.approx(sum(file.stat().st_size for file in folder.iterdir()) / 1e6)
    assert found["decoded_off_mm"] < 0.2 and f"within {found['decoded_off_mm']:.2f} mm" in printed
    assert str(folder / "index.html") in printed


@pytest.mark.parametrize("name", ["notes.txt", "index.html", "recording.js"])
def test_a_folder_with_other_files_is_refused_and_left_alone(
    name: str, database: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also one whose file only has a name of ours."""
    (tmp_path / name).write_text("mine", encoding="utf-8")
    assert command.main(["export", str(database), "-o", str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert "holds other files" in message and name in message
    assert [(file.name, file.read_text(encoding="utf-8")) for file in tmp_path.iterdir()] == [(name, "mine")]


def test_an_empty_folder_is_taken_and_an_earlier_page_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "page"
    folder.mkdir()
    for recording in (b"earlier", b"later"):
        assert write_page(folder, recording) > 0
        assert recording_of(folder) == recording
    assert [entry.name for entry in tmp_path.iterdir()] == ["page"]


def test_a_page_that_cannot_be_put_in_place_leaves_the_earlier_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "page"
    write_page(folder, b"earlier")
    real = page.os.rename

    def full(source: Path, target: Path) -> None:
        if Path(source).suffix == ".part":
            raise OSError(28, "No space left on device", str(target))
        real(source, target)

    monkeypatch.setattr(page.os, "rename", full)
    with pytest.raises(OSError, match="No space"):
        write_page(folder, b"later")
    assert recording_of(folder) == b"earlier"
    assert [entry.name for entry in tmp_path.iterdir()] == ["page"]


def test_without_three_js_it_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "WEB", tmp_path)
    refuses(r"has no three\.js.*make runtime/export/web/built/three\.js", check_page_folder, tmp_path / "page")


def test_the_page_loads_nothing_from_elsewhere() -> None:
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', (WEB / "index.html").read_text(encoding="utf-8"))
    assert policy is not None
    rules = dict(rule.strip().split(" ", 1) for rule in policy.group(1).split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["script-src"] == "'self'"
    for name in ("index.html", "style.css", "reader.js", "page.js"):
        text = (WEB / name).read_text(encoding="utf-8")
        assert not re.search(r"https?:|innerHTML|insertAdjacent|document\.write|\beval\(", text)


def test_three_js_comes_with_its_licence() -> None:
    assert "Three.js Authors" in (WEB / "built" / "three.js").read_text(encoding="utf-8")
    licence = (WEB / "built" / "three.LICENSE").read_text(encoding="utf-8")
    assert licence.startswith("The MIT License") and "three.js authors" in licence
