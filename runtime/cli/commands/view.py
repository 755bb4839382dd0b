"""`gube view`: a garment in the browser, played, scrubbed and dragged."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.arguments import add_output_folder

if TYPE_CHECKING:
    from runtime.output.report import Report
    from runtime.viewer.opened_view import Truths

__all__ = ["SUMMARY", "add_arguments", "run", "view"]

SUMMARY = "show a database or a scene in the browser: play, scrub, drag, compare"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "file",
        type=Path,
        nargs="?",
        metavar="FILE",
        help="a wrinkle database (.h5), a scene or a saved view (.toml) (default: what `gube demo` made in "
        "out/demo; without that, a skirt that comes with the package)",
    )
    add_output_folder(parser, "out/view", "a folder for saved pictures, clips and views")
    parser.add_argument(
        "--truth",
        action="store_true",
        help="show the fine simulation of each motion too; it is simulated first if it is not recorded yet "
        "(default: off)",
    )


def run(options: argparse.Namespace) -> Report:
    """Serve until the command is interrupted."""
    return view(options, None)


def view(options: argparse.Namespace, truths: Truths | None) -> Report:
    """Serve until the command is interrupted.

    Args:
        options: of the command.
        truths: finds the fine simulations that are shown; None shows none.
    """
    import threading

    from assets.extras import require_extra

    require_extra("view")
    from runtime.output.outputs import check_folder
    from runtime.output.report import Report
    from runtime.output.terminal import say
    from runtime.viewer.opened_view import open_source
    from runtime.viewer.viewer import Viewer

    check_folder(options.output)
    opened = open_source(options.file, truths)
    viewer = Viewer(opened, options.output)
    say("\n".join((opened.source.title, opened.source.notice, f"open {viewer.address} (Ctrl-C ends)")))
    try:
        viewer.run(threading.Event())
    except KeyboardInterrupt:  # the way to end it
        say("")
    finally:
        viewer.close()
    return Report()
