"""`gube compare --wrinkles`: methods that add fine wrinkles to a coarse garment, on one held-out motion.

Each is judged twice: given the truth's own coarse states, and on a free run of the coarse garment. Simulations of a
finer mesh at equal cost, which need no coarse garment, are judged on their own free runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from precompute.learning.decoding import (
    MEAN_FRAMES,
    FrameDecoder,
    Predictor,
    by_patches,
    decoded_frames,
    with_vertex_mean,
)
from precompute.learning.held_out import JUDGED, HeldOut, held_out_truth, require_held_out
from precompute.learning.options import LearningOptions
from precompute.learning.pipeline import default_cache, training_recordings, training_run
from precompute.learning.run_recording import Recording, Run
from precompute.learning.training import Layer, build_layer, coefficients_of, spread_frames, training_set
from precompute.wrinkle_comparison.baselines import player_times, typical_ms
from precompute.wrinkle_comparison.compare_database import check_motions, database_of, described, plain_methods
from precompute.wrinkle_comparison.wrinkle_baselines import WrinkleBaseline, fit_baselines
from precompute.wrinkle_comparison.wrinkle_meshes import WrinkleMesh, WrinkleMeshOptions
from runtime.setup.garment_setup import GarmentSetup, scene_of
from wrinkles.database import WrinkleDatabase
from wrinkles.database_file import read_database
from wrinkles.spectrum import BandedEnergy

__all__ = ["WrinkleComparison", "WrinkleMethod", "compare_wrinkles", "compare_wrinkles_file", "tuned_wrinkle_mesh"]

TUNED_FRAMES = 60  # recorded frames of training motion that wrinkle meshes are tuned on
RADII, BENDINGS, ITERATIONS = (0.25, 0.5, 1.0), (0.5, 1.0), (4, 10)  # that are tried; see WrinkleMeshOptions


@dataclass(frozen=True)
class WrinkleMethod:
    """One method, judged.

    Attributes:
        name: for people.
        frame_ms: processor time of a whole frame [ms].
        megabytes: stored besides the mesh, atoms included, as float32 [MB]; 0 for a method that learns nothing.
        given: figures given the truth's coarse states; none for a simulation.
        free: figures of its free run; none where it broke.
        settings: the ones chosen for it, in words.
    """

    name: str
    frame_ms: float
    megabytes: float
    given: dict[str, float]
    free: dict[str, float]
    settings: str = ""


@dataclass(frozen=True)
class WrinkleComparison:
    """All methods on one motion.

    Attributes:
        garment, motion: names.
        methods: ours, what learns, smooth and what else learns nothing, simulations.
        limit: figures given the coarse state, of the truth's own patches reduced to the atoms.
        floor: figures of a second converged fine simulation.
    """

    garment: str
    motion: str
    methods: tuple[WrinkleMethod, ...]
    limit: dict[str, float]
    floor: dict[str, float]


def compare_wrinkles(
    layer: Layer,
    database: WrinkleDatabase,
    baselines: Sequence[WrinkleBaseline],
    mesh_options: WrinkleMeshOptions,
    held_out: HeldOut,
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    report: Callable[[str], None] | None = None,
) -> WrinkleComparison:
    """Judge the smooth surface, the database's mapping, every baseline and plain cloth.

    Args:
        layer: of the garment.
        database: what was learned.
        baselines: fitted mappings.
        mesh_options: of wrinkle meshes.
        held_out: what is judged on.
        runs, recordings: the baselines' training runs, to which their means of vertices are fitted as ours is.
        report: called with lines of progress.
    """
    progress = report or (lambda line: None)
    truth, levels = held_out.truth, held_out.truth.levels
    progress("comparing wrinkles: ours")
    ours_ms, smooth_ms = player_times(database, truth)
    mapping, atoms = database.mapping, database.atoms
    ours = WrinkleBaseline("ours", mapping.predict, tuple(mapping.arrays().values()))
    given, freely = (
        held_out.show(layer, by_patches(layer, ours.predict, atoms), r) for r in (truth.recording, held_out.free)
    )
    figures = held_out.given_figures(*given[:2]), held_out.free_figures(freely[1])
    drawn = 4e-6 * (atoms.shapes.size + atoms.mean.size + atoms.vertex_mean.size)
    methods = [WrinkleMethod("ours", typical_ms(ours_ms), ours.megabytes + drawn, *figures)]

    def with_own_mean(predict: Predictor) -> FrameDecoder:
        own = with_vertex_mean(layer, predict, atoms, runs, recordings)
        return by_patches(layer, predict, own)

    def judge(name: str, begin: Callable[[], FrameDecoder], megabytes: float, settings: str, free: Recording) -> None:
        progress(f"comparing wrinkles: {name}")
        *shown, spent = held_out.show(layer, begin(), truth.recording)
        figures = held_out.free_figures(held_out.show(layer, begin(), free)[1])
        frame_ms = methods[0].frame_ms + spent - given[2]  # our frame, wrinkles made otherwise
        methods.append(WrinkleMethod(name, frame_ms, megabytes, held_out.given_figures(*shown), figures, settings))

    for baseline in baselines:
        lift = with_own_mean(baseline.predict)
        judge(baseline.name, lambda lift=lift: lift, baseline.megabytes + drawn, baseline.settings, held_out.free)
    # Methods that learn nothing come last: where a chart leaves them out, the others keep their marks.
    smooth = np.stack([levels.subdivision.upsample(frame) for frame in held_out.plain.coarse[JUDGED]])
    figures = held_out.given_figures(given[0], given[0]), held_out.free_figures(smooth.astype(np.float32))
    methods.append(WrinkleMethod("smooth", typical_ms(smooth_ms), 0.0, *figures))
    settings = ", ".join(f"{name} {value:g}" for name, value in vars(mesh_options).items())
    # As published: on the simulated garment itself.
    judge("wrinkle meshes", lambda: _wrinkle_mesh(layer, mesh_options), 0.0, settings, held_out.plain)
    methods += _plain(database, held_out, report)
    progress("comparing wrinkles: true patches")
    true = iter(coefficients_of(layer, [*spread_frames(recordings, MEAN_FRAMES), truth.recording], atoms))
    limit = with_own_mean(lambda features: next(true))  # first the frames that are learned from, then the judged ones
    *shown, _ = held_out.show(layer, limit, truth.recording)
    floor = held_out.free_figures(held_out.judged.floor)
    return WrinkleComparison(
        database.garment_name, truth.run.name, tuple(methods), held_out.given_figures(*shown), floor
    )


def _plain(database: WrinkleDatabase, held_out: HeldOut, report: Callable[[str], None] | None) -> list[WrinkleMethod]:
    """Plain cloth, running freely."""
    return [
        WrinkleMethod(
            method.name,
            method.frame_ms,
            0.0,
            {},
            {} if method.frames is None else held_out.free_figures(method.frames[JUDGED]),
            f"{method.settings['substeps a frame']} substeps a frame",
        )
        for method in plain_methods(database, held_out.truth, report=report)
    ]


def _wrinkle_mesh(layer: Layer, options: WrinkleMeshOptions) -> FrameDecoder:
    mesh = WrinkleMesh(layer.levels, options)
    return lambda fine, upsample, features, frames: mesh(fine)


def tuned_wrinkle_mesh(layer: Layer, run: Run, recording: Recording) -> WrinkleMeshOptions:
    """The options whose bending energy comes nearest to the truth's on training motion, given its coarse states.

    Judged as the coarse model is, by octave bands of wavelength. By normals smooth would win: without data nobody
    knows where a fold belongs.

    Args:
        layer: of the garment.
        run: a fine training run.
        recording: some frames of it, one after the other.
    """
    bands = BandedEnergy(layer.levels.fine)
    wanted = bands.energy(recording.positions).mean(axis=0)

    def error(options: WrinkleMeshOptions) -> float:
        frames = decoded_frames(layer, _wrinkle_mesh(layer, options), run, recording)
        found = bands.energy(np.stack([lifted for _, lifted, _ in frames])).mean(axis=0)
        return float((np.log(found / wanted) ** 2).mean())

    return min((WrinkleMeshOptions(*one) for one in product(RADII, BENDINGS, ITERATIONS)), key=error)


@threadpool_limits.wrap(limits=1, user_api="blas")  # as everywhere here: beside other work, more are slower by far
def compare_wrinkles_file(
    path: Path, output: Path, *, report: Callable[[str], None] | None = None
) -> WrinkleComparison:
    """Fit every baseline to the training runs of a database, and compare on its first held-out motion.

    Args:
        path: a database whose recorded runs lie beside it (they are simulated again where they do not), or a scene.
        output: folder of the scene's database.
        report: called with lines of progress.

    Raises:
        InputError: what cannot be read, or a scene without held-out motion.
    """
    progress = report or (lambda line: None)
    require_held_out(path, described(path)[0])
    check_motions(path)
    path = database_of(path, output, report)
    database = read_database(path)
    scene = scene_of(database)
    stage, cache = GarmentSetup.of(scene), default_cache(path)
    truth = held_out_truth(path, stage, scene, cache, report)
    held_out = HeldOut.of(database, truth)
    layer = build_layer(stage.levels)
    runs = [training_run(stage, scene, motion) for motion in stage.training_motions()]
    recordings = training_recordings(runs, cache, 2, report)
    progress("fitting baselines: wrinkle meshes")
    mesh_options = tuned_wrinkle_mesh(layer, runs[-1], recordings[-1].where(slice(-TUNED_FRAMES, None)))
    chosen = spread_frames(recordings, LearningOptions().training_frames)
    data = training_set(layer, chosen, len(database.atoms.shapes), database.seed)
    baselines = fit_baselines(data, database.seed, report)
    return compare_wrinkles(layer, database, baselines, mesh_options, held_out, runs, chosen, report)
