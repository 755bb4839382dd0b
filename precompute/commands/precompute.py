"""`gube precompute`: a wrinkle database, learned from the simulations of a scene."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_file, add_scheduler

if TYPE_CHECKING:
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "learn the wrinkles of a scene's garment and write its wrinkle database"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("scene", type=Path, nargs="?", metavar="SCENE", help="a scene file (.toml)")
    parser.add_argument(
        "--all",
        type=Path,
        metavar="WARDROBE",
        help="instead of a scene a file (.toml) of many: learn a database from each (default: only the scene)",
    )
    add_output_file(parser, "DB.h5", "the wrinkle database, a file ending in .h5; with --all a folder for all of them")
    parser.add_argument(
        "--cache",
        type=Path,
        metavar="DIR",
        help="a folder that keeps the simulated runs (default: .gube-cache beside the database)",
    )
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        default=os.cpu_count() or 1,
        help="processes that simulate at a time [-] (default: one for each core, here %(default)s)",
    )
    add_scheduler(parser)


def run(options: argparse.Namespace) -> Report:
    """Simulate, learn, and print what the new database holds."""
    from pbd.errors import InputError
    from runtime.output.outputs import check_file, check_folder
    from runtime.output.report import Progress, Report

    if options.workers < 1:
        raise InputError("too few processes", key="--workers", received=options.workers, expected="at least 1")
    if (options.scene is None) == (options.all is None):
        raise InputError("nothing to learn from, or too much", key="SCENE", expected="a scene file, or --all WARDROBE")
    if options.cache is not None:
        check_folder(options.cache, "--cache")
    if options.all is not None:
        return _run_all(options)
    check_file(options.output, ".h5")
    with Progress(sys.stderr) as progress:
        progress.later(f"reading {options.scene}")
        from assets.io.scene import load_scene
        from precompute.cluster import workers_of
        from precompute.learning.pipeline import default_cache, precompute
        from precompute.learning.stages import stage_figures, stage_table
        from runtime.output.database_info import info_text
        from runtime.output.terminal import say

        scene = load_scene(options.scene)
        progress("setting up the garment and its body")
        cache = options.cache or default_cache(options.output)
        with workers_of(options.scheduler, options.workers, cache) as workers:
            made = precompute(scene, options.output, cache=cache, workers=workers, report=progress)
    text, figures = info_text(options.output)
    say(text)
    say(f"where the time went:\n{stage_table(made.stages)}")
    say(f"To see it: gube play {options.output} --truth\nFor others: gube bake {options.output} -o OUT.glb")
    return Report(figures | stage_figures(made.stages))


def _run_all(options: argparse.Namespace) -> Report:
    """Learn a database from each scene of a wardrobe."""
    from assets.io.wardrobe import load_wardrobe
    from precompute.cluster import workers_of
    from precompute.learning.pipeline import default_cache
    from precompute.wardrobe_learning import learn_wardrobe, wardrobe_rows, wardrobe_text, write_wardrobe
    from runtime.output.outputs import check_folder
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    check_folder(options.output)
    scenes = load_wardrobe(options.all)
    page = options.output / "wardrobe.html"
    cache = options.cache or default_cache(page)
    with Progress(sys.stderr) as progress, workers_of(options.scheduler, options.workers, cache) as workers:
        outcomes = learn_wardrobe(scenes, options.output, cache, workers, progress)
    write_wardrobe(page, outcomes)
    say(f"{wardrobe_text(outcomes)}\n{page}")
    failed = sum(bool(one.problem) for one in outcomes)
    figures = {"databases": float(len(outcomes) - failed), "failed_databases": float(failed)}
    return Report(figures, wardrobe_rows(outcomes), passed=not failed)
