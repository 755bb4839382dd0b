"""The command ``gube``.

A command is a function that takes the parsed arguments and returns a :class:`runtime.report.Report`. It imports what it
needs inside itself, so that no command pays for another; that is also where ``precompute`` may be reached.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pbd.errors import InputError
from runtime.outputs import check_file, check_folder
from runtime.report import Progress, Report, machine_description, package_version, process_age, write_report

if TYPE_CHECKING:
    from runtime.play import Cast
    from runtime.simulation import Motion
    from wrinkles.database import WrinkleDatabase

__all__ = ["main"]

Handler = Callable[[argparse.Namespace], Report]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: the words after ``gube``; None for those of the process.

    Returns:
        The exit status: 0, 1 for a failed run, 2 for bad input.
    """
    options = _parser().parse_args(arguments)
    try:
        if options.json:
            check_file(options.json, key="--json")
        report = options.handler(options)
        if options.json:
            write_report(options.json, options.command, report.figures, report.rows)
    except InputError as error:
        print(f"gube {options.command}: {error}", file=sys.stderr)
        return 2
    except OSError as error:  # a full disk, or one that went away
        print(f"gube {options.command}: {_disk_problem(error)}", file=sys.stderr)
        return 1
    except BrokenExecutor:
        print(
            f"gube {options.command}: a simulating process was ended from outside, perhaps for want of memory; "
            "what it had finished is kept, and the same command goes on from there",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 1
    return 0 if report.passed else 1


def _disk_problem(error: OSError) -> str:
    problem = (error.strerror or str(error)).lower()
    return f"{error.filename}: {problem}" if error.filename else problem


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="gube",
        description="Real-time clothing with the folds of an offline simulation.",
        epilog="Exit status: 0, 1 for a failed run, 2 for bad input.",
    )
    parser.add_argument("--version", action="version", version=f"gube {package_version('gube')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = _add_command(commands, "demo", _demo, "the whole road on the built-in scene, up to pictures")
    demo.add_argument("-o", dest="output", type=Path, default=Path("out/demo"), metavar="DIR", help="default: out/demo")

    simulate = _add_command(commands, "simulate", _simulate, "simulate the garment of a scene and bake it")
    simulate.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    simulate.add_argument("-o", dest="output", type=Path, metavar="OUT", help=".glb, .pc2 or .obj; out/SCENE.glb")
    simulate.add_argument("--seconds", type=_positive, metavar="S", help="all of the motion; 5 s without a body")
    simulate.add_argument("--fine", action="store_true", help="simulate the subdivided mesh")
    simulate.add_argument("--explain", action="store_true", help="only print the resolved scene")

    precompute = _add_command(commands, "precompute", _precompute, "learn the wrinkles of a scene's garment")
    precompute.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    precompute.add_argument(
        "-o", dest="output", type=Path, metavar="DB.h5", required=True, help="wrinkle database, ending in .h5"
    )
    precompute.add_argument("--cache", type=Path, metavar="DIR", help="simulated runs; .gube-cache beside the database")
    precompute.add_argument("--workers", type=int, metavar="N", default=os.cpu_count() or 1, help="processes at a time")

    play = _add_command(commands, "play", _play, "play a wrinkle database without a window")
    _add_played(play)
    play.add_argument("-o", dest="output", type=Path, metavar="DIR", default=Path("out/play"), help="for pictures")
    mode = play.add_mutually_exclusive_group()
    mode.add_argument("--truth", action="store_true", help="beside the fine simulation, with figures of both")
    mode.add_argument("--loop", type=_positive, metavar="SECONDS", help="by the clock, with a gust; no pictures")
    play.add_argument("--hz", type=int, choices=(30, 60), default=60, help="frames a second of --loop")

    bake = _add_command(commands, "bake", _bake, "bake a played wrinkle database into an animation")
    _add_played(bake)
    bake.add_argument("-o", dest="output", type=Path, metavar="OUT", required=True, help=".glb, .pc2 or .obj")
    bake.add_argument("--rate", type=_positive, metavar="HZ", default=30.0, help="frames a second")

    info = _add_command(commands, "info", _info, "what a wrinkle database holds and how good it is")
    info.add_argument("database", type=Path, metavar="DB.h5", help="wrinkle database")

    check = _add_command(commands, "check", _check, "check a wrinkle database whole")
    check.add_argument("database", type=Path, metavar="DB.h5", help="wrinkle database")

    compare = _add_command(commands, "compare", _compare, "chart what every method costs against how right it is")
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

    plan = _add_command(commands, "plan", _plan, "model no more than a scene needs")
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

    validate = _add_command(commands, "validate", _validate, "hold the solver to physics that is known exactly")
    validate.add_argument("names", nargs="*", metavar="NAME", help="test of the table; all if absent")
    validate.add_argument("--solver", metavar="S", help="this solver alone; all if absent")
    validate.add_argument("--resolution", type=_edges, metavar="N", help="edges along the length (default: 20 and 40)")
    validate.add_argument("--param", action="append", default=[], metavar="KEY=VALUE", help="parameter of the test")
    validate.add_argument(
        "-o", dest="output", type=Path, default=Path("out/validate"), metavar="DIR", help="for pictures of curves"
    )

    fabric = _add_command(
        commands, "fabric", _fabric, "measure a fabric in the instruments of a laboratory, or fit one"
    )
    fabric.add_argument("fabric", metavar="NAME|FILE.json", help="preset, or measured fabric as ARCSim stores it")
    fabric.add_argument("--fit", type=Path, metavar="CURVES.csv", help="change it to what these measured curves say")
    fabric.add_argument("--solver", metavar="S", default="fem-stvk/quasi-static", help="default: %(default)s")
    fabric.add_argument(
        "-o", dest="output", type=Path, default=Path("out/fabric"), metavar="DIR", help="for curves and their picture"
    )

    stability = _add_command(commands, "stability", _stability, "map where methods fail, and how")
    stability.add_argument(
        "--method", action="append", metavar="M", help="solver, may be repeated (default: default and one explicit)"
    )
    stability.add_argument("--cell", metavar="MAP:X:Y", help="run this cell again and tell what goes and when")
    stability.add_argument(
        "-o", dest="output", type=Path, default=Path("out/stability"), metavar="DIR", help="folder of stability.html"
    )

    bench = commands.add_parser("bench", help="what each part is worth and costs", description="Print a table.")
    tables = bench.add_subparsers(dest="table", required=True, metavar="TABLE")
    ablations = _add_command(tables, "wrinkles", _bench_wrinkles, "the wrinkle layer with parts left out")
    ablations.add_argument("database", type=Path, metavar="DB.h5", help="wrinkle database, its runs beside it")

    solver = _add_command(tables, "solver", _bench_solver, "time against stretch on a swinging square, by settings")
    solver.add_argument(
        "-o", dest="output", type=Path, default=Path("out/bench"), metavar="DIR", help="folder of solver.html and .csv"
    )
    solver.add_argument("--rivals", action="store_true", help="measure other engines too: pip install 'gube[rivals]'")

    failures = _add_command(
        tables, "failures", _bench_failures, "where cloth engines fail, and how each method ends there"
    )
    failures.add_argument("--solver", metavar="S", help="this one alone; the default and the classic ones if absent")
    failures.add_argument(
        "-o",
        dest="output",
        type=Path,
        metavar="OUT.csv",
        default=Path("out/bench/failures.csv"),
        help="table of all runs",
    )

    clips = _add_command(tables, "clips", _bench_clips, "real garments on real clips: body, layers, speed, time")
    clips.add_argument("names", nargs="*", metavar="NAME", help="these alone; all if absent")
    clips.add_argument(
        "-o",
        dest="output",
        type=Path,
        metavar="OUT.csv",
        default=Path("out/bench/clips.csv"),
        help="table; pictures come beside it",
    )
    return parser


def _add_command(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, handler: Handler, words: str
) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=words, description=words.capitalize() + ".")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure that is printed to FILE")
    parser.set_defaults(handler=handler)
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


def _simulate(options: argparse.Namespace) -> Report:
    from assets.scene import load_scene, scene_text

    scene = load_scene(options.scene)
    if options.explain:
        print(scene_text(scene), end="")
        return Report()
    from runtime.info import figure_lines
    from runtime.play import BAKED, simulated_frames, write_baked
    from runtime.stage import simulation_of

    output = options.output or Path("out") / f"{options.scene.stem}.glb"
    check_file(output, *BAKED)
    simulation, motion = simulation_of(scene, options.fine)
    longest = 5.0 if motion is None else motion.duration
    seconds = longest if options.seconds is None else min(options.seconds, longest if motion else math.inf)
    frames, bodies, rate, figures = simulated_frames(simulation, motion, scene, seconds)
    body_faces = None if bodies is None else simulation.body.faces
    write_baked(output, simulation.model.mesh.faces, frames, rate, body_faces=body_faces, bodies=bodies)
    print("\n".join([*figure_lines(figures), f"baked to {output}"]))
    return Report(figures)


def _demo(options: argparse.Namespace) -> Report:
    from precompute.demo import run_demo

    check_folder(options.output)
    with Progress(sys.stderr) as progress:
        figures = run_demo(options.output, report=progress)
    out = options.output
    print(f"page:      {out / 'index.html'}")
    print(f"picture:   {out / 'demo.png'} (coarse | truth | ours)")
    print(f"animation: {out / 'skirt.glb'} (Blender: File, Import, glTF)")
    print(f"database:  {out / 'skirt.h5'}")
    print(f"next: gube info {out / 'skirt.h5'}")
    print(f"      gube play {out / 'skirt.h5'} --loop 60 --hz 60")
    return Report(figures)


def _precompute(options: argparse.Namespace) -> Report:
    from assets.scene import load_scene
    from precompute.pipeline import precompute
    from runtime.info import info_text

    if options.workers < 1:
        raise InputError("too few processes", key="--workers", received=options.workers, expected="at least 1")
    check_file(options.output, ".h5")
    if options.cache is not None:
        check_folder(options.cache, "--cache")
    scene = load_scene(options.scene)
    with Progress(sys.stderr) as progress:
        precompute(scene, options.output, cache=options.cache, workers=options.workers, report=progress)
    text, figures = info_text(options.output)
    print(text)
    print(f"To see it: gube play {options.output} --truth\nFor others: gube bake {options.output} -o OUT.glb")
    return Report(figures)


def _play(options: argparse.Namespace) -> Report:
    from runtime.info import figure_lines
    from runtime.play import cast_of, loop_figures, play_motion
    from wrinkles.database import read_database

    import_s = process_age()
    if options.loop is None:
        check_folder(options.output)
    database = read_database(options.database)
    if options.fabric is not None:
        database = database.in_fabric(options.fabric)
    cast = cast_of(database, options.character, options.clip)
    rows: list[dict[str, float | str]] = []
    for motion in cast.motions:
        if options.loop is not None:
            figures = loop_figures(database, cast, motion, options.loop, options.hz)
        elif options.truth:
            figures = _beside_truth(options, database, cast, motion)
        else:
            figures = play_motion(database, cast, motion, options.seconds, options.output)
        rows.append({"motion": motion.name, "import_s": import_s, **figures})
        numbers = {name: value for name, value in rows[-1].items() if not isinstance(value, str)}
        print("\n".join([f"{motion.name}:", *figure_lines(numbers)]))
        if "state_hash" in figures:
            print(f"  state_hash {figures['state_hash']}")
    if options.loop is None:
        print(f"pictures: {options.output}")
    return Report({name: value for name, value in rows[0].items() if name != "motion"}, rows)


def _beside_truth(options: argparse.Namespace, database: WrinkleDatabase, cast: Cast, motion: Motion) -> dict[str, Any]:
    """Figures of a motion beside the fine simulation, and pictures of both."""
    from precompute.compare import equal_cost_rivals
    from precompute.evaluation import evaluate, fine_run, levels_from, truth_of
    from precompute.pipeline import default_cache
    from precompute.rivals import player_times, typical_ms
    from runtime.play import posed_bodies
    from runtime.strips import draw_strips

    levels = levels_from(database, cast.body)
    run = fine_run(levels, cast.body, motion, database, wind=cast.wind, primitives=cast.primitives)
    with Progress(sys.stderr) as progress:
        truth = truth_of(run, default_cache(options.database), os.cpu_count() or 1, progress)
        if options.seconds is not None:
            truth = truth.until(options.seconds)
        evaluation = evaluate(database, truth, default_cache(options.database), progress)
        figures: dict[str, Any] = dict(evaluation.figures)
        ours_ms, _ = player_times(database, truth)
        figures["frame_cpu_ms"] = typical_ms(ours_ms)
        for rival in equal_cost_rivals(database, truth, ours_ms, report=progress):
            figures |= {f"{rival.prefix}{name}": value for name, value in rival.figures.items()}
            figures[f"{rival.prefix}frame_cpu_ms"] = rival.frame_ms
        progress("drawing")
        numbers = truth.recording.frames
        shown = numbers % 10 == 0
        free = evaluation.free
        columns = {"smooth": free.smooth[shown], "truth": truth.frames[shown], "ours": free.frames[shown]}
        faces = levels.subdivision.faces
        bodies = posed_bodies(cast.body, run.poses[numbers[shown]])
        draw_strips(options.output, motion.name, columns, faces, bodies, cast.body.faces, numbers[shown], run.dt)
    return figures | {"state_hash": free.state_hash}


def _bake(options: argparse.Namespace) -> Report:
    from runtime.play import BAKED, baked_frames, cast_of, write_baked
    from wrinkles.database import read_database

    check_file(options.output, *BAKED)
    database = read_database(options.database)
    if options.fabric is not None:
        database = database.in_fabric(options.fabric)
    cast = cast_of(database, options.character, options.clip)
    player, frames, normals, bodies = baked_frames(database, cast, cast.motions[0], options.rate, options.seconds)
    faces = player.levels.subdivision.faces
    write_baked(options.output, faces, frames, options.rate, normals, cast.body.faces, bodies)
    print(f"{cast.motions[0].name}: {len(frames)} frames of {frames.shape[1]} vertices baked to {options.output}")
    return Report({"frame_count": len(frames), "fine_vertex_count": frames.shape[1]})


def _info(options: argparse.Namespace) -> Report:
    from runtime.info import info_text

    text, figures = info_text(options.database)
    print(text, end="")
    return Report(figures)


def _check(options: argparse.Namespace) -> Report:
    from runtime.info import check_database

    checks = check_database(options.database)
    for check in checks:
        print(f"{'passed' if check.passed else 'FAILED'}  {check.check}: {check.detail}")
    return Report(rows=[check._asdict() for check in checks], passed=all(check.passed for check in checks))


def _compare(options: argparse.Namespace) -> Report:
    databases = [name for name in options.sources if name.lower().endswith((".h5", ".toml"))]
    scenes = [name for name in options.sources if name not in databases]
    of_database = options.wrinkles or (bool(databases) and not scenes)
    for name in ("methods", "budget") if of_database else () if databases else ("clip",):
        if getattr(options, name) is not None:
            expected = "built-in scenes" if of_database else "a database (.h5)"
            raise InputError("cannot be chosen here", key=f"--{name}", received=options.sources, expected=expected)
    if len(databases) > 1 or (options.wrinkles and (scenes or not databases)):
        raise InputError("one database at a time", key="SCENE", received=options.sources, expected="DB.h5")
    options.output = options.output or (Path(".") if of_database else Path("out/compare"))
    options.database = Path(databases[0]) if databases else None
    check_folder(options.output)
    if not of_database:
        return _compare_scenes(options, scenes)
    return _compare_wrinkles(options) if options.wrinkles else _compare_database(options)


def _compare_scenes(options: argparse.Namespace, scenes: Sequence[str]) -> Report:
    from precompute.compare import compare_file
    from precompute.scene_compare import BUDGET, compare_scenes
    from precompute.scene_page import (
        comparison_figures,
        comparison_text,
        fabric_sections,
        wrinkle_sections,
        write_comparison,
    )

    methods, output = [] if options.methods is None else options.methods.split(","), options.output
    with Progress(sys.stderr) as progress:
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
    print("\n\n".join(comparison_text(one) for one in found))
    print(f"\n{output / 'compare.html'}")
    return Report(comparison_figures(found), [point.row(one.scene.name) for one in found for point in one.points])


def _compare_wrinkles(options: argparse.Namespace) -> Report:
    from precompute.wrinkle_comparison import compare_wrinkles_file
    from precompute.wrinkle_page import wrinkle_rows, wrinkle_verdict, write_wrinkles

    for name in ("clip", "seconds"):
        if getattr(options, name) is not None:
            raise InputError("cannot be chosen with --wrinkles", key=f"--{name}", expected="the held-out motion")
    with Progress(sys.stderr) as progress:
        found = compare_wrinkles_file(options.database, options.output, report=progress)
    page = options.output / "wrinkles.html"
    write_wrinkles(page, found)
    print(wrinkle_verdict(found))
    print(f"\n{page}")
    rows = wrinkle_rows(found)
    figures = {name: value for name, value in rows[0].items() if not isinstance(value, str)}
    return Report(figures, rows)


def _compare_database(options: argparse.Namespace) -> Report:
    from precompute.compare import compare_file
    from precompute.comparison_page import verdict, write_comparison

    with Progress(sys.stderr) as progress:
        found = compare_file(
            options.database, options.output, clip=options.clip, seconds=options.seconds, report=progress
        )
    page = options.output / "compare.html"
    write_comparison(page, found)
    print(verdict(found))
    print(f"\n{page}")
    rows = [{"method": m.name, "frame_ms_p50": m.frame_ms, **m.settings, **m.figures} for m in found.methods]
    return Report(found.figures, rows)


def _plan(options: argparse.Namespace) -> Report:
    from precompute.planning import plan_file, plan_rows, plan_text
    from runtime.planner import TARGETS

    check_folder(options.output)
    with Progress(sys.stderr) as progress:
        found = plan_file(
            options.source,
            options.output,
            target_px=TARGETS[options.target],
            budget_ms=options.budget_ms,
            distance=options.distance,
            field_of_view_deg=options.fov,
            garments=options.garments,
            report=progress,
        )
    print(plan_text(found))
    return Report(found.figures, plan_rows(found))


def _validate(options: argparse.Namespace) -> Report:
    from precompute.validation import chosen_rows, validate_all, validation_text, verdict_row
    from precompute.validation_pictures import draw_verdicts

    check_folder(options.output)
    tests = chosen_rows(options.names, options.param, options.solver)
    with Progress(sys.stderr) as progress:
        verdicts = validate_all(tests, options.solver, options.resolution, os.cpu_count() or 1, progress)
    print(validation_text(verdicts))
    for path in draw_verdicts(options.output, verdicts):
        print(path)
    rows = [verdict_row(verdict) for verdict in verdicts]
    figures = {
        "tests": len(rows),
        "passed_best": sum(row["passed_best"] for row in rows),
        "passed_realtime": sum(row["passed_realtime"] for row in rows),
    }
    return Report(figures, rows, passed=all(row["passed_best"] and row["passed_realtime"] for row in rows))


def _fabric(options: argparse.Namespace) -> Report:
    from assets.fabrics import load_fabric
    from precompute import fabric_fit, fabric_report
    from precompute.trial import Setting

    check_folder(options.output)
    fabric, setting = load_fabric(options.fabric), Setting(solver=options.solver)
    options.output.mkdir(parents=True, exist_ok=True)
    if options.fit is not None:
        fitted, found = fabric_fit.fit_fabric(fabric_fit.read_curves(options.fit), fabric, setting)
        picture = options.output / "fit.png"
        fabric_fit.draw_fit(picture, found)
        print(fabric_report.fabric_text(fitted))
        for curve in found:
            print(f"# {curve.instrument} {curve.direction}: {100.0 * curve.error:.2g} % off")
        print(f"# {picture}")
        rows = [{"instrument": c.instrument, "direction": c.direction, "error": c.error} for c in found]
        return Report(asdict(fitted), rows)
    with Progress(sys.stderr) as progress:
        curves, figures = fabric_report.measure_fabric(fabric, setting, progress)
    print(fabric_report.curves_text(curves, figures))
    fabric_report.write_curves(options.output / "curves.csv", curves)
    fabric_report.draw_curves(options.output / "curves.png", curves)
    print(f"\n{options.output / 'curves.png'}")
    return Report(figures, fabric_report.curve_rows(curves))


def _stability(options: argparse.Namespace) -> Report:
    from precompute.stability_cells import run_cell
    from precompute.stability_maps import chosen_cell
    from precompute.stability_page import cell_row, cell_text, stability_text, write_stability
    from precompute.stability_sweep import METHODS, check_methods, sweep

    if options.cell is not None:
        cell = chosen_cell(options.cell)
        cells = [run_cell(*cell, method) for method in check_methods(options.method or METHODS[:1])]
        print("\n".join(map(cell_text, cells)))
        return Report(cells[0].figures, [cell_row(one) for one in cells])
    check_folder(options.output)
    with Progress(sys.stderr) as progress:
        found = sweep(options.method or METHODS, workers=os.cpu_count() or 1, report=progress)
        progress("drawing")
        files = write_stability(options.output, found)
    print(stability_text(found))
    print(f"\n{files[0]}")
    return Report(found.figures, [cell_row(cell) for cell in found.cells])


def _bench_wrinkles(options: argparse.Namespace) -> Report:
    from precompute.ablations import ablate_file, table

    with Progress(sys.stderr) as progress:
        rows = ablate_file(options.database, report=progress)
    machine = machine_description()
    print(f"{options.database.stem}, {machine['cpu']}, {machine['date'][:10]}:\n\n{table(rows)}")
    return Report({name: value for name, value in rows[0].items() if not isinstance(value, str)}, rows)


def _bench_solver(options: argparse.Namespace) -> Report:
    from precompute.solver_bench import bench_rows, bench_solver, bench_verdict, write_bench

    check_folder(options.output)
    with Progress(sys.stderr) as progress:
        bench = bench_solver(report=progress, with_rivals=options.rivals)
    options.output.mkdir(parents=True, exist_ok=True)
    write_bench(options.output, bench)
    print(bench_verdict(bench))
    print(f"\n{options.output / 'solver.html'}")
    return Report(bench.figures(), bench_rows(bench))


def _bench_failures(options: argparse.Namespace) -> Report:
    from precompute.failures import CLASSIC, all_failure_rows, failure_table, write_failures

    check_file(options.output, ".csv")
    solvers = (options.solver,) if options.solver else ("default", *CLASSIC)
    with Progress(sys.stderr) as progress:
        rows = all_failure_rows(solvers, os.cpu_count() or 1, progress)
    write_failures(options.output, rows)
    print(f"{failure_table(rows)}\n\n{options.output}")
    ours = [row for row in rows if row["solver"] == "default"]
    catastrophic = [row for row in rows if row["class"] == "catastrophic"]
    figures = {
        "failure_scenes": float(len(rows)),
        "catastrophic_scenes": float(len(catastrophic)),
        "catastrophic_scenes_default": float(sum(row in catastrophic for row in ours)),
        "late_scenes_default": float(sum(row["recovered_s"] > 1.0 for row in ours)),
    }
    late = figures["catastrophic_scenes_default"] + figures["late_scenes_default"]
    return Report(figures, rows, passed=late == 0.0)


def _bench_clips(options: argparse.Namespace) -> Report:
    from precompute.clips import LIMBS, clip_rows, write_clips

    check_file(options.output, ".csv")
    with Progress(sys.stderr) as progress:
        rows = clip_rows(options.names, progress, options.output.parent)
    write_clips(options.output, rows)
    for row in rows:
        print(row["clip"])
        print("\n".join(f"    {name} {value:.4g}" for name, value in row.items() if name != "clip"))
    print(options.output)
    figures = {f"{row['clip']}_{name}": value for row in rows for name, value in row.items() if name != "clip"}
    well = all(
        row["finite"] == 1.0
        and row["inside_s"] <= 0.5
        and row["crossings_layers"] == 0.0
        and row["catastrophic_frames"] == 0.0
        and row["speed_over_limb"] < LIMBS
        for row in rows
    )
    return Report(figures, rows, passed=well)
