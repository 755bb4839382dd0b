import argparse
import errno
import json
import multiprocessing
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from runtime.cli import command
from runtime.cli.arguments import duration
from runtime.cli.commands import simulate
from runtime.detail.planner import TARGETS
from runtime.output.report import Report
from tests.processes import python

SCENE = '[[garment]]\nname = "skirt"\nmesh = "builtin:skirt"\n'
LEARNING = SCENE + '[character]\nfile = "builtin:mannequin"\n[training]\nprocedural_seconds = 40\n'


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def test_explain_prints_a_scene_that_explains_itself(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["simulate", "--explain", str(scene)]) == 0
    printed = capsys.readouterr().out
    scene.write_text(printed, encoding="utf-8")
    assert command.main(["simulate", "--explain", str(scene)]) == 0
    assert capsys.readouterr().out == printed
    assert "subdivisions = 2" in printed


def test_bad_input_is_one_message_and_status_2(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene.write_text(SCENE + "thickness = -1\n[solver]\ngravty = 3\n", encoding="utf-8")
    assert command.main(["simulate", "--explain", str(scene)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("gube simulate: 2 problems:\n")
    assert "garment[0].thickness" in captured.err
    assert "did you mean 'gravity'?" in captured.err


def test_a_missing_command_or_argument_is_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in ([], ["simulate"], ["nonsense"]):
        with pytest.raises(SystemExit) as caught:
            command.main(arguments)
        assert caught.value.code == 2
    assert "usage: gube" in capsys.readouterr().err


def test_the_json_file_has_what_was_found_and_where(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    assert command.main(["simulate", "--explain", str(scene), "--json", str(out)]) == 0
    content = json.loads(out.read_text(encoding="utf-8"))
    assert list(content) == ["command", "version", "machine", "figures", "rows"]
    assert content["command"] == "simulate"
    assert content["machine"]["cores"] >= 1
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".part"] == []


def test_a_json_file_that_cannot_be_written_is_refused_before_the_run(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = []
    monkeypatch.setattr(simulate, "run", lambda options: runs.append(options) or Report())
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "out.json", tmp_path):
        assert command.main(["simulate", "--explain", str(scene), "--json", str(path)]) == 2
        assert "--json: cannot be written" in capsys.readouterr().err
    assert runs == []


def test_a_failed_run_is_status_1_and_keeps_its_figures(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed = Report({"rmse_mm": 3.0}, [{"test": "swing", "passed": False}], passed=False)
    monkeypatch.setattr(simulate, "run", lambda options: failed)
    out = tmp_path / "out.json"
    assert command.main(["simulate", "--explain", str(scene), "--json", str(out)]) == 1
    content = json.loads(out.read_text(encoding="utf-8"))
    assert content["figures"] == {"rmse_mm": 3.0}
    assert content["rows"] == [{"test": "swing", "passed": False}]


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """All commands under a parser; groups themselves are left out."""
    groups = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for group in groups:
        for one in group.choices.values():
            yield from parsers(one)
    if not groups:
        yield parser


def said_badly(parser: argparse.ArgumentParser) -> list[str]:
    """Arguments whose help leaves out the unit of a number, or the default of an option."""
    bad = []
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        name = "/".join(action.option_strings) or action.dest
        text = parser._get_formatter()._expand_help(action) if action.help else ""
        if is_number(action) and not re.search(r"\[(s|ms|m|mm|Hz|px|deg|-)\]", text):
            bad.append(f"{name}: no unit")
        required = action.required if action.option_strings else action.nargs != "*"
        ending = r"\(required\)$" if required else r"\(default: .+\)$"
        if (action.option_strings or not required) and not re.search(ending, text):
            bad.append(f"{name}: no default")
        shown = action.default not in (None, False, [])
        if shown and f"{action.default}".removesuffix(".0") not in text.rpartition("default:")[2]:
            bad.append(f"{name}: another default")
    return bad


def is_number(action: argparse.Action) -> bool:
    """Whether an argument takes a number, or a number with its unit behind it."""
    if not callable(action.type):
        return False
    for text in ("5", "5s"):
        try:
            return isinstance(action.type(text), (int, float))
        except argparse.ArgumentTypeError:
            continue
    return False


def test_the_help_of_every_command_says_units_and_defaults() -> None:
    found = {parser.prog: said_badly(parser) for parser in parsers(command.parser())}
    assert set(found) == {f"gube {name}" for name in command.COMMANDS}
    assert {name: bad for name, bad in found.items() if bad} == {}


@pytest.mark.parametrize(
    ("option", "bad"),
    [
        ({"type": int, "help": "a rate (default: 3)", "default": 3}, "--x: no unit"),
        ({"type": duration, "help": "time (default: 1h)"}, "--x: no unit"),
        ({"type": Path, "help": "a file"}, "--x: no default"),
        ({"type": Path, "help": "a file", "required": True}, "--x: no default"),
        ({"action": "store_true", "help": "do it"}, "--x: no default"),
        ({"type": Path, "help": "a file (default: b)", "default": Path("a")}, "--x: another default"),
        ({}, "--x: no default"),
    ],
)
def test_a_bad_help_is_found(option: dict, bad: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--x", **option)
    assert said_badly(parser) == [bad]


def test_the_help_says_what_other_files_define() -> None:
    from precompute.method_comparison.scene_compare import BUDGET

    found = {parser.prog: " ".join(parser.format_help().split()) for parser in parsers(command.parser())}
    assert duration("15m") == BUDGET and "(default: 15m)" in found["gube compare"]
    assert {f"{name} is {px:g} px" for name, px in TARGETS.items()} <= set(
        re.findall(r"\w+ is \d+ px", found["gube plan"])
    )


def loaded_by(*words: str) -> set[str]:
    """Modules that are loaded after ``gube`` with these words, which ends by itself."""
    script = (
        "import sys\nfrom runtime.cli.command import main\n"
        f"try: main({words!r})\nexcept SystemExit: pass\nprint(*sorted(sys.modules), sep='\\n')"
    )
    return set(python(script).splitlines())


@pytest.mark.parametrize("words", [["--help"], ["bench", "--help"], ["compare", "--help"], ["play"], ["nonsense"]])
def test_help_and_bad_words_load_nothing_heavy(words: list[str]) -> None:
    assert not loaded_by(*words) & {"numpy", "scipy", "taichi", "h5py", "pbd", "wrinkles"}


def test_a_command_loads_no_other(tmp_path: Path) -> None:
    files = {name for name in loaded_by("play", str(tmp_path / "no.h5")) if ".commands." in name}
    assert files == {"runtime.cli.commands.play"}


def test_truth_is_played_by_the_file_that_the_table_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from precompute.commands import play_truth

    runs = []
    monkeypatch.setattr(play_truth, "run", lambda options: runs.append(options) or Report())
    assert command.main(["play", "no.h5", "-o", str(tmp_path), "--truth"]) == 0 and len(runs) == 1
    assert command.main(["play", "no.h5", "-o", str(tmp_path)]) == 2 and len(runs) == 1
    assert "no.h5" in capsys.readouterr().err


DATABASE = ["precompute", "no.toml", "-o"]


@pytest.mark.parametrize(
    "arguments, key, expected",
    [
        ([*DATABASE, "."], "-o", "a file ending in .h5"),
        ([*DATABASE, "new/skirt"], "-o", "a file ending in .h5"),
        ([*DATABASE, "file/skirt.h5"], "-o", "where files can be written"),
        ([*DATABASE, "new/skirt.h5", "--cache", "file"], "--cache", "a folder"),
        (["demo", "-o", "file/demo"], "-o", "a folder"),
        (["play", "no.h5", "-o", "file"], "-o", "a folder"),
        (["bake", "no.h5", "-o", "new/skirt.fbx"], "-o", "a file ending in .glb or .usdc or .pc2 or .mdd or .obj"),
        (["bake", "no.h5", "-o", "file/skirt.glb"], "-o", "where files can be written"),
        (["compare", "no.h5", "-o", "file"], "-o", "a folder"),
        (["export", "no.h5", "-o", "file"], "-o", "a folder"),
    ],
)
def test_what_cannot_be_written_is_refused_before_anything_is_read_or_made(
    arguments: list[str],
    key: str,
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert command.main(arguments) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"gube {arguments[0]}: {key}: cannot be written") and message.count("\n") == 1
    assert "received" in message and expected in message
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    "arguments, key",
    [
        (["waltz"], "SCENE"),
        (["swing", "--methods", "magic"], "--methods"),
        (["swing", "--clip", "walk"], "--clip"),
        (["no.h5", "--methods", "pbd"], "--methods"),
        (["no.h5", "--budget", "5m"], "--budget"),
        (["no.h5", "other.h5"], "SCENE"),
        (["swing", "--wrinkles"], "SCENE"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    arguments: list[str], key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(["compare", *arguments, "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"gube compare: {key}: ") and "expected" in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text, seconds", [("90s", 90.0), ("1.5m", 90.0), ("2h", 7200.0)])
def test_a_budget_is_a_time(text: str, seconds: float) -> None:
    assert command.parser().parse_args(["compare", f"--budget={text}"]).budget == seconds


@pytest.mark.parametrize("text", ["", "5", "-5m", "five m", "infs", "m"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(SystemExit):
        command.main(["compare", f"--budget={text}"])


def test_a_new_folder_is_made_only_with_its_file(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "a" / "b" / "out.json"
    assert command.main(["simulate", "--explain", str(tmp_path / "no.toml"), "--json", str(out)]) == 2
    assert not (tmp_path / "a").exists()
    assert command.main(["simulate", "--explain", str(scene), "--json", str(out)]) == 0
    assert out.exists()


def test_a_full_disk_is_one_message_and_status_1(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(path: Path, content: str, encoding: str) -> None:
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    out = tmp_path / "out.json"
    out.write_text("old", encoding="utf-8")
    monkeypatch.setattr(Path, "write_text", full)
    assert command.main(["simulate", "--explain", str(scene), "--json", str(out)]) == 1
    message = capsys.readouterr().err
    assert message.startswith("gube simulate: ") and message.endswith("no space left on device\n")
    assert message.count("\n") == 1
    assert out.read_text(encoding="utf-8") == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.json", "scene.toml"]


def test_a_worker_ended_from_outside_is_one_message_and_status_1(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scene.write_text(LEARNING, encoding="utf-8")
    monkeypatch.setattr("precompute.learning.run_recording._record", _killed)
    assert command.main(["precompute", str(scene), "-o", str(tmp_path / "out.h5")]) == 1
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert message.startswith("gube precompute: a simulating process was ended from outside")
    assert not (tmp_path / "out.h5").exists()


def _killed(*_: object) -> None:
    assert multiprocessing.parent_process() is not None  # never the tests themselves
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize(
    "change, words",
    [
        ('clip = "wlak"', ["builtin:mannequin: clip: no such clip", "'wlak'", "slow_walk"]),
        ('file = "missing.glb"', ["character.file: no such file", "'missing.glb'"]),
        ('file = "junk.glb"', ["junk.glb: not a binary glTF file", "received", "expected a header"]),
        ('sequence = "junk.npz"', ["junk.npz: truncated, damaged or no arrays", "expected an .npz file with vertices"]),
        ('sequence = "empty.npz"', ["empty.npz: vertices: a missing key", "received ['other']", "expected vertices"]),
    ],
)
def test_a_bad_character_is_one_message_and_nothing_is_written(
    change: str, words: list[str], scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "junk.glb").write_bytes(b"nothing of the kind")
    (tmp_path / "junk.npz").write_bytes(b"nothing of the kind")
    np.savez(tmp_path / "empty.npz", other=np.zeros(3))
    kind = change.partition(" ")[0]
    whole = change if kind == "sequence" else f'file = "builtin:mannequin"\n{change}' if kind == "clip" else change
    scene.write_text(f'{SCENE}attach = "top"\n[character]\n{whole}\n', encoding="utf-8")
    before = sorted(tmp_path.iterdir())
    assert command.main(["simulate", str(scene), "-o", str(tmp_path / "new" / "a.glb")]) == 2
    message = capsys.readouterr().err
    assert message.startswith("gube simulate: ") and message.count("\n") == 1
    assert all(word in message for word in words), message
    assert sorted(tmp_path.iterdir()) == before
