"""`gube compare`: what every method costs against how right it is, on held-out motions that all run freely."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from assets.io.scene import load_scene, scene_text
from pbd import InputError
from pbd.distance import penetration_figures
from precompute.learning.evaluation import (
    CHANCE,
    Truth,
    body_distances,
    database_run,
    floor_figures,
    free_figures,
    mean_figures,
    truth_of,
)
from precompute.learning.pipeline import default_cache, precompute
from precompute.workers import Workers
from precompute.wrinkle_comparison.baselines import (
    Cloth,
    ClothTurn,
    Played,
    PlayerTurn,
    fine_cloth,
    plain_cloths,
    take_turns,
)
from precompute.wrinkle_comparison.realism import PatchStatistics, Realism, realism
from runtime.garment_setup import scene_of
from runtime.level_of_detail import LevelOfDetail
from runtime.play import playback_inputs
from runtime.player import Player
from wrinkles.database import WrinkleDatabase, code_version, read_database, write_database
from wrinkles.metrics import edge_stretch
from wrinkles.relaxation import full_passes

__all__ = [
    "ERRORS",
    "RUNS",
    "Advantage",
    "Comparison",
    "Method",
    "MotionComparison",
    "compare",
    "compare_file",
    "database_of",
    "plain_methods",
    "write_choice",
]

SUBSTEPS = (3, 6, 9, 14, 24, 36)  # of plain cloth on each mesh
BRIEF = (6, 14)  # the same where little time is spent: of the mesh below the fine one; the first of coarser meshes
RUNS, BRIEF_RUNS = 4, 2  # free runs of what decides
MOTIONS = 2  # held-out motions of a database that are compared on, at most
ERRORS = {
    "octaves": "octave_error_max",
    "realism": "realism",
    "normals": "free_normal_error_deg",
    "bias": "low_frequency_bias",
    "spread": "low_frequency_spread",
}
"""By what plain cloth must be as good as ours, all at once: names of figures."""
OF_ONE_RUN = ("octaves", "realism", "normals")  # those that one run has: what fails by them is not run again
BEYOND = 2.0  # standard errors that a difference must exceed to be one


@dataclass(frozen=True)
class Method:
    """One way to make the fine garment.

    Attributes:
        prefix: of its figures' names; ours has none.
        name: for people.
        frame_ms: median processor time of a frame, body included [ms]; nan for the floor, which is no method. Of the
            truth in a brief comparison it is the time by the clock that its simulation took.
        figures: by name, without the prefix, see :func:`precompute.learning.evaluation.mean_figures`; none where it
            broke.
        settings: everything needed to repeat it.
        runs: fine vertices of each run [m], float32, shape (f, N, 3); none where it broke. Where they are mapped from
            files, another process gets the files' names and not the frames.
        broke_at: when it burst, see :class:`precompute.wrinkle_comparison.baselines.Played` [s].
        mesh: that plain cloth is simulated on; empty for what is no plain cloth.
        realism: how its first run is told from the truth; None for the truth and where it broke.
    """

    prefix: str
    name: str
    frame_ms: float
    figures: Mapping[str, float]
    settings: Mapping[str, float]
    runs: tuple[np.ndarray, ...] = field(default=(), repr=False)
    broke_at: float | None = None
    mesh: str = ""
    realism: Realism | None = field(default=None, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        named = tuple((one.filename, one.shape) if isinstance(one, np.memmap) else one for one in self.runs)
        return self.__dict__ | {"runs": named}

    def __setstate__(self, state: dict[str, Any]) -> None:
        mapped = tuple(
            np.memmap(one[0], np.float32, "r", shape=one[1]) if isinstance(one, tuple) else one for one in state["runs"]
        )
        self.__dict__.update(state | {"runs": mapped})

    @property
    def ours(self) -> bool:
        """Whether it is a setting of the player with wrinkles."""
        return self.prefix == "" or self.prefix.startswith("ours_")

    @property
    def frames(self) -> np.ndarray | None:
        """Of its first run."""
        return self.runs[0] if self.runs else None

    def error(self, name: str) -> float:
        """By one of ERRORS, 0 at best; nan where it is unknown."""
        value = self.figures.get(ERRORS[name], math.nan)
        return abs(math.log(max(value, 1e-9))) if name == "spread" and math.isfinite(value) else value

    def standard_error(self, name: str, alike: Method) -> float:
        """Of that error; of one run, which does not know its own chance, from that of another method."""
        known = CHANCE + ERRORS[name] in self.figures
        chance = (self if known else alike).figures.get(CHANCE + ERRORS[name], 0.0)
        if name == "spread":  # its error is a logarithm
            return chance / max(self.figures.get(ERRORS[name], 1.0), 1e-9)
        return chance if name == "bias" else chance / math.sqrt(len(self.runs) if known else 1)


class Advantage(NamedTuple):
    """What the cheapest plain cloth that is as good as ours costs, over ours.

    Attributes:
        ratio: of both times [-], means over the motions; below 1 plain cloth is the better choice.
        at_least: no plain cloth that was tried is as good: the ratio is that of the dearest, a lower bound.
        cloth: the plain cloth, on the first motion.
        frame_ms: its time [ms].
    """

    ratio: float
    at_least: bool
    cloth: Method
    frame_ms: float

    def __str__(self) -> str:
        return f"{'at least ' if self.at_least else ''}{self.ratio:.2f}"


@dataclass(frozen=True)
class MotionComparison:
    """All methods on one motion.

    Attributes:
        motion: its name.
        truth: what is right.
        methods: in the order of the page.
    """

    motion: str
    truth: Truth = field(repr=False)
    methods: tuple[Method, ...]

    def method(self, prefix: str) -> Method:
        """The method whose figures have a prefix."""
        return next(method for method in self.methods if method.prefix == prefix)

    @property
    def plain(self) -> list[Method]:
        """Plain cloth, on all meshes."""
        return [method for method in self.methods if method.mesh]

    @property
    def equal_cost(self) -> Method | None:
        """The plain cloth whose time is nearest to ours, of those that did not break."""
        ours = self.method("").frame_ms
        whole = [method for method in self.plain if method.figures]
        return min(whole, key=lambda method: abs(math.log(method.frame_ms / ours)), default=None)

    def as_good(self, prefix: str, errors: Sequence[str]) -> bool:
        """Whether a method is as good as ours by each of some errors: no worse than ours or the floor, beyond chance.

        Args:
            prefix: of the method.
            errors: names of ERRORS. One that is unknown of the method is not as good.
        """
        rival, ours, floor = self.method(prefix), self.method(""), self.method("floor_")
        return all(
            rival.error(name)
            <= max(ours.error(name), floor.error(name))
            + BEYOND * math.hypot(rival.standard_error(name, ours), ours.standard_error(name, ours))
            for name in errors
        )

    def with_method(self, method: Method) -> MotionComparison:
        """The same where a method is another."""
        return replace(self, methods=tuple(method if one.prefix == method.prefix else one for one in self.methods))


@dataclass(frozen=True)
class Comparison:
    """All methods on all motions.

    Attributes:
        garment: its name.
        motions: the first is the one that figures without a prefix are of.
    """

    garment: str
    motions: tuple[MotionComparison, ...]

    def frame_ms(self, prefix: str = "") -> float:
        """Time of a frame of a method, mean over the motions [ms]."""
        return float(np.mean([motion.method(prefix).frame_ms for motion in self.motions]))

    @property
    def _plain(self) -> list[str]:
        """Prefixes of the plain cloths that held in every motion, the cheapest first."""
        found = [method.prefix for method in self.motions[0].plain]
        held = [one for one in found if all(motion.method(one).figures for motion in self.motions)]
        return sorted(held, key=self.frame_ms)

    @property
    def candidates(self) -> list[str]:
        """Prefixes of the plain cloths that may be as good as ours by what one run tells, the cheapest first."""
        if not all(motion.method("").figures for motion in self.motions):
            return []
        return [one for one in self._plain if all(motion.as_good(one, OF_ONE_RUN) for motion in self.motions)]

    @property
    def as_good(self) -> list[str]:
        """Prefixes of the plain cloths that are as good as ours by all of ERRORS in every motion, cheapest first."""
        several = [one for one in self.candidates if len(self.motions[0].method(one).runs) != 1]
        return [one for one in several if all(motion.as_good(one, list(ERRORS)) for motion in self.motions)]

    @property
    def cost_advantage(self) -> Advantage | None:
        """How much dearer plain cloth is that is as good as ours; None where no plain cloth, or not ours, held."""
        whole, good = self._plain, self.as_good
        if not whole or not all(motion.method("").figures for motion in self.motions):
            return None
        prefix = good[0] if good else whole[-1]
        frame_ms = self.frame_ms(prefix)
        return Advantage(frame_ms / self.frame_ms(), not good, self.motions[0].method(prefix), frame_ms)

    @property
    def choice(self) -> dict[str, float]:
        """The figures that say whether plain cloth is the better choice, as a database keeps them; none if unknown."""
        found = self.cost_advantage
        if found is None:
            return {}
        return {
            "cost_advantage": found.ratio,
            "cost_advantage_is_at_least": float(found.at_least),
            "plain_frame_ms": found.frame_ms,
            "plain_substeps": found.cloth.settings["substeps a frame"],
            "plain_vertex_count": found.cloth.settings["simulated vertices"],
            "plain_passes": found.cloth.settings.get("relaxation passes", 0),
        }

    @property
    def figures(self) -> dict[str, float]:
        """Every figure by its full name; those of the second motion begin with the motion's."""
        found = dict(self.choice)
        for number, one in enumerate(self.motions):
            motion = f"{one.motion.replace(' ', '_')}_" if number else ""
            for method in one.methods:
                start = motion + method.prefix
                found |= {start + name: value for name, value in method.figures.items()}
                if np.isfinite(method.frame_ms):
                    found[f"{start}frame_ms_p50"] = method.frame_ms
                if method.realism is not None:
                    places = method.realism.by_place.items()
                    found |= {f"{start}realism_{name.replace(' ', '_')}": value for name, value in places}
        return found


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
        truths: converged fine runs of each motion, as :func:`precompute.learning.evaluation.truth_of` gives.
        brief: few plain cloths, few runs, and of ours only the full detail.
        workers: that measure what was played, or how many do.
        report: called with lines of progress.

    Raises:
        InputError: too short a motion to judge realism in.
    """
    tell, motions = report or (lambda line: None), []
    # Forty methods of a fine garment do not fit into memory together. Frames stay mapped when their files are removed.
    with Workers.of(workers) as pool, TemporaryDirectory(prefix="gube-") as directory:
        folder = Path(directory) if pool.sees_files else None
        for truth in truths:
            # In a process of its own where there are some: it finds the kernels that earlier ones left on the disk.
            play = partial(_played, database, truth, brief, folder)
            tell(f"comparing: all methods in turn, {truth.run.name}")
            methods = play() if pool.count == 1 else pool.run([play])[0]
            tell(f"comparing: figures, {truth.run.name}")
            methods = _with_figures(truth, methods, pool)
            motions.append(MotionComparison(truth.run.name, truth, tuple(methods)))
        found = Comparison(database.garment_name, tuple(motions))
        for prefix in found.candidates:
            tell(f"comparing: again, {found.motions[0].method(prefix).name}")
            jobs = [partial(_again, database, one.truth, one.method(prefix), brief, folder) for one in found.motions]
            again = zip(found.motions, pool.run(jobs), strict=True)
            found = replace(found, motions=tuple(motion.with_method(method) for motion, method in again))
            if prefix in found.as_good:
                break
    return found


def _played(database: WrinkleDatabase, truth: Truth, brief: bool, folder: Path | None) -> list[Method]:
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
    take_turns([*ours.values(), *(turn for _, turn in plain)], run.frame_count)
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
    methods += [_method(method, turn.played) for method, turn in plain]
    truth_ms = truth.recording.step_ms if brief else truth_cost.cost()
    methods.append(Method("truth_", "truth", truth_ms, {}, _settings(truth_cost), (truth.frames,)))
    settings = _settings(truth_cost.with_substeps(math.ceil(1.5 * truth_cost.substeps)))
    methods.append(Method("floor_", "floor", math.nan, {}, settings, (truth.floor, *truth.others)))
    return methods


def _starts(brief: bool) -> range:
    """Numbers of the starts of the runs after the first."""
    return range(1, BRIEF_RUNS if brief else RUNS)


def _again(database: WrinkleDatabase, truth: Truth, method: Method, brief: bool, folder: Path | None) -> Method:
    """A plain cloth in several runs, with its figures."""
    cloth = next(cloth for one, cloth in _plain_methods(database, truth, brief) if one.prefix == method.prefix)
    again = [ClothTurn(cloth, truth.recording.frames, folder, start) for start in _starts(brief)]
    take_turns(again, truth.run.frame_count)
    (found,) = _figures_of(truth, [_with_runs(method, [turn.played for turn in again])])
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
    return _figures_of(truth, [_method(method, turn.played) for method, turn in plain])


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
                rested = replace(tried, passes=full_passes(len(cloth.levels.subdivision.steps)))
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


def _with_figures(truth: Truth, methods: Sequence[Method], workers: Workers | int) -> list[Method]:
    """Methods with figures of what they played; the truth itself is only asked what any run can be."""
    shown = [method for method in methods if method.runs]
    with Workers.of(workers) as pool:
        # Each process makes the filters of the mesh once for its share.
        shares = [shown[first :: pool.count] for first in range(min(pool.count, len(shown)))]
        jobs = [partial(_figures_of, truth, share) for share in shares]
        found = {method.prefix: method for share in pool.run(jobs) for method in share}
    return [found.get(method.prefix, method) for method in methods]


def _figures_of(truth: Truth, methods: Sequence[Method]) -> list[Method]:
    """Methods with their figures beside a truth; one that broke has none."""
    statistics = PatchStatistics(truth.levels.fine)
    of_truth = statistics(truth.frames)
    measured = []
    for method in methods:
        if not method.runs:
            measured.append(method)
            continue
        figures, told = {}, None
        if method.prefix != "truth_":
            every = [realism(statistics, of_truth, statistics(frames)) for frames in method.runs]
            of_runs = [
                free_figures(truth, frames) | {"realism": one.auc}
                for frames, one in zip(method.runs, every, strict=True)
            ]
            floor = method.prefix == "floor_"
            figures, told = (
                floor_figures(truth, of_runs) if floor else mean_figures(truth, method.runs, of_runs),
                every[0],
            )
        if not method.mesh:
            figures |= _shared_figures(truth, method.runs[0])
        measured.append(replace(method, figures=figures, realism=told))
    return measured


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


def _shared_figures(truth: Truth, frames: np.ndarray) -> dict[str, float]:
    """What can be asked of any run, the truth's too: contact with the body and stretch."""
    stretch = edge_stretch(frames, *truth.levels.fine.edge_lengths())
    figures = {name: float(value) for name, value in penetration_figures(*body_distances(truth, frames)).items()}
    return figures | {
        "edge_stretch_p99_percent": 100.0 * stretch.p99,
        "edge_stretch_max_percent": 100.0 * stretch.max,
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
        InputError: what cannot be read, a clip that does not exist or was learned from, or too short a motion.
    """
    path = database_of(path, output, report)
    database = read_database(path)
    inputs = playback_inputs(database, clip=clip)
    motions = inputs.motions[:MOTIONS]
    taught = [part.clip for part in scene_of(database).training.clips]  # a part of the whole clip is enough
    for motion in motions:
        if motion.name in (*database.trained_on, *taught):
            held_out = ", ".join(database.held_out) or "a clip that nothing was learned from"
            raise InputError(
                "the database has learned from this clip", key="--clip", received=motion.name, expected=held_out
            )
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
        except OSError as error:  # a folder that only others may write: what was found is not lost for it
            if report is not None:
                report(f"the database does not keep the cost advantage: {path} cannot be written ({error.strerror})")
    return found


def write_choice(path: Path, database: WrinkleDatabase, comparison: Comparison) -> None:
    """Write into a database whether plain cloth is the better choice, for `gube info`.

    Args:
        path: the database's file.
        database: what it holds.
        comparison: on its held-out motions.
    """
    write_database(path, replace(database, quality={**database.quality, **comparison.choice}))


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
