"""Features of the coarse garment, the input of the dictionary: local shape, distance from what it lies on.

A stencil of 5 by 5 chart points around every coarse vertex is read in the vertex's own frame, so that the features do
not change when the garment turns or moves.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import eigsh
from threadpoolctl import threadpool_limits

from pbd import ClothMesh
from pbd.engine import ensure_initialized, ti
from pbd.geometry import FAR, Float1, Int1, Vec4, vec3, vec4
from pbd.taichi_internals import Launch
from wrinkles.charts import Charts
from wrinkles.layer_distance import LayerDistance

__all__ = ["DYNAMIC_COUNT", "INNER_OFFSETS", "REGIONS", "Stencil"]

SIDE = 5  # points along each side of the stencil
POINTS = SIDE * SIDE
CENTRE = POINTS // 2
OTHERS = [p for p in range(POINTS) if p != CENTRE]
INNER = [CENTRE + SIDE * a + b for a in (-1, 0, 1) for b in (-1, 0, 1)]
UP, DOWN, LEFT, RIGHT = CENTRE + SIDE, CENTRE - SIDE, CENTRE - 1, CENTRE + 1  # +-1 along warp, -+1 along weft
# Features that change with the state: 72 components of offsets, 9 distances from what it lies on.
OFFSET_COUNT = 3 * len(OTHERS)
DYNAMIC_COUNT = OFFSET_COUNT + len(INNER)
# Numbers of the features that are offsets of the eight points around the centre.
INNER_OFFSETS = [3 * OTHERS.index(p) + a for p in INNER if p != CENTRE for a in range(3)]
MODE_COUNT = 8  # slow modes of the mesh among the static features
REGIONS = 5  # parts of a garment with network layers of their own
MIN_REGION_SIZE = 40  # coarse vertices in a region, on average

Corners = ti.types.ndarray(dtype=ti.types.vector(3 * POINTS, ti.i32), ndim=1)
Weights = ti.types.ndarray(dtype=ti.types.vector(3 * POINTS, ti.f32), ndim=1)
Frames = ti.types.ndarray(dtype=ti.types.vector(9, ti.f32), ndim=1)
Features = ti.types.ndarray(dtype=ti.types.vector(DYNAMIC_COUNT, ti.f32), ndim=1)


@ti.func
def _frame(warp: vec3, weft: vec3):
    """Unit vectors along the warp, about along the weft and along the normal."""
    e1 = warp / ti.max(warp.norm(), 1e-12)
    normal = e1.cross(weft)
    e3 = normal / ti.max(normal.norm(), 1e-12)
    return e1, e3.cross(e1), e3


@ti.kernel
def _read_stencil(
    placed: Vec4,
    corners: Corners,
    weights: Weights,
    spacing: ti.f32,
    center: Float1,
    scale: Float1,
    limit: ti.f32,
    frames: Frames,
    row: Int1,
    features: Features,
):
    """The kernel of :meth:`Stencil.read`, with its arguments and attributes; ``placed``: positions, distances over FAR.

    The compiler uses vector instructions only for writes to an array of the kernel's own.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(placed.shape[0]):
            here = placed[i]
            offset = ti.Matrix.zero(ti.f32, POINTS, 4)
            for p in ti.static(OTHERS):
                total = -here
                for c in ti.static(range(3 * p, 3 * p + 3)):
                    total += weights[i][c] * placed[corners[i][c]]
                for a in ti.static(range(4)):
                    offset[p, a] = total[a]
            warp, weft = vec3(0.0), vec3(0.0)
            for a in ti.static(range(3)):
                warp[a] = offset[UP, a] - offset[DOWN, a]
                weft[a] = offset[RIGHT, a] - offset[LEFT, a]
            e1, e2, e3 = _frame(warp, weft)
            for a in ti.static(range(3)):
                frames[i][a] = e1[a]
                frames[i][3 + a] = e2[a]
                frames[i][6 + a] = e3[a]
            e1, e2, e3 = e1 / spacing, e2 / spacing, e3 / spacing
            found = ti.Matrix.zero(ti.f32, DYNAMIC_COUNT, 1)
            for q in range(POINTS - 1):
                p = q + int(q >= CENTRE)
                local = vec4(vec3(0.0))
                for a in ti.static(range(3)):
                    local += offset[p, a] * vec4(vec3(e1[a], e2[a], e3[a]))
                for a in ti.static(range(4)):  # the fourth is written over
                    found[3 * q + a, 0] = local[a]
            for k in ti.static(range(DYNAMIC_COUNT - OFFSET_COUNT)):
                found[OFFSET_COUNT + k, 0] = here[3] + offset[INNER[k], 3]
            for c in range(DYNAMIC_COUNT):
                scaled = (found[c, 0] - center[c]) * scale[c]
                below = ti.select(scaled < limit, scaled, limit)  # ti.math.clamp would ask for more than this
                found[c, 0] = ti.select(below > -limit, below, -limit)
            to = row[i]
            for c in range(DYNAMIC_COUNT):
                features[to][c] = found[c, 0]


@dataclass(frozen=True)
class Stencil:
    """The stencil points of each coarse vertex, and the features that do not change with the state.

    Attributes:
        corners: the three coarse vertices around each stencil point, int32, shape (n, 3 POINTS).
        weights: their barycentric weights, float32, shape (n, 3 POINTS).
        spacing: distance between stencil points [m].
        static: features of each coarse vertex: which of the other points exist (24), share of the stencil that is
            held (1), slow modes of the mesh (8); float32, shape (n, 33).
        below: finds how far the garments of an outfit are from one another; None for one garment.
    """

    corners: np.ndarray
    weights: np.ndarray
    spacing: float
    static: np.ndarray
    below: LayerDistance | None = None
    _launch: Launch = field(default_factory=lambda: Launch(_read_stencil), init=False, repr=False, compare=False)
    _placed: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_placed", np.zeros((len(self.corners), 4), np.float32))

    @classmethod
    def of(cls, charts: Charts, held: np.ndarray, layer: np.ndarray | None = None) -> "Stencil":
        """Make the stencils of a coarse mesh.

        Args:
            charts: of the mesh.
            held: its held vertices, int, shape (p,).
            layer: of an outfit the number of the garment of each vertex, int, shape (n,).
        """
        ensure_initialized()
        mesh = charts.mesh
        count, spacing = len(mesh.vertices), float(mesh.edge_lengths()[1].mean())
        steps = np.arange(SIDE) - SIDE // 2
        # Rows run along the warp; the weft axis of a chart is turned a quarter counter-clockwise from it.
        offsets = spacing * np.array([(a, b) for a in steps for b in steps], float)
        face, weights, arrived = charts.trace(np.repeat(np.arange(count), POINTS), np.tile(offsets, (count, 1)))
        corners = mesh.faces[face].reshape(count, 3 * POINTS)
        exists = arrived.reshape(count, POINTS)[:, OTHERS].astype(float)
        mark = np.isin(np.arange(count), held).astype(float)
        share = (mark[corners] * weights.reshape(count, -1)).sum(axis=1, keepdims=True) / POINTS
        static = np.concatenate([exists, share, slow_modes(mesh)], axis=1)
        return cls(
            np.ascontiguousarray(corners, np.int32),
            np.ascontiguousarray(weights.reshape(count, -1), np.float32),
            spacing,
            static.astype(np.float32),
            None if layer is None else LayerDistance(mesh, layer),
        )

    def regions(self, count: int = REGIONS) -> np.ndarray:
        """Part the garment into regions by clustering its slow modes.

        Args:
            count: number of regions wanted. There are fewer if regions would have less than MIN_REGION_SIZE vertices on
                average, and never more than there are different modes.

        Returns:
            region of each coarse vertex, int, shape (n,).
        """
        from sklearn.cluster import KMeans

        modes = self.static[:, -MODE_COUNT:]
        count = max(1, min(count, len(modes) // MIN_REGION_SIZE, len(np.unique(modes, axis=0))))
        with threadpool_limits(limits=1):  # the bits of sums depend on the number of threads
            return KMeans(count, n_init=3, random_state=0).fit_predict(modes)

    def read(
        self,
        position: np.ndarray,
        contact: np.ndarray,
        frames: np.ndarray,
        features: np.ndarray,
        center: np.ndarray | None = None,
        *,
        scale: np.ndarray | None = None,
        limit: float = 1e30,
        row: np.ndarray | None = None,
    ) -> None:
        """Read frames and features from a state of the garment; both are written to the given arrays.

        Args:
            position: [m], float32, shape (n, 4); the last column is not used.
            contact: distance from the body as in :class:`pbd.State`, float32, shape (n,).
            frames: receives the frame of each vertex as rows (warp, weft, normal), float32, shape (n, 9).
            features: receives clip((features - center) * scale, -limit, limit) [-], float32, shape (n, DYNAMIC_COUNT).
            center, scale: float32, shape (DYNAMIC_COUNT,); None is 0 and 1.
            limit: of the scaled features [-]; without it they are not clipped.
            row: of ``features`` that each vertex gets, int32, shape (n,); None is its own.
        """
        center = np.zeros(DYNAMIC_COUNT, np.float32) if center is None else center
        scale = np.ones(DYNAMIC_COUNT, np.float32) if scale is None else scale
        self._placed[:, :3] = position[:, :3]
        np.divide(contact if self.below is None else self.below(position, contact), FAR, out=self._placed[:, 3])
        self._launch(
            self._placed,
            self.corners,
            self.weights,
            self.spacing,
            center,
            scale,
            limit,
            frames,
            np.arange(len(frames), dtype=np.int32) if row is None else row,
            features,
        )


def slow_modes(mesh: ClothMesh, modes: int = MODE_COUNT) -> np.ndarray:
    """Lowest non-constant eigenvectors of the mesh's graph Laplacian, scaled to unit variance: shape (n, modes).

    They give the approximate position of a vertex on the garment. Edges weigh 1 / length.

    Args:
        mesh: the mesh.
        modes: number of eigenvectors.
    """
    edges, lengths = mesh.edge_lengths()
    count = len(mesh.vertices)
    weight = 1.0 / lengths
    graph = csr_matrix((weight, (edges[:, 0], edges[:, 1])), (count, count))
    graph = graph + graph.T
    laplacian = diags(np.asarray(graph.sum(axis=1)).ravel()) - graph
    start = np.random.default_rng(0).standard_normal(count)  # a fixed start: the same bits every time
    _, vectors = eigsh(laplacian.tocsc(), k=modes + 1, sigma=-1e-3 * weight.mean(), which="LM", v0=start)
    vectors = vectors[:, 1:]
    vectors *= np.where(vectors[np.abs(vectors).argmax(axis=0), np.arange(modes)] < 0, -1.0, 1.0)
    return vectors / vectors.std(axis=0)
