"""Realism: how easily a classifier tells what a screen shows of a garment's motion from what it shows of the truth.

Two free runs of folding cloth never agree fold by fold. They are therefore compared by how their folds look: how the
normals, which give the shading, turn from one place of the cloth to the next and from one recorded frame to the next,
in patches of several sizes. A figure of 1.75 m that fills 1,080 lines has pixels of 1.6 mm, and what turns within a few
of them is not seen as a fold: turns are taken between places about six pixels apart. All normals get noise of a size
that nobody sees. Gradient boosting (Friedman 2001, "Greedy function approximation") learns on some parts of the motion
and on one side of the garment which patches are the truth's, and is asked about other parts of the motion on the other
side. The area under its ROC curve (AUC) is 0.5 where it cannot tell, and 1 where it always can. A second run of the
truth gives the floor.

No statistic knows where a patch is or how it is turned, so that nothing but folds is judged. Both sides are needed: a
fold that stays at its place has the same statistics throughout the motion, and a classifier that has seen it there
knows it again. Two runs of one process would then be distinguished by the places of their folds.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags, identity, triu
from scipy.stats import rankdata
from threadpoolctl import threadpool_limits

from pbd import ClothMesh, InputError
from pbd.mesh import edges_of
from wrinkles.discs import along_cloth, disc_means, spread_points
from wrinkles.mesh_measures import vertex_normals

__all__ = ["FEATURES", "FEWEST_FRAMES", "RADII", "PatchStatistics", "Realism", "realism"]

RADII = (0.03, 0.06, 0.12)  # of patches, along the cloth [m]
CENTRES = 192  # patches of each radius, spread evenly over the garment
FRAMES = 72  # of a motion that are measured, spread evenly
BLOCKS = 4  # parts of the motion: each is asked by what was learned from every second one
FEWEST_FRAMES = 4 * BLOCKS  # of a motion that can be parted
GAP = 0.1  # share of a part that is left out at each end that meets another part
SIDE_GAP = 0.06  # patches nearer to the plane between left and right are not learned from [m]
MEMBERS = 96  # vertices of a patch that its quantiles are taken of
EDGE = 0.03  # a patch whose middle is nearer to a border lies at an edge [m]
SPAN = (0.007, 0.0125)  # distance of places whose normals are compared: four to eight pixels [m]
NOISE = 2.0  # of all normals: root mean square of the angle [deg]
_OF_PATCH = (
    "mean of the bend",
    "size of the bend",
    "lean of the bend",
    "turn of the normals",
    "change of the normals in time",
    "spread of the normals across folds",
    "spread of the normals along folds",
    "10 % quantile of the bend",
    "50 % quantile of the bend",
    "90 % quantile of the bend",
    "50 % quantile of the turn of the normals",
    "90 % quantile of the turn of the normals",
    "50 % quantile of the change in time",
    "90 % quantile of the change in time",
)
FEATURES = tuple(f"{name}, within {100 * radius:.0f} cm" for radius in RADII for name in _OF_PATCH)
_CHUNK_FRAMES = 8  # frames that are measured at once


@dataclass(frozen=True)
class Realism:
    """How easily a method is distinguished from the truth.

    Attributes:
        auc: 0.5 is never distinguished, 1 always; mean over the ways in which motion and garment are parted.
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
        edges, lengths = mesh.edge_lengths()
        _, side_edge = edges_of(self._faces)
        border = np.unique(edges[np.bincount(side_edge.ravel()) == 1])
        # At a border a normal depends on few faces: its vertices have no part in any patch.
        self._inner = np.ones(count, bool)
        self._inner[border] = False
        self._pairs, self._lengths = _apart(vertices, edges[self._inner[edges].all(axis=1)])
        ends, which = self._pairs.T.ravel(), np.tile(np.arange(len(self._pairs)), 2)
        around = csr_matrix((np.ones(len(ends)), (ends, which)), (count, len(self._pairs)))
        self._around = diags(1.0 / np.maximum(np.asarray(around.sum(axis=1)).ravel(), 1.0)) @ around
        self.centres = spread_points(vertices, np.flatnonzero(self._inner), CENTRES)
        away = along_cloth(mesh, self.centres, max(RADII))
        to_border = away[:, border].min(axis=1, initial=np.inf)
        away[:, ~self._inner] = np.inf
        self._means, self._members = [], []
        for radius in RADII:
            self._means.append(disc_means(away, radius, mesh.vertex_areas))
            self._members.append(np.array([_evenly(np.flatnonzero(one <= radius), MEMBERS) for one in away]))
        self.places, self.place = _places(vertices[self.centres])
        self.aside = vertices[self.centres, 0] - np.median(vertices[self.centres, 0])
        self.place[to_border <= EDGE] = len(self.places) - 1

    def __call__(self, frames: np.ndarray) -> np.ndarray:
        """Statistics of every patch, in frames that are spread evenly.

        Args:
            frames: vertices at even steps of time [m], shape (f, N, 3).

        Returns:
            float32, shape (g, p, len(FEATURES)).

        Raises:
            InputError: too few frames to part the motion.
        """
        if len(frames) < FEWEST_FRAMES:
            expected = f">= {FEWEST_FRAMES}"
            raise InputError("too few frames to judge", key="frames", received=len(frames), expected=expected)
        picked = np.unique(np.linspace(1, len(frames) - 1, min(FRAMES, len(frames) - 1)).round().astype(int))
        rng = np.random.default_rng(zlib.crc32(frames[picked[0]].tobytes()))
        rows = [self._rows(frames[some], frames[some - 1], rng) for some in _chunks(picked)]
        return np.concatenate(rows).astype(np.float32)

    def _rows(self, now: np.ndarray, before: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Statistics of frames and those recorded before them [m], shape (f, N, 3): shape (f, p, len(FEATURES))."""
        now = np.asarray(now, float)
        normals = _noisy(vertex_normals(now, self._faces), rng)
        change = np.linalg.norm(normals - _noisy(vertex_normals(np.asarray(before, float), self._faces), rng), axis=2)
        i, j = self._pairs.T
        turned, apart = normals[:, j] - normals[:, i], now[:, j] - now[:, i]
        bend = (self._around @ ((turned * apart).sum(axis=2) / (apart**2).sum(axis=2)).T).T  # [1/m]
        turn = np.sqrt((self._around @ ((turned**2).sum(axis=2) / self._lengths**2).T).T)  # [1/m]
        outer = normals[..., :, None] * normals[..., None, :]
        rows = []
        for means, members in zip(self._means, self._members, strict=True):
            powers = bend, bend**2, bend**3, turn**2, change**2
            first, second, third, turns, changes = ((means @ field.T).T for field in powers)
            spread = (means @ outer.transpose(1, 0, 2, 3).reshape(len(bend.T), -1)).reshape(len(self.centres), -1, 3, 3)
            across, along = np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[..., 1::-1], 0.0)).T
            rows += [first, np.sqrt(second), np.cbrt(third), np.sqrt(turns), np.sqrt(changes), across, along]
            last = members.shape[1] - 1
            for field, quantiles in ((bend, (0.1, 0.5, 0.9)), (turn, (0.5, 0.9)), (change, (0.5, 0.9))):
                ordered = np.sort(field[:, members], axis=2)
                rows += [ordered[..., round(q * last)] for q in quantiles]
        return np.stack(rows, axis=-1)


def _apart(vertices: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of vertices :data:`SPAN` apart, or the edges where these are longer: int (k, 2), and distances [m]."""
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    if np.median(lengths) > SPAN[1]:
        return edges, lengths
    count = len(vertices)
    near = csr_matrix((np.ones(len(edges)), edges.T), (count, count))
    near = near + near.T + identity(count, format="csr")
    reached = near
    for _ in range(int(SPAN[1] / np.median(lengths))):
        reached = reached @ near
    pairs = np.stack(triu(reached, 1).nonzero(), axis=1)
    lengths = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
    apart = (lengths >= SPAN[0]) & (lengths <= SPAN[1])
    return pairs[apart], lengths[apart]


def _noisy(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Unit normals that are turned by :data:`NOISE` at random."""
    noisy = normals + np.radians(NOISE) / np.sqrt(2.0) * rng.standard_normal(normals.shape)
    return noisy / np.linalg.norm(noisy, axis=-1, keepdims=True)


# One thread: the figures must not depend on the number of threads, and threads that wait for each other take longer.
@threadpool_limits.wrap(limits=1)
def realism(statistics: PatchStatistics, truth: np.ndarray, method: np.ndarray) -> Realism:
    """How easily a method is distinguished from the truth.

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
