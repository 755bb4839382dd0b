"""`gube bench wrinkles`: the worth of each part of the wrinkle layer, found by leaving it out or replacing it.

Every row is learned from the same recorded runs, half of the frames of a database in half the passes, and judged on its
first held-out motion. Rows that are finished are kept beside the recorded runs.
"""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from pbd import ModelOptions
from pbd.storage import replacing
from precompute.learning import decoding, held_out, training
from precompute.learning.calibration import filtered
from precompute.learning.decoding import Predictor
from precompute.learning.held_out import coarse_run
from precompute.learning.pipeline import default_cache, training_recordings
from precompute.learning.training import (
    coefficients_of,
    features_of,
    spread_frames,
)
from precompute.wrinkle_comparison.ablation_experiment import EPOCHS, FRAMES, Experiment, Variant
from precompute.wrinkle_comparison.wrinkle_baselines import k_means_modes
from wrinkles.charts import fine_places
from wrinkles.coarse_filter import CoarseFilter
from wrinkles.database import code_version
from wrinkles.dictionary import CoefficientNetwork
from wrinkles.features import DYNAMIC_COUNT

__all__ = ["ABLATIONS", "COLUMNS", "Ablation", "ablate_file", "table"]

HISTORY_NOISE = 0.3  # on the past coefficients that are inputs in training, in standard deviations
COLUMNS = (
    "normal_error_deg",
    "normal_skill",
    "rmse_skill",
    "worse_than_smooth_percent",
    "bending_energy_ratio",
    "spectrum_band_error_max",
    "decode_ratio",
)


@dataclass(frozen=True)
class Ablation:
    """A row of the table.

    Attributes:
        group: the part of the wrinkle layer.
        name: how the part is changed.
        make: makes the variant.
    """

    group: str
    name: str
    make: Callable[[Experiment], Variant]

    def key(self, database: bytes) -> str:
        """Hash of what the row's figures depend on."""
        digest = hashlib.sha256(database)
        made = getattr(self.make, "func", self.make), training, decoding, held_out
        sources = (inspect.getsource(part) for part in made)
        for part in (code_version(), self.group, self.name, str((FRAMES, EPOCHS)), *sources):
            digest.update(part.encode() + b"\0")
        return digest.hexdigest()[:24]


def _seeing(experiment: Experiment, kept: np.ndarray) -> Variant:
    """With some of the features only."""
    mapping = experiment.fit(replace(experiment.data, features=experiment.data.features[..., kept]))
    return experiment.mapped(lambda features, pose: mapping.predict(features[..., kept]))


_OFFSETS = DYNAMIC_COUNT - 12  # then gravity 3 and distances 9; see wrinkles.features


def _without_gravity(experiment: Experiment) -> Variant:
    return _seeing(experiment, np.setdiff1d(np.arange(DYNAMIC_COUNT), np.arange(_OFFSETS, _OFFSETS + 3)))


def _without_body(experiment: Experiment) -> Variant:
    return _seeing(experiment, np.arange(DYNAMIC_COUNT - 9))


def _ring(points: int) -> np.ndarray:
    """Features without the offsets of stencil points further than so many steps away."""
    side = round((_OFFSETS / 3 + 1) ** 0.5)
    steps = np.abs(np.arange(side) - side // 2)
    reach = np.maximum.outer(steps, steps).ravel()
    kept = np.repeat(reach[reach > 0] <= points, 3)
    return np.flatnonzero(np.concatenate([kept, np.ones(DYNAMIC_COUNT - _OFFSETS, bool)]))


def _three_by_three(experiment: Experiment) -> Variant:
    return _seeing(experiment, _ring(1))


def _without_place(experiment: Experiment) -> Variant:
    stencil = experiment.layer.stencil
    layer = replace(experiment.layer, stencil=replace(stencil, static=np.zeros_like(stencil.static)))
    return experiment.variant(experiment.fit(experiment.data, layer))


def _blended(experiment: Experiment, blend: Callable[[np.ndarray], np.ndarray]) -> Variant:
    """With other weights of the three patches around a vertex, made from its barycentric weights."""
    place = fine_places(experiment.layer.levels.subdivision)[1]
    layer = replace(experiment.layer, patches=experiment.layer.patches.blended(blend(place)))
    data = experiment.learn_from(layer)
    return experiment.variant(experiment.fit(data, layer), layer, data.atoms)


def _single_patch(experiment: Experiment) -> Variant:
    return _blended(experiment, lambda place: np.eye(3)[place.argmax(axis=1)])


def _barycentric(experiment: Experiment) -> Variant:
    return _blended(experiment, lambda place: place)


def _remembering(experiment: Experiment, past: np.ndarray, seed: int = 0) -> CoefficientNetwork:
    """A network with the coefficients of the recorded frame before as inputs, with noise on them."""
    spread = past.std(axis=(0, 1))
    noise = np.random.default_rng(seed).standard_normal(past.shape, np.float32) * (HISTORY_NOISE * spread)
    inputs = np.concatenate([experiment.data.features, past + noise.astype(np.float32)], axis=2)
    return experiment.fit(replace(experiment.data, features=inputs))


def _before(experiment: Experiment, sequences: Sequence[np.ndarray]) -> np.ndarray:
    """Coefficients one frame before the frames that are learned from.

    Args:
        experiment: whose recordings.
        sequences: coefficients of all frames of each recording.
    """
    rows = []
    for recording, some, sequence in zip(experiment.recordings, experiment.learned, sequences, strict=True):
        at = np.searchsorted(recording.frames, some.frames)
        rows.append(sequence[np.maximum(at - 1, 0)])
    return np.concatenate(rows)


def _rolled_out(mapping: CoefficientNetwork, features: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Coefficients of a sequence by a mapping whose inputs are its own last outputs; shape (f, n, K)."""
    found, past = np.zeros((len(features), *first.shape), np.float32), first
    for frame, seen in enumerate(features):
        found[frame] = past = mapping.predict(np.concatenate([seen, past], axis=1))
    return found


def _true_past(experiment: Experiment) -> np.ndarray:
    atoms = experiment.data.atoms
    return _before(
        experiment, [coefficients_of(experiment.layer, [recording], atoms) for recording in experiment.recordings]
    )


def _recalling(experiment: Experiment, mapping: CoefficientNetwork) -> Variant:
    """Begin at rest; after that the last output is an input."""
    shape = experiment.data.coefficients.shape[1:]

    def begin() -> Predictor:
        past = np.zeros(shape, np.float32)

        def predict(features: np.ndarray, pose: np.ndarray) -> np.ndarray:
            past[:] = mapping.predict(np.concatenate([features, past], axis=1))
            return past.copy()

        return predict

    return replace(experiment.full, begin=begin)


def _true_history(experiment: Experiment) -> Variant:
    """The past is the truth's own: the most that history could give. No free run has it."""
    mapping = _remembering(experiment, _true_past(experiment))
    truth = coefficients_of(experiment.layer, [experiment.truth.recording], experiment.data.atoms)
    past = np.concatenate([truth[:1], truth[:-1]])

    def begin() -> Predictor:
        rows = iter(past)
        return lambda features, pose: mapping.predict(np.concatenate([features, next(rows)], axis=1))

    return replace(experiment.full, begin=begin)


def _history(experiment: Experiment) -> Variant:
    return _recalling(experiment, _remembering(experiment, _true_past(experiment)))


def _history_of_its_own(experiment: Experiment) -> Variant:
    """Learned again with the outputs of a first network as the past, which had its own outputs as inputs."""
    mapping = _remembering(experiment, _true_past(experiment))
    rest = np.zeros(experiment.data.coefficients.shape[1:], np.float32)
    said = [_rolled_out(mapping, features_of(experiment.layer, r)[0], rest) for r in experiment.recordings]
    return _recalling(experiment, _remembering(experiment, _before(experiment, said)))


def _independent_pairs(experiment: Experiment) -> Variant:
    """Pairs C: learned from the free coarse garment, with the wrinkles of the fine one that ran beside it."""
    runs = [coarse_run(experiment.database, run) for run in experiment.runs]
    matrix = CoarseFilter(experiment.stage.levels).matrix
    coarse = [
        filtered(recording, matrix) for recording in training_recordings(runs, experiment.cache, 2, experiment.report)
    ]
    features = np.concatenate([features_of(experiment.layer, r)[0] for r in spread_frames(coarse, FRAMES)])
    return experiment.variant(experiment.fit(replace(experiment.data, features=features)))


def _atoms(experiment: Experiment, count: int) -> Variant:
    """The first so many: principal components come in order."""
    whole = experiment.data
    atoms = replace(whole.atoms, shapes=np.ascontiguousarray(whole.atoms.shapes[:count]))
    data = replace(whole, atoms=atoms, coefficients=whole.coefficients[..., :count])
    return experiment.variant(experiment.fit(data), atoms=atoms)


def _modes(experiment: Experiment) -> Variant:
    return experiment.mapped(k_means_modes(experiment.data, experiment.database.seed).predict)


def _linear(experiment: Experiment) -> Variant:
    """One ridge regression from features and place, shared by all places."""
    from sklearn.linear_model import Ridge

    data, static = experiment.data, experiment.layer.stencil.static
    spread = data.features.std(axis=(0, 1)) + 1e-4

    def inputs_of(features: np.ndarray) -> np.ndarray:
        places = np.broadcast_to(static, (*features.shape[:-1], static.shape[1]))
        return np.concatenate([features / spread, places], axis=-1)

    inputs = inputs_of(data.features).reshape(-1, data.features.shape[2] + static.shape[1])
    ridge = Ridge(1.0).fit(inputs, data.coefficients.reshape(len(inputs), -1))
    return experiment.mapped(lambda features, pose: ridge.predict(inputs_of(features)).astype(np.float32))


def _hidden(experiment: Experiment, widths: tuple[int, int]) -> Variant:
    return experiment.variant(experiment.fit(experiment.data, hidden=widths))


def _one_region(experiment: Experiment) -> Variant:
    return experiment.variant(experiment.fit(experiment.data, regions=1))


def _relaxed(experiment: Experiment, passes: int) -> Variant:
    return replace(experiment.full, passes=passes)


def _coarse_model(experiment: Experiment, squeeze: float, bend_scale: float, shear_scale: float = 1.0) -> Variant:
    own = experiment.full.options or ModelOptions()
    options = replace(own, compression_compliance_scale=squeeze, bend_scale=bend_scale, shear_scale=shear_scale)
    return replace(experiment.full, options=options)


ABLATIONS = (
    Ablation("full", "", lambda experiment: experiment.full),
    Ablation("features", "without gravity", _without_gravity),
    Ablation("features", "without the body", _without_body),
    Ablation("features", "stencil 3 by 3", _three_by_three),
    Ablation("features", "without place", _without_place),
    Ablation("pairs", "C: both run independently", _independent_pairs),
    Ablation("dictionary", "16 atoms", partial(_atoms, count=16)),
    Ablation("dictionary", "32 atoms", partial(_atoms, count=32)),
    Ablation("dictionary", "k-means modes", _modes),
    Ablation("dictionary", "ridge regression", _linear),
    Ablation("dictionary", "one region", _one_region),
    Ablation("dictionary", "hidden 128, 64", partial(_hidden, widths=(128, 64))),
    Ablation("dictionary", "hidden 640, 256", partial(_hidden, widths=(640, 256))),
    Ablation("mixing", "nearest patch alone", _single_patch),
    Ablation("mixing", "barycentric weights", _barycentric),
    Ablation("history", "previous coefficients, true ones told", _true_history),
    Ablation("history", "previous coefficients, its own", _history),
    Ablation("history", "previous coefficients, learned from its own", _history_of_its_own),
    Ablation("relaxation", "no pass", partial(_relaxed, passes=0)),
    Ablation("relaxation", "1 pass", partial(_relaxed, passes=1)),
    Ablation("relaxation", "4 passes", partial(_relaxed, passes=4)),
    Ablation("calibration", "off: squeeze 1, bending 1", partial(_coarse_model, squeeze=1.0, bend_scale=1.0)),
    Ablation("calibration", "squeeze 10, bending 1", partial(_coarse_model, squeeze=10.0, bend_scale=1.0)),
    Ablation("calibration", "squeeze 1, bending 10", partial(_coarse_model, squeeze=1.0, bend_scale=10.0)),
    Ablation(
        "calibration", "squeeze 10, shear 0.3", partial(_coarse_model, squeeze=10.0, bend_scale=1.0, shear_scale=0.3)
    ),
)


@threadpool_limits.wrap(limits=1, user_api="blas")
def ablate_file(path: Path, *, report: Callable[[str], None] | None = None) -> list[dict[str, float | str]]:
    """Every row of the table; those that are finished are read back.

    Args:
        path: a database; its recorded runs lie beside it, or are simulated again.
        report: called with lines of progress.

    Raises:
        InputError: what cannot be read, or a scene without held-out motion.
    """
    content, folder = path.read_bytes() if path.is_file() else b"", default_cache(path) / "ablations"
    experiment = Experiment(path, report)
    rows = []
    for ablation in ABLATIONS:
        kept = folder / f"{ablation.key(content)}.json"
        if not kept.exists():
            if report is not None:
                report(f"ablation: {ablation.group} {ablation.name}")
            figures = experiment.judge(ablation.make(experiment))
            with replacing(kept) as beside:
                beside.write_text(json.dumps(figures), encoding="utf-8")
        rows.append({"group": ablation.group, "name": ablation.name, **json.loads(kept.read_text(encoding="utf-8"))})
    return rows


def table(rows: Sequence[dict[str, float | str]]) -> str:
    """The rows as a table in Markdown."""
    lines = ["| | | " + " | ".join(COLUMNS) + " |", "|" + "---|" * (len(COLUMNS) + 2)]
    for row in rows:
        figures = " | ".join(f"{row[name]:.3g}" for name in COLUMNS)
        lines.append(f"| {row['group']} | {row['name']} | {figures} |")
    return "\n".join(lines)
