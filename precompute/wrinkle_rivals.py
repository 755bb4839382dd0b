"""Other ways from a coarse garment to fine wrinkles, learned from the same pairs and decoded by the same patches.

All of them give the coefficients of the patches' atoms, so that what differs is the mapping alone: a linear operator,
principal components with ridge regression, the nearest neighbour (as game engines ship it), a pose-driven radial basis,
k-means modes, kernel ridge regression and a wide network. Those that see the whole garment at once see the inner ring
of every stencil.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from pbd import InputError
from precompute.compare import database_of
from precompute.decoding import Predict, decode_recording
from precompute.evaluation import Truth, truth_of
from precompute.page import Chart, Line, Point, Section, Table, Text, write_page
from precompute.pipeline import EPOCHS, TRAINING_FRAMES, default_cache, scene_run, training_runs
from precompute.recording import Recording, record_runs
from precompute.training import Layer, TrainingSet, build_layer, fit_layer, spread_frames, training_set
from runtime.stage import Stage, scene_of
from wrinkles.charts import leading_vertices
from wrinkles.database import WrinkleDatabase, read_database
from wrinkles.features import INNER_OFFSETS
from wrinkles.metrics import given_coarse_figures

__all__ = [
    "WrinkleRival",
    "Wrinkles",
    "compare_wrinkles",
    "compare_wrinkles_file",
    "fit_rivals",
    "wrinkle_verdict",
    "write_wrinkles",
]

COMPONENTS = 128  # of the whole garment's features and of its coefficients
CENTRES = 400  # of the pose-driven basis
MODES = 512  # of k-means
SOFTNESS = 10.0  # of ridge regressions, in units of a feature's variance times one sample
WIDE = (256, 256)
TIMED_FRAMES = 15
EVERY = 4  # recorded frames from one that is judged to the next
_NOTES = """Every way gives the coefficients of the same patches, learned from the same recorded frames, and is decoded
and relaxed alike; each is given the truth's own coarse states of a motion that nothing was learned from. Times are
medians of the mapping alone in NumPy and scikit-learn on one core, features and decoding not counted, and say how the
ways compare, not what a player takes; megabytes count what each must store as 32-bit numbers."""


@dataclass(frozen=True)
class WrinkleRival:
    """A fitted mapping.

    Attributes:
        name: for people.
        predict: features of one frame, float32, shape (n, DYNAMIC_COUNT), and the body's pose to coefficients, (n, K).
        arrays: what has to be stored.
    """

    name: str
    predict: Predict
    arrays: tuple[np.ndarray, ...]

    @property
    def megabytes(self) -> float:
        return sum(array.size for array in self.arrays) * 4e-6  # as float32


def fit_rivals(
    layer: Layer,
    data: TrainingSet,
    poses: np.ndarray,
    *,
    epochs: int,
    seed: int,
    report: Callable[[str], None] | None = None,
) -> list[WrinkleRival]:
    """Fit every rival to a training set.

    Args:
        layer: of the garment.
        data: pairs.
        poses: of the body in the same frames, shape (S, joints, 3, 4); those of a vertex sequence have no joints, and
            nothing is driven by them.
        epochs: of the wide network.
        seed: of every random choice.
        report: told lines of progress.
    """
    from sklearn.cluster import MiniBatchKMeans
    from sklearn.decomposition import PCA
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.linear_model import Ridge
    from sklearn.neighbors import NearestNeighbors

    tell = report or (lambda line: None)
    frames, places, atoms = data.coefficients.shape
    rivals = []

    tell("fitting rivals: linear operator")
    weights = np.zeros((places, data.features.shape[2], atoms), np.float32)
    bias = np.zeros((places, atoms), np.float32)
    for place in range(places):
        ridge = Ridge(SOFTNESS).fit(data.features[:, place], data.coefficients[:, place])
        weights[place], bias[place] = ridge.coef_.T, ridge.intercept_
    operate = lambda f, pose: np.matmul(f[:, None], weights)[:, 0] + bias  # noqa: E731
    rivals.append(WrinkleRival("linear operator", operate, (weights, bias)))

    tell("fitting rivals: principal components")
    whole = lambda f: f[..., INNER_OFFSETS].reshape(*f.shape[:-2], -1)  # noqa: E731
    count = min(COMPONENTS, frames - 1)
    seen = PCA(count, svd_solver="randomized", random_state=seed).fit(whole(data.features))
    drawn = PCA(count, svd_solver="randomized", random_state=seed).fit(data.coefficients.reshape(frames, -1))
    inputs = seen.transform(whole(data.features))
    outputs = drawn.transform(data.coefficients.reshape(frames, -1))
    spread = inputs.std(axis=0)
    spread += 1e-3 * spread.max()  # components of no size are noise
    code = lambda f: seen.transform(whole(f)[None]) / spread  # noqa: E731
    draw = lambda c: drawn.inverse_transform(c).reshape(places, atoms).astype(np.float32)  # noqa: E731
    bases = (seen.components_, seen.mean_, drawn.components_, drawn.mean_)

    def fitted(name: str, model: Any, *arrays: np.ndarray) -> WrinkleRival:
        return WrinkleRival(name, lambda f, pose: draw(model.predict(code(f))), bases + arrays)

    ridge = Ridge(SOFTNESS).fit(inputs / spread, outputs)
    rivals.append(fitted("PCA and ridge", ridge, ridge.coef_))

    tell("fitting rivals: kernel ridge")
    kernel = KernelRidge(alpha=0.1, kernel="rbf", gamma=0.5 / count).fit(inputs / spread, outputs)
    rivals.append(fitted("kernel ridge", kernel, inputs, kernel.dual_coef_))

    tell("fitting rivals: nearest neighbour")
    neighbours = NearestNeighbors(n_neighbors=1).fit(inputs / spread)
    nearest = lambda f, pose: data.coefficients[neighbours.kneighbors(code(f))[1][0, 0]]  # noqa: E731
    rivals.append(WrinkleRival("nearest neighbour", nearest, (*bases[:2], inputs, data.coefficients)))

    if poses.ndim == 4:
        tell("fitting rivals: pose-driven")
        rivals.append(_pose_driven(poses, outputs, draw, bases[2:], seed))

    tell("fitting rivals: modes")
    flat = data.features.reshape(frames * places, -1)
    centre, scale = flat.mean(axis=0), 1.0 / (flat.std(axis=0) + 1e-4)
    modes = MiniBatchKMeans(min(MODES, len(flat)), batch_size=4096, n_init=1, random_state=seed)
    label = modes.fit_predict((flat - centre) * scale)
    size = np.maximum(np.bincount(label, minlength=modes.n_clusters), 1)[:, None]
    means = np.zeros((modes.n_clusters, atoms), np.float32)
    np.add.at(means, label, data.coefficients.reshape(-1, atoms))
    means /= size
    rivals.append(
        WrinkleRival(
            "k-means modes",
            lambda f, pose: means[modes.predict((f - centre) * scale)],
            (modes.cluster_centers_, means, centre, scale),
        )
    )

    tell("fitting rivals: wide network")
    wide = fit_layer(layer, data, hidden=WIDE, epochs=epochs, seed=seed)
    rivals.append(WrinkleRival("wide network", lambda f, pose: wide.predict(f), tuple(wide.arrays().values())))
    return rivals


def _pose_driven(
    poses: np.ndarray, outputs: np.ndarray, draw: Callable, bases: tuple[np.ndarray, ...], seed: int
) -> WrinkleRival:
    """Radial basis (distance itself) over the joints' turns against the first joint, thinned to CENTRES poses."""
    from scipy.interpolate import RBFInterpolator
    from sklearn.decomposition import PCA

    def turns(pose: np.ndarray) -> np.ndarray:
        rotation = pose[..., :3]
        return np.einsum("...jab,...ac->...jbc", rotation, rotation[..., 0, :, :]).reshape(*pose.shape[:-3], -1)

    some = np.random.default_rng(seed).permutation(len(poses))[:CENTRES]
    reduce = PCA(min(24, len(some) - 1), random_state=seed).fit(turns(poses))
    places = reduce.transform(turns(poses[some]))
    spline = RBFInterpolator(places, outputs[some], smoothing=1e-3, kernel="linear", degree=0)
    predict = lambda f, pose: draw(spline(reduce.transform(turns(pose)[None])))  # noqa: E731
    return WrinkleRival("pose-driven RBF", predict, (*bases, places, outputs[some], reduce.components_))


@dataclass(frozen=True)
class Wrinkles:
    """One mapping on the truth's own coarse states.

    Attributes:
        name: for people.
        figures: of :func:`wrinkles.metrics.given_coarse_figures`, with bending energy by band over the truth's.
        predict_ms: median time of the mapping alone, one frame at a time [ms].
        megabytes: that it has to store, as float32.
    """

    name: str
    figures: dict[str, float]
    predict_ms: float
    megabytes: float


def compare_wrinkles(
    layer: Layer,
    database: WrinkleDatabase,
    rivals: Sequence[WrinkleRival],
    truth: Truth,
    report: Callable[[str], None] | None = None,
) -> list[Wrinkles]:
    """Judge the database's mapping, every rival and the smooth surface on held-out motion, given its coarse states."""
    mapping = database.mapping
    ours = WrinkleRival("ours", lambda f, pose: mapping.predict(f), tuple(mapping.arrays().values()))
    recording = truth.recording.where(slice(EVERY // 2, None, EVERY))
    energy = truth.energy[EVERY // 2 :: EVERY]
    faces, owner = truth.levels.fine.faces, leading_vertices(truth.levels.subdivision)[:, 0]
    found = []
    for rival in (ours, *rivals):
        if report is not None:
            report(f"comparing wrinkles: {rival.name}")
        smooth, decoded, times = _decode(layer, database, rival, truth, recording)
        figures = dict(given_coarse_figures(decoded, recording.positions, smooth, faces, owner))
        ratios = truth.bands.band_ratios(truth.bands.energy(decoded), energy)
        figures |= {f"given_band_ratio_{name.replace(' ', '_')}": float(v) for name, v in ratios.items()}
        found.append(Wrinkles(rival.name, figures, 1e3 * float(np.median(times[:TIMED_FRAMES])), rival.megabytes))
    return found


def _decode(
    layer: Layer, database: WrinkleDatabase, rival: WrinkleRival, truth: Truth, recording: Recording
) -> tuple[np.ndarray, np.ndarray, list[float]]:
    times: list[float] = []

    def predict(features: np.ndarray, pose: np.ndarray) -> np.ndarray:
        began = time.perf_counter()
        coefficients = rival.predict(features, pose)
        times.append(time.perf_counter() - began)
        return coefficients

    return *decode_recording(layer, predict, database.atoms, truth.run, recording), times


@threadpool_limits.wrap(limits=1, user_api="blas")  # as everywhere here: beside other work, more are slower by far
def compare_wrinkles_file(
    path: Path, output: Path, *, report: Callable[[str], None] | None = None
) -> tuple[WrinkleDatabase, list[Wrinkles]]:
    """Fit every rival on what a database has learned from, and compare on its first held-out motion.

    Args:
        path: a database whose recorded runs lie beside it (they are simulated again where they do not), or a scene.
        output: folder of the scene's database.
        report: told lines of progress.

    Raises:
        InputError: what cannot be read, or a scene without held-out motion.
    """
    path = database_of(path, output, report)
    database = read_database(path)
    scene = scene_of(database)
    if not scene.training.held_out:
        raise InputError("nothing is held out", file=path, key="training.held_out", expected="a clip to compare on")
    stage, cache = Stage.of(scene), default_cache(path)
    runs = training_runs(stage, scene)
    chosen = spread_frames(record_runs(runs, cache, 2, report), TRAINING_FRAMES)
    layer = build_layer(stage.levels)
    data = training_set(layer, chosen, len(database.atoms.shapes), database.seed)
    poses = np.concatenate([run.poses[r.frames] for run, r in zip(runs, chosen, strict=True)])
    rivals = fit_rivals(layer, data, poses, epochs=EPOCHS, seed=database.seed, report=report)
    held_out = scene_run(stage, scene, stage.motion(scene.training.held_out[0]))
    truth = truth_of(held_out, cache, 2, report)
    return database, compare_wrinkles(layer, database, rivals, truth, report)


def write_wrinkles(path: Path, database: WrinkleDatabase, found: Sequence[Wrinkles]) -> None:
    """Write the page: error against time and against megabytes, and all figures."""
    smooth = found[0].figures["normal_error_smooth_deg"]

    def chart(cost: Callable[[Wrinkles], float], label: str) -> Chart:
        points = [Point(cost(one), one.figures["normal_error_deg"], one.name, one.name) for one in found]
        return Chart(points, label, "mean normal error [deg]", log_x=True, lines=[Line("y", smooth, "smooth")])

    names = list(found[0].figures)
    rows = [["mapping of a frame [ms]", *(one.predict_ms for one in found)]]
    rows += [["to store [MB]", *(one.megabytes for one in found)]]
    rows += [[name, *(one.figures[name] for one in found)] for name in names]
    sections: list[Section] = [
        Text(wrinkle_verdict(found)),
        chart(lambda one: one.predict_ms, "time of the mapping of a frame [ms]"),
        chart(lambda one: one.megabytes, "to store [MB]"),
        Table(["", *(one.name for one in found)], rows, "Given the coarse state of the truth"),
        Text(_NOTES),
    ]
    write_page(path, f"{database.garment_name}, {database.held_out[0]}: ways to wrinkles", sections)


def wrinkle_verdict(found: Sequence[Wrinkles]) -> str:
    """Who is nearest to the truth, in a sentence; a rival that wins is named as plainly as ours would be."""
    best = min(found, key=lambda one: one.figures["normal_error_deg"])
    told = ", ".join(f"{one.name} {one.figures['normal_error_deg']:.3g} deg" for one in found)
    smooth = found[0].figures["normal_error_smooth_deg"]
    return f"Nearest to the truth's normals is {best.name}. Smooth {smooth:.3g} deg, {told}."
