"""The dictionary of wrinkles: atoms (shapes of wrinkle patches), and a small network that mixes them.

The network gives the atoms' coefficients at each coarse vertex for the features there. Its first layer is the same
everywhere on the garment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from pbd import Fabric
from wrinkles.network import Network
from wrinkles.patches import NODES, slope_metric

__all__ = ["FABRIC_COUNT", "Atoms", "Mapping", "fabric_features", "fit_atoms", "fit_mapping", "whitening"]

NOISE = 0.05  # of the features in training, in standard deviations
FABRIC_COUNT = 2  # number of fabric_features
MIN_GRAVITY_LENGTH = 1e-3  # shorter ones count as this [m]: no mesh shows their folds
REGION_RATE = 0.015  # where a region goes on from what all places have learned
CLIP = 4.0  # features further out than this many standard deviations count as if they stood there


@dataclass(frozen=True)
class Atoms:
    """Shapes of wrinkle patches: principal components in the slope metric, see :func:`wrinkles.patches.slope_metric`.

    Attributes:
        shapes: displacements [m] of unit coefficients, float32, shape (K, 3 NODES): warp, weft, normal of node 0, ...
        mean: mean patch [m], float32, shape (3 NODES,).
        kept: share of the metric's variance that the atoms represent [-].
        vertex_mean: mean displacement of each fine vertex that patches do not represent, in the vertex's frame [m],
            float32, shape (N, 3), see :mod:`wrinkles.vertex_mean`.
    """

    shapes: np.ndarray
    mean: np.ndarray
    kept: float
    vertex_mean: np.ndarray

    @cached_property
    def analysis(self) -> np.ndarray:
        """Matrix that gives coefficients of a patch: (patch - mean) @ analysis, float32, shape (3 NODES, K)."""
        lower = slope_metric()
        shapes = self.shapes.astype(float).T.reshape(NODES, -1)
        return (lower @ (lower.T @ shapes)).reshape(3 * NODES, -1).astype(np.float32)


def fit_atoms(patches: np.ndarray, count: int, fine_count: int) -> Atoms:
    """Principal components of patches in the slope metric; the vertex mean is zero.

    Args:
        patches: [m], shape (S, 3 NODES).
        count: number of atoms K.
        fine_count: number of fine vertices N.
    """
    from sklearn.decomposition import PCA

    lower = slope_metric()
    samples = patches.reshape(-1, NODES, 3)
    mean = samples.mean(axis=0)
    whitened = (np.swapaxes(samples - mean, 1, 2) @ lower).swapaxes(1, 2).reshape(len(samples), -1)
    components = PCA(count, svd_solver="covariance_eigh").fit(whitened)
    basis = components.components_.T
    shapes = np.linalg.solve(lower.T, basis.reshape(NODES, -1)).reshape(NODES, 3, -1)
    return Atoms(
        np.ascontiguousarray(shapes.reshape(3 * NODES, -1).T, np.float32),
        mean.ravel().astype(np.float32),
        float(components.explained_variance_ratio_.sum()),
        np.zeros((fine_count, 3), np.float32),
    )


@dataclass(frozen=True)
class Mapping:
    """The network that gives coefficients for features: two hidden layers of rectified units and a linear one.

    All places share the first layer; each region has its own second and third. The static features contribute to the
    first layer a bias for every coarse vertex, and the fabric contributes one bias for all vertices; neither costs time
    in playing. Regions with different layers cost a tenth of the network's time.

    Attributes:
        center, scale: of the dynamic features, float32, shape (DYNAMIC_COUNT,).
        place: static features, float32, shape (n, s).
        region: of each coarse vertex, int32, shape (n,), 0 to r - 1.
        weights_1, place_weights, bias_1: of the first layer, float32, shapes (DYNAMIC_COUNT, h1), (s, h1), (h1,).
        fabric_weights: of the first layer for :func:`fabric_features`, float32, shape (FABRIC_COUNT, h1).
        weights_2, bias_2, weights_3, bias_3: of the other layers in each region, float32, shapes (r, h1, h2), (r, h2),
            (r, h2, K), (r, K).
    """

    center: np.ndarray
    scale: np.ndarray
    place: np.ndarray
    region: np.ndarray
    weights_1: np.ndarray
    place_weights: np.ndarray
    bias_1: np.ndarray
    fabric_weights: np.ndarray
    weights_2: np.ndarray
    bias_2: np.ndarray
    weights_3: np.ndarray
    bias_3: np.ndarray

    @cached_property
    def place_bias(self) -> np.ndarray:
        """Bias of the first layer at each coarse vertex, float32, shape (n, h1)."""
        return self.place @ self.place_weights + self.bias_1

    def for_fabric(self, features: np.ndarray) -> Mapping:
        """The mapping for a fabric with these :func:`fabric_features`, shape (FABRIC_COUNT,)."""
        bias = np.asarray(features, np.float32) @ self.fabric_weights
        return replace(self, bias_1=self.bias_1 + bias, fabric_weights=np.zeros_like(self.fabric_weights))

    def amplified(self, gain: float) -> Mapping:
        """The mapping with all coefficients multiplied by ``gain`` [-]."""
        factor = np.float32(gain)
        return replace(self, weights_3=factor * self.weights_3, bias_3=factor * self.bias_3)

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Coefficients for features, shape (..., n, DYNAMIC_COUNT) to (..., n, K).

        :class:`wrinkles.decoder.Decoder` computes the same faster; tests compare it with this method.
        """
        return self.coefficients(self.hidden(features))

    def hidden(self, features: np.ndarray) -> np.ndarray:
        """First hidden layer for features, shape (..., n, DYNAMIC_COUNT) to (..., n, h1)."""
        z = np.clip((features - self.center) * self.scale, -CLIP, CLIP)
        return np.maximum(z @ self.weights_1 + self.place_bias, 0.0)

    def coefficients(self, hidden: np.ndarray) -> np.ndarray:
        """Coefficients for the first hidden layer, shape (..., n, h1) to (..., n, K)."""
        coefficients = np.zeros((*hidden.shape[:-1], self.bias_3.shape[1]), np.float32)
        for r in range(len(self.bias_3)):
            members = self.region == r
            second = np.maximum(hidden[..., members, :] @ self.weights_2[r] + self.bias_2[r], 0.0)
            coefficients[..., members, :] = second @ self.weights_3[r] + self.bias_3[r]
        return coefficients

    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays by the names of their attributes."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}


def fabric_features(fabric: Fabric, own: Fabric) -> np.ndarray:
    """The mapping's features of a fabric: log of the gravity length and of the mass per area, shape (FABRIC_COUNT,).

    Args:
        fabric: the fabric.
        own: the garment's own fabric; both values are divided by its own, so that its features are zero.
    """
    logarithms = lambda f: np.log([max(f.gravity_length, MIN_GRAVITY_LENGTH), f.areal_density])  # noqa: E731
    return logarithms(fabric) - logarithms(own)


def fit_mapping(
    features: np.ndarray,
    static: np.ndarray,
    coefficients: np.ndarray,
    *,
    hidden: tuple[int, int] = (96, 64),
    epochs: int = 8,
    seed: int = 0,
    report: Callable[[str], None] | None = None,
    fabrics: np.ndarray | None = None,
    region: np.ndarray | None = None,
) -> Mapping:
    """Fit the mapping on training frames: one for all places first, from which that of each region goes on.

    What all places have in common is learned from all of them, and what is left is small enough to learn from a part.

    Features are learned from with noise on them: a garment that runs freely has at its mesh's limit folds of its own,
    as faint as what the filter leaves of true ones there, and what hangs on these must not be raised. With the noise
    they are whitened, so that faint directions are learned as fast as strong ones; this goes into the first layer.

    Args:
        features: dynamic features, float32, shape (S, n, d).
        static: float32, shape (n, s).
        coefficients: targets, float32, shape (S, n, K).
        hidden: widths of the hidden layers.
        epochs: passes over the data by all places together; half as many follow region by region.
        seed: of weights and shuffling.
        report: told lines of progress.
        fabrics: :func:`fabric_features` of each frame, shape (S, FABRIC_COUNT); None where all are the garment's own.
        region: of each place, int, shape (n,), 0 to r - 1; None is one for all.

    Returns:
        The mapping, for the garment's own fabric.
    """
    count = features.shape[2]
    flat = features.reshape(-1, count)
    center, scale = flat.mean(axis=0), 1.0 / (flat.std(axis=0) + 1e-4)
    z = (flat - center) * scale
    np.clip(z, -CLIP, CLIP, out=z)
    z += NOISE * np.random.default_rng(seed).standard_normal(z.shape, np.float32)
    middle, axes = whitening(z[:: max(1, len(z) // 200_000)])
    z -= middle
    told = np.zeros((len(features), FABRIC_COUNT)) if fabrics is None else np.asarray(fabrics, float)
    differs = np.ptp(told, axis=0) > 0.0
    usual, spread = told[:, differs].mean(axis=0), told[:, differs].std(axis=0)
    inputs = np.zeros((len(z), count + len(usual)), np.float32)
    np.matmul(z, axes, out=inputs[:, :count])
    inputs[:, count:] = np.repeat((told[:, differs] - usual) / spread, features.shape[1], axis=0)
    middle_place, spread_place = static.mean(axis=0), static.std(axis=0) + 1e-2
    place = ((static - middle_place) / spread_place).astype(np.float32)
    unit = float(np.sqrt((coefficients**2).mean()))
    targets = (coefficients / unit).astype(np.float32)
    network = Network((inputs.shape[1] + place.shape[1], *hidden, targets.shape[2]), seed)
    tell = report or (lambda line: None)
    told_pass = lambda e, n, loss: tell(f"fitting: pass {e} of {n}, loss {loss:.4f}")  # noqa: E731
    network.fit(inputs, place, targets.reshape(-1, targets.shape[2]), epochs=epochs, on_epoch=told_pass)
    region = np.zeros(len(static), np.int32) if region is None else np.asarray(region, np.int32)
    seen = inputs.reshape(len(features), -1, inputs.shape[1])
    heads = _fit_regions(network, seen, place, targets, region, -(-epochs // 2), seed, tell)
    first, bias_1 = network.weights[0], network.biases[0]
    single = lambda a: np.ascontiguousarray(a, np.float32)  # noqa: E731
    weights_1, by_place = axes @ first[:count], first[inputs.shape[1] :] / spread_place[:, None]
    by_fabric = np.zeros((FABRIC_COUNT, hidden[0]))
    by_fabric[differs] = first[count : inputs.shape[1]] / spread[:, None]
    own_fabric = usual @ by_fabric[differs]
    return Mapping(
        single(center),
        single(scale),
        single(static),
        region,
        single(weights_1),
        single(by_place),
        single(bias_1 - middle_place @ by_place - middle @ weights_1 - own_fabric),
        single(by_fabric),
        single([head.weights[0] for head in heads]),
        single([head.biases[0] for head in heads]),
        single([head.weights[1] * unit for head in heads]),
        single([head.biases[1] * unit for head in heads]),
    )


def _fit_regions(
    network: Network,
    inputs: np.ndarray,
    place: np.ndarray,
    targets: np.ndarray,
    region: np.ndarray,
    epochs: int,
    seed: int,
    tell: Callable[[str], None],
) -> list[Network]:
    """The layers after the first for each region, fitted further on what the first one gives there.

    Args:
        network: of all places; is left as it is.
        inputs, targets: shapes (S, n, d), (S, n, K).
        place, region: of each place, shapes (n, s), (n,); with one region alone there is nothing to go on to.
        epochs, seed, tell: as for :func:`fit_mapping`.
    """
    heads = [network.after_first(seed) for _ in range(int(region.max()) + 1)]
    by_input, by_place = np.split(network.weights[0], [inputs.shape[2]])
    for r, head in enumerate(heads if len(heads) > 1 else []):
        there = np.flatnonzero(region == r)
        seen = np.maximum(inputs[:, there] @ by_input + (place[there] @ by_place + network.biases[0]), 0.0)
        own = targets[:, there].reshape(-1, targets.shape[2])
        nowhere = np.zeros((len(there), 0), np.float32)  # the first layer has told the place
        loss = head.fit(seen.reshape(len(own), -1), nowhere, own, epochs=epochs, rate=REGION_RATE)
        tell(f"fitting: region {r + 1} of {len(heads)}, loss {loss:.4f}")
    return heads


def whitening(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and axes such that (samples - mean) @ axes has unit covariance.

    Args:
        samples: shape (k, d).

    Returns:
        the mean, shape (d,), and the axes, float32, shape (d, d).
    """
    mean = samples.mean(axis=0)
    values, vectors = np.linalg.eigh(np.cov((samples - mean).T))
    return mean, (vectors / np.sqrt(values)).astype(np.float32)
