"""Types and groups of command line arguments that several commands share.

A command's help says of every option its unit in brackets, ``[-]`` for a plain number, and its default.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

__all__ = [
    "add_all",
    "add_database",
    "add_motion",
    "add_output_file",
    "add_output_folder",
    "add_playback",
    "add_scheduler",
    "angle",
    "duration",
    "edge_count",
    "not_negative",
    "positive",
]


def add_database(parser: argparse.ArgumentParser) -> None:
    """Add the argument ``database``, the path of a wrinkle database."""
    parser.add_argument("database", type=Path, metavar="DB.h5", help="a wrinkle database")


def add_all(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--all`` of a command that prints the figures that matter most."""
    parser.add_argument(
        "--all", action="store_true", help="print every figure, in the words of the glossary (default: off, a few)"
    )


def add_output_file(parser: argparse.ArgumentParser, metavar: str, content: str, default: str | None = None) -> None:
    """Add the option ``-o`` of a command that writes one file; it is required if there is no default.

    Args:
        parser: of the command.
        metavar: name of the file in the help; its ending is the kind of file.
        content: the file's content, in words.
        default: the file without the option.
    """
    parser.add_argument(
        "-o",
        dest="output",
        type=Path,
        required=default is None,
        default=None if default is None else Path(default),
        metavar=metavar,
        help=f"{content} ({'required' if default is None else 'default: %(default)s'})",
    )


def add_output_folder(parser: argparse.ArgumentParser, default: str, content: str) -> None:
    """Add the option ``-o`` of a command that writes several files.

    Args:
        parser: of the command.
        default: the folder without the option.
        content: the files that the command writes there, in words.
    """
    parser.add_argument(
        "-o", dest="output", type=Path, default=Path(default), metavar="DIR", help=f"{content} (default: %(default)s)"
    )


def add_playback(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a command that plays a database, with its wrinkles or as plain cloth."""
    add_motion(parser)
    parser.add_argument(
        "--wrinkles",
        action="store_true",
        help="play the learned wrinkles even where plain cloth is the better choice (default: off)",
    )


def add_motion(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say which database is played, on which body, in which motion and fabric."""
    add_database(parser)
    parser.add_argument(
        "--character", type=Path, metavar="FILE", help="a file with body and clips (default: the body of the scene)"
    )
    parser.add_argument("--clip", metavar="NAME", help="name of the clip that is played (default: all held-out clips)")
    parser.add_argument(
        "--fabric", metavar="NAME", help="name of a fabric of the database (default: the garment's own fabric)"
    )
    parser.add_argument(
        "--seconds", type=positive, metavar="S", help="play only so much of the motion [s] (default: all of it)"
    )


def add_scheduler(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--scheduler`` of a command whose work can be done on a cluster."""
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="address of a Dask scheduler, whose workers do the work; 'local' starts one on this machine "
        "(default: processes of this machine without one)",
    )


def positive(text: str) -> float:
    """A number above 0.

    Raises:
        argparse.ArgumentTypeError: anything else.
    """
    value = not_negative(text, expected := "a number above 0")
    if value == 0.0:
        raise argparse.ArgumentTypeError(f"received {text!r}, expected {expected}")
    return value


def not_negative(text: str, expected: str = "a number of 0 or above") -> float:
    """A number of 0 or above; ``expected`` is what the message asks for.

    Raises:
        argparse.ArgumentTypeError: anything else.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"received {text!r}, expected {expected}")
    return value


def duration(text: str) -> float:
    """A time with its unit, such as 90s, 15m or 1h, in seconds.

    Raises:
        argparse.ArgumentTypeError: another unit or none, or a number that is not above 0.
    """
    unit = {"s": 1.0, "m": 60.0, "h": 3600.0}.get(text[-1:])
    try:
        value = float(text[:-1]) * unit if unit else math.nan
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"received {text!r}, expected a time such as 90s, 15m or 1h")
    return value


def angle(text: str) -> float:
    """An angle between 0 and 180 [deg].

    Raises:
        argparse.ArgumentTypeError: anything else.
    """
    value = positive(text)
    if value >= 180.0:
        raise argparse.ArgumentTypeError(f"received {text!r}, expected a number above 0 and below 180")
    return value


def edge_count(text: str) -> int:
    """A number of edges, from 4 to 400.

    Raises:
        argparse.ArgumentTypeError: anything else.
    """
    if not (text.isdecimal() and 4 <= int(text) <= 400):
        raise argparse.ArgumentTypeError(f"received {text!r}, expected a whole number, 4 to 400")
    return int(text)
