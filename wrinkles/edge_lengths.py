"""Brings the edges of the middle mesh nearer to their rest lengths after decoding, because cloth keeps its lengths.

The mapping leaves out folds that it cannot predict, and their length is then missing. Edges that are too short push
their ends apart, and edges that are too long pull them together; folds that were predicted grow by this, as in wrinkle
meshes (Mueller and Chentanez 2010, "Wrinkle meshes"), but from a learned first guess. On the fine mesh the same makes
zigzags from edge to edge. The edges of the middle mesh are too long for zigzags; its displacements are spread to the
fine mesh by Loop's rule.
"""

import numpy as np

from pbd.engine import ensure_initialized, ti
from pbd.geometry import Float1, Int1, Int2, Vec3, vec3
from pbd.mesh import greedy_colors
from pbd.taichi_internals import Launch
from wrinkles.levels import Levels, held_between
from wrinkles.surface import Subdivision, csr_arrays

__all__ = ["EdgeLengthProjection", "edges_by_color", "middle_edges"]

PASSES = 8  # sweeps over all edges, unless the caller asks for another number


@ti.kernel
def _keep_lengths(vertices: Vec3, inverse_mass: Float1, edges: Int2, lengths: Float1, passes: ti.i32):
    """Project each edge onto its length in turn (Mueller et al. 2007, "Position based dynamics", distance constraint).

    ``inverse_mass`` is 0 for held vertices.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        for _pass in range(passes):
            for c in range(edges.shape[0]):
                i, j = edges[c][0], edges[c][1]
                d = vertices[j] - vertices[i]
                size = d.norm()
                total = inverse_mass[i] + inverse_mass[j]
                d *= (size - lengths[c]) / ti.max(size * total, 1e-12)
                vertices[i] += inverse_mass[i] * d
                vertices[j] -= inverse_mass[j] * d


@ti.kernel
def _spread(start: Int1, index: Int1, value: Float1, before: Vec3, middle: Vec3, fine: Vec3):
    """Move fine vertices by the displacements of the middle ones, times a sparse matrix.

    ``before`` holds the middle vertices before they moved, and afterwards their displacements.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(middle.shape[0]):
            before[i] = middle[i] - before[i]
        for i in range(fine.shape[0]):
            total = vec3(0.0)
            for q in range(start[i], start[i + 1]):
                total += value[q] * before[index[q]]
            fine[i] += total


class EdgeLengthProjection:
    """Projects edges of the middle mesh onto their rest lengths, in Gauss-Seidel sweeps; held vertices stay.

    A correction both lengthens and shortens edges. A delivered mesh is not changed: its vertex mean already contains
    the length that its smooth surface lacks in pleats.

    Args:
        levels: of the garment.
    """

    def __init__(self, levels: Levels) -> None:
        ensure_initialized()
        edges, lengths = middle_edges(levels)
        middle = levels.subdivision.middle
        self._delivered = levels.subdivision.binding is not None
        self._inverse_mass = np.ones(middle.fine_count, np.float32)
        self._inverse_mass[held_between(middle, levels.coarse_held)] = 0.0
        free = self._inverse_mass[edges].any(axis=1)
        edges, lengths = edges[free], lengths[free]
        order = np.argsort(greedy_colors(edges, middle.fine_count), kind="stable")
        self._edges = np.ascontiguousarray(edges[order], np.int32)
        self._lengths = lengths[order].astype(np.float32)
        self._from_middle = csr_arrays(levels.subdivision.from_middle)
        self._before = np.zeros((middle.fine_count, 3), np.float32)
        self._keep_lengths, self._spread = Launch(_keep_lengths), Launch(_spread)

    def __call__(self, middle: np.ndarray, fine: np.ndarray, passes: int = PASSES) -> None:
        """Bring the edges of the middle mesh nearer to their lengths, and move the fine mesh along.

        Args:
            middle, fine: [m], float32, shapes (q, 3), (N, 3); changed in place.
            passes: number of sweeps over all edges.
        """
        if self._delivered:
            return
        self._before[:] = middle
        self._keep_lengths(middle, self._inverse_mass, self._edges, self._lengths, passes)
        self._spread(*self._from_middle, self._before, middle, fine)


def middle_edges(levels: Levels) -> tuple[np.ndarray, np.ndarray]:
    """Edges of the middle mesh, and their rest lengths along the fine surface.

    Returns:
        edges, int32, shape (e, 2), and lengths [m], shape (e,).
    """
    whole = levels.subdivision
    upper = Subdivision.of(whole.middle.faces, whole.middle.fine_count, len(whole.steps) - 1, whole.binding)
    # These vertices lie on the fine surface, so that the smooth surface through them is the fine one.
    vertices = whole.cut_surface(levels.coarse.vertices)[: whole.middle.fine_count]
    return upper.meshes(vertices)[0].edge_lengths()


def edges_by_color(edges: np.ndarray, lengths: np.ndarray, is_held: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Edges in the order in which their lengths are corrected: no two beside each other share a vertex.

    Edges with two held ends are left out. Those with one follow after the others and have it first.

    Args:
        edges: int, shape (e, 2).
        lengths: [m], shape (e,).
        is_held: whether each vertex is held, bool, shape (n,).

    Returns:
        edges, int32, their lengths, and the number of those with two free ends.
    """
    order = np.argsort(greedy_colors(edges, len(is_held)), kind="stable")
    edges, lengths = edges[order], lengths[order]
    ends = is_held[edges].sum(axis=1)
    edges = np.where(is_held[edges[:, 1:]], edges[:, ::-1], edges)
    free, half = np.flatnonzero(ends == 0), np.flatnonzero(ends == 1)
    chosen = np.concatenate([free, half])
    return np.ascontiguousarray(edges[chosen], np.int32), lengths[chosen], len(free)
