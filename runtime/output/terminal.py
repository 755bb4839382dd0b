"""All words that commands write: colours, tables and a line of progress on a terminal, plain lines anywhere else.

Plain is what goes to a file or a pipe, and everything where ``NO_COLOR`` or ``CI`` is set or the terminal is dumb.
Plain text is written as it stands, so that scripts and tests can rely on it. ``rich`` draws on terminals, and is
imported for them alone.
"""

from __future__ import annotations

import os
import re
import sys
import time
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live
    from rich.text import Text

__all__ = ["LiveLine", "is_plain", "say", "say_error"]

_MIN_ROWS = 3  # of aligned columns that are drawn as a table; of indented ones one less
_GAP = 2  # blank columns between two columns of a table
_BAR_WIDTH = 24
_MAX_CELL = 40  # a longer text in a table is an explanation, which may be wrapped
_NUMBER = re.compile(r"-?[\d.]|-$")
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")  # a name out of a file must not steer the terminal


def is_plain(stream: TextIO) -> bool:
    """Whether a stream takes plain lines alone."""
    set_plain = os.environ.get("NO_COLOR") or os.environ.get("CI") or os.environ.get("TERM") == "dumb"
    return bool(set_plain) or not stream.isatty()


def say(text: object, *, verbatim: bool = False) -> None:
    """Write a result to the standard output, with a line's end.

    Args:
        text: lines; on a terminal aligned columns are drawn as tables, and numbers, paths and titles are coloured.
        verbatim: the text is the content of a file, which stays as it is on a terminal too.
    """
    if verbatim or is_plain(sys.stdout):
        print(text, flush=True)
        return
    console = _console(sys.stdout)
    for block in _blocks(_CONTROL.sub("\ufffd", str(text))):
        console.print(block, soft_wrap=True)


def say_error(name: str, text: object) -> None:
    """Write why a command ended to the standard error.

    Args:
        name: of the command, or nothing.
        text: the reason; several lines may follow.
    """
    head = f"{name}: " if name else ""
    if is_plain(sys.stderr):
        print(f"{head}{text}", file=sys.stderr)
        return
    from rich.text import Text

    line = Text(_CONTROL.sub("\ufffd", f"{head}{text}"))
    line.stylize("bold red", 0, len(head.rstrip()) or len(line))
    line.highlight_regex(r"to mend it: .*", "green")
    line.highlight_regex(r"received .*?(?=, expected|\)$)", "yellow")
    _console(sys.stderr).print(line, soft_wrap=True, highlight=False)


class LiveLine:
    """One line of progress on a terminal, written over by the next: time, a bar where the text counts, and the text.

    Args:
        stream: the terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._began = stream, time.monotonic()
        self._live: Live | None = None

    def show(self, text: str) -> None:
        """Show a text in the place of the last one."""
        line = _progress_line(time.monotonic() - self._began, _CONTROL.sub("\ufffd", text))
        if self._live is None:
            from rich.live import Live

            # Without a thread of its own: it is drawn when something is reported.
            console = _console(self._stream)
            self._live = Live(console=console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
            self._live.start()
            console.show_cursor(True)  # whoever kills the program keeps it
        self._live.update(line, refresh=True)

    def close(self) -> None:
        """Leave the last text as it stands."""
        if self._live is not None:
            self._live.stop()
            self._live = None


def _console(stream: TextIO) -> Console:
    from rich.console import Console

    return Console(file=stream, markup=False, emoji=False)


def _progress_line(seconds: float, text: str) -> RenderableType:
    from rich.progress_bar import ProgressBar
    from rich.table import Table

    cells: list[Any] = [f"{seconds:5.0f} s"]
    line = Table.grid(padding=(0, 1), expand=True)
    line.add_column(style="dim", no_wrap=True)
    share = _share(text)
    if share is not None:
        line.add_column(width=_BAR_WIDTH)
        cells.append(ProgressBar(total=1.0, completed=share, width=_BAR_WIDTH))
    line.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
    line.add_row(*cells, text)
    return line


def _share(text: str) -> float | None:
    """The part that is done by the last "k of n" or "p %" of a text [-]; None if it has neither."""
    counts = re.findall(r"([\d,]+) of ([\d,]+)|([\d.]+) %", text)
    if not counts:
        return None
    done, total, percent = counts[-1]
    if percent:
        return min(float(percent) / 100.0, 1.0)
    done, total = float(done.replace(",", "") or 0), float(total.replace(",", "") or 0)
    return min(done / total, 1.0) if total else None


def _blocks(text: str) -> list[Any]:
    """What is drawn for a text: tables for blocks of aligned lines, coloured lines for all others."""
    from rich.text import Text

    drawn: list[Any] = []
    lines = text.split("\n")
    while lines:
        count = next((place for place, line in enumerate(lines) if not line.strip()), len(lines))
        block, lines = lines[: max(count, 1)], lines[max(count, 1) :]
        indented = len(block) > 1 and all(line[:1] == " " for line in block[1:])
        if indented and block[0][:1] != " ":  # a title
            drawn.append(Text(block.pop(0), style="bold"))
        table = _table(block) if len(block) >= _MIN_ROWS - indented else None
        drawn += [table] if table is not None else [_line(line) for line in block]
    return drawn


def _line(text: str) -> Text:
    """A line that is no row of a table."""
    from rich.text import Text

    line = Text(text)
    line.highlight_words(["FAILED"], "bold red")
    line.highlight_regex(r"^passed\b", "green")
    return line


def _table(lines: list[str]) -> RenderableType | None:
    """A table of indented lines whose columns are aligned; None where they are not."""
    from rich.table import Table

    columns = _columns(lines)
    if len(columns) < 2 or any(line.lstrip().startswith("|") for line in lines):  # one for Markdown stays as it is
        return None
    cells = [[line[first:last].strip() for first, last in columns] for line in lines]
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0), pad_edge=False)
    for index in range(len(columns)):
        below = [row[index] for row in cells if row[index]]
        words = max(map(len, below), default=0) > _MAX_CELL
        numbers = not words and sum(bool(_NUMBER.match(cell)) for cell in below) * 2 > len(below)
        table.add_column(
            justify="right" if numbers and len(columns) > 2 else "left",
            style="dim" if words else "cyan" if numbers else None,
            no_wrap=not words,
        )
    for row in cells:
        table.add_row(*row)
    return table


def _columns(lines: list[str]) -> list[tuple[int, int]]:
    """Where columns of text begin and end: between two of them every line is blank over at least two places."""
    width = max(map(len, lines), default=0)
    blank = [all(line[place : place + 1].strip() == "" for line in lines) for place in range(width)] + [True] * _GAP
    found, first = [], None
    for place in range(width + 1):
        if first is None and not blank[place]:
            first = place
        elif first is not None and all(blank[place : place + _GAP]):
            found.append((first, place))
            first = None
    return found
