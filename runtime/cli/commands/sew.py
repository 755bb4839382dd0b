"""`gube sew`: a pattern, sewn on a body and draped."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from assets.sewing import DEFAULT_EDGE
from runtime.cli.arguments import add_output_file, not_negative, positive

if TYPE_CHECKING:
    from assets.patterns.pattern import Pattern
    from assets.sewing.body import StandingBody
    from runtime.output.report import Report

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "sew a pattern on a body, drape it and write the garment"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "pattern", metavar="PATTERN", help="a GarmentCode specification (.json), a drawing (.svg, .dxf), or draft:NAME"
    )
    parser.add_argument(
        "-b",
        dest="body",
        required=True,
        metavar="BODY",
        help="a character (glTF, USD), builtin:mannequin, a vertex sequence (.npz, .mdd, USD) or a closed surface "
        "(.obj) (required)",
    )
    add_output_file(parser, "GARMENT.npz", "the sewn garment")
    parser.add_argument(
        "--edge",
        type=positive,
        default=DEFAULT_EDGE,
        metavar="METRES",
        help="length of the garment's edges [m]; finer ones take a scene's subdivisions or a smaller value "
        "(default: %(default)s, which a game simulates)",
    )
    parser.add_argument(
        "--fabric", default="cotton", metavar="NAME", help="a fabric, or a file of one (default: %(default)s)"
    )
    parser.add_argument(
        "--ease",
        type=not_negative,
        metavar="METRES",
        help="of a draft: how much wider than the body it is, around [m] (default: the draft's own)",
    )
    parser.add_argument(
        "--param",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="another parameter of a draft, or a measure of the body that was taken by hand, such as waist=0.72 [m]; "
        "may be repeated (default: the draft's own, and what is measured)",
    )
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE.png",
        help="draw the pattern, the panels around the body and the draped garment (default: no picture)",
    )


def run(options: argparse.Namespace) -> Report:
    """Sew a pattern and write the garment."""
    import numpy as np

    from assets.extras import require_extra
    from assets.loading import load_standing_body
    from assets.sewing.sewing import SewingError, sew
    from assets.sewing.sewn_file import write_sewn
    from runtime.output.figures import figure_lines
    from runtime.output.outputs import check_file
    from runtime.output.report import Progress, Report
    from runtime.output.terminal import say, say_error

    check_file(options.output, ".npz")
    if options.picture:
        check_file(options.picture, ".png", key="--picture")
        require_extra("report", options.picture)
    began = time.monotonic()
    body = load_standing_body(options.body)
    pattern = _pattern_of(options, body)
    fault = None
    with Progress(sys.stderr) as progress:
        try:
            sewn = sew(pattern, body, options.fabric, edge_length=options.edge, report=progress)
        except SewingError as error:
            fault, sewn = error, error.garment
    figures = {} if sewn is None else dict(sewn.figures)
    figures["sewing_s"] = time.monotonic() - began
    say("\n".join(figure_lines(figures)))
    if options.picture:
        from runtime.draw.sewing_picture import draw_sewing

        draw_sewing(options.picture, pattern, body, sewn)
        say(f"picture in {options.picture}")
    if fault is not None or sewn is None:
        say_error("", f"{pattern.name} did not come out whole on {body.name}: {fault}")
        return Report(figures, passed=False)
    write_sewn(options.output, sewn)
    sides = sewn.garment.vertices[sewn.garment.faces]
    edge = 1e3 * float(np.median(np.linalg.norm(np.roll(sides, -1, axis=1) - sides, axis=2)))
    say(f"garment of {len(sewn.garment.vertices):,} vertices, edges of {edge:.0f} mm, in {options.output}")
    return Report(figures)


def _pattern_of(options: argparse.Namespace, body: StandingBody) -> Pattern:
    """The pattern that is asked for, from a file or drafted for the body."""
    from assets.patterns.load import load_pattern
    from pbd.errors import InputError

    parameters = dict(_parameter(text) for text in options.param)
    if options.ease is not None:
        parameters["ease"] = options.ease
    if options.pattern.startswith("draft:"):
        from assets.anthropometry import measure
        from assets.measures import MEASURES
        from assets.patterns.drafts import draft, draft_parameters

        name = options.pattern.removeprefix("draft:")
        known = [parameter.name for parameter in draft_parameters(name)]
        by_hand = {key: value for key, value in parameters.items() if key in MEASURES and key not in known}
        if unknown := sorted(parameters.keys() - by_hand.keys() - set(known)):
            expected = f"one of {', '.join(known)}, or a measure: {', '.join(MEASURES)}"
            raise InputError("no such parameter", key=f"--param, draft {name}", received=unknown[0], expected=expected)
        return draft(
            name, measure(body, by_hand), **{key: parameters[key] for key in parameters.keys() - by_hand.keys()}
        )
    if parameters:
        expected = "none: only a draft (draft:NAME) has parameters"
        raise InputError("a parameter of a file", key="--param", received=sorted(parameters), expected=expected)
    return load_pattern(options.pattern)


def _parameter(text: str) -> tuple[str, float]:
    from pbd.errors import InputError

    key, _, value = text.partition("=")
    try:
        return key.strip().replace("-", "_"), float(value)
    except ValueError:
        raise InputError("not a parameter", key="--param", received=text, expected="KEY=NUMBER") from None
