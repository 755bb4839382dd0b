"""Words of commands: plain lines stay as they are, and a pseudo-terminal gets colours, tables and one live line."""

from __future__ import annotations

import fcntl
import io
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TextIO

import pytest

from runtime.output.report import Progress
from runtime.output.terminal import is_plain, say, say_error
from tests.data import ROOT

WIDTH = 80
TABLE = """Fabric
  name              wool
  areal density     0.24 kg/m2

Quality on motion
                     ours    smooth
  rmse_mm          1.1425    3.7774  distance of vertices from those of the truth, wherever the coarse state is given
  rmse_skill       0.6975         -  share of smooth's distance that is removed

prose that follows, with a path: out/x.h5"""


Terminal = tuple[TextIO, Callable[[], str]]


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    """A stream on a pseudo-terminal, and a function that closes it and gives what it got."""
    for name in ("NO_COLOR", "CI", "COLUMNS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, WIDTH, 0, 0))
    stream = os.fdopen(theirs, "w", encoding="utf-8")

    def written() -> str:
        stream.close()
        got = b""
        while True:
            try:
                part = os.read(ours, 65536)
            except OSError:  # all that was written is read
                return got.decode().replace("\r\n", "\n")
            if not part:
                return got.decode().replace("\r\n", "\n")
            got += part

    yield stream, written
    stream.close()
    os.close(ours)


def without_colours(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


def test_a_file_gets_the_text_as_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(sys, "stderr", stream)
    say(TABLE)
    say_error("gube play", "a.h5: no such file\n  more")
    say_error("", "stopped")
    assert stream.getvalue() == f"{TABLE}\ngube play: a.h5: no such file\n  more\nstopped\n"


@pytest.mark.parametrize(("name", "value"), [("NO_COLOR", "1"), ("CI", "true"), ("TERM", "dumb")])
def test_a_terminal_can_be_told_to_stay_plain(
    name: str, value: str, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, written = terminal
    assert not is_plain(stream)
    monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stdout", stream)
    say(TABLE)
    with Progress(stream) as progress:
        progress("simulating: 1 of 2")
    assert written() == f"{TABLE}\n[    0 s] simulating: 1 of 2\n"


def test_a_terminal_gets_titles_tables_and_wrapped_explanations(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, written = terminal
    monkeypatch.setattr(sys, "stdout", stream)
    say(TABLE)
    text = written()
    assert "\x1b[1mFabric\x1b[0m" in text  # bold
    lines = without_colours(text).split("\n")
    assert max(map(len, lines)) <= WIDTH
    row, rest = (next(n for n, line in enumerate(lines) if word in line) for word in ("rmse_mm", "wherever"))
    assert lines[row].split()[:3] == ["rmse_mm", "1.1425", "3.7774"]
    assert rest > row and lines[rest].startswith(" ")  # the explanation goes on below
    assert re.sub(r"\s+", " ", without_colours(text)).count("areal density 0.24 kg/m2") == 1
    assert "prose that follows, with a path: out/x.h5" in without_colours(text)


def test_marks_and_control_characters_of_names_do_nothing(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, written = terminal
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(sys, "stderr", stream)
    say("[red]a[/red] :smile: \x1b[31mb\x1b]0;title\x07")
    say_error("gube play", "\x1b[2Ja.h5: no such file")
    text = written()
    assert "[red]a[/red] :smile:" in without_colours(text)
    assert "\x1b[31m" not in text and "\x1b]0" not in text and "\x1b[2J" not in text and "\x07" not in text


def test_the_content_of_a_file_stays_as_it_is(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, written = terminal
    monkeypatch.setattr(sys, "stdout", stream)
    say(TABLE, verbatim=True)
    assert written() == TABLE + "\n"


def test_an_error_is_red_and_its_cure_green(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, written = terminal
    monkeypatch.setattr(sys, "stderr", stream)
    say_error("gube new", "a.obj: a mesh without faces (received '0 vertices', expected faces)\n    to mend it: export")
    text = written()
    assert text.startswith("\x1b[1;31mgube new:\x1b[0m ")
    assert "\x1b[32mto mend it: export\x1b[0m" in text
    assert "\x1b[33mreceived '0 vertices'\x1b[0m" in text


def test_progress_is_one_line_with_a_bar_where_it_counts(terminal: Terminal) -> None:
    stream, written = terminal
    with Progress(stream) as progress:
        progress("stage 1 of 2: starting")
        progress("stage 2 of 2: simulating: 1 of 4 frames, " + "x" * 200)
    text = written()
    shown = [without_colours(part) for part in re.split(r"\r\x1b\[2K|\n", text)]
    lines = [line for line in shown if "stage" in line]
    assert all(len(line.rstrip()) <= WIDTH for line in lines)
    assert lines[-1].rstrip().endswith("…")
    assert "━" in lines[-1]  # the bar
    assert text.count("\n") == 1  # both stood on one line


def test_a_line_that_stays_is_followed_by_others(terminal: Terminal) -> None:
    stream, written = terminal
    with Progress(stream) as progress:
        progress.say("kept")
        progress("next")
    lines = [line for line in without_colours(written()).split("\n") if "kept" in line or "next" in line]
    assert ["kept" in line for line in lines] == [True, False]


def test_a_command_in_a_terminal_colours_its_error_and_in_a_pipe_does_not(terminal: Terminal, tmp_path: Path) -> None:
    stream, written = terminal
    words = [sys.executable, "-m", "gube", "check", str(tmp_path / "no.h5")]
    assert subprocess.run(words, cwd=ROOT, stdout=stream, stderr=stream).returncode == 2
    plain = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    coloured = written()
    assert coloured.startswith("\x1b[1;31mgube check:")
    assert "\x1b" not in plain.stderr and plain.stderr.startswith("gube check: ")
    assert without_colours(coloured) == plain.stderr
