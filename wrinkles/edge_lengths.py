"""Brings the edges of the middle mesh nearer to their rest lengths after decoding, because cloth keeps its lengths.

The mapping leaves out folds that it cannot predict, and their length is then missing. Edges that are too short push
their ends apart, and edges that are too long pull them together; folds that were predicted grow by this, as in wrinkle
meshes (Mueller and Chentanez 2010, "Wrinkle meshes"), but from a learned first guess. On the fine mesh the same makes
zigzags from edge to edge. The edges of the middle mesh are too long for zigzags; its displacements are spread to the
fine mesh by Loop's rule.
"""

import numpy as np

from pbd.engine import ti
from pbd.mesh import greedy_colors
from wrinkles.levels import Levels, held_between
from wrinkles.surface import Subdivision

__all__ = ["PASSES", "EdgeLengthProjection", "edges_by_color", "middle_edges", "project_lengths"]

PASSES = 8  # sweeps over all edges, unless the caller asks for another number


@ti.func
def project_lengths(
    vertices: ti.template(), edges: ti.template(), lengths: ti.template(), free_edges: ti.i32, sweeps: ti.i32
):
    """Project each edge onto its length in turn (Mueller et al. 2007, "Position based dynamics", distance constraint).

    Vertices have four components, which the compiler loads and stores at once: half the time.

    Args:
        vertices: [m].
        edges, lengths, free_edges: see :class:`EdgeLengthProjection`.
        sweeps: over all edges.
    """
    for _sweep in range(sweeps):
        for c in range(free_edges):
            start, end = vertices[edges[c][0]], vertices[edges[c][1]]
            d = 0.5 * _excess(end - start, lengths[c])
            vertices[edges[c][0]] = start + d
            vertices[edges[c][1]] = end - d
        for c in range(free_edges, edges.shape[0]):
            start, end = vertices[edges[c][0]], vertices[edges[c][1]]
            vertices[edges[c][1]] = end - _excess(end - start, lengths[c])


@ti.func
def _excess(d: ti.math.vec4, length: ti.f32) -> ti.math.vec4:
    """The length that an edge d [m] has too much, as a vector along it."""
    size = ti.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    return ((size - length) / ti.max(size, 1e-12)) * d


class EdgeLengthProjection:
    """The edges of the middle mesh that are projected onto their rest lengths, in Gauss-Seidel sweeps.

    Held vertices stay. A correction both lengthens and shortens edges. A delivered mesh has no such edges: its vertex
    mean already contains the length that its smooth surface lacks in pleats.

    Args:
        levels: of the garment.

    Attributes:
        edges: int32, shape (e, 2), in the order of :func:`edges_by_color`.
        lengths: [m], float32, shape (e,).
        free_edges: number of edges with two free ends, which come first.
    """

    def __init__(self, levels: Levels) -> None:
        edges, lengths = middle_edges(levels)
        middle = levels.subdivision.middle
        is_held = np.zeros(middle.fine_count, bool)
        is_held[held_between(middle, levels.coarse_held)] = True
        if levels.subdivision.binding is not None:
            edges, lengths = edges[:0], lengths[:0]
        self.edges, lengths, self.free_edges = edges_by_color(edges, lengths, is_held)
        self.lengths = lengths.astype(np.float32)


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
    kept = ~is_held[edges].all(axis=1)
    edges, lengths = edges[kept], lengths[kept]
    edges = np.where(is_held[edges[:, 1:]], edges[:, ::-1], edges)
    order = np.lexsort((greedy_colors(edges, len(is_held)), is_held[edges[:, 0]]))
    free = len(edges) - int(is_held[edges[:, 0]].sum())
    return np.ascontiguousarray(edges[order], np.int32), lengths[order], free
