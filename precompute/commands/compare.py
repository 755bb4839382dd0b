"""`gube compare`: methods on the same scenes, or on the held-out motion of a database."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_scheduler, duration, positive

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "compare methods: draw the error of each over its cost"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "sources",
        nargs="*",
        metavar="SCENE",
        help="names of built-in scenes, which may stand beside one database (.h5); or a database or scene file (.toml) "
        "alone (default: all built-in scenes)",
    )
    parser.add_argument(
        "-o",
        dest="output",
        type=Path,
        metavar="DIR",
        help="a folder for the page (default: out/compare for built-in scenes, the current folder for a database)",
    )
    parser.add_argument(
        "--methods",
        metavar="LIST",
        help="methods of built-in scenes, parted by commas; each is NAME or NAME@EDGESxSUBSTEPSxPASSES "
        "(default: all, without runs of over 20 s)",
    )
    parser.add_argument(
        "--budget",
        type=duration,
        metavar="TIME",
        help="time for all runs of built-in scenes [s], [min] or [h], such as 90s, 15m or 1h (default: 15m)",
    )
    parser.add_argument(
        "--wrinkles",
        action="store_true",
        help="compare other methods that make the fine mesh of the database from the coarse one (default: off)",
    )
    parser.add_argument(
        "--blind",
        action="store_true",
        help="also draw 12 pairs of the truth and ours without names, in random order; the key goes to a folder of its "
        "own (default: off)",
    )
    parser.add_argument(
        "--answers",
        type=Path,
        metavar="FILE",
        help="only count how often somebody told the truth in the pairs of --blind: a file with a letter, A or B, on a "
        "line for each (default: no such file)",
    )
    parser.add_argument(
        "--clip",
        metavar="NAME",
        help="name of a clip to compare in, from which nothing was learned (default: the first two that are held out)",
    )
    parser.add_argument(
        "--seconds",
        type=positive,
        metavar="S",
        help="compare in only so much of each motion [s] (default: all of it)",
    )
    add_scheduler(parser)


def run(options: argparse.Namespace) -> Report:
    """Find out which kind of comparison is asked for and run it."""
    from pbd.errors import InputError
    from runtime.output.outputs import check_folder

    databases = [name for name in options.sources if name.lower().endswith((".h5", ".toml"))]
    scenes = [name for name in options.sources if name not in databases]
    of_database = options.wrinkles or (bool(databases) and not scenes)
    for name in ("methods", "budget") if of_database else () if databases else ("clip",):
        if getattr(options, name) is not None:
            expected = "built-in scenes" if of_database else "a database (.h5)"
            raise InputError("cannot be chosen here", key=f"--{name}", received=options.sources, expected=expected)
    if len(databases) > 1 or (options.wrinkles and (scenes or not databases)):
        raise InputError("one database at a time", key="SCENE", received=options.sources, expected="DB.h5")
    if options.scheduler is not None and (options.wrinkles or not of_database):
        expected = "a database (.h5)"
        raise InputError("cannot be chosen here", key="--scheduler", received=options.sources, expected=expected)
    for name in ("blind", "answers") if options.wrinkles or not of_database else ():
        if getattr(options, name):
            expected = "a database (.h5), without --wrinkles"
            raise InputError("cannot be chosen here", key=f"--{name}", received=options.sources, expected=expected)
    options.output = options.output or (Path(".") if of_database else Path("out/compare"))
    options.database = Path(databases[0]) if databases else None
    check_folder(options.output)
    if options.answers is not None:
        return _blind_answers(options)
    if not of_database:
        return _compare_scenes(options, scenes)
    return _compare_wrinkles(options) if options.wrinkles else _compare_database(options)


def _compare_scenes(options: argparse.Namespace, scenes: Sequence[str]) -> Report:
    from precompute.method_comparison.scene_compare import BUDGET, compare_scenes
    from precompute.method_comparison.scene_page import (
        comparison_figures,
        comparison_text,
        fabric_sections,
        wrinkle_sections,
        write_comparison,
    )
    from precompute.wrinkle_comparison.compare_database import check_motions, compare_file
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    methods, output = [] if options.methods is None else options.methods.split(","), options.output
    with Progress(sys.stderr) as progress:
        if options.database is not None:
            check_motions(options.database, options.clip, seconds=options.seconds)
        budget = options.budget or BUDGET
        found = compare_scenes(
            scenes, output, methods=methods, budget_s=budget, seconds=options.seconds, report=progress
        )
        layer = None
        if options.database is not None:
            layer = compare_file(options.database, output, clip=options.clip, seconds=options.seconds, report=progress)
        more = wrinkle_sections(layer) + ([] if scenes else fabric_sections(output, progress))
        progress("drawing")
        write_comparison(output, found, more)
    say("\n\n".join(comparison_text(one) for one in found))
    say(f"\n{output / 'compare.html'}")
    return Report(comparison_figures(found), [point.row(one.scene.name) for one in found for point in one.points])


def _compare_wrinkles(options: argparse.Namespace) -> Report:
    from pbd.errors import InputError
    from precompute.wrinkle_comparison.wrinkle_comparison import compare_wrinkles_file
    from precompute.wrinkle_comparison.wrinkle_page import wrinkle_rows, wrinkle_verdict, write_wrinkles
    from runtime.output.report import Progress, Report, numbers_of
    from runtime.output.terminal import say

    for name in ("clip", "seconds"):
        if getattr(options, name) is not None:
            raise InputError("cannot be chosen with --wrinkles", key=f"--{name}", expected="the held-out motion")
    with Progress(sys.stderr) as progress:
        progress.later(f"reading {options.database}")
        found = compare_wrinkles_file(options.database, options.output, report=progress)
        page = options.output / "wrinkles.html"
        progress("drawing")
        write_wrinkles(page, found)
    say(wrinkle_verdict(found))
    say(f"\n{page}")
    rows = wrinkle_rows(found)
    return Report(numbers_of(rows[0]), rows)


def _blind_answers(options: argparse.Namespace) -> Report:
    from precompute.wrinkle_comparison.blind import blind_figures
    from runtime.output.report import Report
    from runtime.output.terminal import say

    figures = blind_figures(options.output, options.answers)
    say(
        f"{figures['blind_right_percent']:.0f} % of the answers are right; "
        f"by guessing so many or more are right in {figures['blind_chance_percent']:.2g} % of all trials"
    )
    return Report(figures)


def _compare_database(options: argparse.Namespace) -> Report:
    from precompute.cluster import workers_of
    from precompute.wrinkle_comparison.blind import write_blind
    from precompute.wrinkle_comparison.compare_database import compare_file
    from precompute.wrinkle_comparison.comparison_page import verdict, write_comparison
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    clip, seconds = options.clip, options.seconds
    with Progress(sys.stderr) as progress, workers_of(options.scheduler, 2) as workers:
        progress.later(f"reading {options.database}")
        found = compare_file(
            options.database, options.output, clip=clip, seconds=seconds, workers=workers, report=progress
        )
        page = options.output / "compare.html"
        progress("drawing")
        write_comparison(page, found)
    say(verdict(found))
    say(f"\n{page}")
    if options.blind:
        first = found.motions[0]
        ours = first.method("").frames
        assert ours is not None
        *_, key = write_blind(options.output, first.truth, ours)
        say(f"{options.output / 'blind'}: which row of each picture is the truth? Write A or B, a letter a line.")
        say(f"then: gube compare {options.database} -o {options.output} --answers FILE (key: {key})")
    rows = [
        {"motion": one.motion, "method": m.name, "frame_ms_p50": m.frame_ms, **m.settings, **m.figures}
        for one in found.motions
        for m in one.methods
    ]
    return Report(found.figures, rows)
