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
from runtime.arguments import parser
from runtime.outputs import check_file, check_folder
from runtime.report import Progress, Report, machine_description, process_age, write_report

if TYPE_CHECKING:
    from runtime.play import Cast
    from runtime.simulation import Motion
    from wrinkles.database import WrinkleDatabase

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: the words after ``gube``; None for those of the process.

    Returns:
        The exit status: 0, 1 for a failed run, 2 for bad input.
    """
    options = parser().parse_args(arguments)
    try:
        if options.json:
            check_file(options.json, key="--json")
        report = _handler(options)(options)
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


def _simulate(options: argparse.Namespace) -> Report:
    from assets.io.scene import load_scene, scene_text

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
    from assets.io.scene import load_scene
    from precompute.learning.pipeline import precompute
    from precompute.learning.stages import stage_figures, stage_table
    from runtime.info import info_text

    if options.workers < 1:
        raise InputError("too few processes", key="--workers", received=options.workers, expected="at least 1")
    check_file(options.output, ".h5")
    if options.cache is not None:
        check_folder(options.cache, "--cache")
    scene = load_scene(options.scene)
    with Progress(sys.stderr) as progress:
        made = precompute(scene, options.output, cache=options.cache, workers=options.workers, report=progress)
    text, figures = info_text(options.output)
    print(text)
    print(f"where the time went:\n{stage_table(made.stages)}")
    print(f"To see it: gube play {options.output} --truth\nFor others: gube bake {options.output} -o OUT.glb")
    return Report({**figures, **stage_figures(made.stages)})


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
    from precompute.learning.evaluation import evaluate, fine_run, levels_from, truth_of
    from precompute.learning.pipeline import default_cache
    from precompute.wrinkle_comparison.compare import equal_cost_rivals
    from precompute.wrinkle_comparison.rivals import player_times, typical_ms
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
    from precompute.method_comparison.scene_compare import BUDGET, compare_scenes
    from precompute.method_comparison.scene_page import (
        comparison_figures,
        comparison_text,
        fabric_sections,
        wrinkle_sections,
        write_comparison,
    )
    from precompute.wrinkle_comparison.compare import compare_file

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
    from precompute.wrinkle_comparison.wrinkle_comparison import compare_wrinkles_file
    from precompute.wrinkle_comparison.wrinkle_page import wrinkle_rows, wrinkle_verdict, write_wrinkles

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
    from precompute.wrinkle_comparison.compare import compare_file
    from precompute.wrinkle_comparison.comparison_page import verdict, write_comparison

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
    from precompute.planning.planning import plan_file, plan_rows, plan_text
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
    from precompute.validation.validation import chosen_rows, validate_all, validation_text, verdict_row
    from precompute.validation.validation_pictures import draw_verdicts

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
    from precompute.fabric_lab import fabric_fit, fabric_report
    from precompute.validation.trial import Setting

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
    from precompute.stability.stability_cells import run_cell
    from precompute.stability.stability_maps import chosen_cell
    from precompute.stability.stability_page import cell_row, cell_text, stability_text, write_stability
    from precompute.stability.stability_sweep import METHODS, check_methods, sweep

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
    from precompute.wrinkle_comparison.ablations import ablate_file, table

    with Progress(sys.stderr) as progress:
        rows = ablate_file(options.database, report=progress)
    machine = machine_description()
    print(f"{options.database.stem}, {machine['cpu']}, {machine['date'][:10]}:\n\n{table(rows)}")
    return Report({name: value for name, value in rows[0].items() if not isinstance(value, str)}, rows)


def _bench_solver(options: argparse.Namespace) -> Report:
    from precompute.benchmarks.solver_bench import bench_rows, bench_solver, bench_verdict, write_bench

    check_folder(options.output)
    with Progress(sys.stderr) as progress:
        bench = bench_solver(report=progress, with_rivals=options.rivals)
    options.output.mkdir(parents=True, exist_ok=True)
    write_bench(options.output, bench)
    print(bench_verdict(bench))
    print(f"\n{options.output / 'solver.html'}")
    return Report(bench.figures(), bench_rows(bench))


def _bench_failures(options: argparse.Namespace) -> Report:
    from precompute.failures.failures import CLASSIC, all_failure_rows, failure_table, write_failures

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
    from precompute.benchmarks.clips import LIMBS, clip_rows, write_clips

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


def _handler(options: argparse.Namespace) -> Callable[[argparse.Namespace], Report]:
    words = f"{options.command} {options.table}" if options.command == "bench" else options.command
    return {
        "demo": _demo,
        "simulate": _simulate,
        "precompute": _precompute,
        "play": _play,
        "bake": _bake,
        "info": _info,
        "check": _check,
        "compare": _compare,
        "plan": _plan,
        "validate": _validate,
        "fabric": _fabric,
        "stability": _stability,
        "bench wrinkles": _bench_wrinkles,
        "bench solver": _bench_solver,
        "bench failures": _bench_failures,
        "bench clips": _bench_clips,
    }[words]
