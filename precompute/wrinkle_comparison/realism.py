"""Realism: how easily a classifier tells patches of a garment's motion from patches of the truth's.

Two free runs of folding cloth never agree fold by fold. They are therefore compared by how their folds look: curvature,
sharpness of ridges, how far the cloth is from a developable surface, and how all this changes in time, in patches of
several sizes. Gradient boosting (Friedman 2001, "Greedy function approximation") learns on some parts of the motion and
on one side of the garment which patches are the truth's, and is asked about other parts of the motion on the other
side. The area under its ROC curve (AUC) is 0.5 where it cannot tell, and 1 where it always can. A second run of the
truth gives the floor.

No statistic knows where a patch is or how it is turned, so that nothing but folds is judged. Both sides are needed: a
fold that stays at its place has the same statistics throughout the motion, and a classifier that has seen it there
knows it again. Two runs of one process would then be told from one another by the places of their folds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import dijkstra
from scipy.stats import rankdata
from threadpoolctl import threadpool_limits

from pbd import ClothMesh, InputError
from pbd.mesh import edges_of
from wrinkles.metrics import vertex_normals
from wrinkles.spectrum import cotangent_laplacian

__all__ = ["FEATURES", "RADII", "PatchStatistics", "Realism", "realism"]

RADII = (0.03, 0.06, 0.12)  # of patches, along the cloth [m]
CENTRES = 192  # patches of each radius, spread evenly over the garment
FRAMES = 72  # of a motion that are measured, spread evenly
BLOCKS = 4  # parts of the motion: each is asked by what was learned from every second one
GAP = 0.1  # share of a part that is left out at each end that meets another part
SIDE_GAP = 0.06  # patches nearer to the plane between left and right are not learned from [m]
MEMBERS = 96  # vertices of a patch that its quantiles are taken of
EDGE = 0.03  # a patch whose middle is nearer to a border lies at an edge [m]
QUANTILES = (0.1, 0.5, 0.9)
_OF_PATCH = (
    "mean of the curvature",
    "size of the curvature",
    "lean of the curvature",
    "peaks of the curvature",
    "sharpness of ridges",
    "Gaussian curvature",
    "turn of the normals across folds",
    "turn of the normals along folds",
    "change of the curvature in time",
    "change of ridges in time",
    *(f"{100 * share:.0f} % quantile of the curvature" for share in QUANTILES),
    "90 % quantile of the sharpness of ridges",
)
FEATURES = tuple(f"{name}, within {100 * radius:.0f} cm" for radius in RADII for name in _OF_PATCH)
_CHUNK_FRAMES = 8  # frames that are measured at once


@dataclass(frozen=True)
class Realism:
    """How easily a method is told from the truth.

    Attributes:
        auc: 0.5 cannot be told, 1 always; mean over the ways in which motion and garment are parted.
        by_place: the same of the patches of each part of the garment, by its name.
        by_feature: AUC of each of FEATURES alone over all patches, by a threshold: over 0.5 where the method has more
            of it than the truth, and below where it has less.
        gives_away: the feature that tells most by itself in each part of the garment, with its AUC as above.
    """

    auc: float
    by_place: dict[str, float]
    by_feature: dict[str, float]
    gives_away: dict[str, tuple[str, float]]

    def told_by(self) -> str:
        """In words, the statistic and the place that give the method away most."""
        place = max(self.by_place, key=self.by_place.__getitem__)
        name, auc = self.gives_away[place]
        return f"too {'large' if auc > 0.5 else 'small'}: {name} ({place})"


class PatchStatistics:
    """Statistics of folds in patches of a garment, at the same places and times for all methods.

    Args:
        mesh: the fine mesh in its bind pose, Y up. Its flat faces set the metric.

    Attributes:
        centres: vertices in the middle of the patches, int, shape (p,).
        places: names of parts of the garment: its edges and, of the rest, three heights in front and behind.
        place: part of each patch, an index of ``places``, int, shape (p,).
        aside: distance of each patch's middle from the plane between left and right, negative on the right [m],
            shape (p,).
    """

    def __init__(self, mesh: ClothMesh) -> None:
        vertices, self._faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
        count = len(vertices)
        stiffness, self._mass = cotangent_laplacian(mesh)
        self._curvature = (diags(-0.5 / self._mass) @ stiffness).tocsr()
        edges, lengths = mesh.edge_lengths()
        _, side_edge = edges_of(self._faces)
        border = np.unique(edges[np.bincount(side_edge.ravel()) == 1])
        # At a border the Laplacian is a force and no curvature: its vertices have no part in any patch.
        self._inner = np.ones(count, bool)
        self._inner[border] = False
        inner = self._inner[edges].all(axis=1)
        self._edges, self._lengths = edges[inner], lengths[inner]
        ends, which = self._edges.T.ravel(), np.tile(np.arange(len(self._edges)), 2)
        around = csr_matrix((np.ones(len(ends)), (ends, which)), (count, len(self._edges)))
        self._around = diags(1.0 / np.maximum(np.asarray(around.sum(axis=1)).ravel(), 1.0)) @ around
        corners = (np.ones(self._faces.size), (self._faces.ravel("F"), np.arange(self._faces.size)))
        self._corners = csr_matrix(corners, (count, self._faces.size))
        paths = csr_matrix((lengths, edges.T), (count, count))
        self.centres = _spread(vertices, np.flatnonzero(self._inner), CENTRES)
        away = dijkstra(paths, directed=False, indices=self.centres, limit=max(RADII))
        away[:, ~self._inner] = np.inf
        self._means, self._members = [], []
        for radius in RADII:
            row, column = np.nonzero(away <= radius)
            sums = csr_matrix((self._mass[column], (row, column)), (len(self.centres), count))
            self._means.append(diags(1.0 / np.asarray(sums.sum(axis=1)).ravel()) @ sums)
            self._members.append(np.array([_evenly(np.flatnonzero(one <= radius), MEMBERS) for one in away]))
        to_border = dijkstra(paths, directed=False, indices=border, limit=EDGE, min_only=True) if len(border) else None
        self.places, self.place = _places(vertices[self.centres])
        self.aside = vertices[self.centres, 0] - np.median(vertices[self.centres, 0])
        if to_border is not None:
            self.place[to_border[self.centres] <= EDGE] = len(self.places) - 1

    def __call__(self, frames: np.ndarray) -> np.ndarray:
        """Statistics of every patch, in frames that are spread evenly.

        Args:
            frames: vertices at even steps of time [m], shape (f, N, 3).

        Returns:
            float32, shape (g, p, len(FEATURES)).

        Raises:
            InputError: too few frames to part the motion.
        """
        if len(frames) < 4 * BLOCKS:
            raise InputError("too few frames to judge", key="frames", received=len(frames), expected=f">= {4 * BLOCKS}")
        picked = np.unique(np.linspace(1, len(frames) - 1, min(FRAMES, len(frames) - 1)).round().astype(int))
        return np.concatenate([self._rows(frames, some) for some in _chunks(picked)]).astype(np.float32)

    def _rows(self, frames: np.ndarray, picked: np.ndarray) -> np.ndarray:
        """Statistics of picked frames, which are compared with those before them: shape (g, p, len(FEATURES))."""
        now, before = (np.asarray(frames[numbers], float) for numbers in (picked, picked - 1))
        normals = vertex_normals(now, self._faces)
        mean, slope = self._bends(now, normals)
        old_mean, old_slope = self._bends(before, vertex_normals(before, self._faces))
        angles = np.sqrt(np.abs(self._gaussian(now)))
        outer = normals[..., :, None] * normals[..., None, :]
        rows = []
        for means, members in zip(self._means, self._members, strict=True):
            powers = [mean, mean**2, mean**3, mean**4, slope**2, angles, (mean - old_mean) ** 2]
            powers += [(slope - old_slope) ** 2]
            first, second, third, fourth, ridges, gauss, changed, moved = ((means @ field.T).T for field in powers)
            spread = (means @ outer.transpose(1, 0, 2, 3).reshape(len(mean.T), -1)).reshape(len(self.centres), -1, 3, 3)
            across, along = np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[..., 1::-1], 0.0)).T
            ordered = np.sort(mean[:, members], axis=2)
            last = members.shape[1] - 1
            sharp = np.sort(slope[:, members], axis=2)[..., round(0.9 * last)]
            rows += [first, np.sqrt(second), np.cbrt(third), fourth**0.25, np.sqrt(ridges), gauss, across, along]
            rows += [np.sqrt(changed), np.sqrt(moved), *(ordered[..., round(q * last)] for q in QUANTILES), sharp]
        return np.stack(rows, axis=-1)

    def _bends(self, frames: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean curvature [1/m] and its slope along the cloth [1/m2], shapes (f, N)."""
        count = frames.shape[1]
        bent = (self._curvature @ frames.transpose(1, 0, 2).reshape(count, -1)).reshape(count, -1, 3)
        mean = np.einsum("nfi,fni->fn", bent, normals)
        steps = ((mean[:, self._edges[:, 1]] - mean[:, self._edges[:, 0]]) / self._lengths) ** 2
        return mean, np.sqrt((self._around @ steps.T).T)

    def _gaussian(self, frames: np.ndarray) -> np.ndarray:
        """Gaussian curvature by the missing angle (Meyer et al. 2003) [1/m2], shape (f, N)."""
        points = frames.transpose(1, 0, 2)[self._faces]
        angles = []
        for corner in range(3):
            one, other = (points[:, (corner + k) % 3] - points[:, corner] for k in (1, 2))
            cosine = np.einsum("mfi,mfi->mf", one, other)
            # |a x b|^2 = |a|^2 |b|^2 - (a . b)^2
            lengths = np.einsum("mfi,mfi->mf", one, one) * np.einsum("mfi,mfi->mf", other, other)
            angles.append(np.arctan2(np.sqrt(np.maximum(lengths - cosine**2, 0.0)), cosine))
        return (2.0 * np.pi - (self._corners @ np.concatenate(angles)).T) / self._mass


# One thread: what is found must not depend on how many there are, and threads that wait for each other take longer.
@threadpool_limits.wrap(limits=1)
def realism(statistics: PatchStatistics, truth: np.ndarray, method: np.ndarray) -> Realism:
    """How easily a method is told from the truth.

    Args:
        statistics: of the garment.
        truth, method: what ``statistics`` gives for frames of both at the same times, shape (f, p, len(FEATURES)).

    Raises:
        InputError: statistics of different shape.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier
    from sklearn.metrics import roc_auc_score

    if truth.shape != method.shape:
        raise InputError(
            "statistics of different frames", key="method", received=method.shape, expected=f"{truth.shape}"
        )
    parts = list(_blocks(len(truth)))
    turns = parts[::2], parts[1::2]
    sides = statistics.aside > 0.0, statistics.aside <= 0.0
    learnable = np.abs(statistics.aside) > SIDE_GAP
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for learned, asked in (turns, turns[::-1]):
        for here, there in (sides, sides[::-1]):
            some = np.ix_(np.concatenate(learned), np.flatnonzero(here & learnable))
            model = HistGradientBoostingClassifier(
                max_iter=60, max_leaf_nodes=8, min_samples_leaf=100, l2_regularization=1.0, early_stopping=False
            )
            model.fit(*_samples(truth[some], method[some]))
            for numbers in asked:  # each apart: what is more likely in one part than in another tells nothing
                one = np.ix_(numbers, np.flatnonzero(there))
                x, wanted = _samples(truth[one], method[one])
                place = np.tile(statistics.place[there], 2 * len(numbers))
                found.append((wanted, model.predict_proba(x)[:, 1], place))
    x, wanted = _samples(truth, method)
    place = np.tile(statistics.place, len(x) // len(statistics.place))
    by_place, gives_away = {}, {}
    for number, name in enumerate(statistics.places):
        if not (statistics.place == number).any():
            continue
        by_place[name] = _told(
            [roc_auc_score(y[p == number], s[p == number]) for y, s, p in found if (p == number).any()]
        )
        here = place == number
        alone = _by_threshold(wanted[here], x[here])
        most = int(np.argmax(np.abs(np.array(alone) - 0.5)))
        gives_away[name] = (FEATURES[most], alone[most])
    by_feature = dict(zip(FEATURES, _by_threshold(wanted, x), strict=True))
    return Realism(_told([roc_auc_score(y, s) for y, s, _ in found]), by_place, by_feature, gives_away)


def _by_threshold(wanted: np.ndarray, x: np.ndarray) -> list[float]:
    """AUC of each column by itself, from the sum of ranks (Mann and Whitney 1947)."""
    ranks, few, many = rankdata(x, axis=0), int((wanted == 0).sum()), int((wanted == 1).sum())
    return ((ranks[wanted == 1].sum(axis=0) - many * (many + 1) / 2.0) / (few * many)).tolist()


def _told(aucs: list[float]) -> float:
    """Mean AUC, at least 0.5: a rule that holds in one part and not in another tells nothing."""
    return max(0.5, float(np.mean(aucs)))


def _samples(truth: np.ndarray, method: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Patches of both, shape (2 f p, features), and which are the method's."""
    x = np.concatenate([one.reshape(-1, one.shape[2]) for one in (truth, method)])
    return x, np.repeat([0, 1], len(x) // 2)


def _blocks(count: int) -> Iterator[np.ndarray]:
    """Numbers of the frames of each part of the motion, with gaps between the parts."""
    limits = np.linspace(0, count, BLOCKS + 1)
    gap = GAP * count / BLOCKS
    for number, (first, last) in enumerate(zip(limits[:-1], limits[1:], strict=True)):
        start, end = first + gap * (number > 0), last - gap * (number < BLOCKS - 1)
        yield np.arange(int(np.ceil(start)), int(np.floor(end)))


def _chunks(numbers: np.ndarray) -> Iterator[np.ndarray]:
    return (numbers[first : first + _CHUNK_FRAMES] for first in range(0, len(numbers), _CHUNK_FRAMES))


def _spread(points: np.ndarray, among: np.ndarray, count: int) -> np.ndarray:
    """Numbers of points that are spread evenly: each is the furthest from those before (Gonzalez 1985)."""
    chosen, some = [int(among[0])], points[among]
    away = np.linalg.norm(some - points[chosen[0]], axis=1)
    for _ in range(min(count, len(among)) - 1):
        chosen.append(int(among[away.argmax()]))
        away = np.minimum(away, np.linalg.norm(some - points[chosen[-1]], axis=1))
    return np.array(chosen)


def _evenly(numbers: np.ndarray, count: int) -> np.ndarray:
    """``count`` of some numbers, taken evenly; some twice where there are fewer."""
    return numbers[np.linspace(0, len(numbers) - 1, count).round().astype(int)]


def _places(points: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Parts of a garment by height and depth, edges last, and the part of each point: three heights, two sides."""
    low, high = points[:, 1].min(), points[:, 1].max()
    third = np.clip(((high - points[:, 1]) / max(high - low, 1e-9) * 3).astype(int), 0, 2)
    behind = points[:, 2] < np.median(points[:, 2])
    names = [f"{side} {height}" for height in ("top", "middle", "bottom") for side in ("front", "back")]
    return (*names, "edges"), 2 * third + behind
