"""`gube compare`: what every method costs against how right it is, on held-out motions that all run freely."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from threadpoolctl import threadpool_limits

from assets.io.scene import Scene, load_scene, scene_text
from assets.motion import Motion
from pbd import InputError
from precompute.learning.pipeline import default_cache, precompute
from precompute.learning.run_recording import Run
from precompute.learning.stages import counted
from precompute.learning.truth import SETTLE, Truth, database_run, truth_of
from precompute.scratch import UNCOUNTED, Tally, scratch_folder
from precompute.workers import Workers
from precompute.wrinkle_comparison.baselines import (
    TURN,
    Cloth,
    ClothTurn,
    Played,
    PlayerTurn,
    fine_cloth,
    plain_cloths,
    take_turns,
)
from precompute.wrinkle_comparison.comparison import Comparison, Method, MotionComparison
from precompute.wrinkle_comparison.method_figures import figures_of
from precompute.wrinkle_comparison.realism import FEWEST_FRAMES
from runtime.export.animation_baking import clip_begin
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.player import Player
from runtime.setup.garment_setup import scene_of
from runtime.setup.playback_inputs import motions_of, playback_inputs
from runtime.setup.scene_body import body_of
from wrinkles.database import WrinkleDatabase, code_version
from wrinkles.database_file import read_database, write_database
from wrinkles.relaxation import PASSES

__all__ = [
    "RUNS",
    "check_length",
    "check_motions",
    "compare",
    "compare_file",
    "database_of",
    "described",
    "plain_methods",
    "run_again",
    "write_choice",
]

SUBSTEPS = (3, 6, 9, 14, 24, 36)  # of plain cloth on each mesh
BRIEF = (6, 14)  # the same where little time is spent: of the mesh below the fine one; the first of coarser meshes
RUNS, BRIEF_RUNS = 4, 2  # free runs of what decides
AT_A_TIME = 2  # plain cloths that are run again, the cheapest first, until one is as good
MOTIONS = 2  # held-out motions of a database that are compared on, at most
PROBED = (
    3 * TURN
)  # frames after which plain cloth of a finer mesh is given up that takes so many times as long as ours:
DEAR = 4.0  # nobody would play it, and it takes most of the time of a comparison


@threadpool_limits.wrap(limits=1, user_api="blas")
def compare(
    database: WrinkleDatabase,
    truths: Sequence[Truth],
    *,
    brief: bool = False,
    workers: Workers | int = 1,
    report: Callable[[str], None] | None = None,
) -> Comparison:
    """Run every method freely over the truths' motions and measure it; run again what decides.

    Args:
        database: what was learned.
        truths: converged fine runs of each motion, as :func:`precompute.learning.truth.truth_of` gives.
        brief: few plain cloths, few runs, and of ours only the full detail.
        workers: that measure what was played, or how many do.
        report: called with lines of progress.

    Raises:
        InputError: too short a motion to judge realism in.
    """
    tell, motions = report or (lambda line: None), []
    # Forty methods of a fine garment do not fit into memory together. Frames stay mapped when their files are removed.
    with Workers.of(workers) as pool, scratch_folder() as directory:
        folder = directory if pool.sees_files else None
        for number, truth in enumerate(truths):
            name, tally = truth.run.name, Tally(folder and folder / f"played_{number}")
            # In a process of its own where there are some: it finds the kernels that earlier ones left on the disk.
            play = partial(_played, database, truth, brief, folder, tally)
            tell(f"comparing: all methods in turn, {name}")
            told = _told(tally, report, f"comparing: all methods in turn, {name}: frames", truth.run.frame_count)
            methods = play() if pool.count == 1 else pool.run([play], meanwhile=told)[0]
            tell(f"comparing: figures, {name}")
            tally = Tally(folder and folder / f"figures_{number}")
            told = _told(tally, report, f"comparing: figures, {name}: methods", sum(bool(one.runs) for one in methods))
            methods = _with_figures(truth, methods, pool, tally, told)
            motions.append(MotionComparison(truth.run.name, truth, tuple(methods)))
        found = Comparison(database.garment_name, tuple(motions))
        candidates = found.candidates
        for first in range(0, len(candidates), AT_A_TIME):
            some = candidates[first : first + AT_A_TIME]
            line = f"comparing: again, {', '.join(found.motions[0].method(prefix).name for prefix in some)}"
            tally = Tally(folder and folder / f"again_{first}")
            frames = len(some) * sum(one.truth.run.frame_count for one in found.motions)
            tell(line)
            jobs = [
                partial(run_again, database, one.truth, one.method(prefix), brief=brief, folder=folder, tally=tally)
                for prefix in some
                for one in found.motions
            ]
            again = iter(pool.run(jobs, meanwhile=_told(tally, report, f"{line}: frames", frames)))
            for _ in some:
                found = replace(found, motions=tuple(motion.with_method(next(again)) for motion in found.motions))
            if found.as_good:
                break
    return found


def _told(tally: Tally, report: Callable[[str], None] | None, what: str, total: int) -> Callable[[], None]:
    """A function that reports what was counted, out of so many."""
    tell = counted(report, what, total)
    return lambda: tell(min(tally.count, total), None)


def _played(database: WrinkleDatabase, truth: Truth, brief: bool, folder: Path | None, tally: Tally) -> list[Method]:
    """All methods with their times and frames, ours in several runs, without figures of the frames."""
    run, keep = truth.run, truth.recording.frames
    player = Player(database, run.body, run.poses[0], run.primitives)
    details = {"": player.full}
    if not brief:
        full = player.full
        details["ours_half_substeps_"] = replace(full, substeps=max(1, full.substeps // 2))
        details["ours_half_atoms_"] = replace(full, atoms=max(1, full.atoms // 2))
    plain = [(method, ClothTurn(cloth, keep, folder)) for method, cloth in _plain_methods(database, truth, brief)]
    others = {
        prefix: PlayerTurn(database, run, keep, detail, folder=folder) for prefix, detail in details.items() if prefix
    }
    ours = {"": PlayerTurn(database, run, keep, player=player, folder=folder)} | others
    truth_cost = fine_cloth(run)
    probed = min(PROBED, run.frame_count)
    take_turns([*ours.values(), *(turn for _, turn in plain)], probed, tally.add)
    most = DEAR * ours[""].played.frame_ms
    # The first frames say what a finer mesh costs; the mesh of ours is dear only as long as its cloth is tangled.
    cheap = [turn for method, turn in plain if method.mesh == "coarse" or turn.played.frame_ms <= most]
    take_turns([*ours.values(), *cheap], run.frame_count - probed, tally.add)
    names = {"": "ours", "ours_half_substeps_": "ours, half the substeps", "ours_half_atoms_": "ours, half the atoms"}
    simulated, dt = len(database.coarse_vertices), 1.0 / database.frame_rate
    methods = [
        _method(Method("smooth_", "smooth", 0.0, {}, _player_settings(simulated, player.full, dt)), ours[""].smooth)
    ]
    methods += [
        _method(Method(prefix, names[prefix], 0.0, {}, _player_settings(simulated, details[prefix], dt)), turn.played)
        for prefix, turn in ours.items()
    ]
    again = [PlayerTurn(database, run, keep, folder=folder, start=start) for start in _starts(brief)]
    take_turns(again, run.frame_count)
    methods[1] = _with_runs(methods[1], [turn.played for turn in again])
    for method, turn in plain:
        method = _method(method, turn.played)
        methods.append(method if turn in cheap else replace(method, runs=()))
    truth_ms = truth.recording.step_ms if brief else truth_cost.cost()
    methods.append(Method("truth_", "truth", truth_ms, {}, _settings(truth_cost), (truth.frames,)))
    settings = _settings(truth_cost.with_substeps(math.ceil(1.5 * truth_cost.substeps)))
    methods.append(Method("floor_", "floor", math.nan, {}, settings, (truth.floor, *truth.others)))
    return methods


def _starts(brief: bool) -> range:
    """Numbers of the starts of the runs after the first."""
    return range(1, BRIEF_RUNS if brief else RUNS)


def run_again(
    database: WrinkleDatabase,
    truth: Truth,
    method: Method,
    *,
    brief: bool = False,
    folder: Path | None = None,
    tally: Tally = UNCOUNTED,
) -> Method:
    """A plain cloth in several runs, with its figures.

    Args:
        database: what was learned.
        truth: of the motion.
        method: a plain cloth, with its first run.
        brief: as for :func:`compare`.
        folder: where frames are kept; None keeps them in memory.
        tally: counts the frames that are played.
    """
    cloth = next(cloth for one, cloth in _plain_methods(database, truth, brief) if one.prefix == method.prefix)
    again = [ClothTurn(cloth, truth.recording.frames, folder, start) for start in _starts(brief)]
    take_turns(again, truth.run.frame_count, tally.add)
    (found,) = figures_of(truth, [_with_runs(method, [turn.played for turn in again])])
    return found


def plain_methods(
    database: WrinkleDatabase, truth: Truth, *, report: Callable[[str], None] | None = None
) -> list[Method]:
    """A few plain cloths on each mesh below the fine one, with their figures.

    Args:
        database: what was learned.
        truth: as for :func:`compare`.
        report: called with lines of progress.
    """
    tell = report or (lambda line: None)
    tell("comparing: plain cloth")
    keep = truth.recording.frames
    plain = [(method, ClothTurn(cloth, keep)) for method, cloth in _plain_methods(database, truth, brief=True)]
    take_turns([turn for _, turn in plain], truth.run.frame_count)
    return figures_of(truth, [_method(method, turn.played) for method, turn in plain])


def _plain_methods(database: WrinkleDatabase, truth: Truth, brief: bool) -> Iterator[tuple[Method, Cloth]]:
    """Plain cloth on every mesh, before it is played."""
    clothes = plain_cloths(database, truth.run)
    *coarser, below, fine = clothes
    few = dict.fromkeys(coarser, BRIEF[:1]) | {below: BRIEF, fine: ()}  # the fine cloth is dearest and seldom decides
    for mesh, cloth in clothes.items():
        for substeps in few[mesh] if brief else SUBSTEPS:
            tried = cloth.with_substeps(substeps)
            kind = "mesh" if mesh != "fine" else "cloth"
            name = f"{mesh.replace('_', ' ')} {kind}, {substeps} substeps"
            yield Method(f"plain_{mesh}_{substeps}_", name, 0.0, {}, _settings(tried), mesh=mesh), tried
            if cloth.levels is not None and cloth.levels.subdivision.binding is None:  # others do not come to rest
                rested = replace(tried, passes=PASSES)
                settings, called = _settings(rested), f"{name}, at rest"
                yield Method(f"plain_{mesh}_{substeps}_at_rest_", called, 0.0, {}, settings, mesh=mesh), rested


def _method(method: Method, played: Played) -> Method:
    """A method with what it played first."""
    runs = (played.frames,) if played.broke_at is None else ()
    return replace(method, frame_ms=played.frame_ms, runs=runs, broke_at=played.broke_at)


def _with_runs(method: Method, again: Sequence[Played]) -> Method:
    """A method with what it played from other starts, too; it broke where one of them did."""
    broke = [one.broke_at for one in again if one.broke_at is not None]
    if broke or not method.runs:
        return replace(method, runs=(), figures={}, realism=None, broke_at=min(broke, default=method.broke_at))
    return replace(method, runs=(*method.runs, *(one.frames for one in again)))


def _with_figures(
    truth: Truth, methods: Sequence[Method], workers: Workers | int, tally: Tally, told: Callable[[], None]
) -> list[Method]:
    """Methods with figures of what they played; the truth itself is only asked what any run can be.

    Args:
        truth: of the motion.
        methods: all of them.
        workers: that measure, or how many do.
        tally: counts the methods that are measured.
        told: called every few seconds.
    """
    shown = [method for method in methods if method.runs]
    with Workers.of(workers) as pool:
        # Each process makes the filters of the mesh once for its share.
        shares = [shown[first :: pool.count] for first in range(min(pool.count, len(shown)))]
        jobs = [partial(figures_of, truth, share, tally) for share in shares]
        found = {method.prefix: method for share in pool.run(jobs, meanwhile=told) for method in share}
    return [found.get(method.prefix, method) for method in methods]


def _settings(cloth: Cloth) -> dict[str, float]:
    return {
        "simulated vertices": cloth.model.vertex_count,
        "substeps a frame": cloth.substeps,
        "substep [s]": cloth.run.dt / cloth.substeps,
        "relaxation passes": cloth.passes,
    }


def _player_settings(simulated: int, detail: LevelOfDetail, dt: float) -> dict[str, float]:
    return {
        "simulated vertices": simulated,
        "substeps a frame": detail.substeps,
        "substep [s]": dt / detail.substeps,
        "atoms": detail.atoms,
    }


def compare_file(
    path: Path,
    output: Path,
    *,
    clip: str | None = None,
    seconds: float | None = None,
    workers: Workers | int = 2,
    report: Callable[[str], None] | None = None,
) -> Comparison:
    """Compare on the held-out motions of a database or a scene, the first two.

    Args:
        path: a database, or a scene (``.toml``), whose database is made first where ``output`` does not have it yet.
        output: folder of that database.
        clip: name of one clip that nothing was learned from; None takes those that are held out.
        seconds: cut the motions there.
        workers: that simulate, play and measure; one of them plays all methods in turn.
        report: called with lines of progress.

    Raises:
        InputError: as :func:`check_motions`, or what cannot be read.
    """
    check_motions(path, clip, seconds=seconds)
    path = database_of(path, output, report)
    database = read_database(path)
    inputs = playback_inputs(database, clip=clip)
    motions = inputs.motions[:MOTIONS]
    with Workers.of(workers) as pool:
        truths = [
            truth_of(database_run(database, inputs, motion), default_cache(path), pool, report, count=RUNS)
            for motion in motions
        ]
        if seconds is not None:
            truths = [truth.until(seconds) for truth in truths]
        found = compare(database, truths, workers=pool, report=report)
    if clip is None and seconds is None:
        try:
            write_choice(path, database, found)
        except OSError as error:  # a folder that only others may write: the figures are printed all the same
            if report is not None:
                report(f"the database does not keep the cost advantage: {path} cannot be written ({error.strerror})")
    return found


def described(path: Path) -> tuple[Scene, tuple[str, ...], float]:
    """Scene, names of the motions that were learned from, and frame rate [Hz], of a database or a scene file."""
    if path.suffix == ".toml":
        scene = load_scene(path)
        return scene, (), scene.solver.frame_rate
    database = read_database(path)
    return scene_of(database), database.trained_on, database.frame_rate


def check_motions(path: Path, clip: str | None = None, *, seconds: float | None = None) -> None:
    """Refuse what cannot be compared on, before anything is simulated or learned.

    Args:
        path, clip, seconds: as for :func:`compare_file`.

    Raises:
        InputError: a clip that does not exist or was learned from, or a motion too short to judge realism in.
    """
    scene, trained, frame_rate = described(path)
    names = tuple(part.name for part in scene.training.held_out)
    taught = [part.clip for part in scene.training.clips]  # a part of the whole clip is enough
    for motion in motions_of(body_of(scene), clip, names, scene)[:MOTIONS]:
        if motion.name in (*trained, *taught):
            expected = ", ".join(names) or "a clip that nothing was learned from"
            raise InputError(
                "the database has learned from this clip", key="--clip", received=motion.name, expected=expected
            )
        check_length(motion, 1.0 / frame_rate, seconds)


def check_length(motion: Motion, dt: float, seconds: float | None) -> None:
    """Refuse a motion of which too few frames are recorded after the cloth has settled.

    Args:
        motion: to compare on.
        dt: length of a frame [s].
        seconds: where it is cut; None takes all of it.

    Raises:
        InputError: it is too short.
    """
    begin, every = clip_begin(motion), Run.every
    settled = max(SETTLE, motion.lead_in)
    first = every * (int(settled / dt / every + 1e-6) + 1)  # the first recorded frame that is judged
    needed = (first + every * (FEWEST_FRAMES - 1)) * dt
    if motion.duration < needed - 1e-6 * dt:
        raise InputError(
            "too short to compare on",
            key=motion.name,
            received=f"{motion.duration - begin:.2f} s",
            expected=f"at least {needed - begin:.2f} s: {FEWEST_FRAMES} recorded frames after the cloth has settled",
        )
    if seconds is not None and round(seconds / dt) * dt < needed - 1e-6 * dt:
        expected = f"at least {needed:.2f} [s]: {FEWEST_FRAMES} recorded frames after the cloth has settled"
        raise InputError("too short to compare on", key="--seconds", received=seconds, expected=expected)


def write_choice(path: Path, database: WrinkleDatabase, comparison: Comparison) -> WrinkleDatabase:
    """Write into a database whether plain cloth is the better choice, for `gube info`, and return it.

    Args:
        path: the database's file.
        database: what it holds.
        comparison: on its held-out motions.
    """
    written = replace(database, quality={**database.quality, **comparison.choice})
    write_database(path, written)
    return written


def database_of(path: Path, output: Path, report: Callable[[str], None] | None) -> Path:
    """A database, or that of a scene (``.toml``), made where ``output`` has none of this scene and this code yet."""
    if path.suffix != ".toml":
        return path
    scene, made = load_scene(path), output / f"{path.stem}.h5"
    if made.exists():
        database = read_database(made)
        if database.scene == scene_text(scene) and database.code_version == code_version():
            return made
    return precompute(scene, made, report=report).path
