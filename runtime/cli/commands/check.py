"""`gube check`: every part of a wrinkle database, checked."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_database

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "check every part of a wrinkle database"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_database(parser)


def run(options: argparse.Namespace) -> Report:
    """Check a database and print a line for each check."""
    from runtime.output.database_info import check_database
    from runtime.output.report import Report
    from runtime.output.terminal import say

    checks = check_database(options.database)
    for check in checks:
        say(f"{'passed' if check.passed else 'FAILED'}  {check.check}: {check.detail}")
    return Report(rows=[check._asdict() for check in checks], passed=all(check.passed for check in checks))
