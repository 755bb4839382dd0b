"""`gube new`: a scene file for a character and garments of one's own."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_file

if TYPE_CHECKING:
    from runtime.output.report import Report
    from runtime.setup.new_scene import NewScene

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "look at a character and garments and write a scene file that works"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "character", metavar="CHARACTER", help="a character (.glb), a vertex sequence (.npz), or builtin:mannequin"
    )
    parser.add_argument(
        "garments", nargs="+", metavar="GARMENT", help="a garment (.obj, .glb, .npz of `gube sew`, or builtin:NAME)"
    )
    add_output_file(parser, "SCENE.toml", "the scene file; converted files are written beside it")


def run(options: argparse.Namespace) -> Report:
    """Write a scene file and print what was guessed."""
    import sys

    from pbd.errors import InputError
    from runtime.output.outputs import check_file
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say

    check_file(options.output, ".toml")
    if options.output.exists():
        expected = "a new file: a scene that somebody has changed is not written over"
        raise InputError("exists already", key="-o", received=str(options.output), expected=expected)
    with Progress(sys.stderr) as progress:
        progress.later(f"looking at {options.character}")
        from runtime.setup.new_scene import write_new_scene

        made = write_new_scene(options.character, options.garments, options.output, progress.later)
    say(made.text, verbatim=True)
    for guess in made.garments:
        for note in guess.notes:
            say(f"note: {guess.garment.name}: {note}")
    database = options.output.with_suffix(".h5")
    say(f"scene in {options.output}; to go on:")
    say(f"  gube simulate {options.output} --seconds 3")
    say(f"  gube precompute {options.output} -o {database}")
    say(f"  gube export {database} -o {options.output.with_suffix('')}")
    return Report(rows=_rows(made))


def _rows(made: NewScene) -> list[dict[str, float | str]]:
    """A row of guesses for each garment."""
    return [
        {
            "garment": guess.garment.name,
            "character": made.body.body.name,
            "read_as": str(guess.placement),
            "kind": guess.kind,
            "fabric": guess.fabric,
            "attach": guess.attach,
            "coarse_subdivisions": guess.coarse_subdivisions,
            "gap_mm_p50": 1e3 * guess.fit.gap_p50,
            "inside_percent": 100.0 * guess.fit.inside_share,
            "held_out": made.motions.held_out.name,
        }
        for guess in made.garments
    ]
