"""The command ``gube``: finds the file of the command that is asked for and runs it.

Each command is one file with ``SUMMARY``, a line for the help; ``add_arguments(parser)``; and ``run(options)``, which
returns a :class:`runtime.output.report.Report`. These files import at their top only what their arguments need, so
that the help and bad arguments are answered at once, and no command pays for another.

This table is the only place below ``precompute`` that names a module of it.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

__all__ = ["COMMANDS", "main", "parser"]

COMMANDS: Mapping[str, str] = {
    "demo": "precompute.commands.demo",
    "new": "runtime.cli.commands.new",
    "measure": "runtime.cli.commands.measure",
    "sew": "runtime.cli.commands.sew",
    "simulate": "runtime.cli.commands.simulate",
    "precompute": "precompute.commands.precompute",
    "play": "runtime.cli.commands.play",
    "view": "runtime.cli.commands.view",
    "bake": "runtime.cli.commands.bake",
    "export": "runtime.cli.commands.export",
    "info": "runtime.cli.commands.info",
    "check": "runtime.cli.commands.check",
    "compare": "precompute.commands.compare",
    "plan": "precompute.commands.plan",
    "validate": "precompute.commands.validate",
    "fabric": "precompute.commands.fabric_laboratory",
    "stability": "precompute.commands.stability",
    "fuzz": "precompute.commands.fuzz",
    "bench frame": "precompute.commands.bench_frame",
    "bench garment": "precompute.commands.bench_garment",
    "bench solver": "precompute.commands.bench_solver",
    "bench failures": "precompute.commands.bench_failures",
    "bench stress": "precompute.commands.bench_stress",
    "bench clips": "precompute.commands.bench_clips",
}
"""The file of each command, in the order of the help. Of two words, the first names a group."""

GROUPS: Mapping[str, str] = {"bench": "measure the parts of the project and print a table"}
"""Summaries of groups."""

OPTIONS: Mapping[tuple[str, str], str] = {
    ("play", "truth"): "precompute.commands.play_truth",
    ("view", "truth"): "precompute.commands.view_truth",
    ("export", "truth"): "precompute.commands.export_truth",
}
"""Where ``run`` is found instead when a command gets a certain option: it needs more than the command itself does."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: the words after ``gube``; None for those of the process.

    Returns:
        The exit status: 0, 1 for a failed run, 2 for bad input.
    """
    words = sys.argv[1:] if arguments is None else arguments
    options = parser(words).parse_args(words)

    from concurrent.futures import BrokenExecutor

    from assets.extras import missing_library
    from pbd.errors import InputError
    from runtime.output.outputs import check_file
    from runtime.output.report import write_report
    from runtime.output.terminal import say_error

    try:
        with _ended_by_signals():
            if options.json:
                check_file(options.json, key="--json")
            report = _command_module(options).run(options)
            if options.json:
                write_report(options.json, options.command, report.figures, report.rows)
    except InputError as error:
        say_error(f"gube {options.command}", error)
        return 2
    except ModuleNotFoundError as error:
        missing = missing_library(error.name or "")
        if missing is None:
            raise
        say_error(f"gube {options.command}", missing)
        return 2
    except OSError as error:  # a full disk, or one that went away
        say_error(f"gube {options.command}", _disk_problem(error))
        return 1
    except BrokenExecutor as error:
        # A pool of this machine says it in words of its library, a cluster in ours.
        ended = "a simulating process was ended from outside, perhaps for want of memory"
        why = str(error) if type(error) is BrokenExecutor else ended
        say_error(
            f"gube {options.command}",
            f"{why}; what was finished is kept, and the same command goes on from there",
        )
        return 1
    except KeyboardInterrupt:
        say_error("", "stopped")
        return 1
    return 0 if report.passed else 1


def parser(words: Sequence[str] = ()) -> argparse.ArgumentParser:
    """The parser of ``gube``; what it parses has ``command``, the first word, and of a group ``table``, the second.

    Args:
        words: those after ``gube``. If the first one is a command or a group, the parser knows no other, so that only
            its files are imported.
    """
    whole = argparse.ArgumentParser(
        prog="gube",
        description="Real-time clothing with the folds of an offline simulation.",
        epilog="Exit status: 0, 1 for a failed run, 2 for bad input. 'gube COMMAND --help' explains a command.",
    )
    whole.add_argument("--version", action=_Version, help="show the version and exit")
    commands = whole.add_subparsers(dest="command", required=True, metavar="COMMAND")
    groups: dict[str, Any] = {}
    for name, module in _asked_for(words):
        group, _, last = name.rpartition(" ")
        if group and group not in groups:
            one = commands.add_parser(group, help=GROUPS[group], description=_sentence(GROUPS[group]))
            groups[group] = one.add_subparsers(dest="table", required=True, metavar="TABLE")
        file = import_module(module)
        one = groups.get(group, commands).add_parser(last, help=file.SUMMARY, description=_sentence(file.SUMMARY))
        file.add_arguments(one)
        one.add_argument(
            "--json", type=Path, metavar="FILE", help="a file for every printed figure (default: no such file)"
        )
        one.set_defaults(module=module)
    return whole


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """In the block the signals that end a process do what Ctrl-C does, so that nothing is left half-done."""
    if threading.current_thread() is not threading.main_thread():  # only that one may set them
        yield
        return
    ending = [one for one in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(one) is signal.SIG_DFL]
    for one in ending:
        signal.signal(one, signal.default_int_handler)
    try:
        yield
    finally:
        for one in ending:
            signal.signal(one, signal.SIG_DFL)


def _asked_for(words: Sequence[str]) -> Iterator[tuple[str, str]]:
    """The commands that the first word can mean, and their files."""
    found = [(name, module) for name, module in COMMANDS.items() if words and name.split()[0] == words[0]]
    return iter(found or COMMANDS.items())


def _command_module(options: argparse.Namespace) -> Any:
    """The module whose ``run`` does what is asked for."""
    for (command, option), module in OPTIONS.items():
        if options.command == command and getattr(options, option):
            return import_module(module)
    return import_module(options.module)


def _sentence(summary: str) -> str:
    return f"{summary[:1].upper()}{summary[1:]}."


class _Version(argparse.Action):
    """Prints the version, and looks it up no sooner."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, default=argparse.SUPPRESS, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from runtime.output.report import package_version
        from runtime.output.terminal import say

        say(f"gube {package_version('gube')}")
        parser.exit()


def _disk_problem(error: OSError) -> str:
    problem = (error.strerror or str(error)).lower()
    return f"{error.filename}: {problem}" if error.filename else problem
