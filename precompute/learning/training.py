"""From recorded runs to a fitted dictionary, and the calibration of the coarse model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from precompute.learning.recording import Recording
from wrinkles.charts import Charts
from wrinkles.dictionary import Atoms, Mapping, fit_atoms, fit_mapping
from wrinkles.features import DYNAMIC_COUNT, REGIONS, Stencil
from wrinkles.levels import Levels
from wrinkles.patches import NODES, Patches

__all__ = [
    "FeatureStatistics",
    "Layer",
    "TrainingSet",
    "build_layer",
    "coefficients_of",
    "features_of",
    "fit_layer",
    "spread_frames",
    "training_set",
]


@dataclass(frozen=True)
class Layer:
    """The wrinkle layer of one garment before anything is learned: where to look and where to write."""

    levels: Levels
    stencil: Stencil
    patches: Patches
    middle_patches: Patches


def build_layer(levels: Levels) -> Layer:
    """Charts, stencil and patches of a garment."""
    charts = Charts.of(levels.coarse)
    fine, middle = (Patches.of(one, charts) for one in (levels.subdivision, levels.subdivision.middle))
    return Layer(levels, Stencil.of(charts, levels.coarse_held), fine, middle)


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


def training_set(layer: Layer, recordings: Sequence[Recording], atom_count: int, seed: int) -> TrainingSet:
    """Residual patches of recorded frames, fitted and reduced to atoms.

    Args:
        layer: of the garment.
        recordings: fine runs, filtered down (pairs A); see :func:`spread_frames`.
        atom_count: number of atoms.
        seed: of the choice of patches that the atoms are fitted to.
    """
    features, patches_at, count = _patch_reader(layer, recordings)
    rng = np.random.default_rng(seed)
    frame_count = len(features)
    some = rng.choice(frame_count, min(frame_count, max(1, 60_000 // count)), replace=False)
    sample = np.stack([patches_at(i)[some] for i in range(count)], axis=1)
    atoms = fit_atoms(sample.reshape(-1, 3 * NODES), atom_count, layer.levels.subdivision.fine_count)
    return TrainingSet(features, _reduced(patches_at, count, atoms), atoms)


def coefficients_of(layer: Layer, recordings: Sequence[Recording], atoms: Atoms) -> np.ndarray:
    """What the patches of recorded frames are in atoms: float32, shape (S, n, K)."""
    _, patches_at, count = _patch_reader(layer, recordings)
    return _reduced(patches_at, count, atoms)


def _reduced(patches_at: Callable[[int], np.ndarray], count: int, atoms: Atoms) -> np.ndarray:
    coefficients = np.stack([(patches_at(i) - atoms.mean) @ atoms.analysis for i in range(count)], axis=1)
    return coefficients.astype(np.float32)


def _patch_reader(layer: Layer, recordings: Sequence[Recording]) -> tuple[np.ndarray, Callable[[int], np.ndarray], int]:
    """Features of recorded frames, a function that gives the fitted patches of a coarse vertex, and their number."""
    features, turned = zip(*(features_of(layer, r) for r in recordings), strict=True)
    residual = np.concatenate([residual_of(layer, r) for r in recordings])
    frames = np.concatenate(turned)
    fits = layer.patches.fits(layer.levels.subdivision.coarse_count)
    return np.concatenate(features), lambda i: _patches(residual, frames, fits, i), len(fits)


def residual_of(layer: Layer, recording: Recording) -> np.ndarray:
    """Fine positions less the smooth surface of their coarse ones [m], float32, shape (f, N, 3)."""
    smooth = np.stack([layer.levels.subdivision.upsample(frame) for frame in recording.coarse])
    return (recording.positions - smooth).astype(np.float32)


def _patches(residual: np.ndarray, frames: np.ndarray, fits: list, i: int) -> np.ndarray:
    """Grids fitted to the residual around coarse vertex i in its own frame: shape (f, 3 NODES)."""
    members, fit = fits[i]
    basis = frames[:, i].reshape(-1, 3, 3)
    local = np.einsum("fkx,fax->fka", residual[:, members], basis)
    return np.einsum("nk,fka->fna", fit.astype(np.float32), local).reshape(len(residual), -1)


def fit_layer(
    layer: Layer,
    data: TrainingSet,
    *,
    hidden: tuple[int, int],
    epochs: int,
    seed: int,
    report: Callable[[str], None] | None = None,
    fabrics: np.ndarray | None = None,
    regions: int = REGIONS,
) -> Mapping:
    """Fit the mapping to a training set; arguments as for :func:`wrinkles.dictionary.fit_mapping`, in ``regions``."""
    return fit_mapping(
        data.features,
        layer.stencil.static,
        data.coefficients,
        hidden=hidden,
        epochs=epochs,
        seed=seed,
        report=report,
        fabrics=fabrics,
        region=layer.stencil.regions(regions),
    )


@dataclass(frozen=True)
class FeatureStatistics:
    """Whitened statistics of features, to measure how far one set is from another.

    Attributes:
        mean, axes: of the reference; (features - mean) @ axes has unit variance, shapes (d,), (d, k).
    """

    mean: np.ndarray
    axes: np.ndarray

    @classmethod
    def of(cls, features: np.ndarray, kept: int = 40) -> FeatureStatistics:
        """Statistics of reference features, shape (f, n, d)."""
        flat = features.reshape(-1, features.shape[-1]).astype(float)
        mean, spread = flat.mean(axis=0), flat.std(axis=0) + 1e-4
        _, values, rows = np.linalg.svd(np.cov(((flat - mean) / spread).T), hermitian=True)
        return cls(mean, (rows[:kept] / np.sqrt(values[:kept, None])).T / spread[:, None])

    def shift(self, features: np.ndarray) -> float:
        """Root mean squared Mahalanobis distance from the reference mean, per dimension; 1 for the reference."""
        z = (features.reshape(-1, features.shape[-1]) - self.mean) @ self.axes
        return float(np.sqrt((z**2).mean()))

    def mismatch(self, features: np.ndarray) -> float:
        """Frechet distance to the reference with diagonal covariances, per dimension; 0 for the reference."""
        z = (features.reshape(-1, features.shape[-1]) - self.mean) @ self.axes
        return float(np.sqrt((z.mean(axis=0) ** 2 + (z.std(axis=0) - 1.0) ** 2).mean()))
