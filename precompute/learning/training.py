"""From recorded runs to a fitted dictionary."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from precompute.learning.run_recording import Recording
from wrinkles.charts import Charts
from wrinkles.dictionary import Atoms, CoefficientNetwork, fit_atoms, fit_coefficient_network
from wrinkles.features import DYNAMIC_COUNT, Stencil
from wrinkles.levels import Levels
from wrinkles.network import in_threads
from wrinkles.patches import Patches

__all__ = [
    "Layer",
    "TrainingSet",
    "build_layer",
    "coefficients_of",
    "features_of",
    "fit_layer",
    "spread_frames",
    "training_set",
]

SAMPLED_PATCHES = 60_000  # that the atoms are fitted to
BLOCK = 32  # frames whose smooth surface is computed at once


@dataclass(frozen=True)
class Layer:
    """The wrinkle layer of one garment before anything is learned: where to look and where to write."""

    levels: Levels
    stencil: Stencil
    patches: Patches


def build_layer(levels: Levels) -> Layer:
    """Charts, stencil and patches of a garment."""
    charts = Charts.of(levels.coarse)
    layer = None if levels.layers is None else levels.layers.layer
    return Layer(levels, Stencil.of(charts, levels.coarse_held, layer), Patches.of(levels.subdivision, charts))


def features_of(layer: Layer, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Dynamic features, float32, shape (f, n, DYNAMIC_COUNT), and vertex frames, shape (f, n, 9), of a recording."""
    count, total = layer.levels.subdivision.coarse_count, len(recording.frames)
    features = np.zeros((total, count, DYNAMIC_COUNT), np.float32)
    frames = np.zeros((total, count, 9), np.float32)
    position = np.zeros((count, 4), np.float32)
    for f in range(total):
        position[:, :3] = recording.coarse[f]
        contact = np.ascontiguousarray(recording.contact[f])
        layer.stencil.read(position, contact, frames[f], features[f])
    return features, frames


@dataclass(frozen=True)
class TrainingSet:
    """Features with the patches that belong to them.

    Attributes:
        features: float32, shape (S, n, DYNAMIC_COUNT).
        coefficients: float32, shape (S, n, K).
        atoms: the atoms that the coefficients count.
    """

    features: np.ndarray
    coefficients: np.ndarray
    atoms: Atoms


def spread_frames(recordings: Sequence[Recording], frames: int) -> list[Recording]:
    """Frames spread over recordings, ``frames`` of them at most."""
    step = max(1, -(-sum(len(r.frames) for r in recordings) // frames))
    return [r.where(slice(step // 2, None, step)) for r in recordings]


def training_set(
    layer: Layer,
    recordings: Sequence[Recording],
    atom_count: int,
    seed: int,
    report: Callable[[str], None] | None = None,
) -> TrainingSet:
    """Residual patches of recorded frames, fitted and reduced to atoms.

    Args:
        layer: of the garment.
        recordings: fine runs, filtered down (pairs A); see :func:`spread_frames`.
        atom_count: number of atoms.
        seed: of the choice of patches that the atoms are fitted to.
        report: called with lines of progress.
    """
    tell = report or (lambda line: None)
    tell("fitting patches: reading frames")
    around = _Residuals.of(layer, recordings)
    tell("fitting patches: choosing atoms")
    count, frame_count = len(around.fits), len(around.features)
    rng = np.random.default_rng(seed)
    some = rng.choice(frame_count, min(frame_count, max(1, SAMPLED_PATCHES // count)), replace=False)
    sample = np.stack(in_threads(lambda i: around.grids(i, some), range(count)), axis=1)
    atoms = fit_atoms(sample.reshape(-1, sample.shape[-1]), atom_count, layer.levels.subdivision.fine_count)
    tell("fitting patches: reading coefficients")
    return TrainingSet(around.features, around.coefficients(atoms), atoms)


def coefficients_of(layer: Layer, recordings: Sequence[Recording], atoms: Atoms) -> np.ndarray:
    """What the patches of recorded frames are in atoms: float32, shape (S, n, K)."""
    return _Residuals.of(layer, recordings).coefficients(atoms)


@dataclass(frozen=True)
class _Residuals:
    """What recorded frames have besides the smooth surface, to be read patch by patch.

    Attributes:
        features: float32, shape (f, n, DYNAMIC_COUNT).
        rows: the residual along each axis [m], float32, shape (3, N, f): the frames of a vertex lie together.
        frames: of the coarse vertices, float32, shape (n, 3, 3, f): axis of the frame, axis of space.
        fits: of each coarse vertex, see :meth:`wrinkles.patches.Patches.fits`.
    """

    features: np.ndarray
    rows: np.ndarray
    frames: np.ndarray
    fits: list[tuple[np.ndarray, np.ndarray]]

    @classmethod
    def of(cls, layer: Layer, recordings: Sequence[Recording]) -> _Residuals:
        features, frames = (
            np.concatenate(parts) for parts in zip(*(features_of(layer, r) for r in recordings), strict=True)
        )
        rows = np.zeros((3, layer.levels.subdivision.fine_count, len(frames)), np.float32)
        firsts = np.cumsum([0, *(len(r.frames) for r in recordings)])
        blocks = [
            (recording, first, slice(begin, min(begin + BLOCK, len(recording.frames))))
            for recording, first in zip(recordings, firsts, strict=False)
            for begin in range(0, len(recording.frames), BLOCK)
        ]

        def fill(block: tuple[Recording, int, slice]) -> None:
            recording, first, some = block
            residual = residual_of(layer, recording.where(some))
            rows[:, :, first + some.start : first + some.stop] = residual.transpose(2, 1, 0)

        in_threads(fill, blocks)
        turned = np.ascontiguousarray(frames.reshape(*frames.shape[:2], 3, 3).transpose(1, 2, 3, 0))
        return cls(features, rows, turned, layer.patches.fits(frames.shape[1]))

    def local(self, i: int, some: np.ndarray | slice = slice(None)) -> np.ndarray:
        """The residual in the patch of coarse vertex i, in its own frame [m]: float32, shape (3, k, f)."""
        members, _ = self.fits[i]
        there, basis = self.rows[:, members][:, :, some], self.frames[i][:, :, some]
        found = basis[:, None, 0] * there[0]
        for axis in (1, 2):
            found += basis[:, None, axis] * there[axis]
        return found

    def grids(self, i: int, some: np.ndarray) -> np.ndarray:
        """Grids that are fitted to it in some frames [m], float32, shape (f, 3 nodes)."""
        fit = self.fits[i][1].astype(np.float32)
        return (fit @ self.local(i, some)).transpose(2, 1, 0).reshape(len(some), -1)

    def coefficients(self, atoms: Atoms) -> np.ndarray:
        """What the grids of all patches are in atoms, float32, shape (f, n, K)."""
        found = np.zeros((len(self.features), len(self.fits), len(atoms.shapes)), np.float32)
        analysis = atoms.analysis.astype(float).reshape(len(atoms.mean) // 3, 3, -1)
        offset = (atoms.mean @ atoms.analysis).astype(np.float32)

        def fill(i: int) -> None:
            local = self.local(i)
            # Fitting a grid and reading its coefficients are one matrix.
            both = np.einsum("nk,nac->akc", self.fits[i][1], analysis, optimize=True).astype(np.float32)
            found[:, i] = local.reshape(-1, local.shape[2]).T @ both.reshape(-1, both.shape[2]) - offset

        in_threads(fill, range(len(self.fits)))
        return found


def residual_of(layer: Layer, recording: Recording) -> np.ndarray:
    """Fine positions less the smooth surface of their coarse ones [m], float32, shape (f, N, 3)."""
    return (recording.positions - layer.levels.subdivision.upsample(recording.coarse)).astype(np.float32)


def fit_layer(
    layer: Layer,
    data: TrainingSet,
    *,
    hidden: tuple[int, int],
    epochs: int,
    seed: int,
    report: Callable[[str], None] | None = None,
) -> CoefficientNetwork:
    """Fit the network to a training set; see :func:`wrinkles.dictionary.fit_coefficient_network`."""
    return fit_coefficient_network(
        data.features,
        layer.stencil.static,
        data.coefficients,
        hidden=hidden,
        epochs=epochs,
        seed=seed,
        report=report,
        region=layer.stencil.regions(),
    )
