"""`gube info`: the content of a wrinkle database and its figures."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_all, add_database

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "print the content of a wrinkle database and its measured quality"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_database(parser)
    add_all(parser)


def run(options: argparse.Namespace) -> Report:
    """Print what a database holds."""
    from runtime.output.database_info import info_text
    from runtime.output.report import Report
    from runtime.output.terminal import say

    text, figures = info_text(options.database, everything=options.all)
    say(text.removesuffix("\n"))
    return Report(figures)
