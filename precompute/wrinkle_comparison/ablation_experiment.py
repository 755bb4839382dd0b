"""The material of ablations of the wrinkle layer: a database, its training runs and its held-out motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from pbd import ModelOptions
from precompute.learning.decoding import (
    FrameDecoder,
    Predictor,
    by_features,
    by_patches,
    decoded_frames,
    with_vertex_mean,
)
from precompute.learning.evaluation import Truth
from precompute.learning.held_out import HeldOut, held_out_truth
from precompute.learning.options import LearningOptions
from precompute.learning.pipeline import default_cache, training_recordings, training_runs
from precompute.learning.recording import Recording, Run
from precompute.learning.training import Layer, TrainingSet, build_layer, fit_layer, spread_frames, training_set
from runtime.garment_setup import GarmentSetup, scene_of
from wrinkles.database import WrinkleDatabase, read_database
from wrinkles.dictionary import Atoms, CoefficientNetwork

__all__ = ["Experiment", "Variant"]

FRAMES, EPOCHS = LearningOptions().training_frames // 2, LearningOptions().epochs
TIMED_FRAMES = 30


@dataclass(frozen=True)
class Variant:
    """One way from the coarse to the fine mesh.

    Attributes:
        layer: the stencils that features are read from and the patches that are written to.
        atoms: of the coefficients.
        begin: gives the mapping at the start of a run; one that remembers is shown all frames in order.
        passes: of relaxation; None takes those of full detail.
        options: of the coarse model in the free run; None for the calibrated ones.
    """

    layer: Layer
    atoms: Atoms
    begin: Callable[[], Predictor]
    passes: int | None = None
    options: ModelOptions | None = None

    def lift(self) -> FrameDecoder:
        """Adds wrinkles to a run from its first frame on."""
        predict = self.begin()
        return by_patches(self.layer, predict, self.atoms)


class Experiment:
    """A database with its training runs and its held-out motion; each is made when it is first asked for.

    Args:
        path: of the database; its recorded runs lie beside it, or are simulated again.
        report: called with lines of progress.

    Raises:
        InputError: what cannot be read, or a scene without held-out motion.
    """

    def __init__(self, path: Path, report: Callable[[str], None] | None = None) -> None:
        self.database: WrinkleDatabase = read_database(path)
        self.report = report
        self.cache = default_cache(path)
        self._path, self._scene = path, scene_of(self.database)
        self.stage = GarmentSetup.of(self._scene)
        self.layer = build_layer(self.stage.levels)
        self.hidden = self.database.mapping.weights_2.shape[1:]
        self.held_out = cache(self._held_out)

    @cached_property
    def truth(self) -> Truth:
        return held_out_truth(self._path, self.stage, self._scene, self.cache, self.report)

    def _held_out(self, options: ModelOptions | None) -> HeldOut:
        return HeldOut.of(self.database, self.truth, self.cache, options, self.report)

    @cached_property
    def runs(self) -> list[Run]:
        return training_runs(self.layer, self.stage, self._scene, self.cache, self.report)

    @cached_property
    def recordings(self) -> list[Recording]:
        """Every recorded frame of the training runs."""
        return training_recordings(self.runs, self.cache, 2, self.report)

    @cached_property
    def data(self) -> TrainingSet:
        return self.learn_from(self.layer)

    @cached_property
    def learned(self) -> list[Recording]:
        """The frames that are learned from."""
        return spread_frames(self.recordings, FRAMES)

    def learn_from(self, layer: Layer) -> TrainingSet:
        """The training set of a layer with other stencils or patches."""
        return training_set(layer, self.learned, len(self.database.atoms.shapes), self.database.seed)

    def fit(self, data: TrainingSet, layer: Layer | None = None, **changes) -> CoefficientNetwork:
        """The network, in half the passes of a database, but for ``changes``, arguments of :func:`fit_layer`."""
        settings = {"hidden": self.hidden, "epochs": max(1, EPOCHS // 2), "seed": self.database.seed} | changes
        return fit_layer(layer or self.layer, data, **settings)

    @cached_property
    def full(self) -> Variant:
        return self.variant(self.fit(self.data))

    def variant(self, mapping: CoefficientNetwork, layer: Layer | None = None, atoms: Atoms | None = None) -> Variant:
        """The full variant with another mapping, layer or atoms."""
        return self.mapped(by_features(mapping), layer, atoms)

    def mapped(self, predict: Predictor, layer: Layer | None = None, atoms: Atoms | None = None) -> Variant:
        """The same with any mapping; vertices have the mean of what it leaves."""
        layer, atoms = layer or self.layer, atoms or self.data.atoms
        atoms = with_vertex_mean(layer, predict, atoms, self.runs, self.learned)
        return Variant(layer, atoms, lambda: predict)

    def judge(self, variant: Variant) -> dict[str, float]:
        """Figures given the coarse state and running freely, and the time of decoding over the full one's."""
        held_out = self.held_out(variant.options)
        given = held_out.truth.recording
        smooth, decoded, _ = held_out.show(variant.layer, variant.lift(), given, variant.passes)
        figures = held_out.given_figures(smooth, decoded)
        figures |= held_out.free_figures(held_out.show(variant.layer, variant.lift(), held_out.free, variant.passes)[1])
        some, run = given.where(slice(TIMED_FRAMES)), self.truth.run
        both = (decoded_frames(one.layer, one.lift(), run, some, one.passes) for one in (variant, self.full))
        ratios = [mine[2] / full[2] for mine, full in zip(*both, strict=True)]  # frame by frame, in turns
        return figures | {"decode_ratio": float(np.median(ratios))}
