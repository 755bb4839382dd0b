"""Fine vertices of a garment: smooth surface, wrinkles of the patches and vertex mean in one pass."""

import numpy as np
from scipy.sparse import csr_matrix, hstack

from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Int1, Int3, Vec3, Vec4, vec3, vec4, xyz
from pbd.taichi_internals import Launch
from wrinkles.patches import Patches
from wrinkles.surface import Subdivision, csr_arrays

__all__ = ["FineSurface", "sparse_row"]


@ti.func
def sparse_row(start: ti.template(), index: ti.template(), value: ti.template(), source: ti.template(), i: ti.i32):
    """Row i of a sparse matrix times the vectors of ``source``, of four components."""
    total = ti.math.vec4(0.0)
    for q in range(start[i], start[i + 1]):
        total += value[q] * source[index[q]]
    return total


@ti.func
def _side(grids: ti.template(), frames: ti.template()) -> ti.i32:
    """Nodes along a side of the grids, one of which belongs to each frame's three axes."""
    return int(ti.sqrt(3.0 * grids.shape[0] / frames.shape[0]) + 0.5)


@ti.func
def _patch(
    i: ti.i32, c: ti.template(), node: ti.template(), share: ti.template(), side: ti.i32, grids: ti.template()
) -> vec3:
    """What the patch of corner c adds to vertex i, in the patch's own frame [m]: read with bilinear interpolation."""
    first, w = node[i][c], share[3 * i + c]
    near = w[0] * grids[first] + w[1] * grids[first + 1]
    return near + w[2] * grids[first + side] + w[3] * grids[first + side + 1]


@ti.func
def _turned(d: vec3, j: ti.i32, frames: ti.template()) -> vec3:
    """A vector in the frame of coarse vertex j, turned into space."""
    return d[0] * frames[3 * j] + d[1] * frames[3 * j + 1] + d[2] * frames[3 * j + 2]


@ti.func
def _wrinkles(
    i: ti.i32,
    node: ti.template(),
    share: ti.template(),
    side: ti.i32,
    corners: ti.template(),
    grids: ti.template(),
    frames: ti.template(),
) -> vec3:
    """What the patches add to vertex i [m]; nothing where there are no grids."""
    added = vec3(0.0)
    if grids.shape[0] > 0:
        for c in ti.static(range(3)):
            added += _turned(_patch(i, c, node, share, side, grids), corners[i][c], frames)
    return added


@ti.kernel
def _make_subdivided(
    start: Int1,
    index: Int1,
    value: Float1,
    middle: Vec4,
    node: Int3,
    share: Vec4,
    corners: Int3,
    blend: Vec3,
    mean: Vec3,
    grids: Vec3,
    frames: Vec3,
    fine: Vec3,
):
    """Smooth surface, wrinkles and mean; see :meth:`FineSurface.__call__`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        side = _side(grids, frames)
        for i in range(fine.shape[0]):
            x = xyz(sparse_row(start, index, value, middle, i))
            if grids.shape[0] > 0:
                for c in ti.static(range(3)):
                    d = _patch(i, c, node, share, side, grids) + blend[i][c] * mean[i]
                    x += _turned(d, corners[i][c], frames)
            fine[i] = x


@ti.kernel
def _make_delivered(
    smooth: Vec4,
    node: Int3,
    share: Vec4,
    corners: Int3,
    grids: Vec3,
    frames: Vec3,
    start: Int1,
    index: Int1,
    value: Float1,
    source: Vec4,
    fine: Vec3,
):
    """Smooth surface, smoothed wrinkles and mean of a delivered mesh by one sparse matrix; see :class:`FineSurface`.

    Its columns stand for the smooth middle vertices, the wrinkles of the fine vertices and the axes of the frames;
    ``source`` receives these in that order.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        first, count, side = smooth.shape[0], fine.shape[0], _side(grids, frames)
        for i in range(first):
            source[i] = smooth[i]
        for i in range(count):
            added = _wrinkles(i, node, share, side, corners, grids, frames)
            source[first + i] = vec4(added)
        for k in range(frames.shape[0]):
            source[first + count + k] = vec4(ti.select(grids.shape[0] > 0, frames[k], vec3(0.0)))
        for i in range(count):
            fine[i] = xyz(sparse_row(start, index, value, source, i))


class FineSurface:
    """Makes fine vertices from the smooth middle ones and the grids of all coarse vertices.

    Args:
        subdivision: from the coarse to the fine mesh.
        patches: where each fine vertex reads the grids.
        vertex_mean: displacement of each fine vertex in its own frame [m], float32, shape (N, 3); see
            :mod:`wrinkles.vertex_mean`.
    """

    def __init__(self, subdivision: Subdivision, patches: Patches, vertex_mean: np.ndarray) -> None:
        ensure_initialized()
        u, v = (patches.within.reshape(-1, 3, 2)[..., axis].astype(float) for axis in (0, 1))
        share = np.stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v], axis=-1) * patches.blend[..., None]
        node = (patches.cell + patches.grid.nodes * patches.corners).astype(np.int32)
        self._reading = node, np.ascontiguousarray(share.reshape(-1, 4), np.float32), patches.corners
        self._blend, self._mean = patches.blend, vertex_mean
        self._delivered = patches.smoothing is not None
        matrix = subdivision.from_middle
        if patches.smoothing is not None:
            matrix = hstack([matrix, patches.smoothing, _mean_rows(patches.turning, vertex_mean)])
        self._rows = csr_arrays(csr_matrix(matrix))
        self._source = np.zeros((matrix.shape[1] if self._delivered else 0, 4), np.float32)
        self._nothing = np.zeros((0, 3), np.float32)
        self._make = Launch(_make_delivered if self._delivered else _make_subdivided)

    def __call__(self, smooth: np.ndarray, grids: np.ndarray | None, frames: np.ndarray, fine: np.ndarray) -> None:
        """Write fine vertices.

        Args:
            smooth: middle vertices of the smooth surface [m], float32, shape (q, 4).
            grids: displacements in the patches' frames [m], float32, shape (n, 3 nodes); None leaves out wrinkles and
                mean.
            frames: of the coarse vertices, float32, shape (n, 9).
            fine: receives the fine vertices [m], float32, shape (N, 3).
        """
        nodes = self._nothing if grids is None else grids.reshape(-1, 3)
        axes = frames.reshape(-1, 3)
        if self._delivered:
            self._make(smooth, *self._reading, nodes, axes, *self._rows, self._source, fine)
        else:
            self._make(*self._rows, smooth, *self._reading, self._blend, self._mean, nodes, axes, fine)


def _mean_rows(turning: csr_matrix, mean: np.ndarray) -> csr_matrix:
    """Matrix that turns the means into space: times the axes of the coarse vertices' frames, shape (N, 3 n).

    Args:
        turning: weights of the coarse vertices' frames, see :class:`wrinkles.patches.Patches`, shape (N, n).
        mean: [m], shape (N, 3).
    """
    weights = turning.tocoo()
    rows, columns = np.repeat(weights.row, 3), 3 * np.repeat(weights.col, 3) + np.tile(range(3), weights.nnz)
    values = (weights.data[:, None] * mean[weights.row]).ravel()
    return csr_matrix((values, (rows, columns)), (turning.shape[0], 3 * turning.shape[1]))
