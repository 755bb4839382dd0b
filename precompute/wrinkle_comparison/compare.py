"""`gube compare`: what every method costs against how right it is, on one held-out motion that all run freely."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from assets.io.scene import load_scene, scene_text
from pbd import InputError
from pbd.distance import penetration_figures
from precompute.learning.decoding import bands_of
from precompute.learning.evaluation import (
    Truth,
    body_distances,
    fine_run,
    free_figures,
    levels_from,
    play_freely,
    truth_of,
)
from precompute.learning.pipeline import default_cache, precompute
from precompute.learning.recording import Recording, Run
from precompute.stability.stability import StabilityLimit, largest_stable_step
from precompute.workers import Workers
from precompute.wrinkle_comparison.baselines import (
    PROBE_FRAMES,
    Cloth,
    coarse_cloth,
    equal_cost_substeps,
    fine_cloth,
    middle_cloth,
    player_times,
    typical_ms,
)
from runtime.play import Free, playback_inputs
from wrinkles.database import WrinkleDatabase, code_version, read_database
from wrinkles.metrics import edge_stretch
from wrinkles.spectrum import LowPass

__all__ = ["Comparison", "Method", "compare", "compare_file", "database_of", "equal_cost_baselines", "winners"]

STABILITY_SECONDS = 3.5  # the blend from the bind pose and two seconds of motion
TIE = 1.05  # free runs are chaotic: what differs by less is the same
AT_EQUAL_COST = ("", "smooth_", "middle_mesh_", "equal_cost_fine_")  # smooth costs less


@dataclass(frozen=True)
class Method:
    """One way to make the fine garment.

    Attributes:
        prefix: of its figures' names; ours has none.
        name: for people.
        frame_ms: median processor time of a frame, body included [ms]; nan for the floor, which is no method.
        figures: by name, without the prefix; none where it broke.
        settings: everything needed to repeat it.
        frames: fine vertices [m], float32, shape (f, N, 3); None where it broke.
        broke_at: when it burst, see :class:`precompute.wrinkle_comparison.baselines.Played` [s].
    """

    prefix: str
    name: str
    frame_ms: float
    figures: Mapping[str, float]
    settings: Mapping[str, float]
    frames: np.ndarray | None = field(default=None, repr=False)
    broke_at: float | None = None


@dataclass(frozen=True)
class Comparison:
    """All methods on one motion.

    Attributes:
        garment, motion: names.
        truth: what is right.
        methods: in the order of the page.
        stability: the largest stable substep of each garment.
    """

    garment: str
    motion: str
    truth: Truth = field(repr=False)
    methods: tuple[Method, ...]
    stability: tuple[StabilityLimit, ...]

    def method(self, prefix: str) -> Method:
        """The method whose figures have a prefix."""
        return next(method for method in self.methods if method.prefix == prefix)

    @property
    def figures(self) -> dict[str, float]:
        """Every figure by its full name."""
        found = {method.prefix + name: value for method in self.methods for name, value in method.figures.items()}
        for method in self.methods:
            if np.isfinite(method.frame_ms):
                found[f"{method.prefix}frame_ms_p50"] = method.frame_ms
        return found | {f"{one.name}_dt_max_s": one.dt_max for one in self.stability}

    def winners(self, figure: str) -> tuple[str, ...]:
        """Prefixes of the methods at equal cost that win by a figure; several where they are alike."""
        values = {m.prefix: m.figures[figure] for m in self.methods if m.prefix in AT_EQUAL_COST and m.figures}
        return winners(values, self.method("floor_").figures[figure])


def winners(errors: Mapping[str, float], floor: float) -> tuple[str, ...]:
    """Who has the least error. What lies within the floor or within 5 % of the least has won alike."""
    finite = {name: error for name, error in errors.items() if np.isfinite(error)}
    limit = max(floor, TIE * min(finite.values(), default=0.0))
    return tuple(name for name, error in finite.items() if error <= limit)


@threadpool_limits.wrap(limits=1, user_api="blas")
def compare(
    database: WrinkleDatabase,
    truth: Truth,
    *,
    free: Free | None = None,
    brief: bool = False,
    workers: Workers | int = 1,
    report: Callable[[str], None] | None = None,
) -> Comparison:
    """Run every method freely over the truth's motion and measure it.

    Args:
        database: what was learned.
        truth: two converged fine runs, as :func:`precompute.learning.evaluation.truth_of` gives.
        free: the player's free run of it, where there is one already.
        brief: of what ours is compared with at equal cost only the middle mesh (the fine cloth where there is none),
            nothing converged besides the truth and the floor, and no largest stable step.
        workers: that measure what was played, or how many do.
        report: called with lines of progress.
    """
    tell = report or (lambda line: None)
    run = truth.run
    with Workers.of(workers) as pool:
        # In a process of its own where there are some: it finds the kernels that earlier ones have left on the disk.
        play = partial(_played, database, truth, free, brief)
        tell("comparing: ours and smooth, and others at equal cost")
        methods = play(tell) if pool.count == 1 else pool.run([play])[0]
        tell("comparing: figures")
        methods = _with_figures(truth, methods, pool)
    clothes = {"coarse": coarse_cloth(database, truth.run), "middle_mesh": middle_cloth(database, truth.run)}
    clothes["fine"] = fine_cloth(truth.run)
    stability = []
    poses = run.poses[: round(STABILITY_SECONDS / run.dt) + 1]
    for name, cloth in clothes.items():
        if cloth is not None and not brief:
            tell(f"stability: {name.replace('_', ' ')}")
            stability.append(largest_stable_step(name, cloth.simulation, cloth.options, poses, run.dt, run.wind))
    return Comparison(database.garment_name, run.name, truth, tuple(methods), tuple(stability))


def _played(
    database: WrinkleDatabase,
    truth: Truth,
    free: Free | None,
    brief: bool,
    tell: Callable[[str], None] = lambda line: None,
) -> list[Method]:
    """All methods with their times and frames, without figures of the frames; arguments as for :func:`compare`."""
    free = free or play_freely(database, truth.run.body, truth.run)
    ours_ms, smooth_ms = player_times(database, truth)
    settings = _settings(coarse_cloth(database, truth.run))
    methods = [
        Method("smooth_", "smooth", typical_ms(smooth_ms), {}, settings, free.smooth),
        Method("", "ours", typical_ms(ours_ms), {}, settings, free.frames),
    ]
    fine, middle = fine_cloth(truth.run), middle_cloth(database, truth.run)
    methods += _baselines(database, truth, ours_ms, tell, most=1 if brief else 2)
    if middle is not None and not brief:
        tell("comparing: middle mesh, converged")
        methods.append(_cloth(truth, middle, "middle_mesh_converged_", "middle mesh, converged"))
    tell("comparing: truth and floor")
    methods.append(Method("truth_", "truth", fine.cost(), {}, _settings(fine), truth.frames))
    settings = _settings(fine.with_substeps(math.ceil(1.5 * fine.substeps)))
    methods.append(Method("floor_", "floor", math.nan, {}, settings, truth.floor))
    return methods


def equal_cost_baselines(
    database: WrinkleDatabase, truth: Truth, ours_ms: np.ndarray, *, report: Callable[[str], None] | None = None
) -> list[Method]:
    """The middle mesh, where there is one, and the fine cloth, with the substeps that the player's cost allows.

    Args:
        database: what was learned.
        truth: as for :func:`compare`.
        ours_ms: processor time of each of the player's frames [ms], by
            :func:`precompute.wrinkle_comparison.baselines.player_times`.
        report: called with lines of progress.
    """
    tell = report or (lambda line: None)
    return _with_figures(truth, _baselines(database, truth, ours_ms, tell), 1)


def _baselines(
    database: WrinkleDatabase, truth: Truth, ours_ms: np.ndarray, tell: Callable[[str], None], most: int = 2
) -> list[Method]:
    """The same without their figures, ``most`` of them."""
    budget = typical_ms(ours_ms[:PROBE_FRAMES])  # on the frames that baselines are tried on
    offered = [
        (middle_cloth(database, truth.run), "middle_mesh_", "middle mesh, equal cost"),
        (fine_cloth(truth.run), "equal_cost_fine_", "fine cloth, few substeps"),
    ]
    methods: list[Method] = []
    for cloth, prefix, name in offered:
        if cloth is not None and len(methods) < most:
            tell(f"comparing: {name}")
            methods.append(_cloth(truth, _at_cost(cloth, budget), prefix, name))
    return methods


def _with_figures(truth: Truth, methods: Sequence[Method], workers: Workers | int) -> list[Method]:
    """Methods with figures of what they played; the truth itself is only asked what any run can be."""
    jobs = [
        partial(_figures_of, truth.run, truth.recording, truth.floor, truth.energy, method.frames, method.prefix)
        for method in methods
        if method.frames is not None
    ]
    with Workers.of(workers) as pool:
        found = iter(pool.run(jobs))
    return [
        method if method.frames is None else replace(method, figures={**next(found), **method.figures})
        for method in methods
    ]


def _figures_of(
    run: Run, recording: Recording, floor: np.ndarray, energy: np.ndarray, frames: np.ndarray, prefix: str
) -> dict[str, float]:
    """Figures of a method's frames beside a truth, whose filters are made anew: they are larger than all else."""
    levels = run.levels
    low_pass = LowPass(levels.rest_vertices, levels.fine.faces, levels.cutoff)
    truth = Truth(run, levels, recording, floor, bands_of(levels), energy, low_pass)
    shared = _shared_figures(truth, frames)
    return shared if prefix == "truth_" else free_figures(truth, frames) | shared


def _at_cost(cloth: Cloth, budget: float) -> Cloth:
    return cloth.with_substeps(equal_cost_substeps(lambda count: cloth.with_substeps(count).cost(), budget))


def _settings(cloth: Cloth) -> dict[str, float]:
    options = cloth.model.options
    return {
        "simulated vertices": cloth.model.vertex_count,
        "substeps a frame": cloth.substeps,
        "substep [s]": cloth.run.dt / cloth.substeps,
        "squeeze": options.compression_compliance_scale,
        "shear_scale": options.shear_scale,
        "bend_scale": options.bend_scale,
    }


def _shared_figures(truth: Truth, frames: np.ndarray) -> dict[str, float]:
    """What can be asked of any run, the truth's too: contact with the body and stretch."""
    stretch = edge_stretch(frames, *truth.levels.fine.edge_lengths())
    figures = {name: float(value) for name, value in penetration_figures(*body_distances(truth, frames)).items()}
    return figures | {
        "edge_stretch_p99_percent": 100.0 * stretch.p99,
        "edge_stretch_max_percent": 100.0 * stretch.max,
    }


def _cloth(truth: Truth, cloth: Cloth, prefix: str, name: str) -> Method:
    played = cloth.play(truth.recording.frames)
    settings = _settings(cloth)
    if played.broke_at is not None:
        return Method(prefix, name, played.frame_ms, {}, settings, None, played.broke_at)
    figures = {"substeps_per_frame": float(cloth.substeps)}
    return Method(prefix, name, played.frame_ms, figures, settings, played.frames)


def compare_file(
    path: Path,
    output: Path,
    *,
    clip: str | None = None,
    seconds: float | None = None,
    report: Callable[[str], None] | None = None,
) -> Comparison:
    """Compare on the held-out motion of a database or a scene.

    Args:
        path: a database, or a scene (``.toml``), whose database is made first where ``output`` does not have it yet.
        output: folder of that database.
        clip: name of a clip that nothing was learned from; None takes the first that is held out.
        seconds: cut the motion there.
        report: called with lines of progress.

    Raises:
        InputError: what cannot be read, a clip that does not exist or was learned from, or too short a motion.
    """
    path = database_of(path, output, report)
    database = read_database(path)
    inputs = playback_inputs(database, clip=clip)
    motion, levels = inputs.motions[0], replace(levels_from(database, inputs.body), pattern=inputs.pattern)
    if motion.name in database.trained_on:
        held_out = ", ".join(database.held_out) or "a clip that nothing was learned from"
        raise InputError(
            "the database has learned from this clip", key="--clip", received=motion.name, expected=held_out
        )
    run = fine_run(levels, inputs.body, motion, database, wind=inputs.wind, primitives=inputs.primitives)
    truth = truth_of(run, default_cache(path), 2, report)
    return compare(database, truth if seconds is None else truth.until(seconds), report=report)


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
