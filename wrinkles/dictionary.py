"""The dictionary of wrinkles: atoms (shapes of wrinkle patches), and a small network that mixes them.

The network gives the atoms' coefficients at each coarse vertex for the features there. Its first layer is the same
everywhere on the garment.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from wrinkles.network import Network, Samples, in_threads
from wrinkles.patches import Grid

__all__ = [
    "Atoms",
    "CoefficientNetwork",
    "fit_atoms",
    "fit_coefficient_network",
    "whitening",
]

NOISE = 0.05  # of the features in training, in standard deviations
REGION_RATE = 0.03  # where a region goes on from what all places have learned
BLOCK, KEPT_OUT = 20, 8  # every eighth block of twenty frames says when the fit may stop
VALIDATED = 40_000  # samples of these that are asked: the mean loss of more is the same
PARTS = 16  # in which the outputs of the first layer are computed
CLIP = 4.0  # features further out than this many standard deviations count as if they stood there


@dataclass(frozen=True)
class Atoms:
    """Shapes of wrinkle patches: principal components in the metric of :meth:`wrinkles.patches.Grid.slope_metric`.

    Attributes:
        shapes: displacements [m] of unit coefficients, float32, shape (K, 3 nodes): warp, weft, normal of node 0, ...
        mean: mean patch [m], float32, shape (3 nodes,).
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
        """Matrix that gives coefficients of a patch: (patch - mean) @ analysis, float32, shape (3 nodes, K)."""
        size = len(self.mean)
        lower = Grid.with_nodes(size // 3).slope_metric()
        shapes = self.shapes.astype(float).T.reshape(size // 3, -1)
        return (lower @ (lower.T @ shapes)).reshape(size, -1).astype(np.float32)


def fit_atoms(patches: np.ndarray, count: int, fine_count: int) -> Atoms:
    """Principal components of patches in the slope metric; the vertex mean is zero.

    Args:
        patches: [m], shape (S, 3 nodes).
        count: number of atoms K.
        fine_count: number of fine vertices N.
    """
    from sklearn.decomposition import PCA

    nodes = patches.shape[1] // 3
    lower = Grid.with_nodes(nodes).slope_metric()
    samples = patches.reshape(-1, nodes, 3)
    mean = samples.mean(axis=0)
    whitened = (np.swapaxes(samples - mean, 1, 2) @ lower).swapaxes(1, 2).reshape(len(samples), -1)
    components = PCA(count, svd_solver="covariance_eigh").fit(whitened)
    basis = components.components_.T
    shapes = np.linalg.solve(lower.T, basis.reshape(nodes, -1)).reshape(nodes, 3, -1)
    return Atoms(
        np.ascontiguousarray(shapes.reshape(3 * nodes, -1).T, np.float32),
        mean.ravel().astype(np.float32),
        float(components.explained_variance_ratio_.sum()),
        np.zeros((fine_count, 3), np.float32),
    )


@dataclass(frozen=True)
class CoefficientNetwork:
    """The network that gives coefficients for features: two hidden layers of rectified units and a linear one.

    All places share the first layer; each region has its own second and third. The static features contribute to the
    first layer a bias for every coarse vertex, which costs no time in playing. Regions with different layers cost a
    tenth of the network's time.

    Attributes:
        center, scale: of the dynamic features, float32, shape (DYNAMIC_COUNT,).
        place: static features, float32, shape (n, s).
        region: of each coarse vertex, int32, shape (n,), 0 to r - 1.
        weights_1, place_weights, bias_1: of the first layer, float32, shapes (DYNAMIC_COUNT, h1), (s, h1), (h1,).
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
    weights_2: np.ndarray
    bias_2: np.ndarray
    weights_3: np.ndarray
    bias_3: np.ndarray

    @cached_property
    def place_bias(self) -> np.ndarray:
        """Bias of the first layer at each coarse vertex, float32, shape (n, h1)."""
        return self.place @ self.place_weights + self.bias_1

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


def fit_coefficient_network(
    features: np.ndarray,
    static: np.ndarray,
    coefficients: np.ndarray,
    *,
    hidden: tuple[int, int] = (96, 64),
    epochs: int = 8,
    seed: int = 0,
    report: Callable[[str], None] | None = None,
    region: np.ndarray | None = None,
) -> CoefficientNetwork:
    """Fit the mapping on training frames: one for all places first, from which that of each region goes on.

    The network learns from all places what they have in common; the rest is small enough to be learned from a part.

    Training adds noise to the features. A garment that runs freely has folds of its own at the limit of its mesh, as
    faint as the true folds that the filter leaves there: without noise the network would make wrinkles from them. The
    features with noise are whitened, so that faint directions are learned as fast as strong ones; the first layer takes
    this over.

    Args:
        features: dynamic features, float32, shape (S, n, d).
        static: float32, shape (n, s).
        coefficients: targets, float32, shape (S, n, K).
        hidden: widths of the hidden layers.
        epochs: passes over the data by all places together, at most; half as many follow region by region.
        seed: of weights and shuffling.
        report: called with lines of progress.
        region: of each place, int, shape (n,), 0 to r - 1; None is one for all.
    """
    scaling = _Scaling.of(features, static, seed)
    unit = float(np.sqrt((coefficients**2).mean()))
    samples = Samples(
        scaling.inputs(features, seed).reshape(-1, features.shape[2]),
        scaling.place(static),
        (coefficients / np.float32(unit)).reshape(-1, coefficients.shape[2]),
        _validation(len(features), features.shape[1], seed),
    )
    network = Network((features.shape[2] + static.shape[1], *hidden, coefficients.shape[2]), seed)
    tell = report or (lambda line: None)
    began = time.monotonic()

    def tell_pass(done: float, loss: float) -> None:
        left = (time.monotonic() - began) * max(0.0, epochs - done) / done
        tell(f"fitting: {done:.1f} of at most {epochs} passes, loss {loss:.4f}, at most {left:.0f} s left")

    network.fit(samples, epochs=epochs, on_check=tell_pass)
    region = np.zeros(len(static), np.int32) if region is None else np.asarray(region, np.int32)
    heads = _fit_regions(network, samples, region, -(-epochs // 2), seed, tell)
    return _unscaled(scaling, static, region, network, heads, unit)


@dataclass(frozen=True)
class _Scaling:
    """What the network sees instead of the features: whitened with the noise that they are learned from with.

    Attributes:
        center, scale: of the dynamic features, float32, shape (d,).
        middle, axes: of the scaled features, which are whitened by them, float32, shapes (d,), (d, d).
        middle_place, spread_place: of static features, shape (s,).
    """

    center: np.ndarray
    scale: np.ndarray
    middle: np.ndarray
    axes: np.ndarray
    middle_place: np.ndarray
    spread_place: np.ndarray

    @classmethod
    def of(cls, features: np.ndarray, static: np.ndarray, seed: int) -> _Scaling:
        flat = features.reshape(-1, features.shape[2])
        center, scale = flat.mean(axis=0), 1.0 / (flat.std(axis=0) + 1e-4)
        some = np.clip((flat[:: max(1, len(flat) // 200_000)] - center) * scale, -CLIP, CLIP)
        some += NOISE * np.random.default_rng(seed).standard_normal(some.shape, np.float32)
        middle, axes = whitening(some)
        middle_place, spread_place = static.mean(axis=0), static.std(axis=0) + 1e-2
        return cls(center, scale, middle, axes, middle_place, spread_place)

    def inputs(self, features: np.ndarray, seed: int) -> np.ndarray:
        """Dynamic features as the network sees them, with noise, float32, shape (S, n, d)."""
        total, _, count = features.shape
        found = np.zeros(features.shape, np.float32)

        def fill(first: int) -> None:
            some = slice(first, first + BLOCK)
            z = (features[some] - self.center) * self.scale
            np.clip(z, -CLIP, CLIP, out=z)
            z += np.float32(NOISE) * np.random.default_rng((seed, first)).standard_normal(z.shape, np.float32)
            z -= self.middle
            found[some] = (z.reshape(-1, count) @ self.axes).reshape(z.shape)

        in_threads(fill, range(0, total, BLOCK))
        return found

    def place(self, static: np.ndarray) -> np.ndarray:
        """Static features as the network sees them, float32, shape (n, s)."""
        return ((static - self.middle_place) / self.spread_place).astype(np.float32)

    def unscaled(self, weights: np.ndarray, bias: np.ndarray) -> tuple[np.ndarray, ...]:
        """The first layer for unscaled features: weights of dynamic and static ones, bias."""
        count = len(self.center)
        weights_1, by_place = self.axes @ weights[:count], weights[count:] / self.spread_place[:, None]
        return weights_1, by_place, bias - self.middle_place @ by_place - self.middle @ weights_1


def _unscaled(
    scaling: _Scaling, static: np.ndarray, region: np.ndarray, network: Network, heads: Sequence[Network], unit: float
) -> CoefficientNetwork:
    """The network for features and coefficients as they are.

    Args:
        scaling: of the features from which it learned.
        static: of each place, shape (n, s).
        region: of each place, shape (n,).
        network: of all places, whose first layer is taken.
        heads: the other layers of each region.
        unit: of the coefficients that it learned [m].
    """
    single = lambda a: np.ascontiguousarray(a, np.float32)  # noqa: E731
    weights_1, place_weights, bias_1 = scaling.unscaled(network.weights[0], network.biases[0])
    return CoefficientNetwork(
        single(scaling.center),
        single(scaling.scale),
        single(static),
        region,
        single(weights_1),
        single(place_weights),
        single(bias_1),
        single([head.weights[0] for head in heads]),
        single([head.biases[0] for head in heads]),
        single([head.weights[1] * unit for head in heads]),
        single([head.biases[1] * unit for head in heads]),
    )


def _validation(frames: int, places: int, seed: int) -> np.ndarray:
    """Samples of whole blocks of frames, VALIDATED of them at most; none where there are too few frames for a block.

    Frames beside each other are nearly the same: those between learned ones would say nothing.
    """
    kept_out = np.flatnonzero(np.arange(frames) // BLOCK % KEPT_OUT == KEPT_OUT - 1)
    samples = (kept_out[:, None] * places + np.arange(places)).ravel()
    return np.sort(np.random.default_rng(seed).permutation(samples)[:VALIDATED])


def _fit_regions(
    network: Network,
    samples: Samples,
    region: np.ndarray,
    epochs: int,
    seed: int,
    tell: Callable[[str], None],
) -> list[Network]:
    """The layers after the first for each region, fitted further on what the first one gives there.

    Args:
        network: of all places; is left as it is.
        samples: of all places.
        region: of each place, shape (n,); with one region alone there is nothing to go on to.
        epochs, seed, tell: as for :func:`fit_coefficient_network`.
    """
    heads = [network.after_first(seed) for _ in range(int(region.max()) + 1)]
    nowhere = np.zeros((1, 0), np.float32)  # the first layer includes the place
    for r, head in enumerate(heads if len(heads) > 1 else []):
        own = np.flatnonzero(np.resize(region == r, len(samples)))
        seen = np.concatenate(in_threads(lambda rows: network.first(samples, rows), np.array_split(own, PARTS)))
        loss = head.fit(Samples(seen, nowhere, samples.targets[own]), epochs=epochs, rate=REGION_RATE)
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
