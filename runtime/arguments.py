"""The words after ``gube``: commands, what they take and what it means."""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path

from runtime.report import package_version

__all__ = ["parser"]


def parser() -> argparse.ArgumentParser:
    """The parser of ``gube``: ``command`` and, of a bench, ``table`` say which of them it found."""
    whole = argparse.ArgumentParser(
        prog="gube",
        description="Real-time clothing with the folds of an offline simulation.",
        epilog="Exit status: 0, 1 for a failed run, 2 for bad input.",
    )
    whole.add_argument("--version", action="version", version=f"gube {package_version('gube')}")
    commands = whole.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = _add_command(commands, "demo", "the whole road on the built-in scene, up to pictures")
    demo.add_argument("-o", dest="output", type=Path, default=Path("out/demo"), metavar="DIR", help="default: out/demo")

    simulate = _add_command(commands, "simulate", "simulate the garment of a scene and bake it")
    simulate.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    simulate.add_argument("-o", dest="output", type=Path, metavar="OUT", help=".glb, .pc2 or .obj; out/SCENE.glb")
    simulate.add_argument("--seconds", type=_positive, metavar="S", help="all of the motion; 5 s without a body")
    simulate.add_argument("--fine", action="store_true", help="simulate the subdivided mesh")
    simulate.add_argument("--explain", action="store_true", help="only print the resolved scene")

    precompute = _add_command(commands, "precompute", "learn the wrinkles of a scene's garment")
    precompute.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    precompute.add_argument(
        "-o", dest="output", type=Path, metavar="DB.h5", required=True, help="wrinkle database, ending in .h5"
    )
    precompute.add_argument("--cache", type=Path, metavar="DIR", help="simulated runs; .gube-cache beside the database")
    precompute.add_argument("--workers", type=int, metavar="N", default=os.cpu_count() or 1, help="processes at a time")

    play = _add_command(commands, "play", "play a wrinkle database without a window")
    _add_played(play)
    play.add_argument("-o", dest="output", type=Path, metavar="DIR", default=Path("out/play"), help="for pictures")
    mode = play.add_mutually_exclusive_group()
    mode.add_argument("--truth", action="store_true", help="beside the fine simulation, with figures of both")
    mode.add_argument("--loop", type=_positive, metavar="SECONDS", help="by the clock, with a gust; no pictures")
    play.add_argument("--hz", type=int, choices=(30, 60), default=60, help="frames a second of --loop")

    bake = _add_command(commands, "bake", "bake a played wrinkle database into an animation")
    _add_played(bake)
    bake.add_argument("-o", dest="output", type=Path, metavar="OUT", required=True, help=".glb, .pc2 or .obj")
    bake.add_argument("--rate", type=_positive, metavar="HZ", default=30.0, help="frames a second")

    info = _add_command(commands, "info", "what a wrinkle database holds and how good it is")
    info.add_argument("database", type=Path, metavar="DB.h5", help="wrinkle database")

    check = _add_command(commands, "check", "check a wrinkle database whole")
    check.add_argument("database", type=Path, metavar="DB.h5", help="wrinkle database")

    compare = _add_command(commands, "compare", "chart what every method costs against how right it is")
    compare.add_argument(
        "sources",
        nargs="*",
        metavar="SCENE",
        help="built-in scenes (default: all) and a database, or one (.h5, .toml) alone",
    )
    compare.add_argument(
        "-o", dest="output", type=Path, metavar="DIR", help="folder of compare.html (default: out/compare; . for .h5)"
    )
    compare.add_argument("--methods", metavar="LIST", help="NAME or NAME@EDGESxSUBSTEPSxPASSES, parted by commas")
    compare.add_argument("--budget", type=_duration, metavar="TIME", help="such as 90s, 15m (default), 1h")
    compare.add_argument("--wrinkles", action="store_true", help="of a database: other ways from coarse to fine")
    compare.add_argument("--clip", metavar="NAME", help="of a database: a clip that nothing was learned from")
    compare.add_argument("--seconds", type=_positive, metavar="S", help="cut the motion there")

    plan = _add_command(commands, "plan", "model no more than a scene needs")
    plan.add_argument(
        "source", type=Path, metavar="DB.h5|SCENE.toml", help="wrinkle database, or a scene to make one of"
    )
    plan.add_argument("--budget-ms", type=_positive, metavar="MS", default=2.0, help="for all garments (default: 2)")
    plan.add_argument(
        "--target", choices=("imperceptible", "accepted"), default="imperceptible", help="largest error: 1 or 10 px"
    )
    plan.add_argument("--distance", type=_positive, metavar="M", help="of the camera; the scene's own if absent")
    plan.add_argument("--fov", type=_angle, metavar="DEG", help="vertical field of view; the scene's own if absent")
    plan.add_argument("--garments", type=int, metavar="N", default=1, help="that share the budget")
    plan.add_argument(
        "-o", dest="output", type=Path, default=Path("out/plan"), metavar="DIR", help="for a scene's database"
    )

    validate = _add_command(commands, "validate", "hold the solver to physics that is known exactly")
    validate.add_argument("names", nargs="*", metavar="NAME", help="test of the table; all if absent")
    validate.add_argument("--solver", metavar="S", help="this solver alone; all if absent")
    validate.add_argument("--resolution", type=_edges, metavar="N", help="edges along the length (default: 20 and 40)")
    validate.add_argument("--param", action="append", default=[], metavar="KEY=VALUE", help="parameter of the test")
    validate.add_argument(
        "-o", dest="output", type=Path, default=Path("out/validate"), metavar="DIR", help="for pictures of curves"
    )

    fabric = _add_command(commands, "fabric", "measure a fabric in the instruments of a laboratory, or fit one")
    fabric.add_argument("fabric", metavar="NAME|FILE.json", help="preset, or measured fabric as ARCSim stores it")
    fabric.add_argument("--fit", type=Path, metavar="CURVES.csv", help="change it to what these measured curves say")
    fabric.add_argument("--solver", metavar="S", default="fem-stvk/quasi-static", help="default: %(default)s")
    fabric.add_argument(
        "-o", dest="output", type=Path, default=Path("out/fabric"), metavar="DIR", help="for curves and their picture"
    )

    stability = _add_command(commands, "stability", "map where methods fail, and how")
    stability.add_argument(
        "--method", action="append", metavar="M", help="solver, may be repeated (default: default and one explicit)"
    )
    stability.add_argument("--cell", metavar="MAP:X:Y", help="run this cell again and tell what goes and when")
    stability.add_argument(
        "-o", dest="output", type=Path, default=Path("out/stability"), metavar="DIR", help="folder of stability.html"
    )

    bench = commands.add_parser("bench", help="what each part is worth and costs", description="Print a table.")
    tables = bench.add_subparsers(dest="table", required=True, metavar="TABLE")
    ablations = _add_command(tables, "wrinkles", "the wrinkle layer with parts left out")
    ablations.add_argument("database", type=Path, metavar="DB.h5", help="wrinkle database, its runs beside it")

    solver = _add_command(tables, "solver", "time against stretch on a swinging square, by settings")
    solver.add_argument(
        "-o", dest="output", type=Path, default=Path("out/bench"), metavar="DIR", help="folder of solver.html and .csv"
    )
    solver.add_argument("--rivals", action="store_true", help="measure other engines too: pip install 'gube[rivals]'")

    failures = _add_command(tables, "failures", "where cloth engines fail, and how each method ends there")
    failures.add_argument("--solver", metavar="S", help="this one alone; the default and the classic ones if absent")
    failures.add_argument(
        "-o",
        dest="output",
        type=Path,
        metavar="OUT.csv",
        default=Path("out/bench/failures.csv"),
        help="table of all runs",
    )

    clips = _add_command(tables, "clips", "real garments on real clips: body, layers, speed, time")
    clips.add_argument("names", nargs="*", metavar="NAME", help="these alone; all if absent")
    clips.add_argument(
        "-o",
        dest="output",
        type=Path,
        metavar="OUT.csv",
        default=Path("out/bench/clips.csv"),
        help="table; pictures come beside it",
    )
    return whole


def _add_command(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, words: str
) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=words, description=words.capitalize() + ".")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure that is printed to FILE")
    return parser


def _add_played(parser: argparse.ArgumentParser) -> None:
    """What says which database is played with which body and motion."""
    parser.add_argument("database", type=Path, metavar="DB.h5", help="wrinkle database")
    parser.add_argument("--character", type=Path, metavar="FILE", help="body and clips; the scene's own if absent")
    parser.add_argument("--clip", metavar="NAME", help="motion; those that were held out if absent")
    parser.add_argument("--fabric", metavar="NAME", help="one that the database holds; the garment's own if absent")
    parser.add_argument("--seconds", type=_positive, metavar="S", help="only the start of the motion")


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"received {text!r}, expected a number above 0")
    return value


def _duration(text: str) -> float:
    """Seconds."""
    unit = {"s": 1.0, "m": 60.0, "h": 3600.0}.get(text[-1:])
    try:
        value = float(text[:-1]) * unit if unit else math.nan
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"received {text!r}, expected a time such as 90s, 15m or 1h")
    return value


def _angle(text: str) -> float:
    value = _positive(text)
    if value >= 180.0:
        raise argparse.ArgumentTypeError(f"received {text!r}, expected a number above 0 and below 180")
    return value


def _edges(text: str) -> int:
    if not (text.isdecimal() and 4 <= int(text) <= 400):
        raise argparse.ArgumentTypeError(f"received {text!r}, expected a whole number, 4 to 400")
    return int(text)
