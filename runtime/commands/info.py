"""`gube info`: the content of a wrinkle database and its figures."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from runtime.arguments import add_database

if TYPE_CHECKING:
    from runtime.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "print the content of a wrinkle database and its measured quality"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_database(parser)


def run(options: argparse.Namespace) -> Report:
    """Print what a database holds."""
    from runtime.info import info_text
    from runtime.report import Report
    from runtime.terminal import say

    text, figures = info_text(options.database)
    say(text.removesuffix("\n"))
    return Report(figures)
