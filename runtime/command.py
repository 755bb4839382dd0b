"""The command ``gube``.

A command is a function that takes the parsed arguments and returns a :class:`runtime.report.Report`. It imports what it
needs inside itself, so that no command pays for another; that is also where ``precompute`` may be reached.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from pbd.errors import InputError
from runtime.report import Report, package_version, write_report

__all__ = ["main"]

Handler = Callable[[argparse.Namespace], Report]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: the words after ``gube``; None for those of the process.

    Returns:
        The exit status: 0, 1 for a failed run, 2 for bad input.
    """
    options = _parser().parse_args(arguments)
    try:
        if options.json:
            _check_folder(options.json)
        report = options.handler(options)
        if options.json:
            write_report(options.json, options.command, report.figures, report.rows)
    except InputError as error:
        print(f"gube {options.command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 1
    return 0 if report.passed else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="gube",
        description="Real-time clothing with the folds of an offline simulation.",
        epilog="Exit status: 0, 1 for a failed run, 2 for bad input.",
    )
    parser.add_argument("--version", action="version", version=f"gube {package_version('gube')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    simulate = _add_command(commands, "simulate", _simulate, "simulate a scene")
    simulate.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    simulate.add_argument("--explain", action="store_true", required=True, help="only print the resolved scene")

    info = _add_command(commands, "info", _info, "what a wrinkle database holds and how good it is")
    info.add_argument("database", type=Path, metavar="DB.h5", help="wrinkle database")

    check = _add_command(commands, "check", _check, "check a wrinkle database whole")
    check.add_argument("database", type=Path, metavar="DB.h5", help="wrinkle database")
    return parser


def _add_command(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, handler: Handler, words: str
) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=words, description=words.capitalize() + ".")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure that is printed to FILE")
    parser.set_defaults(handler=handler)
    return parser


def _check_folder(path: Path) -> None:
    """Refuse now what would lose the figures of a long run later."""
    if path.is_dir() or not path.resolve().parent.is_dir():
        raise InputError("cannot be written", key="--json", received=str(path), expected="a file in an existing folder")


def _simulate(options: argparse.Namespace) -> Report:
    from assets.scene import load_scene, scene_text

    print(scene_text(load_scene(options.scene)), end="")
    return Report()


def _info(options: argparse.Namespace) -> Report:
    from runtime.info import info_text

    text, figures = info_text(options.database)
    print(text, end="")
    return Report(figures)


def _check(options: argparse.Namespace) -> Report:
    from runtime.info import check_database

    checks = check_database(options.database)
    for check in checks:
        print(f"{'passed' if check.passed else 'FAILED'}  {check.check}: {check.detail}")
    return Report(rows=[check._asdict() for check in checks], passed=all(check.passed for check in checks))
