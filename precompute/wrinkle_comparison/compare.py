"""`gube compare`: what every method costs against how right it is, on one held-out motion that all run freely."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
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
from precompute.learning.decoding import bands_of
from precompute.learning.evaluation import (
    Truth,
    body_distances,
    database_run,
    free_figures,
    truth_of,
)
from precompute.learning.pipeline import default_cache, precompute
from precompute.learning.recording import Recording, Run
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
from wrinkles.spectrum import LowPass

__all__ = [
    "ERRORS",
    "Advantage",
    "Comparison",
    "Method",
    "compare",
    "compare_file",
    "database_of",
    "plain_methods",
    "write_choice",
]

SUBSTEPS = (4, 6, 9, 14, 24, 36)  # of plain cloth on each mesh
BRIEF = (6, 14)  # the same where little time is spent: of the mesh below the fine one; the first of coarser meshes
ERRORS = {
    "band": "spectrum_band_error_max",
    "realism": "realism",
    "low_frequency": "low_frequency_ratio_to_floor",
    "normals": "free_normal_error_deg",
}
"""What plain cloth must reach, by the name of its cost advantage; the first two decide."""
DECIDING = ("band", "realism")


@dataclass(frozen=True)
class Method:
    """One way to make the fine garment.

    Attributes:
        prefix: of its figures' names; ours has none.
        name: for people.
        frame_ms: median processor time of a frame, body included [ms]; nan for the floor, which is no method. Of the
            truth in a brief comparison it is the time by the clock that its simulation took.
        figures: by name, without the prefix; none where it broke.
        settings: everything needed to repeat it.
        frames: fine vertices [m], float32, shape (f, N, 3); None where it broke. Where they are mapped from a file,
            another process gets the file's name and not the frames.
        broke_at: when it burst, see :class:`precompute.wrinkle_comparison.baselines.Played` [s].
        mesh: that plain cloth is simulated on; empty for what is no plain cloth.
        realism: how it is told from the truth; None for the truth and where it broke.
    """

    prefix: str
    name: str
    frame_ms: float
    figures: Mapping[str, float]
    settings: Mapping[str, float]
    frames: np.ndarray | None = field(default=None, repr=False)
    broke_at: float | None = None
    mesh: str = ""
    realism: Realism | None = field(default=None, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        if not isinstance(self.frames, np.memmap):
            return self.__dict__
        return self.__dict__ | {"frames": (self.frames.filename, self.frames.shape)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        frames = state["frames"]
        if isinstance(frames, tuple):
            file, shape = frames
            frames = np.memmap(file, np.float32, "r", shape=shape)
        self.__dict__.update(state | {"frames": frames})

    @property
    def ours(self) -> bool:
        """Whether it is a setting of the player with wrinkles."""
        return self.prefix == "" or self.prefix.startswith("ours_")


class Advantage(NamedTuple):
    """What the cheapest plain cloth that is as good as ours costs, over ours.

    Attributes:
        ratio: of both times [-]; below 1 plain cloth is the better choice.
        at_least: no plain cloth that was tried is as good: the ratio is that of the dearest, a lower bound.
        cloth: the plain cloth.
    """

    ratio: float
    at_least: bool
    cloth: Method

    def __str__(self) -> str:
        return f"{'at least ' if self.at_least else ''}{self.ratio:.2f}"


@dataclass(frozen=True)
class Comparison:
    """All methods on one motion.

    Attributes:
        garment, motion: names.
        truth: what is right.
        methods: in the order of the page.
    """

    garment: str
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

    def advantage(self, error: str, ours: str = "") -> Advantage | None:
        """How much dearer plain cloth is that is as good as ours by an error; None where no plain cloth held.

        Plain cloth is as good if its error is at most ours, or at most the floor: below the floor nothing is better.

        Args:
            error: a name of ERRORS.
            ours: prefix of a setting of the player.
        """
        return self._over_plain((error,), ours)

    def _over_plain(self, errors: Sequence[str], ours: str) -> Advantage | None:
        """How much dearer plain cloth is that is as good as ours by each of some errors; see :meth:`advantage`."""
        mine, floor = self.method(ours), self.method("floor_")
        whole = [method for method in self.plain if method.figures]
        if not mine.figures or not whole:
            return None
        limits = {ERRORS[error]: max(mine.figures[ERRORS[error]], floor.figures[ERRORS[error]]) for error in errors}
        good = [one for one in whole if all(one.figures[figure] <= limit for figure, limit in limits.items())]
        if good:
            cloth = min(good, key=lambda method: method.frame_ms)
        else:
            cloth = max(whole, key=lambda method: method.frame_ms)
        return Advantage(cloth.frame_ms / mine.frame_ms, not good, cloth)

    def cost_advantage(self, ours: str = "") -> Advantage | None:
        """The least advantage by the errors that decide."""
        found = [one for name in DECIDING if (one := self.advantage(name, ours)) is not None]
        return min(found, key=lambda one: one.ratio, default=None)

    def cost_advantage_both(self, ours: str = "") -> Advantage | None:
        """The advantage over plain cloth that is as good by all errors that decide: what is played hangs on it."""
        return self._over_plain(DECIDING, ours)

    @property
    def choice(self) -> dict[str, float]:
        """The figures that say whether plain cloth is the better choice, as a database keeps them; none if unknown."""
        found = self.cost_advantage_both()
        if found is None:
            return {}
        return {
            "cost_advantage_both": found.ratio,
            "cost_advantage_both_is_at_least": float(found.at_least),
            "plain_frame_ms": found.cloth.frame_ms,
            "plain_substeps": found.cloth.settings["substeps a frame"],
            "plain_vertex_count": found.cloth.settings["simulated vertices"],
            "plain_passes": found.cloth.settings.get("relaxation passes", 0),
        }

    @property
    def figures(self) -> dict[str, float]:
        """Every figure by its full name."""
        found = {method.prefix + name: value for method in self.methods for name, value in method.figures.items()}
        for method in self.methods:
            if np.isfinite(method.frame_ms):
                found[f"{method.prefix}frame_ms_p50"] = method.frame_ms
            if method.realism is not None:
                places = method.realism.by_place.items()
                found |= {f"{method.prefix}realism_{name.replace(' ', '_')}": value for name, value in places}
        for prefix in [method.prefix for method in self.methods if method.ours]:
            named = {f"_{name}": self.advantage(name, prefix) for name in ERRORS} | {
                "_both": self.cost_advantage_both(prefix),
                "": self.cost_advantage(prefix),
            }
            for name, one in named.items():
                if one is not None:
                    found[f"{prefix}cost_advantage{name}"] = one.ratio
                    found[f"{prefix}cost_advantage{name}_is_at_least"] = float(one.at_least)
        return found


@threadpool_limits.wrap(limits=1, user_api="blas")
def compare(
    database: WrinkleDatabase,
    truth: Truth,
    *,
    brief: bool = False,
    workers: Workers | int = 1,
    report: Callable[[str], None] | None = None,
) -> Comparison:
    """Run every method freely over the truth's motion and measure it.

    Args:
        database: what was learned.
        truth: two converged fine runs, as :func:`precompute.learning.evaluation.truth_of` gives.
        brief: few plain cloths, and of ours only the full detail.
        workers: that measure what was played, or how many do.
        report: called with lines of progress.

    Raises:
        InputError: too short a motion to judge realism in.
    """
    tell = report or (lambda line: None)
    # Forty methods of a fine garment do not fit into memory together. Frames stay mapped when their files are removed.
    with Workers.of(workers) as pool, TemporaryDirectory(prefix="gube-") as folder:
        # In a process of its own where there are some: it finds the kernels that earlier ones have left on the disk.
        play = partial(_played, database, truth, brief, Path(folder) if pool.sees_files else None)
        tell("comparing: all methods in turn")
        methods = play() if pool.count == 1 else pool.run([play])[0]
        tell("comparing: figures")
        methods = _with_figures(truth, methods, pool)
    return Comparison(database.garment_name, truth.run.name, truth, tuple(methods))


def _played(database: WrinkleDatabase, truth: Truth, brief: bool, folder: Path | None) -> list[Method]:
    """All methods with their times and frames, without figures of the frames."""
    run, keep = truth.run, truth.recording.frames
    player = Player(database, run.body, run.poses[0], run.primitives)
    details = {"": player.full}
    if not brief:
        full = player.full
        details["ours_half_substeps_"] = replace(full, substeps=max(1, full.substeps // 2))
        details["ours_half_atoms_"] = replace(full, atoms=max(1, full.atoms // 2))
    plain = _plain_turns(database, truth, brief, folder)
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
    methods += [_method(method, turn.played) for method, turn in plain]
    truth_ms = truth.recording.step_ms if brief else truth_cost.cost()
    methods.append(Method("truth_", "truth", truth_ms, {}, _settings(truth_cost), truth.frames))
    settings = _settings(truth_cost.with_substeps(math.ceil(1.5 * truth_cost.substeps)))
    methods.append(Method("floor_", "floor", math.nan, {}, settings, truth.floor))
    return methods


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
    plain = _plain_turns(database, truth, brief=True)
    take_turns([turn for _, turn in plain], truth.run.frame_count)
    played = [_method(method, turn.played) for method, turn in plain]
    return _with_figures(truth, played, 1)


def _plain_turns(
    database: WrinkleDatabase, truth: Truth, brief: bool, folder: Path | None = None
) -> list[tuple[Method, ClothTurn]]:
    """Plain cloth on every mesh, ready to be played."""
    run, keep = truth.run, truth.recording.frames
    found: list[tuple[Method, ClothTurn]] = []
    clothes = plain_cloths(database, run)
    *coarser, below, fine = clothes
    few = dict.fromkeys(coarser, BRIEF[:1]) | {below: BRIEF, fine: ()}  # the fine cloth is dearest and seldom decides
    for mesh, cloth in clothes.items():
        for substeps in few[mesh] if brief else SUBSTEPS:
            tried = cloth.with_substeps(substeps)
            kind = "mesh" if mesh != "fine" else "cloth"
            name = f"{mesh.replace('_', ' ')} {kind}, {substeps} substeps"
            method = Method(f"plain_{mesh}_{substeps}_", name, 0.0, {}, _settings(tried), mesh=mesh)
            found.append((method, ClothTurn(tried, keep, folder)))
            if cloth.levels is not None and cloth.levels.subdivision.binding is None:  # others do not come to rest
                rested = replace(tried, passes=full_passes(len(cloth.levels.subdivision.steps)))
                settings, called = _settings(rested), f"{name}, at rest"
                method = Method(f"plain_{mesh}_{substeps}_at_rest_", called, 0.0, {}, settings, mesh=mesh)
                found.append((method, ClothTurn(rested, keep, folder)))
    return found


def _method(method: Method, played: Played) -> Method:
    """A method with what it played."""
    frames = played.frames if played.broke_at is None else None
    return replace(method, frame_ms=played.frame_ms, frames=frames, broke_at=played.broke_at)


def _with_figures(truth: Truth, methods: Sequence[Method], workers: Workers | int) -> list[Method]:
    """Methods with figures of what they played; the truth itself is only asked what any run can be."""
    shown = [method for method in methods if method.frames is not None]
    with Workers.of(workers) as pool:
        # Filters of a mesh are larger than all else and are not sent: each process makes them once for its share.
        shares = [shown[first :: pool.count] for first in range(min(pool.count, len(shown)))]
        jobs = [partial(_figures_of, truth.run, truth.recording, truth.floor, truth.energy, share) for share in shares]
        found = {method.prefix: method for share in pool.run(jobs) for method in share}
    return [found.get(method.prefix, method) for method in methods]


def _figures_of(
    run: Run, recording: Recording, floor: np.ndarray, energy: np.ndarray, methods: Sequence[Method]
) -> list[Method]:
    """Methods with their figures beside a truth, whose filters are made anew."""
    levels = run.levels
    low_pass = LowPass(levels.fine, levels.cutoff)
    truth = Truth(run, levels, recording, floor, bands_of(levels), energy, low_pass)
    statistics = PatchStatistics(levels.fine)
    of_truth = statistics(truth.frames)
    measured = []
    for method in methods:
        assert method.frames is not None
        figures, told = dict(method.figures), None
        if method.prefix != "truth_":
            told = realism(statistics, of_truth, statistics(method.frames))
            figures |= free_figures(truth, method.frames) | {"realism": told.auc}
        if not method.mesh:
            figures |= _shared_figures(truth, method.frames)
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
    """Compare on the held-out motion of a database or a scene.

    Args:
        path: a database, or a scene (``.toml``), whose database is made first where ``output`` does not have it yet.
        output: folder of that database.
        clip: name of a clip that nothing was learned from; None takes the first that is held out.
        seconds: cut the motion there.
        workers: that simulate, play and measure; one of them plays all methods in turn.
        report: called with lines of progress.

    Raises:
        InputError: what cannot be read, a clip that does not exist or was learned from, or too short a motion.
    """
    path = database_of(path, output, report)
    database = read_database(path)
    inputs = playback_inputs(database, clip=clip)
    motion = inputs.motions[0]
    taught = [part.clip for part in scene_of(database).training.clips]  # a part of the whole clip is enough
    if motion.name in (*database.trained_on, *taught):
        held_out = ", ".join(database.held_out) or "a clip that nothing was learned from"
        raise InputError(
            "the database has learned from this clip", key="--clip", received=motion.name, expected=held_out
        )
    run = database_run(database, inputs, motion)
    with Workers.of(workers) as pool:
        truth = truth_of(run, default_cache(path), pool, report)
        found = compare(database, truth if seconds is None else truth.until(seconds), workers=pool, report=report)
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
        comparison: on its first held-out motion.
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
