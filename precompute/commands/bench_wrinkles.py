"""`gube bench wrinkles`: the wrinkle layer with parts left out."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from runtime.arguments import add_database

if TYPE_CHECKING:
    from runtime.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "leave out parts of the wrinkle layer, one after the other, and learn it again"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_database(parser)


def run(options: argparse.Namespace) -> Report:
    """Learn the variants and print the table."""
    from precompute.wrinkle_comparison.ablations import ablate_file, table
    from runtime.report import Progress, Report, machine_description, numbers_of
    from runtime.terminal import say

    with Progress(sys.stderr) as progress:
        rows = ablate_file(options.database, report=progress)
    machine = machine_description()
    say(f"{options.database.stem}, {machine['cpu']}, {machine['date'][:10]}:\n\n{table(rows)}")
    return Report(numbers_of(rows[0]), rows)
