"""How good a database is: on a motion, given the coarse state and running freely, beside smooth and the floor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr
from threadpoolctl import threadpool_limits

from assets.character import Character
from assets.io.sequence import Sequence as VertexSequence
from pbd.distance import BodyDistance, penetration_figures
from precompute.learning.body_seen import body_seen_figures
from precompute.learning.crossed import crossed_figures, crossed_jobs, joined_crossed
from precompute.learning.decoding import decode_recording
from precompute.learning.in_time import Pause, popping
from precompute.learning.options import DEFAULT, LearningOptions
from precompute.learning.run_recording import Recording, Run, move_start, record_runs
from precompute.learning.stages import counted
from precompute.learning.training import build_layer, features_of
from precompute.learning.truth import Truth, judged_from
from precompute.workers import Workers
from runtime.draw.shown_body import depth_under_cloth, shown_body
from runtime.export.free_run import Free, play, posed_bodies, timing_figures
from runtime.play.player import Player
from runtime.play.simulation import body_source
from wrinkles.charts import leading_vertices
from wrinkles.clearance import facing
from wrinkles.database import WrinkleDatabase
from wrinkles.mesh_measures import bending_energy, jitter_px
from wrinkles.metrics import bending_energy_ratio, given_coarse_figures, normal_error_deg, patch_normal_errors
from wrinkles.ridges import RADII
from wrinkles.spectrum import spectrum_band_error_max

__all__ = [
    "CHANCE",
    "Evaluation",
    "body_distances",
    "evaluate",
    "floor_figures",
    "free_figures",
    "given_frames",
    "mean_figures",
    "play_freely",
]

BLOCK = 32  # frames whose distance to the body one worker measures
CHANCE = "chance_"  # with which the name of a figure's chance begins
SEEN_FRAMES = 100  # of a free run that are looked at for skin that shows through, at most


def given_frames(
    database: WrinkleDatabase, run: Run, recording: Recording
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smooth and decoded garment for a fine run's own coarse states, and how unfamiliar they are.

    Returns:
        vertices [m], float32, shape (f, N, 3) twice, and scores of :class:`wrinkles.novelty.NoveltyScore`,
        shape (f, n).
    """
    layer = build_layer(run.levels)
    mapping, novelty, scores = database.mapping, database.novelty, []

    def predict(features: np.ndarray) -> np.ndarray:
        hidden = mapping.hidden(features)
        scores.append(novelty.score(hidden))
        return mapping.coefficients(hidden) * novelty.amplitude(scores[-1])[:, None]

    smooth, decoded = decode_recording(layer, predict, database.atoms, run, recording)
    return smooth, decoded, np.array(scores)


def play_freely(database: WrinkleDatabase, body: Character | VertexSequence, run: Run, start: int = 0) -> Free:
    """Play a run's poses with the player from one of its starts, and keep what the run records of settled frames."""
    player = Player(database, body, run.poses[0], run.primitives)
    move_start(player.simulation.state, start)
    return play(player, run.poses, run.dt, run.wind, every=run.every, after=judged_from(run))


def body_distances(truth: Truth, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance of every vertex of recorded frames to the body [m], and whether there is room: shape (f, N)."""
    return _joined([job() for job in _distance_jobs(truth, frames)])


def free_figures(truth: Truth, frames: np.ndarray, prefix: str = "") -> dict[str, float]:
    """Statistics of a free run against the truth; names as in the design, with a prefix."""
    mesh = truth.levels.fine
    ratios, shortest = truth.bands.band_ratios(truth.bands.energy(frames), truth.energy), truth.bands.names[0]
    figures = {
        "bending_energy_ratio": bending_energy_ratio(frames, truth.frames, mesh),
        "spectrum_band_error_max": spectrum_band_error_max(ratios),
        "octave_error_max": spectrum_band_error_max({name: ratios[name] for name in ratios if name != shortest}),
        "free_normal_error_deg": float(np.mean(normal_error_deg(frames, truth.frames, mesh.faces))),
        "jitter_px": jitter_px(frames),
    }
    coherence = truth.ridges(frames) / truth.ridge_coherence
    figures |= {f"ridge_coherence_{100 * r:.0f}_cm": value for r, value in zip(RADII, coherence, strict=True)}
    return {prefix + name: float(value) for name, value in figures.items()} | {
        f"{prefix}band_ratio_{name.replace(' ', '_')}": float(value) for name, value in ratios.items()
    }


def mean_figures(truth: Truth, runs: Sequence[np.ndarray], of_runs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Figures of free runs that differ by their starts: means, large motion, and with ``chance_`` before them chance.

    Args:
        truth: of the motion.
        runs: vertices of each run [m], float32, shape (f, N, 3).
        of_runs: figures of each run by itself.

    Returns:
        by name; the chance of a mean is the standard deviation over runs, that of large motion the standard error of
        both figures. One run has neither chance nor a spread of large motion.
    """
    values = {name: [figures[name] for figures in of_runs] for name in of_runs[0]}
    found = {name: float(np.mean(some)) for name, some in values.items()}
    low = truth.low_frequency(runs)
    if len(runs) == 1:
        return found | {"low_frequency_bias": low.bias}
    found |= {f"{CHANCE}{name}": float(np.std(some, ddof=1)) for name, some in values.items()}
    return found | {
        "low_frequency_bias": low.bias,
        "low_frequency_spread": low.spread,
        f"{CHANCE}low_frequency_bias": low.bias_error,
        f"{CHANCE}low_frequency_spread": low.spread_error,
    }


def floor_figures(truth: Truth, of_runs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Of each figure the worst that the other true runs have against the first; the spread of large motion is right.

    Args:
        truth: of the motion.
        of_runs: figures of each of the other true runs, the one in finer steps too.
    """
    worst = {}
    for name in of_runs[0]:
        values = [figures[name] for figures in of_runs]
        off = abs(np.array(values) - 1.0) if "ratio" in name or "coherence" in name else np.array(values)
        worst[name] = values[int(off.argmax())]
    return worst | {"low_frequency_bias": truth.low_frequency.floor, "low_frequency_spread": 1.0}


def garment_figures(truth: Truth, frames: np.ndarray, prefix: str = "") -> dict[str, float]:
    """Statistics of each garment of an outfit by itself, running freely, its name before theirs; else none.

    Args:
        truth: of the outfit.
        frames: fine vertices of a free run [m], shape (f, N, 3).
        prefix: of the names.
    """
    layers, layer, figures = truth.levels.layers, truth.levels.fine_layer, {}
    for number, name in enumerate(() if layers is None else layers.names):
        where = layer == number
        found, wanted = truth.bands.energy(frames, where), truth.bands.energy(truth.frames, where)
        garment = f"{prefix}{name.replace(' ', '_')}"
        figures[f"{garment}_bending_energy_ratio"] = float(found.sum() / len(found) / (wanted.sum() / len(wanted)))
        error = spectrum_band_error_max(truth.bands.band_ratios(found, wanted))
        figures[f"{garment}_spectrum_band_error_max"] = error
    return figures


def seen_figures(database: WrinkleDatabase, truth: Truth, frames: np.ndarray) -> dict[str, float]:
    """How much of the body shows through a free run, see :func:`precompute.learning.body_seen.body_seen_figures`."""
    run, source = truth.run, body_source(truth.run.body)
    some = slice(None, None, -(-len(frames) // SEEN_FRAMES))
    poses, levels = run.poses[truth.recording.frames[some]], truth.levels
    shown = shown_body(run.body, levels)
    faces, layer = levels.subdivision.faces, None if levels.layers is None else levels.layers.layer
    if facing(levels.coarse, source.vertices, source.faces) < 0.0:
        faces = faces[:, ::-1]
    dressed = depth_under_cloth(levels.coarse, layer, source.vertices, source.faces) > 0.0
    bodies = posed_bodies(shown, poses), posed_bodies(run.body, poses)
    return body_seen_figures(zip(frames[some], *bodies, strict=True), faces, source.faces, dressed)


def contact_bending_ratio(
    truth: Truth, frames: np.ndarray, distances: np.ndarray, truth_distances: np.ndarray
) -> float:
    """Bending energy of what lies on the body (within 8 mm) over the truth's, per vertex."""
    mesh = truth.levels.fine

    def density(vertices: np.ndarray, distance: np.ndarray) -> float:
        touching = distance < 0.008
        return float(bending_energy(vertices, mesh, where=touching).sum() / max(1, touching.sum()))

    return density(frames, distances) / density(truth.frames, truth_distances)


@dataclass(frozen=True)
class Evaluation:
    """A database on one motion.

    Attributes:
        figures: by their names in the design.
        free: the free run.
        smooth, decoded: fine vertices given the truth's coarse state [m], float32, shape (f, N, 3).
    """

    figures: dict[str, float]
    free: Free
    smooth: np.ndarray
    decoded: np.ndarray


@threadpool_limits.wrap(limits=1, user_api="blas")
def evaluate(
    database: WrinkleDatabase,
    truth: Truth,
    cache: Path,
    report: Callable[[str], None] | None = None,
    *,
    workers: Workers | int = 1,
    options: LearningOptions = DEFAULT,
) -> Evaluation:
    """All figures of a database on one motion.

    Args:
        database: what is judged.
        truth: of the motion.
        cache: folder of simulated runs; the fine run of a pause goes there.
        report: called with lines of progress.
        workers: that play and measure, or how many do.
        options: how long a pause is.
    """
    tell = report or (lambda line: None)
    run, recording = truth.run, truth.recording
    pause = Pause.of(run, judged_from(run), options.still_s, piece=options.piece_s)
    with Workers.of(workers) as pool:
        (paused,) = record_runs([pause.run], cache, pool, report=report)
        jobs: list[partial] = [
            *(partial(play_freely, database, run.body, run, start) for start in range(options.free_runs)),
            partial(_pause_figures, database, pause),
            partial(_given_figures, database, run, recording),
            *_distance_jobs(truth, truth.frames),
        ]
        tell("evaluating: running freely, in time, given the coarse state")
        found = pool.run(jobs, done=counted(report, "evaluating: parts", len(jobs)))
        free, *again = found[: options.free_runs]
        in_time, given, *of_truth = found[options.free_runs :]
        jobs = _distance_jobs(truth, free.frames)
        looked_at = {"": free.frames, "smooth_": free.smooth, "truth_": recording.positions}
        mesh, layer = truth.levels.fine, truth.levels.fine_layer
        cross = [crossed_jobs(mesh, layer, frames) for frames in looked_at.values()]
        jobs += [job for some in cross for job in some]
        tell("evaluating: contact with the body, and with itself")
        measured = pool.run(jobs, done=counted(report, "evaluating: parts", len(jobs)))
    distances, room = _joined(measured[: -sum(map(len, cross))])
    crossed = measured[-sum(map(len, cross)) :]
    truth_distances, truth_room = _joined(of_truth)
    figures, smooth, decoded = given
    figures |= _all_free_figures(truth, [free, *again])
    figures |= garment_figures(truth, free.frames) | garment_figures(truth, truth.floor, "floor_")
    figures |= penetration_figures(distances, room) | seen_figures(database, truth, free.frames)
    figures |= {f"truth_{k}": v for k, v in penetration_figures(truth_distances, truth_room).items()}
    for prefix, some in zip(looked_at, cross, strict=True):
        shares, crossed = joined_crossed(crossed[: len(some)]), crossed[len(some) :]
        figures |= {prefix + name: value for name, value in crossed_figures(shares, layer is not None).items()}
    figures["contact_bending_ratio"] = contact_bending_ratio(truth, free.frames, distances, truth_distances)
    figures["attached_off_mm"] = 1e3 * free.held_off
    figures |= timing_figures(free, truth.levels.subdivision.coarse_count, truth.levels.subdivision.fine_count)
    step_ms = recording.step_ms
    figures |= {"fine_simulation_ms": step_ms, "speedup_over_fine": step_ms / figures["frame_ms_p50"]}
    figures |= pause.figures(paused.positions, "truth_") | in_time
    figures["truth_rest_speed_mm_s"] = pause.rest_speed(paused.coarse)
    return Evaluation(figures, free, smooth, decoded)


def _all_free_figures(truth: Truth, runs: Sequence[Free]) -> dict[str, float]:
    """Figures of free runs of ours, of the smooth garment in the first, and of the floor."""
    ours = [one.frames for one in runs]
    figures = mean_figures(truth, ours, [free_figures(truth, frames) for frames in ours])
    floor = [free_figures(truth, frames) for frames in (*truth.others, truth.floor)]
    floored = {f"floor_{name}": value for name, value in floor_figures(truth, floor).items()}
    return figures | free_figures(truth, runs[0].smooth, "smooth_") | floored


def _given_figures(
    database: WrinkleDatabase, run: Run, recording: Recording
) -> tuple[dict[str, float], np.ndarray, np.ndarray]:
    """Figures of a database given a fine run's own coarse states; the smooth garment and the decoded one."""
    smooth, decoded, scores = given_frames(database, run, recording)
    levels, truth = run.levels, recording.positions
    owner, faces = leading_vertices(levels.subdivision)[:, 0], levels.fine.faces
    figures = {k: float(v) for k, v in given_coarse_figures(decoded, truth, smooth, faces, owner).items()}
    errors = patch_normal_errors(decoded, truth, faces, owner)  # of the coarse vertices that lead fine ones
    figures["unfamiliarity_spearman"] = float(spearmanr(scores[:, np.unique(owner)].ravel(), errors.ravel()).statistic)
    figures["faded_percent"] = float(100.0 * (database.novelty.amplitude(scores) < 1.0).mean())
    frames = features_of(build_layer(levels), recording)[1]
    figures["popping"] = popping(decoded - smooth, frames, owner)
    figures["truth_popping"] = popping(truth - smooth, frames, owner)
    return figures, smooth, decoded


def _pause_figures(database: WrinkleDatabase, pause: Pause) -> dict[str, float]:
    """How ours and the smooth garment behave where the body stops, and goes back."""
    run = pause.run
    player = Player(database, run.body, run.poses[0], run.primitives)
    free = play(player, run.poses, run.dt, run.wind, every=1)
    speed = {"rest_speed_mm_s": pause.rest_speed(free.coarse)}
    return pause.figures(free.frames) | pause.figures(free.smooth, "smooth_") | speed


def _distance_jobs(truth: Truth, frames: np.ndarray) -> list[partial]:
    """Jobs that measure distances to the body, of some frames at a time."""
    poses = truth.run.poses[truth.recording.frames]
    thickness = truth.run.fabric.thickness
    return [
        partial(_distances, truth.run.body, poses[first : first + BLOCK], thickness, frames[first : first + BLOCK])
        for first in range(0, len(frames), BLOCK)
    ]


def _distances(
    body: Character | VertexSequence, poses: np.ndarray, thickness: float, frames: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    source = body_source(body)
    distance = BodyDistance(source.faces)
    posed = np.zeros((len(source.vertices), 3), np.float32)
    rows = []
    for pose, vertices in zip(poses, frames, strict=True):
        origin = np.round(vertices.mean(axis=0).astype(float))
        source.skin(pose, origin, posed)
        points, posed_body = vertices.astype(float) - origin, posed.astype(float)
        found = distance.signed_distance(points, posed_body)
        rows.append((found, distance.leaves_room(points, found, posed_body, thickness)))
    return _stacked(rows)


def _stacked(rows: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    first, second = zip(*rows, strict=True)
    return np.array(first), np.array(second)


def _joined(parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    first, second = zip(*parts, strict=True)
    return np.concatenate(first), np.concatenate(second)
